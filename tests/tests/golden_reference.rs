//! The golden vectors are what the independent reference in Python makes of the paper: CI compares them.

use tests::python;

/// The files that `tests/python/reference/generate.py` makes.
const FILES: usize = 11;

#[test]
fn the_reference_makes_the_golden_vectors() {
    let said = python::torch_script("reference/generate.py", &["--check"]).unwrap().good().unwrap();
    assert_eq!(said.matches(": agrees, ").count(), FILES, "{said}");
}

#[test]
fn a_golden_vector_that_is_off_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    python::torch_script("reference/generate.py", &["--out", out]).unwrap().good().unwrap();
    let file = dir.path().join("propulsion.json");
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.contains("\"P\": 167.0"), "{text}");
    std::fs::write(&file, text.replace("\"P\": 167.0", "\"P\": 167.000001")).unwrap();

    let told = python::torch_script("reference/generate.py", &["--recompute", out]).unwrap();
    assert!(told.stdout.contains("propulsion: DIFFERS, .cases[0].P"), "{}", told.stdout);
    assert!(told.good().is_err(), "a difference must end with an error");
}

#[test]
fn the_reference_flies_the_four_controllers() {
    let said = python::torch_script("reference/fly.py", &["--scenario", "2"]).unwrap().good().unwrap();
    let names: Vec<_> = said.lines().skip(2).filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(names, ["crpl", "apc", "rcc-paper", "ucc-paper"], "{said}");
    // The metrics of UCC in golden flights where no packet is lost.
    assert!(said.contains("ucc-paper    1.000   0.0481   136.0     8160     0.1941   0.00"), "{said}");
}
