//! Cut and corrupted recordings: nothing panics, what is read is what was written, and what is missing is said.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};

use lsfb_recording::{Compression, Error, Recording, Writer, WriterConfig};
use lsfb_types::{Image, ImuSample, Stamped, Timestamp, no_progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const START: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);
const SAMPLES: u32 = 40;

fn sample(n: u32) -> Stamped<ImuSample> {
    let time = START + i64::from(n) * 50_000_000;
    let sample = ImuSample {
        angular_velocity_rad_s: [f64::from(n), 0.5, -0.5],
        specific_force_m_s2: [0.0, 0.0, 9.81],
    };
    Stamped {
        time,
        arrival: time + 1_000_000,
        device_ticks: u64::from(n) + 1,
        sample,
    }
}

fn image(n: u32) -> Stamped<Image> {
    let time = START + i64::from(n) * 50_000_000;
    let sample = Image {
        width: 8,
        height: 6,
        pixels: (0..48).map(|i| (i * 5 + n) as u8).collect(),
        exposure_ns: n,
        frame_id: n,
    };
    Stamped {
        time,
        arrival: time + 2_000_000,
        device_ticks: u64::from(n),
        sample,
    }
}

/// Chunks of a quarter of a second, five samples each, with an attachment in front.
fn small_recording(dir: &Path, compression: Compression, samples: u32) -> Vec<u8> {
    let path = dir.join("whole.mcap");
    let config = WriterConfig {
        compression,
        chunk_secs: 0.25,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(&path, &config).unwrap();
    writer.attach("notes.txt", "text/plain", b"a walk").unwrap();
    for n in 0..samples {
        writer.write_imu("imu0", &sample(n)).unwrap();
        writer.write_image("cam0", &image(n)).unwrap();
    }
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

struct Survived {
    imu: usize,
    images: usize,
    errors: usize,
}

/// Reads everything that can be read; panics where something was read that nobody wrote.
fn read_everything(recording: &Recording) -> Survived {
    let mut survived = Survived {
        imu: 0,
        images: 0,
        errors: 0,
    };
    if let Ok(samples) = recording.imu() {
        let mut last = None;
        for item in samples {
            match item {
                Ok(got) => {
                    let n = got.sample.angular_velocity_rad_s[0] as u32;
                    // The counter beside a sample may be lost with the chunk that defines its topic.
                    let counted =
                        got.device_ticks == 0 || got.device_ticks == sample(n).device_ticks;
                    assert!(
                        counted
                            && got
                                == Stamped {
                                    device_ticks: got.device_ticks,
                                    ..sample(n)
                                }
                    );
                    assert!(last < Some(n), "once and in order");
                    last = Some(n);
                    survived.imu += 1;
                }
                Err(_) => survived.errors += 1,
            }
        }
    }
    if let Ok(images) = recording.images("cam0") {
        for item in images {
            match item {
                Ok(got) => {
                    let n = (got.time - START) as u32 / 50_000_000;
                    assert_eq!(got.sample.pixels, image(n).sample.pixels);
                    survived.images += 1;
                }
                Err(_) => survived.errors += 1,
            }
        }
    }
    if let Ok(notes) = recording.attachment("notes.txt") {
        assert_eq!(notes, b"a walk");
    }
    let _ = recording.metadata("lsfb.session");
    let _ = recording.rig();
    let _ = recording.arrival_range();
    recording.verify(&no_progress).unwrap();
    survived
}

fn put(dir: &Path, bytes: &[u8]) -> PathBuf {
    let path = dir.join("damaged.mcap");
    // Truncating a file makes some file systems write it out at once, thousands of times here.
    let _ = std::fs::remove_file(&path);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn cut_at_every_byte_it_opens_up_to_the_last_whole_chunk() {
    let dir = tempfile::tempdir().unwrap();
    for compression in [Compression::Lz4, Compression::None, Compression::Zstd] {
        let bytes = small_recording(dir.path(), compression, 12);
        let step = match compression {
            Compression::Lz4 => 1,
            Compression::Zstd => 13,
            Compression::None => 41,
        };
        let mut best = 0;
        for length in (0..bytes.len()).step_by(step) {
            let path = put(dir.path(), &bytes[..length]);
            match Recording::open(&path) {
                Ok(recording) => {
                    assert!(!recording.damage().is_empty(), "cut to {length}");
                    let lost_bytes: u64 = recording.damage().iter().map(|d| d.bytes).sum();
                    assert!(lost_bytes <= length as u64);
                    let survived = read_everything(&recording);
                    assert_eq!(
                        survived.errors,
                        0,
                        "cut to {length}: {:?}",
                        recording.damage()
                    );
                    assert!(survived.imu >= best, "longer files hold more");
                    best = survived.imu;
                }
                Err(Error::Empty { .. }) => assert_eq!(length, 0),
                Err(Error::NotMcap { .. }) => assert!(length < 64, "cut to {length}"),
                Err(other) => panic!("cut to {length}: {other}"),
            }
        }
        assert_eq!(best, 12, "all chunks, without the summary");
    }
}

#[test]
fn flipped_bytes_never_panic_and_never_lie() {
    let dir = tempfile::tempdir().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut opened, mut noticed) = (0, 0);
    for compression in [Compression::Lz4, Compression::Zstd, Compression::None] {
        let whole = small_recording(dir.path(), compression, SAMPLES);
        for _ in 0..200 {
            let mut bytes = whole.clone();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..bytes.len());
                bytes[at] ^= rng.random_range(1..=255u8);
            }
            // Half of them without a summary, so that the walk over the records is tried as well.
            if rng.random_range(0..2) == 0 {
                bytes.truncate(bytes.len() - rng.random_range(1..200));
            }
            if let Ok(recording) = Recording::open(&put(dir.path(), &bytes)) {
                opened += 1;
                let survived = read_everything(&recording);
                let whole = survived.imu == SAMPLES as usize && survived.images == SAMPLES as usize;
                let said = survived.errors > 0 || !recording.damage().is_empty();
                noticed += u32::from(said);
                assert!(whole || said, "something is missing and nothing was said");
            }
        }
    }
    assert!(
        opened > 500 && noticed > 300,
        "{opened} opened, {noticed} noticed"
    );
}

