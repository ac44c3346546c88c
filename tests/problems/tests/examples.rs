//! The examples do what they say, on problems whose answer is known.

use std::path::PathBuf;
use std::process::Command;

/// A square of one metre whose edges agree, its corners put beside their places.
const SQUARE: &str = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1.1 0.1 0 0 0 0.70710678 0.70710678
VERTEX_SE3:QUAT 2 0.9 1.2 0.1 0 0 1 0
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0.70710678 0.70710678 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1
EDGE_SE3:QUAT 1 2 1 0 0 0 0 0.70710678 0.70710678 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1
";

#[test]
fn a_pose_graph_in_a_file_is_solved() {
    let test = "a_pose_graph_in_a_file_is_solved";
    let Some(example) = lsfb_tests::example(test, "pose_graph") else {
        return;
    };
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let (input, output) = (folder.join("square.g2o"), folder.join("solved.g2o"));
    std::fs::write(&input, SQUARE).expect("file");
    let arguments = [&input, &output];
    let run = Command::new(example)
        .args(arguments)
        .output()
        .expect("the example");
    assert!(run.status.success(), "{run:?}");
    let said = String::from_utf8(run.stdout).expect("text");
    assert!(said.starts_with("3 poses, 2 edges"), "{said}");
    let solved = std::fs::read_to_string(&output).expect("file");
    let last = solved.lines().nth(2).expect("a vertex");
    let numbers: Vec<f64> = last
        .split(' ')
        .skip(2)
        .map(|n| n.parse().expect("a number"))
        .collect();
    for (value, truth) in numbers.iter().zip([1.0, 1.0, 0.0]) {
        assert!((value - truth).abs() < 1e-6, "{solved}");
    }
}
