//! The programs in docs/mavlink.md, run as they stand there.

use std::fs;

use tests::program::{self, workspace};
use tests::python;

/// The page's blocks of Python.
fn examples() -> Vec<String> {
    let page = fs::read_to_string(workspace().join("docs/mavlink.md")).unwrap();
    let blocks = page.split("```python\n").skip(1);
    blocks.map(|block| block.split("```").next().unwrap().to_owned()).collect()
}

/// Each of them pushes the vehicle north.
#[test]
fn the_manuals_programs_fly() {
    let examples = examples();
    assert_eq!(examples.len(), 2, "pymavlink's and MAVSDK's");
    let folder = tempfile::tempdir().unwrap();
    for (k, example) in examples.iter().enumerate() {
        let (sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
        let file = folder.path().join(format!("example{k}.py"));
        assert!(example.contains("127.0.0.1:14550"), "{example}");
        fs::write(&file, example.replace("127.0.0.1:14550", &address.to_string())).unwrap();
        let mut command = std::process::Command::new(python::environment().unwrap().join("python"));
        command.arg(&file);
        program::Program::spawn("the example", command).unwrap().wait().unwrap().good().unwrap();
        sitl.interrupt().unwrap();
        let finished = sitl.wait().unwrap();
        assert!(!finished.stdout.contains("commands: 0 sent"), "{example}\n{}", finished.stdout);
    }
}
