//! A recording of two phones, whose stamps are known to the nanosecond.

use lsfb_recording::message::{self, ImuVariance, TimeReference, decode_clock_model, encode_imu};
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{ImuSample, no_progress};

use super::*;
use crate::clock::{ClockConfig, Exchange, estimate_clocks};
use crate::doctor::{DoctorConfig, examine};
use crate::sidecar::encode_exchange;

const START_NS: i64 = 1_772_359_200_000_000_000;
const BOOT: &str = "android.elapsedRealtime";
const SECS: i64 = 60;

/// The phone's clock: started 50 s ago, 40 ppm slow.
fn device_ns(host_ns: i64) -> i64 {
    let run_ns = host_ns - START_NS;
    50_000_000_000 + run_ns - run_ns / 25_000
}

/// Delays that repeat: short ones, and queues of up to 60 ms on the way to the rig.
fn delay_ns(n: i64) -> i64 {
    4_000_000
        + (n * 7_919 % 13) * 100_000
        + if n % 5 == 0 {
            n * 31 % 60 * 1_000_000
        } else {
            0
        }
}

/// What happens to the first phone.
#[derive(Clone, Copy)]
struct Story {
    /// Seconds between which it is out of reach; what it measured comes afterwards, three times as fast.
    away: (i64, i64),
    /// Exchanges of times at most.
    exchanges: i64,
}

impl Story {
    const QUIET: Self = Self {
        away: (SECS, SECS),
        exchanges: SECS,
    };

    fn arrival_ns(&self, n: i64) -> i64 {
        let (from, to) = (self.away.0 * 1_000_000_000, self.away.1 * 1_000_000_000);
        let after_ns = n * 10_000_000;
        let back_ns = match after_ns < from {
            true => after_ns,
            false => after_ns.max(to + (after_ns - from) / 3),
        };
        START_NS + back_ns + delay_ns(n)
    }

    fn is_away(&self, secs: i64) -> bool {
        (self.away.0..self.away.1).contains(&secs)
    }
}

fn write(path: &Path, story: Story) {
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("recording");
    let mut put =
        |topic: &str, schema: message::Schema, time_ns: i64, arrival_ns: i64, bytes: &[u8]| {
            let channel = Channel {
                topic,
                schema_name: schema.name,
                schema_text: schema.text,
            };
            let (time, arrival) = (
                Timestamp::from_nanos(time_ns),
                Timestamp::from_nanos(arrival_ns),
            );
            writer
                .write_cdr(&channel, time, arrival, bytes)
                .expect("written");
        };
    for n in 0..SECS * 100 {
        let measured_ns = START_NS + n * 10_000_000;
        let arrival_ns = story.arrival_ns(n);
        // While it was recorded, the phone's time was the arrival less nothing: too late by a delay.
        let believed_ns = measured_ns + 4_000_000;
        let sample = ImuSample {
            specific_force_m_s2: [0.0, 0.0, n as f64],
            ..ImuSample::default()
        };
        let time = Timestamp::from_nanos(believed_ns);
        let bytes = encode_imu(time, "imu", &sample, ImuVariance::UNKNOWN);
        let reference = TimeReference {
            device_ticks: device_ns(measured_ns).unsigned_abs(),
            source: BOOT.to_owned(),
        };
        let stamp = message::encode_time_reference(time, BOOT, &reference).expect("ticks");
        put(
            "/sidecar/pixel/imu/device_time",
            message::TIME_REFERENCE,
            believed_ns,
            arrival_ns,
            &stamp,
        );
        put(
            "/sidecar/pixel/imu",
            message::IMU,
            believed_ns,
            arrival_ns,
            &bytes,
        );
        put(
            "/sidecar/watch/imu",
            message::IMU,
            measured_ns,
            arrival_ns,
            &bytes,
        );
        let secs = n / 100;
        if n % 100 == 0 && secs < story.exchanges && !story.is_away(secs) {
            let heard_ns = measured_ns + delay_ns(n);
            let answered_ns = heard_ns + 50_000;
            let exchange = Exchange {
                t1_ns: device_ns(measured_ns),
                t2_ns: heard_ns,
                t3_ns: answered_ns,
                t4_ns: device_ns(answered_ns + delay_ns(n + 1)),
            };
            let (schema, bytes) = encode_exchange(BOOT, &exchange);
            put(
                "/sidecar/pixel/time_sync",
                schema,
                answered_ns,
                answered_ns,
                &bytes,
            );
        }
    }
    writer.finish().expect("finished");
}

