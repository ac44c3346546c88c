//! `lsfb calib target`: boards on paper, and the files that describe them.

use crate::process::lsfb;
use crate::refusal::badly_asked;

#[test]
fn boards_are_printed_and_their_files_name_the_same_board() {
    let folder = tempfile::tempdir().expect("folder");
    for (option, numbers, words) in [
        ("--charuco", "11,8,0.025,0.019,5x5", "charuco"),
        ("--checkerboard", "9,6,0.025", "checkerboard"),
        ("--april-grid", "4,3,0.04,0.3", "aprilgrid"),
    ] {
        let print = |board: [&str; 2], out: &str| {
            let page = ["--page-m", "0.297,0.21", "--out", out, "--force"];
            let output = lsfb(
                folder.path(),
                &[&["calib", "target"], &board[..], &page].concat(),
            );
            assert_eq!(output.status.code(), Some(0), "{output:?}");
            std::fs::read(folder.path().join(out)).expect("a page")
        };
        let pdf = print([option, numbers], "board.pdf");
        assert!(pdf.starts_with(b"%PDF-"));
        let yaml = std::fs::read_to_string(folder.path().join("board.yaml")).expect("a file");
        assert!(yaml.contains(words), "{yaml}");
        assert_eq!(print(["--target", "board.yaml"], "again.pdf"), pdf);
    }
    let charuco = |numbers| {
        [
            "calib",
            "target",
            "--charuco",
            numbers,
            "--out",
            "board.pdf",
        ]
    };
    for (numbers, words) in [
        ("11,8,0.025,0.019,7x7", "expected 4x4, 5x5 or 6x6"),
        ("11,8,0.025,0.024,5x5", "at most 0.9 of the square"),
        ("40,40,0.025,0.019,5x5", "at most 250 white ones"),
    ] {
        let output = lsfb(folder.path(), &charuco(numbers));
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(words), "{said}");
    }
    let large = charuco("30,16,0.05,0.04,5x5");
    badly_asked(folder.path(), &large, &["--page-m", "1500 × 800 mm"]);
    let nowhere = [&charuco("11,8,0.025,0.019,5x5")[..], &["--page-m=0,0"]].concat();
    badly_asked(folder.path(), &nowhere, &["--page-m"]);
}
