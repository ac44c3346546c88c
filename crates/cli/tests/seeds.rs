//! Whose seed it is: that of the command line, else that of the settings.

use crate::answer::json;

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