#[test]
fn each_phone_gets_its_own_file_with_three_stamps_and_its_clock() {
    let folder = tempfile::tempdir().expect("folder");
    let scan = folder.path().join("scan.mcap");
    write(&scan, Story::QUIET);
    let recording = Recording::open(&scan).expect("recording");
    assert_eq!(phones(&recording), ["pixel", "watch"]);
    let path = walk_path(folder.path(), "pixel");
    let walk = write_walk(&recording, "pixel", None, &path, &no_progress).expect("a walk");
    let samples = SECS as u64 * 100;
    assert_eq!(
        (walk.messages, walk.mapped, walk.unreadable),
        (samples, samples, 0)
    );
    let [clock] = walk.clocks.as_slice() else {
        panic!("{walk:?}")
    };
    assert_eq!(
        (clock.clock_id.as_str(), clock.exchanges, clock.steps),
        (BOOT, SECS as u64, 0)
    );
    let own = Recording::open(&path).expect("a walk");
    assert!(own.topics().iter().all(|t| !t.topic.contains("watch")));
    let imu: Vec<_> = own
        .messages("/sidecar/pixel/imu")
        .expect("imu")
        .map(|m| m.expect("one"))
        .collect();
    let stamps = own
        .messages("/sidecar/pixel/imu/device_time")
        .expect("stamps");
    let stamps: Vec<_> = stamps.map(|m| m.expect("one")).collect();
    let before: Vec<_> = recording
        .messages("/sidecar/pixel/imu")
        .expect("imu")
        .map(|m| m.expect("one"))
        .collect();
    assert_eq!((imu.len(), stamps.len()), (before.len(), before.len()));
    for message in &imu {
        let sample = message::decode_imu(&message.bytes).expect("a sample");
        let n = sample.specific_force_m_s2[2] as i64;
        let measured_ns = START_NS + n * 10_000_000;
        let error_us = (message.time.nanos() - measured_ns) as f64 / 1e3;
        assert!(error_us.abs() < 500.0, "{n}: {error_us} µs");
        assert_eq!(message.arrival.nanos(), measured_ns + delay_ns(n));
        let stamp = stamps
            .iter()
            .find(|s| s.time == message.time)
            .expect("its stamp");
        let reference = message::decode_time_reference(&stamp.bytes).expect("a stamp");
        assert_eq!(
            reference.device_ticks,
            device_ns(measured_ns).unsigned_abs()
        );
    }
    let sigma_us = clock.sigma_us.expect("a standard deviation");
    assert!(sigma_us > 0.0 && sigma_us < 500.0, "{sigma_us}");
    assert_eq!((walk.unmapped, clock.utc_apart_us), (0, None));
    let model = own
        .last_message("/sync/clock/pixel")
        .expect("read")
        .expect("a model");
    let model = decode_clock_model(&model.bytes).expect("a model");
    assert_eq!((model.kind.as_str(), model.epoch), ("exchanged", 1));
    // A phone that is slow gives more host seconds than its own.
    assert!(
        (model.skew * 1e6 - 40.0).abs() < 20.0,
        "{}",
        model.skew * 1e6
    );
    let diagnosis = examine(&own, &DoctorConfig::default(), &no_progress).expect("a diagnosis");
    let findings = diagnosis.judgement.findings();
    let clock = findings
        .iter()
        .find(|f| f.subject == "clock pixel")
        .expect("its clock");
    assert!(clock.what.contains("clock exchanges"), "{}", clock.what);
    // The other one has no exchanges: its stamps stay as they were.
    let path = walk_path(folder.path(), "watch");
    let walk = write_walk(&recording, "watch", None, &path, &no_progress).expect("a walk");
    assert_eq!((walk.messages, walk.mapped, walk.unmapped), (samples, 0, 0));
    assert!(walk.clocks.is_empty());
    // A rig that was calibrated since takes the place of the one that it brought.
    let since = Rig::from_toml("name = \"calibrated since\"\n", "a test").expect("a rig");
    let walk = write_walk(&recording, "watch", Some(&since), &path, &no_progress);
    assert_eq!(walk.expect("a walk").messages, samples);
    let own = Recording::open(&path).expect("a walk").rig();
    assert_eq!(own.expect("a rig"), since);
}

