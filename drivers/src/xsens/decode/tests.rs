use super::*;
use crate::test_random::Random;
use crate::xsens::wire::{UtcTime, Vector};

fn frame(counter: u16) -> Vec<u8> {
    let items = [
        Item::PacketCounter(counter),
        Item::SampleTimeFine(50 * u32::from(counter)),
        Item::Utc(UtcTime::from_unix_nanos(1_772_359_200_005_000_000).unwrap()),
        Item::Acceleration(Vector::single([0.5, -0.25, 9.8125])),
        Item::RateOfTurn(Vector::single([0.125, -0.5, f64::from(counter)])),
        Item::StatusWord(3),
    ];
    message_of(&items)
}

fn message_of(items: &[Item<'_>]) -> Vec<u8> {
    let mut data = Vec::new();
    for item in items {
        item.emit(&mut data).unwrap();
    }
    let mut bytes = Vec::new();
    Message {
        id: 0x36,
        data: &data,
    }
    .emit(&mut bytes)
    .unwrap();
    bytes
}

fn at(nanos: i64, bytes: &[u8]) -> Packet {
    Packet {
        arrival: Timestamp::from_nanos(nanos),
        bytes: bytes.to_vec(),
    }
}

/// Counters of the packets that come out, and what the decoder counted.
fn decode(chunks: impl IntoIterator<Item = Vec<u8>>) -> (Vec<u16>, ImuCounters) {
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut packet_counters = Vec::new();
    for chunk in chunks {
        decoder.push(&at(0, &chunk));
        while let Some(reading) = decoder.next_reading() {
            packet_counters.push(reading.sample.packet_counter.unwrap());
        }
    }
    for reading in decoder.finish() {
        packet_counters.push(reading.sample.packet_counter.unwrap());
    }
    (packet_counters, decoder.counters())
}

#[test]
fn every_field_of_a_reading() {
    let trigger = TriggerIn {
        line: 1,
        polarity: 1,
        sample_time_fine: 99,
        frame_number: 4,
    };
    let bytes = message_of(&[
        Item::PacketCounter(7),
        Item::SampleTimeFine(350),
        Item::Utc(UtcTime::from_unix_nanos(1_772_359_200_005_000_000).unwrap()),
        Item::Temperature {
            celsius: 31.5,
            coding: Default::default(),
        },
        Item::Acceleration(Vector::single([0.5, -0.25, 9.8125])),
        Item::RateOfTurn(Vector::double([0.1, -0.2, 0.3])),
        Item::TriggerIn2(trigger),
        Item::StatusWord(3),
    ]);
    let mut decoder = Decoder::new(DecoderConfig::default());
    decoder.push(&at(5, &bytes));
    assert_eq!(
        decoder.next_reading(),
        Some(Decoded {
            arrival: Timestamp::from_nanos(5),
            device_ticks: 350,
            sample: ImuReading {
                sample: Some(ImuSample {
                    angular_velocity_rad_s: [0.1, -0.2, 0.3],
                    specific_force_m_s2: [0.5, -0.25, 9.8125],
                }),
                utc_ns: Some(1_772_359_200_005_000_000),
                packet_counter: Some(7),
                temperature_celsius: Some(31.5),
                status: Some(3),
                triggers: [None, Some(trigger)],
            },
        })
    );
    assert_eq!(decoder.next_reading(), None);
}

#[test]
fn any_cut_of_the_stream_gives_the_same_packets() {
    let stream: Vec<u8> = (0..50).flat_map(frame).collect();
    for chunk_len in [1, 2, 7, 60, 4096] {
        let (counters, met) = decode(stream.chunks(chunk_len).map(<[u8]>::to_vec));
        assert_eq!(counters, (0..50).collect::<Vec<_>>());
        assert_eq!(
            met,
            ImuCounters {
                packets: 50,
                ..Default::default()
            }
        );
    }
}

#[test]
fn arrival_is_that_of_the_first_byte() {
    let bytes = [frame(1), frame(2)].concat();
    let mut decoder = Decoder::new(DecoderConfig::default());
    decoder.push(&at(10, &bytes[..3]));
    assert_eq!(decoder.next_reading(), None);
    decoder.push(&at(20, &bytes[3..70]));
    decoder.push(&at(30, &bytes[70..]));
    let arrivals: Vec<_> = std::iter::from_fn(|| decoder.next_reading())
        .map(|reading| reading.arrival.nanos())
        .collect();
    assert!(bytes.len() / 2 < 70);
    assert_eq!(arrivals, [10, 20]);
}

#[test]
fn one_damaged_packet_costs_only_itself() {
    let mut stream = vec![0x00, 0xFA, 0x12];
    for counter in 0..5 {
        let mut bytes = frame(counter);
        if counter == 2 {
            bytes[30] ^= 0xFF;
        }
        stream.extend(bytes);
    }
    let len = frame(2).len() as u64;
    let (counters, met) = decode([stream]);
    assert_eq!(counters, [0, 1, 3, 4]);
    assert_eq!(
        met,
        ImuCounters {
            packets: 4,
            skipped_bytes: 3 + len,
            bad_checksums: 1,
            missing: 1,
            ..Default::default()
        }
    );
}

#[test]
fn a_packet_cut_short_does_not_take_the_next_with_it() {
    let mut stream = frame(1);
    stream.truncate(20);
    stream.extend(frame(2));
    stream.extend(frame(3));
    let (counters, met) = decode([stream]);
    assert_eq!(counters, [2, 3]);
    assert_eq!((met.skipped_bytes, met.packets), (20, 2));
    // A damaged length that reaches beyond the end is given up when the stream ends.
    let mut stream = frame(1);
    stream[3] = 0xFE;
    stream.extend(frame(2));
    assert_eq!(decode([stream]).0, [2]);
    // One that is longer than any packet is not waited for.
    let mut stream = frame(1);
    stream[3..6].copy_from_slice(&[0xFF, 0x1F, 0x00]);
    stream.extend(frame(2));
    let mut decoder = Decoder::new(DecoderConfig::default());
    decoder.push(&at(0, &stream));
    assert_eq!(
        decoder.next_reading().unwrap().sample.packet_counter,
        Some(2)
    );
}

#[test]
fn gaps_repetitions_and_restarts_are_counted() {
    let frames = [65_534, 65_535, 0, 0, 3, 2, 3].map(frame);
    let (counters, met) = decode(frames);
    assert_eq!(counters, [65_534, 65_535, 0, 3, 2, 3]);
    assert_eq!((met.missing, met.duplicated), (2, 1));
    let mut error = Vec::new();
    Message {
        id: 0x42,
        data: &[4],
    }
    .emit(&mut error)
    .unwrap();
    let bad_item = message_of(&[Item::Other {
        id: 0x1020,
        value: &[1],
    }]);
    let (_, met) = decode([error, bad_item]);
    assert_eq!((met.device_errors, met.bad_items), (1, 1));
}

#[test]
fn damaged_streams_never_panic_and_good_packets_come_through() {
    let mut random = Random::new(2);
    for _ in 0..300 {
        let mut stream: Vec<u8> = (0..20).flat_map(frame).collect();
        random.mutate(&mut stream);
        // Ten whole packets behind the damage push any bogus length out.
        stream.extend((20..30).flat_map(frame));
        let (counters, _) = decode(stream.chunks(random.below(200) + 1).map(<[u8]>::to_vec));
        let expected: Vec<u16> = (20..30).collect();
        assert!(counters.ends_with(&expected), "{counters:?}");
    }
}
