//! Tangent vectors are perturbed on the right (ARCHITECTURE.md, "Invariants"): an exponential as the first factor of a product, by itself or
//! by the name that it was given before, or a logarithm of a difference that ends in an inverse, is the other convention, and fails here.
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

/// What makes a rotation or a pose of a tangent vector.
const EXPONENTIALS: [&str; 5] = [
    "so3::exp(",
    "Se3::exp(",
    "Se3::new(",
    "UnitQuaternion::from_scaled_axis(",
    "UnitQuaternion::from_axis_angle(",
];

/// Exponentials in front of rotations that perturb nothing: file, and how the excerpt begins.
const CHANGES_OF_FRAME: [(&str, &str); 2] = [
    // The world is turned about its vertical until the start heads along x.
    ("inertial/start.rs", "heading * rotation"),
    // Into a level frame with the rig's heading.
    (
        "loops/descriptor.rs",
        "UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -heading) * rotation",
    ),
];

/// Where exponentials begin, and the text behind them.
fn exponentials(text: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    for name in EXPONENTIALS {
        for (at, _) in text.match_indices(name) {
            let Some((inside, behind)) = closed(&text[at + name.len()..]) else {
                continue;
            };
            // A pose is an exponential where its rotation is one.
            if name == "Se3::new(" && !inside.trim_start().starts_with("so3::exp(") {
                continue;
            }
            found.push((at, behind));
        }
    }
    found
}

fn is_in_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The name that a `let` at the end of a text binds to what follows.
fn bound_name(text: &str) -> Option<&str> {
    let (_, binding) = text.trim_end().strip_suffix('=')?.rsplit_once("let ")?;
    let (name, _) = binding.split_once(':').unwrap_or((binding, ""));
    let name = name.trim_start_matches("mut ").trim();
    (!name.is_empty() && name.chars().all(is_in_name)).then_some(name)
}

/// Where a name may stand for what was bound to it: to the end of the function, or to where it is bound again.
fn scope<'a>(behind: &'a str, name: &str) -> &'a str {
    let ends = [" fn ", "\nfn ", &format!("let {name} ")].map(|end| behind.find(end));
    let end = ends.into_iter().flatten().min();
    &behind[..end.unwrap_or(behind.len())]
}

/// Whether a factor is a pose or a rotation by its name; points may be turned.
fn is_pose(factor: &str) -> bool {
    let factor = factor.trim_start().trim_start_matches(['&', '*', '(']);
    let is_in_path = |c: char| is_in_name(c) || c == '.';
    let end = factor
        .find(|c: char| !is_in_path(c))
        .unwrap_or(factor.len());
    let path = &factor[..end];
    let is_named_so = ["_from_", "pose", "rotation"]
        .iter()
        .any(|n| path.contains(n));
    is_named_so && !path.contains("translation")
}

/// Excerpts that perturb on the left.
fn on_the_left(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let excerpt = |at: usize| text[at..].lines().next().unwrap_or_default().to_owned();
    let is_first = |at: usize| !text[..at].trim_end().ends_with('*');
    for (at, behind) in exponentials(text) {
        let factor = behind.trim_start();
        if is_first(at) && factor.starts_with('*') && !factor.starts_with("*=") {
            found.push(excerpt(at));
        }
        let Some(name) = bound_name(&text[..at]).filter(|_| behind.starts_with(';')) else {
            continue;
        };
        let begin = text.len() - behind.len();
        for (offset, _) in scope(behind, name).match_indices(name) {
            let at = begin + offset;
            let is_longer = text[..at].ends_with(|c: char| is_in_name(c) || c == '.');
            let Some(factor) = text[at + name.len()..].trim_start().strip_prefix('*') else {
                continue;
            };
            if !is_longer && is_first(at) && is_pose(factor) {
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
    let (mut left, mut exceptions) = (String::new(), 0);
    for file in files {
        let text = std::fs::read_to_string(&file).expect("text");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        let code: String = code
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"))
            .map(|line| format!("{line}\n"))
            .collect();
        for line in on_the_left(&code) {
            let is_this =
                |(end, begin): &(&str, &str)| file.ends_with(end) && line.starts_with(begin);
            if CHANGES_OF_FRAME.iter().any(is_this) {
                exceptions += 1;
                continue;
            }
            left.push_str(&format!("{}: {line}\n", file.display()));
        }
    }
    assert!(
        left.is_empty(),
        "perturbed on the left, use `retract` and `local`:\n{left}"
    );
    assert_eq!(
        exceptions,
        CHANGES_OF_FRAME.len(),
        "an exception is not needed any more"
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
        "UnitQuaternion::from_scaled_axis(step) * camera.rotation",
        "UnitQuaternion::from_axis_angle(&axis, 0.1)\n    * rotation",
        "let turn = so3::exp(&step);\n    Some(turn * pose.rotation)",
        "let moved: Se3 = Se3::exp(&step);\n    let other = &moved * self.rig_from_camera;",
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
        "rotation * UnitQuaternion::from_scaled_axis(step)",
        "let turn = so3::exp(&step);\n    pose.rotation * turn",
        "let turn = so3::exp(&step);\n    turn * point + pose.translation",
        "let turn = so3::exp(&step);\n    turn * pose.translation",
        "let turn = so3::exp(&step);\n    start.rotation * turn * rig_from_camera",
        "let turn = so3::exp(&step);\n    right.turn * pose",
        "let size = Se3::exp(&step).translation.norm();\n    size * rotation",
        "let turn = so3::exp(&step);\n}\n\nfn of(turn: Turn) {\n    turn * pose",
        "let turn = so3::exp(&step);\n    let turn = by_hand(turn);\n    turn * pose",
    ] {
        assert!(on_the_left(right).is_empty(), "{right}");
    }
}
