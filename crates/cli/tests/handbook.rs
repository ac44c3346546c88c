//! Every command of `docs/devices.md` does what is said there, with mock devices in place of the hardware.

use std::path::Path;

use crate::process::lsfb;
use crate::running::Running;
use crate::simulated_session::{Ports, one_rig_at_a_time, recorded, text};
use nix::sys::signal::Signal;

/// Commands of `lsfb` in the handbook, as words.
fn commands() -> Vec<Vec<String>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/devices.md");
    let handbook = std::fs::read_to_string(path).expect("docs/devices.md");
    let blocks = handbook.split("```sh\n").skip(1);
    let lines = blocks
        .filter_map(|rest| rest.split("```").next())
        .flat_map(str::lines);
    let lines = lines.filter_map(|line| line.trim().strip_prefix("lsfb "));
    lines
        .map(|line| line.split_whitespace().map(str::to_owned).collect())
        .collect()
}

#[test]
fn every_command_of_the_first_day_works() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let _alone = one_rig_at_a_time();
    let source = recorded(4).join("scan.mcap");
    let ports = Ports::free().arguments();
    let arguments = ["mock", text(&source), "--out", "mock"].map(str::to_owned);
    let mut mock = Running::lsfb(root, arguments.into_iter().chain(ports));
    mock.wait_for("devices.toml");
    std::fs::copy(root.join("mock/devices.toml"), root.join("devices.toml")).expect("a list");
    let commands = commands();
    assert!(commands.len() >= 5, "{commands:?}");
    for words in commands {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let code = match words.iter().position(|word| *word == "--screen") {
            // Nobody presses START here; another test does.
            Some(at) => {
                let mut words: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
                words[at + 1] = "127.0.0.1:0".to_owned();
                let mut scan = Running::lsfb(root, words);
                scan.wait_for("screen: ");
                scan.signal(Signal::SIGINT);
                scan.wait().code()
            }
            None => lsfb(root, &words).status.code(),
        };
        let expected: &[i32] = match words[..] {
            // What this machine lacks is no matter of the handbook's.
            ["doctor", "--host", ..] => &[0, 3, 4],
            [_, _, _, _, _, "--screen", ..] => &[0, 130],
            _ => &[0],
        };
        let code = code.expect("an exit code");
        assert!(expected.contains(&code), "{words:?}: {code}");
    }
    assert!(root.join("first.mcap").exists());
}
