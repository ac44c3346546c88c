use std::path::Path;

use lsfb_geometry::Vector3;
use lsfb_recording::message::{self, Remark, WifiReading};
use lsfb_recording::{Channel, Recording, Writer, WriterConfig};
use lsfb_types::Timestamp;

use super::*;

fn secs(s: f64) -> Timestamp {
    Timestamp::from_secs_f64(1000.0 + s)
}

fn known(s: f64, x: f64) -> KnownPlace {
    KnownPlace {
        time: secs(s),
        position_m: Vector3::new(x, 0.0, 0.0),
        sigma_m: None,
    }
}

/// One scan, heard for four seconds and handed out at once.
fn recording(folder: &Path, heard: &[f64]) -> Recording {
    let path = folder.join("walk.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).expect("file");
    let channel = Channel {
        topic: "/sidecar/phone/wifi",
        schema_name: message::WIFI_READING.name,
        schema_text: message::WIFI_READING.text,
    };
    for (i, &s) in heard.iter().enumerate() {
        let reading = WifiReading {
            scan: 1,
            bssid: format!("02:00:5e:00:00:0{i}"),
            ssid: "a,b".to_owned(),
            frequency_mhz: 5200,
            rssi_dbm: -50,
        };
        let bytes = message::encode_wifi(secs(s), "phone", &reading);
        writer
            .write_cdr(&channel, secs(s), secs(9.0), &bytes)
            .expect("written");
    }
    let channel = Channel {
        topic: "/sidecar/phone/waypoint",
        schema_name: message::REMARK.name,
        schema_text: message::REMARK.text,
    };
    for (s, x) in [(8.0, 8.0), (0.0, 0.0)] {
        let remark = Remark {
            kind: "waypoint".to_owned(),
            text: format!("{{\"x_m\":{x},\"y_m\":0.5,\"floor\":\"F1\"}}"),
            position_in_world_m: None,
        };
        let bytes = message::encode_remark(secs(s), &remark);
        writer
            .write_cdr(&channel, secs(s), secs(s), &bytes)
            .expect("written");
    }
    writer.finish().expect("finished");
    Recording::open(&path).expect("opens")
}

/// All at the time of the scan's end: 4 m off for the first of them.
#[test]
fn readings_of_one_scan_have_places_of_their_own() {
    let folder = tempfile::tempdir().expect("folder");
    let recording = recording(folder.path(), &[-1.0, 2.0, 4.0, 6.0, 9.0]);
    let walk: Vec<KnownPlace> = (0..=80)
        .map(|i| known(0.1 * f64::from(i), 0.1 * f64::from(i)))
        .collect();
    let placed = place(&recording, &walk, &PlacingConfig::default()).expect("placed");
    assert_eq!((placed.outside, placed.in_gaps), (2, 0));
    let found: Vec<f64> = placed.readings.iter().map(|r| r.position_m.x).collect();
    for (found, expected) in found.iter().zip([2.0, 4.0, 6.0]) {
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }
    // At 1 m/s the stamp's 50 ms are 5 cm beside the 10 cm of the trajectory.
    for reading in &placed.readings {
        assert!(
            (reading.sigma_m - 0.1118).abs() < 1e-3,
            "{}",
            reading.sigma_m
        );
    }
    // With its own, smaller one, the stamp is what is left.
    let sure: Vec<KnownPlace> = walk
        .iter()
        .map(|k| KnownPlace {
            sigma_m: Some(0.01),
            ..*k
        })
        .collect();
    let placed = place(&recording, &sure, &PlacingConfig::default()).expect("placed");
    assert!((placed.readings[0].sigma_m - 0.051).abs() < 1e-3);
    // What is long between known places has none.
    let ends = [known(0.0, 0.0), known(100.0, 100.0)];
    let placed = place(&recording, &ends, &PlacingConfig::default()).expect("placed");
    assert_eq!((placed.readings.len(), placed.in_gaps), (0, 4));
}

#[test]
fn waypoints_place_readings_and_say_how_uncertainly() {
    let folder = tempfile::tempdir().expect("folder");
    let recording = recording(folder.path(), &[0.0, 4.0]);
    let known = waypoints(&recording).expect("waypoints");
    assert_eq!(known.len(), 2);
    assert_eq!(known[1].position_m, Vector3::new(8.0, 0.5, 0.0));
    let placed = place(&recording, &known, &PlacingConfig::default()).expect("placed");
    let [first, middle] = placed.readings.as_slice() else {
        panic!("{placed:?}");
    };
    assert_eq!(middle.position_m, Vector3::new(4.0, 0.5, 0.0));
    // At the waypoint it is known, halfway of eight seconds it may have strayed: √(1.9 · 8 / 4).
    assert!(first.sigma_m < 0.12 && (middle.sigma_m - 1.95).abs() < 0.01);
    let path = folder.path().join("radio.csv");
    std::fs::write(&path, table(&placed.readings)).expect("written");
    let back = read_table(&path).expect("read");
    assert_eq!(back.len(), 2);
    assert_eq!((back[1].time, back[1].scan), (middle.time, 1));
    assert_eq!(back[1].source, middle.source);
}

#[test]
fn a_table_that_is_none_is_refused_by_line() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("radio.csv");
    let good = table(&[]);
    for (rows, expected) in [
        ("t x y z\n".to_owned(), "not a table of placed readings"),
        (
            format!("{good}wifi,1,1,a,-50,0,0,0,NaN,0,0,1\n"),
            "line 2: 'NaN'",
        ),
        (format!("{good}wifi,1,1,a,-50,0,0,0,0,0,0\n"), "expected 12"),
        (
            format!("{good}wifi,1,1,a,-50,0,0,0,0,0,0,-1\n"),
            "not a standard deviation",
        ),
        (
            format!("{good}radar,1,1,a,-50,0,0,0,0,0,0,1\n"),
            "not a kind",
        ),
    ] {
        std::fs::write(&path, rows).expect("written");
        let said = read_table(&path).expect_err("refused").to_string();
        assert!(said.contains(expected), "{said}");
    }
}

