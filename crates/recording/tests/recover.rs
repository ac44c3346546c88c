//! Whole files from cut and damaged ones.
#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::path::{Path, PathBuf};

use lsfb_recording::{Compression, Error, Recording, Writer, WriterConfig, recover};
use lsfb_types::{ImuSample, Stamped, Stopped, Timestamp, no_progress};

const START: i64 = 1_772_359_200_000_000_000;
const SAMPLES: u32 = 200;
/// A chunk every quarter of a second, twenty-five samples each.
const PER_CHUNK: u32 = 25;

fn sample(n: u32) -> Stamped<ImuSample> {
    let time = Timestamp::from_nanos(START + i64::from(n) * 10_000_000);
    Stamped {
        time,
        arrival: time + 1_000_000,
        device_ticks: u64::from(n) + 1,
        sample: ImuSample {
            angular_velocity_rad_s: [f64::from(n), 0.5, -0.5],
            specific_force_m_s2: [0.0, 0.0, 9.81],
        },
    }
}

fn whole(dir: &Path, compression: Compression) -> Vec<u8> {
    let path = dir.join("whole.mcap");
    let config = WriterConfig {
        compression,
        chunk_secs: 0.25,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(&path, &config).unwrap();
    writer.attach("notes.txt", "text/plain", b"a walk").unwrap();
    for n in 0..SAMPLES {
        writer.write_imu("imu0", &sample(n)).unwrap();
    }
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

fn put(dir: &Path, bytes: &[u8]) -> PathBuf {
    let path = dir.join("damaged.mcap");
    std::fs::write(&path, bytes).unwrap();
    path
}

fn numbers(path: &Path) -> Vec<u32> {
    let recording = Recording::open(path).unwrap();
    assert_eq!(recording.damage(), []);
    assert_eq!(recording.verify(&no_progress).unwrap(), []);
    assert_eq!(recording.attachment("notes.txt").unwrap(), b"a walk");
    assert!(
        recording
            .metadata("lsfb.session")
            .unwrap()
            .contains_key("software")
    );
    let Ok(samples) = recording.imu() else {
        return Vec::new();
    };
    samples
        .map(Result::unwrap)
        .map(|got| {
            let n = got.sample.angular_velocity_rad_s[0] as u32;
            // The counter beside the last one may have been torn off.
            let device_ticks = got.device_ticks;
            assert_eq!(
                Stamped {
                    device_ticks,
                    ..sample(n)
                },
                got
            );
            n
        })
        .collect()
}

/// Wherever it is cut: all whole chunks are there, and of the torn one what came through.
#[test]
fn a_file_that_is_cut_anywhere_becomes_whole() {
    let dir = tempfile::tempdir().unwrap();
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let bytes = whole(dir.path(), compression);
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let first = summary.chunk_indexes[0].chunk_start_offset as usize;
        let mut salvaged = 0;
        for length in (first..bytes.len()).step_by(997) {
            let out = dir.path().join(format!("{length}.mcap"));
            let recovered =
                recover(&put(dir.path(), &bytes[..length]), &out, &no_progress).unwrap();
            let kept = numbers(&out);
            assert_eq!(kept, (0..kept.len() as u32).collect::<Vec<_>>());
            let chunks = summary
                .chunk_indexes
                .iter()
                .filter(|c| (c.chunk_start_offset + c.chunk_length) as usize <= length)
                .count();
            assert!(kept.len() >= chunks * PER_CHUNK as usize, "cut to {length}");
            assert_eq!(recovered.bytes, std::fs::metadata(&out).unwrap().len());
            salvaged += recovered.salvaged_messages;
            std::fs::remove_file(&out).unwrap();
        }
        // A block of lz4 or zstd that is torn gives nothing.
        assert!(salvaged > 0 || compression != Compression::None);
    }
}

#[test]
fn what_is_damaged_in_the_middle_is_left_out_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = whole(dir.path(), Compression::Lz4);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    // In the first chunk the topic is defined; the end of the file still knows it.
    for chunk in [&summary.chunk_indexes[0], &summary.chunk_indexes[4]] {
        let mut broken = bytes.clone();
        broken[(chunk.chunk_start_offset + chunk.chunk_length / 2) as usize] ^= 0x55;
        let path = put(dir.path(), &broken);
        let out = dir.path().join("out.mcap");
        let recovered = recover(&path, &out, &no_progress).unwrap();
        assert_eq!(numbers(&out).len() as u32, SAMPLES - PER_CHUNK);
        let named: Vec<_> = recovered
            .damage
            .iter()
            .filter(|d| d.offset == chunk.chunk_start_offset && d.bytes == chunk.chunk_length)
            .collect();
        assert_eq!(named.len(), 1, "{:?}", recovered.damage);
        // Nothing is overwritten, the damaged file least of all.
        assert!(matches!(
            recover(&path, &out, &no_progress),
            Err(Error::Exists { .. })
        ));
        assert!(matches!(
            recover(&path, &path, &no_progress),
            Err(Error::Exists { .. })
        ));
        assert_eq!(std::fs::read(&path).unwrap(), broken);
        std::fs::remove_file(&out).unwrap();
    }
}

