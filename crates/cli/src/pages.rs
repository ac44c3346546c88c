//! Pages with the settings and inputs of which they were made.

use std::path::Path;

use lsfb_recording::Provenance;
use lsfb_report::Page;
use serde_json::Value;

use crate::files;

/// Writes a page, and on it what it was made of.
pub fn write(path: &Path, page: Page, made_from: &Provenance) -> anyhow::Result<()> {
    files::write(path, page.settings(settings(made_from)).to_html())
}

/// Versions, hashes of the inputs and settings, as a page lists them.
pub fn settings(made_from: &Provenance) -> Vec<(String, String)> {
    let versions = made_from.versions.iter();
    let mut lines: Vec<(String, String)> = versions
        .map(|(name, version)| (name.clone(), version.clone()))
        .collect();
    let hashed = |(name, hash): (&String, &String)| (format!("{name}, SHA-256"), hash.clone());
    lines.extend(made_from.inputs.iter().map(hashed));
    let rigs = made_from.rigs.iter();
    lines.extend(rigs.map(|(name, hash)| (format!("rig {name}, SHA-256"), hash.clone())));
    let config = match &made_from.config {
        Value::Null => return lines,
        // A file of settings stands as it was written.
        Value::String(text) => text.clone(),
        config => serde_json::to_string_pretty(config).unwrap_or_default(),
    };
    lines.push(("settings".to_owned(), config));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_rigs_and_settings_are_listed() {
        let mut made_from = Provenance::new(&serde_json::json!({ "voxel_size_m": 0.25 }));
        made_from.inputs.insert("scan.mcap".into(), "ab12".into());
        made_from.rigs.insert("backpack".into(), "cd34".into());
        let lines = settings(&made_from);
        let names: Vec<&str> = lines.iter().map(|(name, _)| name.as_str()).collect();
        let expected = [
            "lsfb",
            "scan.mcap, SHA-256",
            "rig backpack, SHA-256",
            "settings",
        ];
        assert_eq!(names, expected);
        assert!(lines[3].1.contains("0.25"));
        // A command without settings has no empty line for them.
        assert_eq!(settings(&Provenance::new(&())).len(), 1);
    }
}
