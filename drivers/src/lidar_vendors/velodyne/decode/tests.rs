use std::collections::VecDeque;
use std::time::Duration;

use lsfb_types::{Echo, Timestamp};

use super::*;
use crate::lidar::HOUR_NS;
use crate::lidar_vendors::velodyne::wire::DATA_PACKET_LEN;
use crate::transport::PacketSource;
use crate::transport::faults::{Fault, Faulty};

const START_NS: i64 = 1_772_359_200_000_000_000;

/// A VLP-32C that turns at a constant rate and sees every laser at 8 m.
struct Twin {
    time_ns: i64,
    rate_centideg_s: f64,
    mode: Returns,
    product: Product,
    window: Option<(u16, u16)>,
}

impl Twin {
    fn new(first_us: i64) -> Self {
        Self {
            time_ns: first_us * 1000,
            rate_centideg_s: 360_000.0,
            mode: Returns::Strongest,
            product: Product::Vlp32c,
            window: None,
        }
    }

    fn azimuth(&self) -> u16 {
        (self.time_ns as f64 * 1e-9 * self.rate_centideg_s).rem_euclid(36_000.0) as u16
    }

    fn packet(&mut self) -> Packet {
        let mut packet =
            DataPacket::init(vec![0; DATA_PACKET_LEN], self.product, self.mode).unwrap();
        let stride = if self.mode == Returns::Dual { 2 } else { 1 };
        let mut start_ns = None;
        for block in 0..12 {
            if block > 0 && block % stride == 0 {
                self.time_ns += 55_296;
            }
            while self
                .window
                .is_some_and(|(from, to)| (from..to).contains(&self.azimuth()))
            {
                self.time_ns += 55_296;
            }
            start_ns.get_or_insert(self.time_ns);
            packet.set_azimuth_centideg(block, self.azimuth());
            for channel in 0..32 {
                packet.set_return(block, channel, 2000, channel as u8);
            }
        }
        self.time_ns += 55_296;
        let start_ns = start_ns.unwrap();
        packet.set_timestamp_us((start_ns.rem_euclid(HOUR_NS) / 1000) as u32);
        Packet {
            arrival: Timestamp::from_nanos(START_NS + start_ns),
            bytes: packet.into_inner(),
        }
    }

    fn packets(&mut self, count: usize) -> Vec<Packet> {
        (0..count).map(|_| self.packet()).collect()
    }
}

struct Run {
    scans: Vec<Decoded<LidarScan>>,
    counters: Counters,
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
    Run {
        scans,
        counters: *decoder.counters(),
    }
}

