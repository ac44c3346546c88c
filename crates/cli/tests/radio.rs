//! `lsfb dataset radio` and `lsfb bench radio` on the walks of a mall that others recorded.

use std::path::{Path, PathBuf};

use crate::answer::json;
use crate::process::lsfb;
use lsfb_eval::radio::{
    PlacedReading, RadioAgreement, RadioAgreementConfig, RadioKind, radio_agreement,
};
use lsfb_sim::{AmbientSample, Device, Place, SimConfig, Simulation};
use lsfb_tests::recordings;
use lsfb_types::{Timestamp, no_progress};

/// Scans, mean, median and largest error, metres, as `benches/radio/neighbours.py` computes them from the walks' texts alone.
const EXPECTED: [(f64, f64, f64, f64); 3] = [
    (397.0, 20.894965, 11.313473, 104.969444),
    (178.0, 6.385683, 6.056773, 16.103417),
    (222.0, 7.166595, 6.552913, 24.845896),
];

#[test]
fn walks_of_a_mall_are_placed_by_their_wifi_as_a_script_has_it() {
    let test = "walks_of_a_mall_are_placed_by_their_wifi_as_a_script_has_it";
    let Some(walks) = recordings(test, "vision/indoorloc20/site1/F1/path_data_files") else {
        return;
    };
    let mut sources: Vec<PathBuf> = std::fs::read_dir(walks)
        .expect("walks")
        .map(|entry| entry.expect("a file").path())
        .collect();
    sources.sort();
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let mut tables = Vec::new();
    for (i, source) in sources.iter().enumerate() {
        let source = source.to_str().expect("UTF-8");
        let (walk, table) = (format!("{i}.mcap"), format!("{i}.csv"));
        json(root, &["import", source, "--out", &walk], 0);
        let placed = json(root, &["dataset", "radio", &walk, "--out", &table], 0);
        assert!(placed["wifi"].as_u64() > Some(100), "{placed}");
        assert!(placed["magnetic"].as_u64() > Some(100), "{placed}");
        // Between waypoints ten seconds apart a place is known to some metres.
        let sigma_m = placed["sigma_rms_m"].as_f64().expect("σ");
        assert!((0.5..4.0).contains(&sigma_m), "{placed}");
        if i == 0 {
            places_in_centimetres_are_refused(root, &walk);
        }
        std::fs::remove_file(root.join(walk)).expect("removed");
        tables.push(table);
    }
    let mut arguments = vec!["bench", "radio"];
    arguments.extend(tables.iter().map(String::as_str));
    let found = json(root, &arguments, 0);
    assert_eq!(found["walks"], 24);
    // Half of a mall was walked once: that is said, and is no failure.
    assert_eq!(found["verdict"], "warn");
    let reaches = found["reaches"].as_array().expect("reaches");
    let figures = [
        &found["errors_m"],
        &reaches[0]["errors_m"],
        &reaches[1]["errors_m"],
    ];
    for (figures, (count, mean, median, max)) in figures.into_iter().zip(EXPECTED) {
        for (name, expected) in [
            ("count", count),
            ("mean", mean),
            ("median", median),
            ("max", max),
        ] {
            let value = figures[name].as_f64().expect(name);
            // The tables have tenths of millimetres.
            assert!(
                (value - expected).abs() < 2e-3,
                "{name}: {value} {expected}"
            );
        }
    }
    // A walk that is given twice would find itself.
    let twice = lsfb(root, &["bench", "radio", "0.csv", "1.csv", "./0.csv"]);
    assert_eq!(twice.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&twice.stderr).contains("given twice"));
}

/// A hundred metres a second.
fn places_in_centimetres_are_refused(root: &Path, walk: &str) {
    let line = |n: u32| format!("{n} {} 0 0 0 0 0 1\n", 100 * n);
    let lines: String = (0..20).map(line).collect();
    std::fs::write(root.join("centimetres.tum"), lines).expect("a trajectory");
    let command = [
        "dataset",
        "radio",
        walk,
        "--trajectory",
        "centimetres.tum",
        "--out",
        "cm.csv",
    ];
    let said = lsfb(root, &command);
    assert_eq!(said.status.code(), Some(4), "{said:?}");
    let said = String::from_utf8_lossy(&said.stderr);
    assert!(said.contains("100 m/s between known positions"), "{said}");
}

/// What a phone heard on its walk through a simulated place, so many floors up, at its true places. Each walk begins at another second.
fn heard(place: Place, seed: u64, device: Device, floors_up: u32) -> Vec<PlacedReading> {
    let mut config = SimConfig::for_place(place, device);
    (config.seed, config.floors_up, config.texel_m) = (seed, floors_up, 0.05);
    if device == Device::Android {
        config.off_path_m = 2.0;
    }
    let simulation = Simulation::new(&config, &no_progress).expect("valid");
    let walk = simulation.glasses().walk();
    let messages = simulation.surroundings().messages(simulation.world(), walk);
    let first_ns = 1_000_000_000 * (1 + device as i64);
    messages
        .into_iter()
        .filter_map(|message| {
            let (kind, scan, source, rssi_dbm) = match message.sample {
                AmbientSample::Wifi(r) => (RadioKind::Wifi, r.scan, r.bssid, r.rssi_dbm),
                AmbientSample::Ble(a) => (RadioKind::Ble, 0, a.sender(), a.rssi_dbm),
                _ => return None,
            };
            let pose = walk.at(message.measured_ns as f64 * 1e-9).world_from_rig;
            Some(PlacedReading {
                kind,
                time: Timestamp::from_nanos(first_ns + message.measured_ns),
                scan,
                source,
                rssi_dbm,
                field_t: [0.0; 3],
                position_m: pose.translation,
                sigma_m: 0.1,
            })
        })
        .collect()
}

/// The walk of somebody else with other glasses on the same way says what is heard where; floors have transmitters of their own, and a slab
/// takes 15 dB.
#[test]
fn a_walk_is_told_from_one_on_another_floor_by_what_it_hears() {
    let agreement = |walk: &[PlacedReading], others: &[PlacedReading]| -> RadioAgreement {
        radio_agreement(walk, others, &RadioAgreementConfig::default()).expect("no copy")
    };
    for (place, seed) in [
        (Place::NarrowCorridor, 1),
        (Place::MediumOffice, 2),
        (Place::Stairs, 3),
    ] {
        let others = heard(place, seed, Device::Glasses, 0);
        let here = agreement(&heard(place, seed, Device::Android, 0), &others);
        let above = agreement(&heard(place, seed, Device::Android, 1), &others);
        println!("{place:?} {seed}: here {here:?}, above {above:?}");
        assert!(
            here.is_judged() && here.elsewhere().is_none(),
            "{place:?}: {here:?}"
        );
        assert!(above.elsewhere().is_some(), "{place:?}: {above:?}");
    }
}