#[test]
fn random_bytes_behind_a_good_start_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let whole = small_recording(dir.path(), Compression::Lz4, SAMPLES);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..300 {
        let keep = rng.random_range(0..whole.len());
        let mut bytes = whole[..keep].to_vec();
        bytes.extend((0..rng.random_range(0..3000)).map(|_| rng.random::<u8>()));
        // Often the end of the file is still there.
        if rng.random_range(0..2) == 0 {
            bytes.extend_from_slice(&whole[whole.len() - rng.random_range(1..whole.len())..]);
        }
        if let Ok(recording) = Recording::open(&put(dir.path(), &bytes)) {
            if let Ok(samples) = recording.imu() {
                assert!(samples.take(1000).filter(Result::is_ok).count() <= 2 * SAMPLES as usize);
            }
            recording.verify(&no_progress).unwrap();
        }
    }
}

#[test]
fn a_damaged_chunk_is_named_once_and_the_rest_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let whole = small_recording(dir.path(), Compression::Lz4, SAMPLES);
    let summary = mcap::Summary::read(&whole).unwrap().unwrap();
    let chunk = &summary.chunk_indexes[3];
    let messages = u64::from(SAMPLES / 8) * 4;
    for without_summary in [false, true] {
        let mut bytes = whole.clone();
        let middle = (chunk.chunk_start_offset + chunk.chunk_length / 2) as usize;
        bytes[middle] ^= 0x55;
        if without_summary {
            bytes.truncate(whole.len() - 30);
        }
        let recording = Recording::open(&put(dir.path(), &bytes)).unwrap();
        let survived = read_everything(&recording);
        assert_eq!(
            (survived.imu, survived.images, survived.errors),
            (35, 35, 2)
        );
        let damage = recording.verify(&no_progress).unwrap();
        let found = &damage[0];
        assert_eq!(
            (found.offset, found.bytes),
            (chunk.chunk_start_offset, chunk.chunk_length)
        );
        assert_eq!(found.messages, Some(messages));
        let error = recording
            .images("cam0")
            .unwrap()
            .find_map(Result::err)
            .unwrap()
            .to_string();
        assert!(
            error.contains("damaged.mcap") && error.contains("20 messages"),
            "{error}"
        );
    }
}