#[test]
fn our_vectors_decode_to_every_listed_point() {
    let vectors: serde_json::Value = serde_json::from_str(include_str!(
        "../../../../tests/vectors/velodyne_vectors.json"
    ))
    .unwrap();
    let bytes: [&[u8]; 3] = [
        include_bytes!("../../../../tests/vectors/vlp32c_strongest_wrap.bin"),
        include_bytes!("../../../../tests/vectors/vlp32c_dual.bin"),
        include_bytes!("../../../../tests/vectors/vlp32c_last_onepoint.bin"),
    ];
    for (vector, bytes) in vectors.as_array().unwrap().iter().zip(bytes) {
        let packet = DataPacket::new(bytes).unwrap();
        let mode = returns_of_code(packet.return_mode_code()).unwrap();
        let layout = PacketLayout::new(&packet, Model::Vlp32c, mode);
        let hits: Vec<_> = crate::lidar_vendors::velodyne::returns(&packet, &layout).collect();
        let expected = vector["points"].as_array().unwrap();
        assert_eq!(hits.len(), expected.len());
        let run = run(
            DecoderConfig::default(),
            &[Packet {
                arrival: Timestamp::default(),
                bytes: bytes.to_vec(),
            }],
        );
        let points: Vec<_> = run
            .scans
            .iter()
            .flat_map(|scan| &scan.sample.points)
            .collect();
        let ticks = run.scans[0].device_ticks;
        assert_eq!(ticks, vector["toh_us"].as_u64().unwrap() * 1000);
        assert_eq!(points.len(), expected.len());
        for want in expected {
            let number = |field: &str| want[field].as_f64().unwrap();
            let at = hits
                .iter()
                .position(|h| {
                    h.block as f64 == number("block") && h.channel as f64 == number("laser")
                })
                .unwrap();
            let hit = &hits[at];
            assert_eq!(f64::from(hit.reflectivity), number("refl"));
            assert!((f64::from(hit.range_raw) * 0.004 - number("dist_m")).abs() < 1e-9);
            assert!(
                (f64::from(hit.azimuth_centideg) / 100.0 - number("az_deg")).abs() < 2e-4,
                "{hit:?} {want}"
            );
            assert!((hit.time_ns as f64 / 1000.0 - number("t_us")).abs() < 1e-6);
            match want["ret"].as_str().unwrap() {
                "strongest" => assert_eq!(hit.echo, Echo::Strongest),
                _ => assert!(matches!(hit.echo, Echo::Last | Echo::Both)),
            }
            let (azimuth, elevation) = (
                number("az_deg").to_radians(),
                number("elev_deg").to_radians(),
            );
            let flat = number("dist_m") * elevation.cos();
            let position = [
                flat * azimuth.cos(),
                -flat * azimuth.sin(),
                number("dist_m") * elevation.sin(),
            ];
            let point = points[at];
            for (got, want) in point.position_m.into_iter().zip(position) {
                assert!((f64::from(got) - want).abs() < 3e-4, "{point:?}");
            }
            assert_eq!((point.intensity, point.ring), (hit.reflectivity, hit.ring));
            assert_eq!(point.echo, hit.echo);
        }
    }
}

#[test]
fn rings_rank_the_lasers_by_elevation() {
    for model in Model::ALL {
        let mut channels = model.table().channels;
        channels.sort_by(|a, b| a.elevation_deg.total_cmp(&b.elevation_deg));
        let mut rings: Vec<u16> = channels.iter().map(|c| c.ring).collect();
        assert!(rings.is_sorted(), "{model}");
        rings.dedup();
        assert_eq!(rings.len(), if model == Model::Vlp16 { 16 } else { 32 });
        assert!(
            channels
                .iter()
                .all(|c| c.firing_ns < model.table().block_period_ns)
        );
    }
}

#[test]
fn revolutions_are_cut_at_the_wrap_and_through_the_top_of_the_hour() {
    let mut twin = Twin::new(3_599_950_000);
    let packets = twin.packets(500);
    let run = run(DecoderConfig::default(), &packets);
    let expected = Counters {
        packets: 500,
        points: 500 * 384,
        scans: 4,
        azimuths: run.counters.azimuths,
        ..Counters::default()
    };
    assert_eq!(run.counters, expected);
    let fired: u64 = run.counters.azimuths.fired.iter().sum();
    assert_eq!(fired, 500 * 12);
    // The twin passes azimuth 0 at every tenth of a second: 3600.0 s is one of them.
    let whole = &run.scans[1];
    assert!(whole.device_ticks < 60_000, "{}", whole.device_ticks);
    assert!((whole.sample.points.len() as i64 - 32 * 1808).abs() <= 32);
    let offsets: Vec<u32> = whole
        .sample
        .points
        .iter()
        .map(|p| p.time_offset_ns)
        .collect();
    assert_eq!(offsets[0], 0);
    assert!(offsets.is_sorted());
    assert!((99_900_000..100_000_000).contains(offsets.last().unwrap()));
    for scan in &run.scans {
        // Arrival is that of the packet with the first firing: at most one packet earlier than the firing itself.
        let device = (scan.device_ticks as i64 - 3_599_950_000_000).rem_euclid(HOUR_NS);
        let arrival = scan.arrival.nanos() - START_NS - 3_599_950_000_000;
        assert!(
            (0..=663_552).contains(&(device - arrival)),
            "{device} {arrival}"
        );
    }
}