fn reading(scan: u32, s: f64, source: &str, rssi_dbm: i16, x: f64) -> PlacedReading {
    PlacedReading {
        kind: RadioKind::Wifi,
        time: secs(s),
        scan,
        source: source.to_owned(),
        rssi_dbm,
        field_t: [0.0; 3],
        position_m: Vector3::new(x, 0.0, 1.5),
        sigma_m: 0.1,
    }
}

/// A walk's own scans lie nearest of all, and an old reading is of where the phone was: both make the baseline look better or worse than it is.
#[test]
fn a_scan_is_placed_by_other_walks_and_by_fresh_readings() {
    let config = NeighbourConfig {
        neighbours: 1,
        ..NeighbourConfig::default()
    };
    let first = vec![
        reading(1, 0.0, "a", -50, 0.0),
        reading(2, 5.0, "b", -50, 5.0),
        // Heard long ago, handed out again.
        reading(2, 0.0, "a", -40, 0.0),
    ];
    let second = vec![
        reading(1, 0.0, "a", -50, 1.0),
        reading(2, 6.0, "b", -50, 6.0),
    ];
    let found = judge_neighbours(&[first.clone(), second], &config).expect("figures");
    assert_eq!((found.scans, found.unheard), (4, 0));
    assert!((found.errors_m.max - 1.0).abs() < 1e-9, "{found:?}");
    assert_eq!(found.findings[0].verdict, lsfb_types::Verdict::Pass);
    // Of others nobody heard anything: there is no figure, and no zero.
    let far = vec![reading(1, 0.0, "c", -50, 0.0)];
    assert!(judge_neighbours(&[first.clone(), far], &config).is_err());
    assert!(judge_neighbours(&[first], &config).is_err());
    assert!(judge_neighbours(&[], &config).is_err());
}

/// A copy of a walk under another name made the median error 5 cm.
#[test]
fn a_walk_and_its_copy_are_refused() {
    let config = NeighbourConfig::default();
    let walk = |from: f64| -> Vec<PlacedReading> {
        let senders = ["a", "b", "c"].into_iter().zip([-50, -60, -70]);
        let scans = (1..=4).flat_map(|scan| senders.clone().map(move |s| (scan, s)));
        scans
            .map(|(scan, (source, rssi_dbm))| {
                let at = from + f64::from(scan);
                reading(scan, at, source, rssi_dbm, at)
            })
            .collect()
    };
    let (one, other) = (walk(0.0), walk(0.5));
    assert!(judge_neighbours(&[one.clone(), other.clone()], &config).is_ok());
    let half: Vec<_> = one.iter().take(6).cloned().collect();
    let said = judge_neighbours(&[one, other, half], &config);
    assert!(
        matches!(said, Err(crate::Error::CopiedScans { scans: 2 })),
        "{said:?}"
    );
}