#[test]
fn garbage_between_chunks_is_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let whole = small_recording(dir.path(), Compression::Lz4, SAMPLES);
    let summary = mcap::Summary::read(&whole).unwrap().unwrap();
    let at = summary.chunk_indexes[5].chunk_start_offset as usize;
    let mut bytes = whole[..at].to_vec();
    bytes.extend([0x06; 5000]);
    bytes.extend_from_slice(&whole[at..]);
    let recording = Recording::open(&put(dir.path(), &bytes)).unwrap();
    let survived = read_everything(&recording);
    assert_eq!(
        (survived.imu, survived.images),
        (SAMPLES as usize, SAMPLES as usize)
    );
    let damage = &recording.damage()[0];
    assert_eq!((damage.offset, damage.bytes), (at as u64, 5000));
}

#[test]
fn what_is_no_recording_is_refused_in_one_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |bytes: &[u8], wanted: &str| {
        let message = Recording::open(&put(dir.path(), bytes))
            .err()
            .unwrap()
            .to_string();
        assert!(
            message.contains("damaged.mcap") && message.contains(wanted),
            "{message}"
        );
        assert!(!message.contains('\n'));
    };
    refused(b"", "empty");
    refused(b"hello", "not an MCAP file");
    refused(&[0; 4096], "not an MCAP file");
    let missing = Recording::open(&dir.path().join("gone.mcap"))
        .err()
        .unwrap()
        .to_string();
    assert!(
        missing.contains("gone.mcap") && missing.contains("cannot open"),
        "{missing}"
    );
    let folder = Recording::open(dir.path()).err().unwrap().to_string();
    assert!(folder.contains("cannot open"), "{folder}");

    let foreign = |options: mcap::WriteOptions| {
        let path = dir.path().join("foreign.mcap");
        let file = std::fs::File::create(&path).unwrap();
        let mut writer = options.create(file).unwrap();
        let channel = writer
            .add_channel(0, "/x", "json", &Default::default())
            .unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: 1,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, b"{}").unwrap();
        writer.finish().unwrap();
        drop(writer);
        std::fs::read(path).unwrap()
    };
    refused(
        &foreign(mcap::WriteOptions::new().profile("x-lab")),
        "profile is `x-lab`",
    );
    let unchunked = mcap::WriteOptions::new().profile("ros2").use_chunks(false);
    refused(&foreign(unchunked), "messages outside chunks");
    let json = put(
        dir.path(),
        &foreign(mcap::WriteOptions::new().profile("ros2")),
    );
    let error = Recording::open(&json)
        .unwrap()
        .packets("/x")
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("no topic"), "{error}");
}

