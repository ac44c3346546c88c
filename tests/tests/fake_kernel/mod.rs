//! Runs a test a second time, below `lsfb-fakekernel`, where it finds devices that this kernel may not have.

use std::process::Command;

use lsfb_tests::fake_kernel::library;

pub use lsfb_tests::fake_kernel::is_possible;

/// Runs the test `name` of this program again, below the emulated kernel, with `variables` set.
pub fn run_below(name: &str, variables: &[(&str, String)]) {
    let output = Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", name, "--nocapture"])
        .env("LD_PRELOAD", library())
        .envs(variables.iter().map(|(key, value)| (*key, value)))
        .output()
        .expect("this program runs");
    let said = String::from_utf8_lossy(&output.stdout);
    let failed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{failed}");
    assert!(said.contains("1 passed"), "{said}");
}
