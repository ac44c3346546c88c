use std::thread;

use lsfb_drivers::microstrain::{Decoder, MipConfig, MipImu};
use lsfb_drivers::transport::PacketSource;
use lsfb_types::no_progress;

use super::*;
use crate::device::clock::Pace;
use crate::{Clocked, Emitted, SimConfig, SimulatedImu, Simulation};

const PATIENCE: Duration = Duration::from_secs(20);

#[test]
fn the_driver_gets_every_sample_or_every_second_one() {
    let mut config = SimConfig::tiny();
    config.texel_m = 0.1;
    (config.scan.duration_s, config.glasses.duration_s) = (1.2, 1.2);
    let simulation = Simulation::new(&config, &no_progress).expect("valid");
    let rig = simulation.scan();
    for every in [1, 2] {
        let rate_hz = rig.imu_rate_hz() as u16;
        let device = MipDevice::new(rate_hz).expect("line");
        let open = MipConfig {
            path: device.path(),
            rate_hz: rate_hz / every,
            ..MipConfig::default()
        };
        let clock = SimClock::new(1, 1_000_000_000, Pace::Unlimited);
        let decoder = thread::scope(|scope| {
            let sent = scope.spawn(|| device.run(rig, &clock, 0).expect("all sent"));
            let mut unit = MipImu::open(&open).expect("unit");
            assert_eq!(unit.base_rate_hz(), rate_hz);
            let mut decoder = Decoder::new();
            let mut number = 0;
            loop {
                match unit.recv(PATIENCE) {
                    Ok(packet) => decoder.push(&packet.expect("the unit went silent")),
                    Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
                    Err(error) => panic!("{error}"),
                }
                while let Some(reading) = decoder.next_reading() {
                    let expected = &rig.imu()[number];
                    assert_eq!(reading.device_ticks as i64, expected.offset_ns);
                    let (sample, exact) =
                        (reading.sample.sample.expect("inertial"), expected.sample);
                    for i in 0..3 {
                        let (a, b) = (sample.specific_force_m_s2[i], exact.specific_force_m_s2[i]);
                        assert!((a - b).abs() < 1e-5, "{a} {b}");
                        let (a, b) = (
                            sample.angular_velocity_rad_s[i],
                            exact.angular_velocity_rad_s[i],
                        );
                        assert!((a - b).abs() < 1e-6, "{a} {b}");
                    }
                    number += usize::from(every);
                }
            }
            let sent = sent.join().expect("unit");
            assert_eq!(sent, rig.imu().len().div_ceil(every.into()) as u64);
            decoder
        });
        let counters = decoder.counters();
        assert_eq!(
            counters.readings,
            rig.imu().len().div_ceil(every.into()) as u64
        );
        assert_eq!((counters.missing, counters.skipped_bytes), (0, 0));
    }
}

#[test]
fn without_sockets_the_bytes_are_the_same() {
    let mut config = SimConfig::tiny();
    (config.texel_m, config.scan_imu_family) = (0.1, SimulatedImu::Microstrain);
    (config.scan.duration_s, config.glasses.duration_s) = (1.2, 1.2);
    let simulation = Simulation::new(&config, &no_progress).expect("valid");
    let rig = simulation.scan();
    let mut decoder = Decoder::new();
    for emitted in simulation.emit_scan(&[Clocked::Imu]) {
        let Ok(Emitted::Imu(packet)) = emitted else {
            panic!("{emitted:?}");
        };
        decoder.push(&packet);
    }
    let readings: Vec<_> = std::iter::from_fn(|| decoder.next_reading()).collect();
    assert_eq!(readings.len(), rig.imu().len());
    let ticks = readings.iter().map(|r| r.device_ticks as i64);
    assert!(ticks.eq(rig.imu().iter().map(|s| s.offset_ns)));
}
