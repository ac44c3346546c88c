//! The example does what it says, on a problem whose answer is known.

use std::process::Command;

/// The column stands at (2, 1) and has a radius of 0.3 m; one return is wrong by 0.8 m.
#[test]
fn the_column_is_found_in_spite_of_a_wrong_return() {
    let test = "the_column_is_found_in_spite_of_a_wrong_return";
    let Some(example) = lsfb_tests::example(test, "custom_residual") else {
        return;
    };
    let output = Command::new(example).output().expect("the example");
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8(output.stdout).expect("text");
    for (name, truth) in [("x", 2.0), ("y", 1.0), ("radius", 0.3)] {
        let line = said
            .lines()
            .find(|line| line.starts_with(name))
            .expect("a line");
        let value: f64 = line
            .split_whitespace()
            .nth(1)
            .expect("a value")
            .parse()
            .expect("a number");
        assert!((value - truth).abs() < 0.02, "{said}");
    }
}