#[test]
fn a_missing_packet_is_counted_once_and_a_late_or_double_one_left_out() {
    let packets = Twin::new(1_000_000).packets(200);
    let mut faulty = packets.clone();
    faulty.remove(50);
    faulty.drain(100..103);
    faulty.insert(20, packets[10].clone());
    faulty.insert(30, faulty[29].clone());
    let run = run(DecoderConfig::default(), &faulty);
    let counters = run.counters;
    assert_eq!(
        (counters.lost, counters.reordered, counters.duplicates),
        (4, 1, 1)
    );
    assert_eq!((counters.packets, counters.clock_jumps), (196, 0));
}

/// The next packet begins where the last one ended, and so nothing was missed.
#[test]
fn whole_turns_that_are_lost_are_counted() {
    let mut twin = Twin::new(1_000_000);
    // A turn of 150 packets.
    twin.rate_centideg_s = 36_000.0 / (150.0 * 663_552e-9);
    let packets = twin.packets(1_200);
    for turns in [1, 3] {
        let mut faulty = packets.clone();
        faulty.drain(400..400 + 150 * turns);
        let counters = run(DecoderConfig::default(), &faulty).counters;
        assert_eq!(counters.lost, 150 * turns as u64, "{turns}");
        assert_eq!((counters.clock_jumps, counters.crowded), (0, 0));
    }

    // Behind a window: from its one edge to the other, but a turn later.
    let mut twin = Twin::new(0);
    twin.window = Some((9_000, 27_000));
    let packets = twin.packets(4_000);
    let edges: Vec<usize> = (100..packets.len())
        .filter(|n| {
            let azimuth = |packet: &Packet, block| {
                DataPacket::new(&packet.bytes[..])
                    .unwrap()
                    .azimuth_centideg(block)
            };
            let (last, first) = (azimuth(&packets[n - 1], 11), azimuth(&packets[*n], 0));
            (8_950..9_000).contains(&last) && (27_000..27_050).contains(&first)
        })
        .collect();
    let (from, to) = (edges[0], edges[1]);
    assert!(to - from > 50, "{edges:?}");
    let mut faulty = packets;
    faulty.drain(from..to);
    let lost = run(DecoderConfig::default(), &faulty).counters.lost;
    assert!(
        lost.abs_diff((to - from) as u64) <= 2,
        "{lost} of {}",
        to - from
    );
}

#[test]
fn a_field_of_view_window_loses_nothing_and_times_both_sides() {
    let mut twin = Twin::new(0);
    twin.window = Some((9_000, 27_000));
    let packets = twin.packets(2_000);
    let config = DecoderConfig {
        cut_azimuth_centideg: 18_000,
        ..DecoderConfig::default()
    };
    let run = run(config, &packets);
    assert_eq!((run.counters.packets, run.counters.malformed), (2_000, 0));
    // Until the window has shown itself inside a packet, a gap between packets counts as loss: here it never comes first.
    assert_eq!(run.counters.lost, 0);
    for scan in &run.scans[1..run.scans.len() - 1] {
        let points = &scan.sample.points;
        // Dead from a quarter to three quarters of each tenth of a second; timestamps are cut to microseconds.
        let start_ns = scan.device_ticks % 100_000_000;
        assert!((75_000_000..75_057_000).contains(&start_ns), "{start_ns}");
        let end_ns = points.last().unwrap().time_offset_ns;
        assert!((49_940_000..50_040_000).contains(&end_ns), "{end_ns}");
    }
}

#[test]
fn a_change_of_mode_or_model_ends_the_scan() {
    let mut twin = Twin::new(0);
    let mut packets = twin.packets(40);
    twin.mode = Returns::Dual;
    packets.extend(twin.packets(40));
    twin.mode = Returns::Last;
    packets.extend(twin.packets(40));
    let run = run(DecoderConfig::default(), &packets);
    let sizes: Vec<usize> = run.scans.iter().map(|s| s.sample.points.len()).collect();
    // In dual mode both echoes are equal here: one point each.
    assert_eq!(sizes, [40 * 384, 40 * 192, 40 * 384]);
    assert_eq!((run.counters.mode_changes, run.counters.lost), (2, 0));
}