/// Any byte of the magic or of the header record: its opcode, its length, a string's length, a letter.
#[test]
fn a_recording_whose_header_is_damaged_becomes_whole() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = whole(dir.path(), Compression::Lz4);
    let header_bytes = 8 + 9 + u64::from_le_bytes(bytes[9..17].try_into().unwrap()) as usize;
    let out = dir.path().join("out.mcap");
    for at in 0..header_bytes {
        let mut broken = bytes.clone();
        broken[at] ^= 0x55;
        let recovered = recover(&put(dir.path(), &broken), &out, &no_progress).unwrap();
        assert_eq!(numbers(&out), (0..SAMPLES).collect::<Vec<_>>(), "byte {at}");
        // A letter of the writer's name harms nobody.
        let is_read = Recording::open(&put(dir.path(), &broken)).is_ok();
        let told = recovered
            .damage
            .iter()
            .any(|d| d.offset == 0 && d.bytes > 0);
        assert!(is_read || told, "byte {at}: {:?}", recovered.damage);
        std::fs::remove_file(&out).unwrap();
    }
    // All of it, and the end of the file as well.
    let mut broken = bytes[..bytes.len() - 100].to_vec();
    broken[..header_bytes].fill(0);
    recover(&put(dir.path(), &broken), &out, &no_progress).unwrap();
    assert_eq!(numbers(&out), (0..SAMPLES).collect::<Vec<_>>());
}

/// Without a checksum nothing but its records tells that a chunk is broken inside; naively it is copied and called whole.
#[test]
fn a_chunk_without_checksum_that_is_broken_inside_is_named_and_its_beginning_saved() {
    let dir = tempfile::tempdir().unwrap();
    let mut bytes = whole(dir.path(), Compression::None);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut chunks: Vec<usize> = summary
        .chunk_indexes
        .iter()
        .map(|chunk| chunk.chunk_start_offset as usize)
        .collect();
    chunks.sort_unstable();
    // Kind, length, two times, length unpacked: then the checksum.
    for chunk in &chunks {
        bytes[chunk + 33..chunk + 37].fill(0);
    }
    let unchecked = Recording::open(&put(dir.path(), &bytes)).unwrap();
    assert_eq!(unchecked.verify(&no_progress).unwrap(), []);
    assert_eq!(
        unchecked.chunks_without_checksum().unwrap(),
        chunks.len() as u64
    );

    // The length of a record in the middle of the third chunk; before its records stand the name of no compression, and their length.
    let length_at = |at: usize| u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
    let start = chunks[2];
    let end = start + 9 + length_at(start) as usize;
    let mut at = start + 49;
    while at < (start + end) / 2 {
        at += 9 + length_at(at) as usize;
    }
    bytes[at + 8] = 0x7f;
    let path = put(dir.path(), &bytes);
    let damage = Recording::open(&path)
        .unwrap()
        .verify(&no_progress)
        .unwrap();
    let [broken] = &damage[..] else {
        panic!("{damage:?}");
    };
    assert_eq!(
        (broken.offset, broken.bytes),
        (start as u64, (end - at) as u64)
    );
    let out = dir.path().join("recovered.mcap");
    let recovered = recover(&path, &out, &no_progress).unwrap();
    let [broken] = &recovered.damage[..] else {
        panic!("{:?}", recovered.damage);
    };
    assert!(broken.reason.contains("records inside a chunk are broken"));
    assert!(recovered.salvaged_messages > 0, "{recovered:?}");
    let left = numbers(&out);
    let (third, rest) = (2 * PER_CHUNK..3 * PER_CHUNK, left.len() as u32);
    assert!(
        (SAMPLES - PER_CHUNK + 5..SAMPLES - 5).contains(&rest),
        "{left:?}"
    );
    assert!((0..SAMPLES).all(|n| left.contains(&n) || third.contains(&n)));
}