#[test]
fn told_to_stop_it_leaves_nothing_behind() {
    let folder = tempfile::tempdir().expect("folder");
    let scan = folder.path().join("scan.mcap");
    write(&scan, Story::QUIET);
    let recording = Recording::open(&scan).expect("recording");
    let path = walk_path(folder.path(), "pixel");
    let stopped = write_walk(&recording, "pixel", None, &path, &|_| {
        Err(lsfb_types::Stopped)
    });
    assert!(stopped.is_err());
    assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 1);
}

#[test]
fn a_phone_that_comes_back_after_half_a_minute_keeps_its_clock() {
    let folder = tempfile::tempdir().expect("folder");
    let scan = folder.path().join("scan.mcap");
    let away = (20, 50);
    let story = Story {
        away,
        ..Story::QUIET
    };
    write(&scan, story);
    let recording = Recording::open(&scan).expect("recording");
    let path = walk_path(folder.path(), "pixel");
    let walk = write_walk(&recording, "pixel", None, &path, &no_progress).expect("a walk");
    assert_eq!((walk.mapped, walk.unmapped), (SECS as u64 * 100, 0));
    let own = Recording::open(&path).expect("a walk");
    for message in own.messages("/sidecar/pixel/imu").expect("imu") {
        let message = message.expect("one");
        let sample = message::decode_imu(&message.bytes).expect("a sample");
        let n = sample.specific_force_m_s2[2] as i64;
        let error_ns = message.time.nanos() - START_NS - n * 10_000_000;
        assert!(error_ns.abs() < 500_000, "{n}: {error_ns} ns");
    }
    // Its messages were half a minute late, and its clock was never set.
    let clocks = estimate_clocks(&own, &ClockConfig::default(), &no_progress).expect("clocks");
    let [clock] = clocks.devices.as_slice() else {
        panic!("{clocks:?}")
    };
    assert_eq!(clock.epochs.len(), 1);
}

#[test]
fn of_too_few_exchanges_no_time_is_made() {
    let folder = tempfile::tempdir().expect("folder");
    let scan = folder.path().join("scan.mcap");
    let story = Story {
        exchanges: 4,
        ..Story::QUIET
    };
    write(&scan, story);
    let recording = Recording::open(&scan).expect("recording");
    let path = walk_path(folder.path(), "pixel");
    let walk = write_walk(&recording, "pixel", None, &path, &no_progress).expect("a walk");
    assert_eq!((walk.mapped, walk.unmapped), (0, SECS as u64 * 100));
    let [clock] = walk.clocks.as_slice() else {
        panic!("{walk:?}")
    };
    assert_eq!((clock.exchanges, clock.unusable), (0, 4));
    assert_eq!((clock.sigma_us, clock.asymmetry_at_most_us), (None, None));
    // The times are those of the recording.
    let own = Recording::open(&path).expect("a walk");
    let first = own.messages("/sidecar/pixel/imu").expect("imu").next();
    let first = first.expect("a message").expect("whole");
    assert_eq!(first.time.nanos(), START_NS + 4_000_000);
}