#[test]
fn other_sensors_are_refused_by_name() {
    let mut twin = Twin::new(0);
    let named = |config: ModelChoice, packet: &Packet| {
        let mut decoder = Decoder::new(DecoderConfig {
            model: config,
            ..DecoderConfig::default()
        });
        let error = decoder.push(packet).unwrap_err();
        assert_eq!(decoder.counters().refused, 1);
        error.to_string()
    };
    for (product, name) in [
        (Product::Vls128, "VLS-128"),
        (Product::Vlp32ab, "VLP-32A/B"),
        (Product::PuckHiRes, "Puck Hi-Res"),
        (Product::Unknown(0x77), "unknown product 0x77"),
    ] {
        twin.product = product;
        let text = named(ModelChoice::FromPackets, &twin.packet());
        assert!(text.contains(name), "{text}");
    }
    twin.product = Product::Vlp16;
    let text = named(ModelChoice::Expect(Model::Vlp32c), &twin.packet());
    assert_eq!(text, "packets of a VLP-16, but a VLP-32C is configured");
    let mut hdl64 = twin.packet();
    for block in (1..12).step_by(2) {
        hdl64.bytes[block * 100..block * 100 + 2].copy_from_slice(&[0xFF, 0xDD]);
    }
    assert!(named(ModelChoice::FromPackets, &hdl64).contains("HDL-64E"));
    let mut modeless = twin.packet();
    modeless.bytes[1204] = 0;
    assert!(named(ModelChoice::FromPackets, &modeless).contains("0x00"));
    let forced = ModelChoice::Force(Model::Vlp16, Returns::Last);
    assert_eq!(
        run(
            DecoderConfig {
                model: forced,
                ..DecoderConfig::default()
            },
            &[modeless]
        )
        .counters
        .packets,
        1
    );
}

#[test]
fn a_clock_that_is_set_ends_the_scan_and_counts_no_loss() {
    let mut twin = Twin::new(5_000_000);
    let mut packets = twin.packets(30);
    // PPS locks: the counter jumps by twenty minutes while the host sees the usual pace.
    let mut later = Twin::new(1_205_000_000);
    packets.extend(later.packets(30).into_iter().map(|mut p| {
        p.arrival = p.arrival.plus_nanos(-1_200_000_000_000 + 30 * 663_552);
        p
    }));
    let mut back = Twin::new(4_000_000);
    packets.extend(back.packets(30).into_iter().map(|mut p| {
        p.arrival = p.arrival.plus_nanos(1_000_000_000 + 60 * 663_552);
        p
    }));
    let run = run(DecoderConfig::default(), &packets);
    assert_eq!(
        (
            run.counters.clock_jumps,
            run.counters.lost,
            run.counters.packets
        ),
        (2, 0, 90)
    );
}

#[test]
fn a_stopped_rotor_does_not_grow_one_scan_for_ever() {
    let mut twin = Twin::new(0);
    twin.rate_centideg_s = 0.0;
    let run = run(DecoderConfig::default(), &twin.packets(4_000));
    // 2.65 s, in scans of 0.3 s.
    assert_eq!(run.counters.overlong, 8);
    assert_eq!(run.scans.len(), 9);
    assert_eq!(run.counters.points, 4_000 * 384);
}

#[test]
fn random_and_mutated_packets_never_panic() {
    // A small multiplicative generator: the test needs variety, not quality.
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut forced = Decoder::new(DecoderConfig {
        model: ModelChoice::Force(Model::Hdl32e, Returns::Dual),
        cut_azimuth_centideg: u16::MAX,
        optical_offset: OpticalOffset::Applied,
    });
    let mut twin = Twin::new(0);
    for round in 0..20_000 {
        let mut packet = twin.packet();
        if round % 3 == 0 {
            let length = random() as usize % 1400;
            packet.bytes = (0..length).map(|_| random() as u8).collect();
        } else {
            for _ in 0..random() % 6 {
                let at = random() as usize % packet.bytes.len();
                packet.bytes[at] = random() as u8;
            }
            if round % 5 == 0 {
                packet.bytes.truncate(random() as usize % 1207);
            }
            packet.arrival = packet
                .arrival
                .plus_nanos(random() as i64 >> (random() % 64));
        }
        let _ = decoder.push(&packet);
        let _ = forced.push(&packet);
    }
    let counters = *decoder.counters();
    assert!(
        counters.packets > 5_000 && counters.malformed > 5_000,
        "{counters:?}"
    );
    while decoder.finish().is_some() {}
    while forced.finish().is_some() {}
}

