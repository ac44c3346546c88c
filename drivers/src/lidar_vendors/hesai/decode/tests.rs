use super::super::wire::Clock;
use super::*;

/// An XT32 that turns at 600 rpm and sees every laser at 8 m, in dual mode the second echo at 6 m on channel 0.
fn packet(number: u32, mode: ReturnMode) -> Packet {
    let layout = Model::Xt32.layout();
    let mut packet = DataPacket::init(vec![0; layout.len + 4], Model::Xt32, mode).unwrap();
    let echoes = mode.echoes().len();
    let shots = (layout.blocks / echoes) as u32;
    for block in 0..layout.blocks {
        let shot = number * shots + (block / echoes) as u32;
        packet.set_azimuth_centideg(block, (shot * 18 % 36_000) as u16);
        for channel in 0..layout.channels {
            let is_nearer = block % echoes == 1 && channel == 0;
            packet.set_return(block, channel, if is_nearer { 1500 } else { 2000 }, 40);
        }
    }
    let micros = number * shots * 50;
    packet.set_motor_rpm(600);
    packet.set_clock(&Clock {
        date: [126, 3, 1],
        time: [10, 59, (micros / 1_000_000) as u8],
        micros: micros % 1_000_000,
    });
    packet.set_sequence(number);
    Packet {
        arrival: Timestamp::from_nanos(i64::from(micros) * 1_000),
        bytes: packet.into_inner(),
    }
}

struct Run {
    scans: Vec<Decoded<LidarScan>>,
    decoder: Decoder,
}

fn run(config: DecoderConfig, packets: &[Packet]) -> Run {
    let mut decoder = Decoder::new(config);
    let mut scans: Vec<_> = packets
        .iter()
        .filter_map(|p| decoder.push(p).ok().flatten())
        .collect();
    while let Some(scan) = decoder.finish() {
        scans.push(scan);
    }
    Run { scans, decoder }
}

#[test]
fn a_turn_is_a_scan_with_every_field_of_every_point() {
    let packets: Vec<_> = (0..500).map(|n| packet(n, ReturnMode::Last)).collect();
    let run = run(DecoderConfig::default(), &packets);
    assert_eq!(run.scans.len(), 2);
    for scan in &run.scans {
        assert_eq!(scan.sample.points.len(), 2_000 * 32);
        for (k, point) in scan.sample.points.iter().enumerate() {
            let (shot, channel) = (k / 32, k % 32);
            let azimuth = (shot as f64 * 0.18).to_radians();
            let elevation = (15.0 - channel as f64).to_radians();
            let expected = [
                8.0 * elevation.cos() * azimuth.cos(),
                -8.0 * elevation.cos() * azimuth.sin(),
                8.0 * elevation.sin(),
            ];
            for (got, want) in point.position_m.into_iter().zip(expected) {
                assert!((f64::from(got) - want).abs() < 1e-5, "{point:?}");
            }
            assert_eq!((point.intensity, point.echo), (40, Echo::Last));
            assert_eq!(usize::from(point.ring), 31 - channel);
            assert_eq!(
                point.time_offset_ns as usize,
                shot * 50_000 + channel * 1_512
            );
        }
    }
    // The second turn begins 0.1 s after the first.
    let ticks: Vec<_> = run.scans.iter().map(|scan| scan.device_ticks).collect();
    assert_eq!(ticks[1] - ticks[0], 100_000_000);
    let found = run.decoder.found().unwrap();
    assert_eq!(
        (found.model, found.returns, found.rpm),
        (Model::Xt32, "last", Some(600))
    );
}

#[test]
fn both_echoes_of_a_shot_say_which_they_are_and_equal_ones_are_one() {
    let packets: Vec<_> = (0..3).map(|n| packet(n, ReturnMode::FirstLast)).collect();
    let run = run(DecoderConfig::default(), &packets);
    let points = &run.scans[0].sample.points;
    assert_eq!(points.len(), 3 * 4 * 33);
    assert_eq!((points[0].echo, points[1].echo), (Echo::Last, Echo::First));
    assert!(points[0].position_m[0] > points[1].position_m[0]);
    assert_eq!(points[2].echo, Echo::Both);
}

#[test]
fn missing_late_and_repeated_packets_are_counted_apart() {
    let mut packets: Vec<_> = (0..100).map(|n| packet(n, ReturnMode::Last)).collect();
    packets.drain(60..63);
    packets.swap(20, 21);
    packets.insert(40, packets[39].clone());
    let counters = *run(DecoderConfig::default(), &packets).decoder.counters();
    assert_eq!(
        (counters.lost, counters.reordered, counters.duplicates),
        (3, 1, 1)
    );
    assert_eq!((counters.packets, counters.clock_jumps), (96, 0));
}

#[test]
fn wrong_models_modes_and_angles_are_refused_with_their_names() {
    let good = packet(0, ReturnMode::Last);
    let error = |config: DecoderConfig, packet: &Packet| {
        Decoder::new(config).push(packet).unwrap_err().to_string()
    };
    let expect = DecoderConfig {
        model: Some(Model::Qt64),
        ..DecoderConfig::default()
    };
    assert_eq!(
        error(expect, &good),
        "packets of a XT32, but a QT64 is configured"
    );
    let angles = BeamAngles::parse_csv("Laser id,Elevation,Azimuth\n1,2.0,3.0\n").unwrap();
    let angles = DecoderConfig {
        angles: Some(angles),
        ..DecoderConfig::default()
    };
    assert!(error(angles, &good).contains("has 1 channels, but a XT32 has 32"));
    let mut triple = good.clone();
    triple.bytes[Model::Xt32.layout().return_mode] = 0x3D;
    assert!(error(DecoderConfig::default(), &triple).contains("0x3d"));
    let mut xt16 = good;
    xt16.bytes[6] = 16;
    assert!(error(DecoderConfig::default(), &xt16).contains("looks like Hesai XT16"));
}
