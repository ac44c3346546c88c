//! Whose seed it is: that of the command line, else that of the settings. What else the settings have is not named beside them.

use crate::answer::json;
use crate::process::lsfb;

/// As little as can be recorded.
const SETTINGS: &str = "seed = 5\ntexel_m = 0.05\n[scan]\nduration_s = 1.0\n[glasses]\nduration_s = 1.0\nheight_m = 1.62\n\
[scan_cameras]\nwidth = 64\nheight = 40\n[glasses_cameras]\nwidth = 64\nheight = 40\nfocal_per_width = 0.4547\n";

#[test]
fn the_seed_of_the_settings_is_taken_unless_another_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("five.toml"), SETTINGS).expect("settings");
    let simulate = |out, named: &[&str]| {
        let all = [
            &["sim", "--config", "five.toml", "--out", out, "--record"],
            named,
        ];
        let made = json(root, &all.concat(), 0);
        let written = std::fs::read_to_string(root.join(out).join("sim.toml")).expect("settings");
        assert!(
            written.contains(&format!("seed = {}\n", made["seed"])),
            "{written}"
        );
        made["seed"].clone()
    };
    assert_eq!(simulate("own", &[]), 5);
    assert_eq!(simulate("named", &["--seed", "7"]), 7);
}

/// The settings would have been passed over without a word.
#[test]
fn what_settings_decide_is_not_named_beside_them() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("five.toml"), SETTINGS).expect("settings");
    let named: [&[&str]; 8] = [
        &["--place", "atrium"],
        &["--motion", "C3"],
        &["--device", "android"],
        &["--scene", "mine.glb"],
        &["--months-later", "3"],
        &["--night"],
        &["--baked-light"],
        &["--simple-light"],
    ];
    for more in named {
        for command in [&["sim"][..], &["sim", "preview"]] {
            let all = [command, &["--config", "five.toml", "--out", "made"], more].concat();
            let refused = lsfb(root, &all);
            let said = String::from_utf8_lossy(&refused.stderr);
            assert_eq!(refused.status.code(), Some(2), "{all:?}: {said}");
            let names_both = said.contains(more[0]) && said.contains("--config");
            assert!(names_both, "{all:?}: {said}");
        }
    }
    assert!(!root.join("made").exists());
}