#[test]
fn a_packet_with_a_wrong_time_costs_a_few_packets_and_not_a_tenth_of_a_second() {
    let mut packets = Twin::new(1_000_000).packets(300);
    let mut wrong = DataPacket::new(packets[100].bytes.clone()).unwrap();
    wrong.set_timestamp_us(wrong.timestamp_us() + 65_536);
    packets[100].bytes = wrong.into_inner();
    let counters = run(DecoderConfig::default(), &packets).counters;
    assert_eq!((counters.reordered, counters.clock_jumps), (8, 1));
    assert_eq!(counters.packets, 292);
}

/// Packets of a list.
struct Replay(VecDeque<Packet>);

impl PacketSource for Replay {
    fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, crate::Error> {
        self.0
            .pop_front()
            .map(Some)
            .ok_or(crate::Error::EndOfStream {
                device: "a list".to_owned(),
            })
    }
}

/// What faults on the way do to a stream, whatever the seed.
#[test]
fn faults_on_the_way_cost_what_they_took_and_are_counted() {
    let packets = Twin::new(1_000_000).packets(1_000);
    let clean = run(DecoderConfig::default(), &packets);
    for seed in 0..10 {
        let suffer = |fault| {
            let mut faulty = Faulty::new(Replay(packets.clone().into()), fault, seed);
            let next = || faulty.recv(Duration::ZERO).ok().flatten();
            let seen: Vec<Packet> = std::iter::from_fn(next).collect();
            let affected = faulty.counts().affected;
            assert!(affected > 0, "{fault:?}");
            (run(DecoderConfig::default(), &seen), seen, affected)
        };

        let (outcome, seen, _) = suffer(Fault::Drop { probability: 0.05 });
        // What is missing before the first or behind the last cannot be known.
        let number = |p: &Packet| packets.iter().position(|q| q.bytes == p.bytes).unwrap();
        let span = number(seen.last().unwrap()) - number(&seen[0]) + 1;
        assert_eq!(outcome.counters.lost, (span - seen.len()) as u64);
        assert_eq!(outcome.counters.packets, seen.len() as u64);

        let (outcome, _, affected) = suffer(Fault::Duplicate { probability: 0.05 });
        assert_eq!(outcome.counters.duplicates, affected);
        assert_eq!(outcome.counters.points, clean.counters.points);

        let (outcome, _, affected) = suffer(Fault::Reorder {
            probability: 0.02,
            places: 2,
        });
        // Who is overtaken by a packet that is overtaken itself, or by none any more at the end, comes in order.
        let late = outcome.counters.reordered;
        assert!(
            late <= affected && late + 4 >= affected,
            "{late} {affected}"
        );
        assert_eq!(outcome.counters.packets + late, 1_000);

        let (outcome, _, affected) = suffer(Fault::Truncate { probability: 0.05 });
        assert_eq!(outcome.counters.malformed, affected);

        let corrupt = Fault::Corrupt {
            probability: 0.05,
            bits: 3,
        };
        let (outcome, ..) = suffer(corrupt);
        assert!(outcome.counters.packets >= 900, "{:?}", outcome.counters);

        // The host's clock, delays and batches change arrivals and no point.
        for fault in [
            Fault::ClockStep {
                after_ns: 300_000_000,
                step_ns: -1_000_000_000,
            },
            Fault::Delay {
                delay_ns: 5_000_000,
                jitter_ns: 5_000_000,
            },
            Fault::Stall {
                start_ns: 100_000_000,
                length_ns: 45_000_000,
                period_ns: 200_000_000,
            },
        ] {
            let (outcome, ..) = suffer(fault);
            assert_eq!(outcome.counters, clean.counters, "{fault:?}");
            let points = |run: &Run| -> Vec<LidarScan> {
                run.scans.iter().map(|scan| scan.sample.clone()).collect()
            };
            assert!(points(&outcome) == points(&clean), "{fault:?}");
        }
    }
}
