//! `lsfb bench ba` on a short walk.

use std::path::Path;
use std::process::Output;

use crate::answer::json;
use crate::pages;
use crate::process::lsfb;

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).expect("a file")
}

#[test]
fn a_growing_problem_is_solved_as_exactly_as_a_whole_one_and_peers_stand_beside() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(
        root.join("peer.csv"),
        "keyframe,cpu_ms,cost\n10,2.5,\n20,4,1e6\n",
    )
    .expect("file");
    let arguments =
        "bench ba --keyframes 60 --points 60 --batch-every 20 --out ba --peer Peer=peer.csv";
    let arguments: Vec<&str> = arguments.split(' ').collect();
    let printed = json(root, &arguments, 0);
    let solvers = &printed["solvers"];
    assert_eq!(solvers[0]["solver"], "incremental");
    assert_eq!(solvers[0]["updates"], 60);
    assert_eq!(solvers[1]["updates"], 3);
    let above = solvers[0]["cost_above_batch"].as_f64().expect("a number");
    assert!(above.abs() < 1e-6, "{above:.1e}");
    assert_eq!(solvers[2]["solver"], "Peer");
    assert_eq!(solvers[2]["max_ms"], 4.0);
    assert!(
        solvers[2]["cost_above_batch"]
            .as_f64()
            .is_some_and(|c| c > 1.0)
    );

    let problem = std::fs::read_to_string(root.join("ba/problem.txt")).expect("problem");
    let lines = |word: &str| problem.lines().filter(|l| l.starts_with(word)).count();
    assert_eq!(lines("keyframe "), 60);
    assert_eq!(Some(lines("see ") as u64), printed["observations"].as_u64());
    let page = std::fs::read_to_string(root.join("ba/ba.html")).expect("page");
    pages::are_whole(root);
    assert!(page.contains("Peer") && page.contains("incremental"));

    // In a map (Eq. 5), poses are those of the optimum. A peer is run on the problem in the same run.
    std::fs::write(
        root.join("peer.sh"),
        "echo counts keyframes\necho \"60,2.5,$(grep -c ^keyframe \"$1\")\" > \"$2\"\n",
    )
    .expect("file");
    let in_map = "bench ba --keyframes 60 --points 60 --map-percent 20 --batch-every 20 --out map";
    let mut in_map: Vec<&str> = in_map.split(' ').collect();
    in_map.extend(["--run", "Counter=sh peer.sh"]);
    let printed = json(root, &in_map, 0);
    let of_peer = read(&root.join("map/peer-Counter.csv"));
    assert_eq!(of_peer, "60,2.5,60\n");
    assert_eq!(
        read(&root.join("map/peer-Counter.log")),
        "counts keyframes\n"
    );
    assert_eq!(printed["solvers"][2]["solver"], "Counter");
    assert_eq!(printed["solvers"][2]["max_ms"], 2.5);
    let apart_m = printed["poses_apart_m"].as_f64().expect("a number");
    assert!(apart_m < 1e-6, "{apart_m:.1e} m");
    let problem = std::fs::read_to_string(root.join("map/problem.txt")).expect("problem");
    assert!(problem.lines().any(|l| l.starts_with("map ")));

    let again = lsfb(root, &arguments);
    assert_eq!(again.status.code(), Some(1), "{}", said(&again));
    assert!(said(&again).contains("--force"), "{}", said(&again));
}

#[test]
fn what_is_no_result_of_a_peer_is_refused_before_anything_is_solved() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("peer.csv"), "1,2\n61,2\n").expect("file");
    let arguments = "bench ba --keyframes 60 --out ba --peer Peer=peer.csv";
    let output = lsfb(root, &arguments.split(' ').collect::<Vec<_>>());
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("line 2"), "{}", said(&output));
    assert!(!root.join("ba/problem.txt").exists());
    let output = lsfb(root, &["bench", "ba", "--out", "ba", "--peer", "peer.csv"]);
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));

    // A peer that fails is named, with what it said.
    let arguments =
        "bench ba --keyframes 60 --points 20 --batch-every 60 --out failed --run Peer=false";
    let output = lsfb(root, &arguments.split(' ').collect::<Vec<_>>());
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("peer-Peer.log"), "{}", said(&output));
}
