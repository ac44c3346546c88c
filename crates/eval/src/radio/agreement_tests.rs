use lsfb_geometry::Vector3;
use lsfb_types::{Timestamp, Verdict};

use super::*;
use crate::Error;

/// Advertisements of beacons that hang every four metres along a straight way, by somebody who walks it at a metre a second, or nothing of
/// those that are too far away; each walk with another stamp and other echoes.
fn heard(walk: u32, floor: &str, loss_db: f64) -> Vec<PlacedReading> {
    let mut readings = Vec::new();
    for second in 0..40_i32 {
        for beacon in 0..10_i32 {
            let place = f64::from(second);
            let away_m = (place - 4.0 * f64::from(beacon)).hypot(2.0);
            let echo_db = f64::from((second * 7 + beacon * 5 + 3 * walk.cast_signed()) % 5 - 2);
            let power_dbm = -59.0 - 20.0 * away_m.log10() - loss_db + echo_db;
            if power_dbm > -92.0 {
                readings.push(PlacedReading {
                    kind: RadioKind::Ble,
                    time: Timestamp::from_nanos(
                        1_000_000_000 * i64::from(1000 * walk) + 1_000_000_000 * i64::from(second),
                    ),
                    scan: 0,
                    source: format!("{floor} {beacon}"),
                    rssi_dbm: power_dbm.round() as i16,
                    field_t: [0.0; 3],
                    position_m: Vector3::new(place, 0.0, 0.0),
                    sigma_m: 0.1,
                });
            }
        }
    }
    readings
}

fn agreement(walk: &[PlacedReading], others: &[PlacedReading]) -> RadioAgreement {
    radio_agreement(walk, others, &RadioAgreementConfig::default()).expect("no copy")
}

#[test]
fn a_walk_heard_what_others_heard_there_whatever_its_phone_reads_too_much() {
    let others = heard(1, "ground", 0.0);
    for offset_db in [-8.0, 0.0, 8.0] {
        let found = agreement(&heard(2, "ground", offset_db), &others);
        assert!(found.share > 0.8, "{found:?}");
        assert_eq!(found.finding().verdict, Verdict::Pass);
    }
}

/// What is the loudest on one floor is heard through the slab on the next, where others are louder.
#[test]
fn a_walk_on_another_floor_heard_others_louder() {
    let others = heard(1, "ground", 0.0);
    let through_the_slab = heard(2, "ground", 15.0);
    let mut walk = heard(2, "first", 0.0);
    walk.extend(through_the_slab);
    let found = agreement(&walk, &others);
    assert!(found.elsewhere().is_some(), "{found:?}");
    assert_eq!(found.finding().verdict, Verdict::Fail);
    // Another building.
    let found = agreement(&heard(2, "elsewhere", 0.0), &others);
    assert_eq!(found.share, 0.0);
    assert!(found.elsewhere().is_some());
}

/// A floor without transmitters of its own: the order of powers is the same, but no phone reads them so weak.
#[test]
fn a_walk_that_heard_everything_much_weaker_is_doubtful() {
    let found = agreement(&heard(2, "ground", 18.0), &heard(1, "ground", 0.0));
    assert_eq!(found.elsewhere(), None, "{found:?}");
    assert_eq!(found.finding().verdict, Verdict::Warn);
}

/// Of a walk that is right but for ten or sixteen seconds on another floor most agrees.
#[test]
fn a_stretch_on_another_floor_is_named() {
    let others = heard(1, "ground", 0.0);
    let walk = |secs: std::ops::Range<i64>| -> Vec<PlacedReading> {
        let is_above = |r: &PlacedReading| secs.contains(&(r.time.nanos() / 1_000_000_000 - 2000));
        let mut walk = heard(2, "ground", 0.0);
        walk.retain(|r| !is_above(r));
        walk.extend(heard(2, "first", 0.0).into_iter().filter(is_above));
        walk
    };
    let found = agreement(&walk(14..30), &others);
    let elsewhere = found.elsewhere().expect("a stretch");
    assert!(found.share > 0.5, "{found:?}");
    assert_eq!(elsewhere.from_ns, 2_014_000_000_000);
    assert_eq!(elsewhere.to_ns, 2_029_000_000_000);
    let finding = found.finding();
    assert_eq!(finding.verdict, Verdict::Fail);
    assert!(finding.sentence().contains("from 2014.000"), "{finding:?}");
    let found = agreement(&walk(14..24), &others);
    assert_eq!(found.elsewhere(), None, "{found:?}");
    assert_eq!(found.finding().verdict, Verdict::Warn);
}

/// Of a short walk the end lies elsewhere.
#[test]
fn a_short_walk_that_is_right_by_half_is_doubtful() {
    let others = heard(1, "ground", 0.0);
    let secs = |r: &PlacedReading| r.time.nanos() / 1_000_000_000 - 2000;
    let mut walk = heard(2, "ground", 0.0);
    walk.retain(|r| secs(r) < 6);
    let above = heard(2, "first", 0.0).into_iter();
    walk.extend(above.filter(|r| (6..12).contains(&secs(r))));
    let found = agreement(&walk, &others);
    assert_eq!(found.elsewhere(), None, "{found:?}");
    assert_eq!(found.finding().verdict, Verdict::Warn, "{found:?}");
}

/// The table has the first third of the way.
#[test]
fn a_walk_that_is_mostly_where_nobody_listened_does_not_pass() {
    let mut others = heard(1, "ground", 0.0);
    others.retain(|r| r.position_m.x < 10.0);
    let found = agreement(&heard(2, "ground", 0.0), &others);
    assert!(found.is_judged() && found.unknown > found.compared);
    assert_eq!(found.finding().verdict, Verdict::Warn);
}

#[test]
fn where_nobody_listened_nothing_is_said() {
    let mut others = heard(1, "ground", 0.0);
    for reading in &mut others {
        reading.position_m.y += 50.0;
    }
    let found = agreement(&heard(2, "ground", 0.0), &others);
    assert_eq!((found.compared, found.is_judged()), (0, false));
    assert_eq!(found.finding().verdict, Verdict::Unknown);
    assert_eq!(found.elsewhere(), None);
    assert_eq!(agreement(&[], &others).compared, 0);
}

#[test]
fn a_walk_among_the_others_would_agree_with_itself() {
    let walk = heard(2, "ground", 0.0);
    let refused = radio_agreement(&walk, &walk, &RadioAgreementConfig::default());
    assert!(
        matches!(refused, Err(Error::CopiedScans { .. })),
        "{refused:?}"
    );
}