/// What was no recording does not become one.
#[test]
fn a_file_of_another_kind_is_not_recovered() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out.mcap");
    for bytes in [&[0; 5000][..], b"a text", &[6; 5000]] {
        let refused = recover(&put(dir.path(), bytes), &out, &no_progress);
        assert!(matches!(refused, Err(Error::NotMcap { .. })), "{refused:?}");
        assert!(!out.exists());
    }
    let path = dir.path().join("ros1.mcap");
    let mut writer = mcap::WriteOptions::new()
        .profile("ros1")
        .create(std::io::BufWriter::new(
            std::fs::File::create(&path).unwrap(),
        ))
        .unwrap();
    let channel = writer
        .add_channel(0, "/imu", "ros1", &std::collections::BTreeMap::new())
        .unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 1,
        publish_time: 1,
    };
    writer.write_to_known_channel(&header, b"bytes").unwrap();
    writer.finish().unwrap();
    let refused = recover(&path, &out, &no_progress);
    assert!(matches!(refused, Err(Error::Profile { .. })), "{refused:?}");
    assert!(!out.exists());
}

#[test]
fn a_whole_file_is_copied_message_by_message() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = whole(dir.path(), Compression::Lz4);
    let out = dir.path().join("out.mcap");
    let recovered = recover(&put(dir.path(), &bytes), &out, &no_progress).unwrap();
    assert_eq!(
        (recovered.damage.len(), recovered.salvaged_messages),
        (0, 0)
    );
    assert_eq!(numbers(&out), (0..SAMPLES).collect::<Vec<_>>());
    // Read by the crate too, whose checks are others.
    let copied = std::fs::read(&out).unwrap();
    let messages = mcap::MessageStream::new(&copied).unwrap();
    assert_eq!(
        messages.map(Result::unwrap).count() as u64,
        recovered.messages
    );
}

#[test]
fn arrivals_and_the_last_message_come_from_the_indexes() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = whole(dir.path(), Compression::Lz4);
    for length in [bytes.len(), bytes.len() - 40] {
        let recording = Recording::open(&put(dir.path(), &bytes[..length])).unwrap();
        let arrivals = recording.arrivals(&no_progress).unwrap();
        let imu = arrivals
            .iter()
            .find(|a| a.topic == "/imu0/data_raw")
            .unwrap();
        let expected: Vec<_> = (0..SAMPLES).map(|n| sample(n).arrival).collect();
        assert_eq!(imu.times, expected);
        let last = recording.last_message("/imu0/data_raw").unwrap().unwrap();
        assert_eq!(last.time, sample(SAMPLES - 1).time);
        assert!(recording.last_message("/nothing").unwrap().is_none());
    }
}

#[test]
fn what_is_stopped_leaves_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = put(dir.path(), &whole(dir.path(), Compression::Zstd));
    let out = dir.path().join("recovered.mcap");
    let stopped = recover(&path, &out, &|p| match p.done {
        0..3 => Ok(()),
        _ => Err(Stopped),
    });
    assert!(matches!(stopped, Err(Error::Stopped(_))), "{stopped:?}");
    assert!(!out.exists());
    let recording = Recording::open(&path).unwrap();
    let stopped = recording.arrivals(&|_| Err(Stopped));
    assert!(matches!(stopped, Err(Error::Stopped(_))), "{stopped:?}");
}
