use lsfb_drivers::lidar::Returns;
use lsfb_drivers::velodyne::model::{Model, code_of_returns};
use lsfb_drivers::velodyne::{Decoder, PacketLayout, returns};
use lsfb_types::Echo;
use lsfb_types::{Packet, no_progress};

use super::*;
use crate::{Device, Place, SimConfig};

/// A scanner in an office with rooms behind glass.
fn office(model: Model, returns: Returns) -> Simulation {
    let mut config = SimConfig::for_place(Place::MediumOffice, Device::Glasses);
    config.texel_m = 0.1;
    (config.scan.duration_s, config.glasses.duration_s) = (12.0, 1.0);
    for cameras in [&mut config.scan_cameras, &mut config.glasses_cameras] {
        (cameras.width, cameras.height) = (16, 8);
    }
    (config.lidar.model, config.lidar.returns) = (model, returns);
    Simulation::new(&config, &no_progress).expect("valid")
}

/// The packets of three revolutions, from half a second into the walk.
fn packets(simulation: &Simulation) -> Vec<[u8; DATA_PACKET_LEN]> {
    let rig = simulation.scan();
    let packet_ns = rig.lidar().expect("a LiDAR").packet_ns();
    let first = 500_000_000 / packet_ns;
    let count = 330_000_000 / packet_ns;
    rig.lidar_packets(simulation.world(), first as u64, count as usize)
        .expect("packets")
}

#[test]
fn the_driver_reads_every_model_and_return_mode() {
    for (model, mode) in [
        (Model::Vlp32c, Returns::Dual),
        (Model::Vlp32c, Returns::Last),
        (Model::Vlp16, Returns::Strongest),
        (Model::Vlp16, Returns::Dual),
    ] {
        let simulation = office(model, mode);
        let rig = simulation.scan();
        let mut decoder = Decoder::new(Default::default());
        let mut scans = Vec::new();
        for (k, bytes) in packets(&simulation).iter().enumerate() {
            let packet = DataPacket::new(bytes).expect("a data packet");
            assert_eq!(packet.product_code(), model.product().code());
            assert_eq!(packet.return_mode_code(), code_of_returns(mode));
            // Far more than what arrives late would be allowed to.
            let arrival = Timestamp::from_nanos(k as i64 * i64::from(model.packet_period_ns(mode)));
            let bytes = bytes.to_vec();
            scans.extend(decoder.push(&Packet { arrival, bytes }).expect("good"));
        }
        let counters = decoder.counters();
        assert_eq!(
            (counters.lost, counters.refused, counters.malformed),
            (0, 0, 0)
        );
        // The first begins in the middle of a revolution.
        assert!(scans.len() >= 3, "{}", scans.len());
        for scan in scans.iter().skip(1) {
            // The walk begins with the hour; the counter is cut to microseconds.
            let number = (scan.device_ticks + 1000) / 100_000_000;
            let number = u32::try_from(number).expect("ten a second");
            let expected = rig.scan(simulation.world(), number).expect("points").sample;
            assert_eq!(scan.sample.points.len(), expected.points.len());
            for (a, b) in scan.sample.points.iter().zip(&expected.points) {
                assert_eq!((a.ring, a.intensity), (b.ring, b.intensity));
                assert!(a.time_offset_ns.abs_diff(b.time_offset_ns) <= 1000);
                // The driver turns the rotor by the rounded azimuths' difference between two blocks.
                for (p, q) in a.position_m.iter().zip(b.position_m) {
                    assert!((p - q).abs() < 2e-4 * norm(b.position_m), "{a:?} {b:?}");
                }
            }
        }
    }
}

fn norm(v: [f32; 3]) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

#[test]
fn two_returns_are_the_last_and_the_strongest_and_one_is_sent_twice() {
    let simulation = office(Model::Vlp32c, Returns::Dual);
    let separation_m = simulation.config().lidar.separation_m;
    let (mut both, mut two, mut shots) = (0, 0, 0);
    for bytes in packets(&simulation) {
        let packet = DataPacket::new(&bytes).expect("a data packet");
        for block in (0..BLOCKS).step_by(2) {
            assert_eq!(
                packet.azimuth_centideg(block),
                packet.azimuth_centideg(block + 1)
            );
            for channel in 0..32 {
                let [even, odd] = [block, block + 1].map(|b| packet.distance_raw(b, channel));
                // A single return stands in both.
                assert_eq!(even == 0, odd == 0);
                if even == 0 {
                    continue;
                }
                shots += 1;
                if even == odd {
                    both += 1;
                    continue;
                }
                // The last is the farthest; two surfaces are told apart from a distance on, give or take their noise.
                let apart_m = 0.004 * (f64::from(even) - f64::from(odd));
                assert!(apart_m > separation_m - 6.0 * 0.03 * 1.5, "{apart_m}");
                two += 1;
            }
        }
        let layout = PacketLayout::new(&packet, Model::Vlp32c, Returns::Dual);
        assert!(returns(&packet, &layout).all(|r| r.echo != Echo::Strongest || r.block % 2 == 1));
    }
    assert!(
        both > shots * 9 / 10 && two > shots / 200,
        "{both} and {two} of {shots}"
    );
}
