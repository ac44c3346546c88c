//! Tangent vectors are perturbed on the right (ARCHITECTURE.md, "Invariants"): an exponential as the first factor of a product, or a
//! logarithm of a difference that ends in an inverse, is the other convention, and fails here.
//!
//! What is searched by least squares is moved by `Manifold::plus` alone; this finds what is moved by hand.

use std::path::{Path, PathBuf};

use lsfb_tests::workspace_root;

/// Whether text behind an opening parenthesis closes it, and what then is inside and behind.
fn closed(text: &str) -> Option<(&str, &str)> {
    let mut depth = 1usize;
    for (at, c) in text.char_indices() {
        match c {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Some((&text[..at], &text[at + 1..]));
        }
    }
    None
}

/// Excerpts that perturb on the left.
fn on_the_left(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let excerpt = |at: usize| text[at..].lines().next().unwrap_or_default().to_owned();
    for name in ["so3::exp(", "Se3::exp(", "Se3::new("] {
        for (at, _) in text.match_indices(name) {
            let Some((inside, behind)) = closed(&text[at + name.len()..]) else {
                continue;
            };
            // A pose is an exponential where its rotation is one.
            if name == "Se3::new(" && !inside.trim_start().starts_with("so3::exp(") {
                continue;
            }
            let first = !text[..at].trim_end().ends_with('*');
            let factor = behind.trim_start();
            if first && factor.starts_with('*') && !factor.starts_with("*=") {
                found.push(excerpt(at));
            }
        }
    }
    for (at, _) in text.match_indices("log(&(") {
        let inside = closed(&text[at + "log(".len()..]).map_or("", |(inside, _)| inside);
        if inside.trim_end().ends_with(".inverse())") && !inside.contains(".inverse() *") {
            found.push(excerpt(at));
        }
    }
    for (at, _) in text.match_indices(").log()") {
        let line = text[..at].lines().next_back().unwrap_or_default();
        if line.trim_end().ends_with(".inverse()") && !line.contains(".inverse() *") {
            found.push(excerpt(at));
        }
    }
    found
}

/// Source files below a folder, without tests.
fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries {
        let path = entry.expect("a file").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() && name != "tests" && name != "target" {
            sources(&path, out);
        } else if name.ends_with(".rs") && name != "tests.rs" {
            out.push(path);
        }
    }
}

#[test]
fn tangents_are_perturbed_on_the_right() {
    let mut files = Vec::new();
    for folder in ["crates", "drivers", "capture", "calib", "pipeline"] {
        sources(&workspace_root().join(folder), &mut files);
    }
    assert!(files.len() > 300, "{} files", files.len());
    let mut left = String::new();
    for file in files {
        let text = std::fs::read_to_string(&file).expect("text");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        let code: String = code
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"))
            .map(|line| format!("{line}\n"))
            .collect();
        for line in on_the_left(&code) {
            left.push_str(&format!("{}: {line}\n", file.display()));
        }
    }
    assert!(
        left.is_empty(),
        "perturbed on the left, use `retract` and `local`:\n{left}"
    );
}

#[test]
fn either_side_is_told_apart() {
    for left in [
        "x = so3::exp(&(step * 2.0)) * b_from_a;",
        "Se3::exp(&step.fixed_rows::<6>(0).into())\n    * pose",
        "Se3::new(so3::exp(&turn), shift) * camera_from_rig",
        "Se3::new(\n    so3::exp(&turn),\n    shift,\n) * camera_from_rig",
        "let off = (found * start.inverse()).log();",
        "so3::log(&(found.rotation * start.rotation.inverse()))",
    ] {
        assert_eq!(on_the_left(left).len(), 1, "{left}");
    }
    for right in [
        "x = b_from_a * so3::exp(&step);",
        "start * so3::exp(&a) * so3::exp(&b)",
        "turn *= so3::exp(&step);",
        "rig_from_camera * Se3::new(so3::exp(&turn), shift)",
        "Se3::new(start.rotation * so3::exp(&turn), shift) * rig_from_camera",
        "let off = (start.inverse() * found).log();",
        "so3::log(&(start.rotation.inverse() * found.rotation))",
        "so3::log(&(measured.inverse() * b_from_a.inverse()))",
    ] {
        assert!(on_the_left(right).is_empty(), "{right}");
    }
}
