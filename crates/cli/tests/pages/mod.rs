//! What every page keeps, whichever command wrote it.

use std::path::{Path, PathBuf};

/// All pages in a folder and below it.
fn pages_in(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(pages_in(&path));
        } else if path.extension().is_some_and(|e| e == "html") {
            found.push(path);
        }
    }
    found
}

/// Each page in a folder says of which settings and inputs it was made, folded away, and is one file: it refers to nothing but its own
/// places and what is within it.
pub fn are_whole(folder: &Path) {
    let pages = pages_in(folder);
    assert!(!pages.is_empty(), "no page in {}", folder.display());
    for path in pages {
        let page = std::fs::read_to_string(&path).expect("a page");
        let name = path.display();
        let (_, settings) = page
            .split_once("<details class=\"settings\">")
            .unwrap_or_else(|| panic!("{name}: no settings and inputs"));
        let (settings, _) = settings.split_once("</details>").expect("an end");
        assert!(settings.contains("<dt>lsfb</dt>"), "{name}: {settings}");
        for attribute in [" src=\"", " href=\""] {
            for target in page.split(attribute).skip(1) {
                let is_within = target.starts_with("data:") || target.starts_with('#');
                let shown: String = target.chars().take(60).collect();
                assert!(is_within, "{name}: {attribute}{shown}");
            }
        }
        for fetched in ["@import", "fetch(", "url("] {
            assert!(!page.contains(fetched), "{name}: {fetched}");
        }
    }
}
