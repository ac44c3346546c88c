//! The examples do what they say: a recording is written, read, cut short and recovered.

use std::path::Path;
use std::process::Command;

/// What an example prints.
fn run(example: &Path, paths: &[&Path]) -> String {
    let output = Command::new(example)
        .args(paths)
        .output()
        .expect("the example");
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn a_recording_is_written_read_and_recovered() {
    let example = |name| lsfb_tests::example("a_recording_is_written_read_and_recovered", name);
    let (Some(write), Some(read), Some(recover)) = (
        example("write_recording"),
        example("read_recording"),
        example("recover_recording"),
    ) else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    run(&write, &[&path("whole.mcap")]);
    let whole = run(&read, &[&path("whole.mcap")]);
    assert!(
        whole.contains("/imu0/") && whole.contains("200.0 Hz"),
        "{whole}"
    );
    assert!(!whole.contains("damaged"), "{whole}");

    let bytes = std::fs::read(path("whole.mcap")).expect("the recording");
    std::fs::write(path("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).expect("file");
    assert!(run(&read, &[&path("cut.mcap")]).contains("damaged: "));
    let said = run(&recover, &[&path("cut.mcap"), &path("again.mcap")]);
    assert!(said.contains("the new file has 0 damaged places"), "{said}");
    let again = run(&read, &[&path("again.mcap")]);
    assert!(
        again.contains("/imu0/") && !again.contains("damaged"),
        "{again}"
    );
}
