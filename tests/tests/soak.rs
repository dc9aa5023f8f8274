//! Twenty vehicles, stations that come and go, lossy links, a bridge that is restarted and whose disk is full:
//! half a minute of `tests/soak/soak.py`, which runs for as long as it is told.

use tests::{program, python};

#[test]
fn nothing_is_lost_or_left_behind_in_half_a_minute() {
    let folder = program::path("gcs").unwrap().parent().unwrap().to_path_buf();
    let args = ["--bin".into(), folder.into_os_string(), "--minutes".into(), "0.5".into()];
    let said = python::script("../soak/soak.py", &args).unwrap().good().unwrap();
    assert!(said.trim().ends_with("ok"), "{said}");
}
