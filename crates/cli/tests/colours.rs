//! Colours: on terminals alone, where they are wanted, and never in what programs read.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::session::with;
use nix::pty::openpty;

const RED: &str = "\x1b[1;31m";
const YELLOW: &str = "\x1b[1;33m";
const GREEN: &str = "\x1b[1;32m";
const CYAN: &str = "\x1b[36m";
const COLOURS: [&str; 4] = [RED, YELLOW, GREEN, CYAN];

/// What `lsfb` writes to a terminal that is its stdout and stderr.
fn on_a_terminal(folder: &Path, arguments: &[&str], variable: Option<(&str, &str)>) -> String {
    let pair = openpty(None, None).expect("a pseudo-terminal");
    let other = || Stdio::from(pair.slave.try_clone().expect("the terminal"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_lsfb"));
    command.args(arguments).current_dir(folder);
    command.env_remove("NO_COLOR").env("TERM", "xterm");
    command.envs(variable);
    command.stdin(Stdio::null()).stdout(other()).stderr(other());
    let mut child = command.spawn().expect("the built binary");
    // Only the child keeps the terminal open: when it ends, reading does.
    drop(command);
    drop(pair.slave);
    let mut said = Vec::new();
    let mut buffer = [0; 4096];
    let mut screen = File::from(pair.master);
    while let Ok(read @ 1..) = screen.read(&mut buffer) {
        said.extend_from_slice(&buffer[..read]);
    }
    child.wait().expect("its end");
    String::from_utf8_lossy(&said).into_owned()
}

fn is_plain(text: &str) -> bool {
    COLOURS.iter().all(|colour| !text.contains(colour))
}

/// Findings of every verdict, of a machine and of recordings.
#[test]
fn verdicts_are_coloured_on_a_terminal_unless_nobody_wants_it() {
    let folder = with(&["scan.mcap"]);
    let path = folder.path();
    for arguments in [
        &["doctor", "--host", "."][..],
        &["doctor", "scan.mcap"],
        &["clock", "scan.mcap", "--out", "a.html"],
    ] {
        let said = on_a_terminal(path, arguments, None);
        let verdicts = ["PASS", "WARN", "FAIL", "UNKNOWN"];
        let colours = [GREEN, YELLOW, RED, YELLOW];
        let mut found = 0;
        for (verdict, colour) in verdicts.iter().zip(colours) {
            let all = said.matches(verdict).count();
            let coloured = said.matches(&format!("{colour}{verdict}\x1b[0m")).count();
            assert_eq!(coloured, all, "{arguments:?}: {verdict} in {said}");
            found += coloured;
        }
        assert!(found > 0, "{arguments:?}: {said}");
    }
    let judged = |variable| on_a_terminal(path, &["doctor", "scan.mcap"], Some(variable));
    for variable in [("NO_COLOR", "1"), ("TERM", "dumb")] {
        let said = judged(variable);
        assert!(is_plain(&said), "{variable:?}: {said}");
    }
    // An empty variable wants nothing, by its specification.
    assert!(!is_plain(&judged(("NO_COLOR", ""))));
}

#[test]
fn errors_are_coloured_on_a_terminal_too() {
    let folder = tempfile::tempdir().expect("folder");
    let arguments = ["map", "missing.mcap", "--out", "map"];
    let said = on_a_terminal(folder.path(), &arguments, None);
    assert!(said.contains(&format!("{RED}error\x1b[0m: ")), "{said}");
    let said = on_a_terminal(folder.path(), &arguments, Some(("NO_COLOR", "1")));
    assert!(is_plain(&said) && said.contains("error: "), "{said}");
}

/// A word in a recording's or folder's name would be coloured inside a string.
#[test]
fn json_has_no_colours_on_a_terminal() {
    let folder = tempfile::tempdir().expect("folder");
    let odd = folder.path().join("a FAIL b");
    std::fs::create_dir(&odd).expect("folder");
    let arguments = ["--json", "--quiet", "doctor", "--host", "a FAIL b"];
    let said = on_a_terminal(folder.path(), &arguments, None);
    let found: serde_json::Value = serde_json::from_str(said.trim()).expect("JSON");
    assert!(
        found["verdict"].is_string() && said.contains("a FAIL b"),
        "{said}"
    );
}
