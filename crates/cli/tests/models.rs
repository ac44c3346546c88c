//! `lsfb models` and `--feature`, as typed.

use std::path::Path;
use std::process::{Command, Output};

use lsfb_tests::published_weights;

fn lsfb(models: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(arguments)
        .env("LSFB_MODELS", models)
        .output()
        .expect("lsfb runs")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

#[test]
fn weights_are_added_checked_and_refused() {
    let scratch = tempfile::tempdir().expect("folder");
    let models = scratch.path().join("models");
    let listed = lsfb(&models, &["models", "list"]);
    assert!(listed.status.success(), "{}", said(&listed));
    assert!(said(&listed).contains("xfeat: grey images of any size; licence Apache-2.0"));

    let torn = scratch.path().join("torn.pt");
    std::fs::write(&torn, b"PK\x03\x04 and no more").expect("a file");
    let refused = lsfb(&models, &["models", "add", &torn.display().to_string()]);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    assert!(
        said(&refused).contains("directory of the archive"),
        "{}",
        said(&refused)
    );

    let test = "weights_are_added_checked_and_refused";
    let Some(weights) = published_weights(test, "xfeat.safetensors") else {
        return;
    };
    let mut bytes = std::fs::read(&weights).expect("a file");
    let weights = weights.display().to_string();
    let added = lsfb(&models, &["models", "add", &weights]);
    assert!(added.status.success(), "{}", said(&added));
    let checked = lsfb(&models, &["models", "check"]);
    assert!(said(&checked).starts_with("PASS"), "{}", said(&checked));
    let checked = lsfb(&models, &["models", "check", "--json"]);
    let judged: serde_json::Value = serde_json::from_slice(&checked.stdout).expect("JSON");
    assert_eq!(judged["verdict"], "pass", "{judged}");
    assert_eq!(judged["findings"][0]["code"], "weights", "{judged}");
    assert_eq!(judged["weights"][0]["agrees"], true, "{judged}");

    // Other weights of the same network: under their own name, and only where that is asked for.
    let last = bytes.len() - 3;
    bytes[last] ^= 1;
    let own = scratch.path().join("own.safetensors");
    std::fs::write(&own, &bytes).expect("a file");
    let own = own.display().to_string();
    let refused = lsfb(&models, &["models", "add", &own]);
    assert!(
        said(&refused).contains("--force-unknown"),
        "{}",
        said(&refused)
    );
    let added = lsfb(&models, &["models", "add", &own, "--force-unknown"]);
    assert!(
        said(&added).contains("not the published ones"),
        "{}",
        said(&added)
    );

    // Weights that changed in the folder are noticed.
    std::fs::write(models.join("xfeat.safetensors"), &bytes).expect("a file");
    let checked = lsfb(&models, &["models", "check"]);
    assert_eq!(checked.status.code(), Some(4), "{}", said(&checked));
}

/// Weights of a network whose published hash nobody knows were never listed as added, and its name was no feature; exports of published ones
/// were strangers.
#[test]
fn weights_of_unknown_hash_are_listed_and_exports_are_known() {
    let scratch = tempfile::tempdir().expect("folder");
    let models = scratch.path().join("models");
    let test = "weights_of_unknown_hash_are_listed_and_exports_are_known";
    let exported =
        ["xfeat.onnx", "superpoint_arch_random.onnx"].map(|f| published_weights(test, f));
    let [Some(xfeat), Some(superpoint)] = exported else {
        return;
    };
    let added = lsfb(&models, &["models", "add", &xfeat.display().to_string()]);
    assert!(said(&added).contains("as published"), "{}", said(&added));
    assert!(models.join("xfeat.safetensors").is_file());

    let superpoint = superpoint.display().to_string();
    let add = ["models", "add", &superpoint, "--force-unknown"];
    assert!(lsfb(&models, &add).status.success());
    let listed = lsfb(&models, &["models", "list"]);
    let lines: Vec<String> = said(&listed).lines().map(str::to_owned).collect();
    let line = |name: &str| lines.iter().find(|l| l.starts_with(name)).expect("listed");
    let at = format!("added to {}; there: ", models.display());
    let expected = format!("{at}xfeat (SHA-256 1d65ea24…, as published)");
    assert!(line("xfeat:").ends_with(&expected), "{lines:?}");
    let own = line("superpoint:");
    assert!(own.contains(&format!("{at}superpoint-")), "{own}");
    assert!(
        own.ends_with("not published, from superpoint_arch_random.onnx)"),
        "{own}"
    );
    assert!(line("superpoint-open:").contains("not added"));

    // Both are features by the names of their networks; with two sets of weights of one, its name is not enough.
    let [images, map] = ["images", "map"].map(|n| scratch.path().join(n).display().to_string());
    let refused = |feature: &str, words: &str| {
        let arguments = [
            "map",
            "--posed-images",
            &images,
            "--out",
            &map,
            "--feature",
            feature,
        ];
        let output = lsfb(&models, &arguments);
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        assert!(
            said(&output).contains(words),
            "{feature}: {}",
            said(&output)
        );
    };
    refused("xfeat", "no such file");
    refused("superpoint", "no such file");
    refused("superpoint-open", "its weights are not in");
    let own = std::fs::read_dir(&models)
        .expect("a folder")
        .map(|e| e.expect("an entry").path());
    let own = own.filter(|path| path.extension().is_some_and(|e| e == "safetensors"));
    let own = own.filter(|path| path.display().to_string().contains("superpoint-"));
    let own: Vec<_> = own.collect();
    std::fs::copy(&own[0], models.join("superpoint-0123abcd.safetensors")).expect("copied");
    refused("superpoint", "choose one: superpoint-0123abcd, superpoint-");
    // What is said of weights that stood there before says nothing of these.
    let note = "weights_sha256 = \"00\"\npublished = true\nfile = \"a\"\nfile_sha256 = \"00\"\n";
    std::fs::write(models.join("superpoint-0123abcd.toml"), note).expect("written");
    refused("superpoint", "choose one: superpoint-0123abcd, superpoint-");
}

/// The option stood in a struct that was never there: `lsfb map` said "give a recording" to whoever gave images.
#[test]
fn map_takes_a_feature_and_names_those_there_are() {
    let scratch = tempfile::tempdir().expect("folder");
    let [images, map] = ["images", "map"].map(|n| scratch.path().join(n).display().to_string());
    let arguments = ["map", "--posed-images", &images, "--out", &map, "--feature"];
    for (feature, expected) in [
        ("xfeat", "lsfb models add"),
        ("orb", "available: sift"),
        ("../xfeat", "available: sift"),
        ("sift", "no such file"),
    ] {
        let refused = lsfb(scratch.path(), &[&arguments[..], &[feature]].concat());
        assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
        assert!(
            said(&refused).contains(expected),
            "{feature}: {}",
            said(&refused)
        );
    }
}