#[test]
fn a_message_that_is_too_short_is_named_and_the_next_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("short.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    let schema = lsfb_recording::message::IMU;
    let channel = lsfb_recording::Channel {
        topic: "/sidecar/x/imu",
        schema_name: schema.name,
        schema_text: schema.text,
    };
    let good = lsfb_recording::message::encode_imu(
        START,
        "imu",
        &sample(2).sample,
        lsfb_recording::message::ImuVariance::UNKNOWN,
    );
    for bytes in [&good[..], &good[..100], &good[..]] {
        writer.write_cdr(&channel, START, START, bytes).unwrap();
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let items: Vec<_> = recording.imu().unwrap().collect();
    assert_eq!(
        items.iter().map(Result::is_ok).collect::<Vec<_>>(),
        [true, false, true]
    );
    let error = items.into_iter().nth(1).unwrap().unwrap_err().to_string();
    for part in [
        "short.mcap",
        "/sidecar/x/imu",
        "ends inside",
        "1772359200000000000 ns",
    ] {
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn a_killed_writer_leaves_what_it_had_closed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("killed.mcap");
    let config = WriterConfig {
        chunk_secs: 0.5,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(&path, &config).unwrap();
    for n in 0..SAMPLES {
        writer.write_imu("imu0", &sample(n)).unwrap();
        // What a reader of another process finds on the disk at this moment.
        let copy = put(dir.path(), &std::fs::read(&path).unwrap());
        let recording = Recording::open(&copy).unwrap();
        let survived = recording
            .imu()
            .map_or(0, |samples| samples.filter(Result::is_ok).count());
        assert!(
            survived + 10 > n as usize,
            "{survived} of {} samples",
            n + 1
        );
    }
}

/// `/dev/full` takes nothing: the disk is full from the first byte on.
#[test]
fn a_full_disk_fails_once_and_stays_failed() {
    let full = Path::new("/dev/full");
    if !full.exists() {
        return;
    }
    let error = Writer::create(full, &WriterConfig::default())
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("/dev/full") && error.contains("No space left"),
        "{error}"
    );
}

#[test]
fn a_disk_that_fills_up_leaves_whole_chunks() {
    if let Some(folder) = lsfb_tests::limited_folder() {
        return write_until_the_limit(&folder);
    }
    let dir = tempfile::tempdir().unwrap();
    let test = "damage::a_disk_that_fills_up_leaves_whole_chunks";
    lsfb_tests::run_with_limited_files(test, 512, dir.path());
    let path = dir.path().join("full.mcap");
    let recording = Recording::open(&path).unwrap();
    let survived = recording.imu().unwrap().map(Result::unwrap).count();
    let written: usize = std::fs::read_to_string(dir.path().join("written.txt"))
        .unwrap()
        .parse()
        .unwrap();
    assert!(
        survived > 100 && written - survived <= 200,
        "{survived} of {written} samples"
    );
    let damage = recording.damage();
    assert!(
        damage.len() == 1 && damage[0].bytes == 0,
        "cut back to whole records: {damage:?}"
    );
}

fn write_until_the_limit(folder: &Path) {
    let path = folder.join("full.mcap");
    let config = WriterConfig {
        compression: Compression::None,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(&path, &config).unwrap();
    for n in 0..100_000 {
        let time = START + i64::from(n) * 5_000_000;
        if let Err(error) = writer.write_imu(
            "imu0",
            &Stamped {
                time,
                arrival: time,
                ..sample(n)
            },
        ) {
            let length = std::fs::metadata(&path).unwrap().len();
            let message = error.to_string();
            assert!(
                message.contains("full.mcap") && message.contains("File too large"),
                "{message}"
            );
            assert!(
                message.contains(&format!("at byte {length}")),
                "{message}, length {length}"
            );
            for _ in 0..3 {
                let again = writer.write_imu("imu0", &sample(n)).unwrap_err();
                assert_eq!(again.to_string(), message);
            }
            assert_eq!(
                writer
                    .attach("a", "text/plain", b"a")
                    .unwrap_err()
                    .to_string(),
                message
            );
            assert_eq!(writer.finish().unwrap_err().to_string(), message);
            assert_eq!(
                std::fs::metadata(&path).unwrap().len(),
                length,
                "nothing more was written"
            );
            std::fs::write(folder.join("written.txt"), n.to_string()).unwrap();
            return;
        }
    }
    panic!("the limit was never reached");
}
