//! What `udev/` gives a host: rules that can be read, and an installer that says what it does and does it once.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use lsfb_tests::{Lacks, skip, workspace_root};

fn folder() -> PathBuf {
    workspace_root().join("udev")
}

/// Runs the installer and takes what it says.
fn install(arguments: &[&str]) -> String {
    let output = Command::new("sh")
        .arg(folder().join("install.sh"))
        .args(arguments)
        .output()
        .expect("a shell");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{said}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    said
}

/// Every file below a folder, by its path there.
fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("folder") {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).expect("below").to_owned();
                found.insert(name, fs::read(&path).expect("file"));
            }
        }
    }
    found
}

#[test]
fn the_installer_says_what_it_would_do_does_it_once_and_takes_it_back() {
    let root = tempfile::tempdir().expect("folder");
    let at = root.path().to_str().expect("UTF-8");
    let shown = install(&["--root", at]);
    assert!(shown.contains("nothing was changed"), "{shown}");
    assert!(files(root.path()).is_empty());

    // Somebody's own settings stay beside ours.
    let limits = root.path().join("etc/security/limits.d/60-lsfb.conf");
    fs::create_dir_all(limits.parent().expect("folder")).expect("folder");
    fs::write(&limits, "@lsfb - rtprio 10\n").expect("file");
    let shown = install(&["--root", at]);
    assert!(shown.contains("-@lsfb - rtprio 10"), "{shown}");

    install(&["--apply", "--root", at]);
    let installed = files(root.path());
    let rules = fs::read_dir(folder())
        .expect("folder")
        .flatten()
        .filter(|entry| {
            entry
                .path()
                .extension()
                .is_some_and(|ending| ending == "rules")
        });
    for rule in rules {
        let name = Path::new("etc/udev/rules.d").join(rule.file_name());
        assert_eq!(installed[&name], fs::read(rule.path()).expect("rules"));
    }
    for name in ["etc/sysctl.d/60-lsfb.conf", "etc/tmpfiles.d/lsfb.conf"] {
        assert!(installed.contains_key(Path::new(name)), "{name}");
    }
    assert!(!installed.contains_key(Path::new("etc/chrony/conf.d/lsfb.conf")));

    let again = install(&["--apply", "--root", at]);
    assert!(
        !again.contains("wrote") && !again.contains("replaced"),
        "{again}"
    );
    assert_eq!(files(root.path()), installed);
    install(&["--apply", "--gnss", "--root", at]);
    assert!(files(root.path()).contains_key(Path::new("etc/chrony/conf.d/lsfb.conf")));

    install(&["--remove", "--root", at]);
    let left = files(root.path());
    assert_eq!(left.len(), 1, "{:?}", left.keys());
    assert_eq!(
        fs::read_to_string(&limits).expect("file"),
        "@lsfb - rtprio 10\n"
    );
}

/// Each rule is a list of `KEY{attribute}op"value"` with at least one comparison and one assignment.
#[test]
fn every_rule_is_well_formed_and_its_file_sorts_where_it_must() {
    let mut seen = 0;
    for entry in fs::read_dir(folder()).expect("folder").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.ends_with(".rules") {
            continue;
        }
        // After the system's 60- rules, which name the devices, and before 73-seat-late and 77-mm.
        assert!(name.starts_with("70-lsfb-"), "{name}");
        let text = fs::read_to_string(entry.path()).expect("rules");
        for rule in text
            .lines()
            .filter(|l| !l.is_empty() && !l.starts_with('#'))
        {
            let (mut comparisons, mut assignments) = (0, 0);
            for term in rule.split(", ") {
                let (left, value) = term.split_once('"').expect(term);
                assert!(
                    value.ends_with('"') && value.matches('"').count() == 1,
                    "{term}"
                );
                let key = left.trim_end_matches(['=', '+']);
                assert!(key.starts_with(|c: char| c.is_ascii_uppercase()), "{term}");
                assert_eq!(key.contains('{'), key.ends_with('}'), "{term}");
                match &left[key.len()..] {
                    "==" => comparisons += 1,
                    "=" | "+=" => assignments += 1,
                    operator => panic!("{operator} in {rule}"),
                }
            }
            assert!(comparisons > 0 && assignments > 0, "{rule}");
            seen += 1;
        }
    }
    assert!(seen >= 20, "{seen}");
}

/// What systemd itself makes of the rules: `udevadm` reads them in a file system of their own.
#[test]
fn udevadm_reads_every_rule_without_complaint() {
    const TEST: &str = "udevadm_reads_every_rule_without_complaint";
    let read = |extra: &str| {
        let script = format!(
            "mount -t tmpfs tmpfs /run && mkdir -p /run/udev/rules.d && cp {}/*.rules /run/udev/rules.d && {extra} \
             udevadm test /sys/class/net/lo 2>&1",
            folder().display()
        );
        let arguments = ["--user", "--map-root-user", "--mount", "sh", "-c", &script];
        let output = Command::new("unshare").args(arguments).output().ok()?;
        Some(String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let broken = "echo 'FOO' > /run/udev/rules.d/99-broken.rules;";
    let (Some(said), Some(warned)) = (read(""), read(broken)) else {
        return skip(TEST, Lacks::Program, "no unshare here");
    };
    // Where it does not complain about what is wrong, it says nothing about what is right.
    if !warned.contains("99-broken.rules:1") {
        return skip(TEST, Lacks::Program, "no udevadm that may be run here");
    }
    let about_ours: Vec<&str> = said.lines().filter(|line| line.contains("lsfb")).collect();
    let complaints: Vec<_> = about_ours
        .iter()
        .filter(|line| !line.starts_with("Reading rules file: "))
        .collect();
    assert!(complaints.is_empty(), "{complaints:?}");
    let files = fs::read_dir(folder()).expect("folder").flatten();
    let rules = files.filter(|e| e.path().extension().is_some_and(|e| e == "rules"));
    assert_eq!(about_ours.len(), rules.count());
}
