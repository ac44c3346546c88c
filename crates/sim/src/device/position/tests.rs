use lsfb_drivers::velodyne::nmea::Sentence;
use lsfb_types::no_progress;

use super::*;
use crate::{Device, NmeaSentence, Place, PulseSource, SimConfig, Simulation};

/// A scanner that goes in and out of houses, its pulse from a receiver.
fn houses(sentence: NmeaSentence) -> Simulation {
    let mut config = SimConfig::for_place(Place::HousePark, Device::Glasses);
    config.texel_m = 0.1;
    config.glasses.duration_s = 5.0;
    config.gnss.pulse = PulseSource::Receiver;
    config.gnss.sentence = sentence;
    for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
        (cameras.width, cameras.height) = (32, 16);
    }
    Simulation::new(&config, &no_progress).expect("valid")
}

#[test]
fn lock_and_sentence_follow_the_sky() {
    let simulation = houses(NmeaSentence::Rmc);
    let rig = simulation.scan();
    let (mut locked, mut lost, mut returning) = (0, 0, 0);
    let mut with_fix = 0;
    for second in 0..rig.walk().duration_s() as i64 {
        let bytes = position_packet(rig, second * SECOND_NS + 900_000_000).expect("packet");
        let packet = PositionPacket::new(bytes).expect("packet");
        let epoch = &rig.time_feed().epochs[second as usize];
        with_fix = match epoch.reading.fix {
            Some(_) => with_fix + 1,
            None => 0,
        };
        match packet.pps_status() {
            PpsStatus::Locked => {
                locked += 1;
                assert!(with_fix > QUALIFIED_S || with_fix > second as usize);
            }
            PpsStatus::Error => {
                lost += 1;
                assert_eq!(with_fix, 0);
            }
            PpsStatus::Synchronizing => {
                returning += 1;
                assert!((1..=QUALIFIED_S).contains(&with_fix));
            }
            other => panic!("{other:?} after a fix at the beginning"),
        }
        let Ok(Sentence::Rmc(rmc)) = Sentence::parse(packet.nmea()) else {
            panic!("no GPRMC");
        };
        assert_eq!(
            rmc.unix_secs(),
            rig.time(second * SECOND_NS).nanos() / SECOND_NS
        );
        assert_eq!(rmc.valid, epoch.reading.fix.is_some());
        if let Some(fix) = epoch.reading.fix {
            let latitude = rmc.latitude_e5_min.expect("fix") as f64 / E5_MIN_PER_DEG;
            let longitude = rmc.longitude_e5_min.expect("fix") as f64 / E5_MIN_PER_DEG;
            assert!((latitude - fix.latitude_deg).abs() < 1e-7);
            assert!((longitude - fix.longitude_deg).abs() < 1e-7);
            // A walk, in knots.
            assert!(rmc.speed_e3_knots.expect("fix") < 4_000);
        }
    }
    assert!(
        locked > 60 && lost > 10 && returning >= 5,
        "{locked} {lost} {returning}"
    );
}

#[test]
fn a_receiver_may_say_where_it_is_without_the_date() {
    let simulation = houses(NmeaSentence::Gga);
    let rig = simulation.scan();
    let bytes = position_packet(rig, 2_900_000_000).expect("packet");
    let packet = PositionPacket::new(bytes).expect("packet");
    let about = rig.start().nanos() / SECOND_NS;
    let Ok(Sentence::Gga(gga)) = Sentence::parse(packet.nmea()) else {
        panic!("no GPGGA");
    };
    assert_eq!(gga.unix_secs(about), about + 2);
    assert_eq!(gga.quality, 1);
    assert!(gga.satellites.expect("some") >= 4);
    let height_m = gga.altitude_mm.expect("fix") as f64 * 1e-3 + GEOID_MM as f64 * 1e-3;
    assert!((height_m - 566.0).abs() < 30.0, "{height_m}");
}

#[test]
fn a_lidar_that_runs_free_has_no_pulse() {
    let mut config = SimConfig::tiny();
    config.texel_m = 0.1;
    config.clocks.lidar.discipline = Discipline::Free;
    config.clocks.lidar.start_s = 3_599.0;
    let simulation = Simulation::new(&config, &no_progress).expect("valid");
    let rig = simulation.scan();
    let bytes = position_packet(rig, 1_500_000_000).expect("packet");
    let packet = PositionPacket::new(bytes).expect("packet");
    assert_eq!(packet.pps_status(), PpsStatus::Absent);
    assert!(packet.nmea().is_empty());
    // Past the hour since it was switched on.
    assert_eq!(packet.timestamp_us(), 500_000);
}
