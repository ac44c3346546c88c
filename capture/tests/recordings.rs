//! Capture files made by others, through replay into recordings.

#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use lsfb_capture::{CaptureReport, Ending, LidarData, ReplayConfig, replay};
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_drivers::transport::rosbag2::Rosbag2Source;
use lsfb_recording::{LIDAR_POSITION, Recording};
use lsfb_tests::recordings;
use lsfb_types::no_progress;

struct Replayed {
    report: CaptureReport,
    recording: Recording,
    _folder: tempfile::TempDir,
}

fn replayed(source: impl lsfb_drivers::transport::PacketSource) -> Replayed {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("replay.mcap");
    let report = replay(source, &ReplayConfig::default(), &out, &no_progress).unwrap();
    Replayed {
        report,
        recording: Recording::open(&out).unwrap(),
        _folder: folder,
    }
}

impl Replayed {
    fn points(&self) -> u64 {
        self.recording
            .scans()
            .unwrap()
            .map(|scan| scan.unwrap().sample.points.len() as u64)
            .sum()
    }

    fn packets(&self) -> usize {
        self.recording.packets("lidar/packets").unwrap().count()
    }
}

#[test]
fn vlp32c_bag_becomes_a_recording() {
    let name = "vlp32c_bag_becomes_a_recording";
    let Some(path) = recordings(
        name,
        "lidar/nebula_velodyne/vlp32/1713492677464078412_0.db3",
    ) else {
        return;
    };
    let replayed = replayed(Rosbag2Source::open(&path).unwrap());
    assert_eq!((replayed.packets(), replayed.points()), (379, 131_305));
    assert_eq!(
        (replayed.report.lost, &replayed.report.streams[0].ending),
        (0, &Ending::EndOfStream)
    );
    // Not locked: the times are the host's, to a few milliseconds.
    for scan in replayed.recording.scans().unwrap().map(Result::unwrap) {
        assert!(
            (scan.time - scan.arrival).abs() < 60_000_000,
            "{} {}",
            scan.time,
            scan.arrival
        );
    }
}

/// Each kind alone is what it is beside the other.
#[test]
fn packets_or_clouds_alone_can_be_kept() {
    let name = "packets_or_clouds_alone_can_be_kept";
    let Some(path) = recordings(
        name,
        "lidar/nebula_velodyne/vlp32/1713492677464078412_0.db3",
    ) else {
        return;
    };
    for (lidar_data, kept, left_out) in [
        (LidarData::Packets, "/lidar/packets", "/lidar/points"),
        (LidarData::Clouds, "/lidar/points", "/lidar/packets"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("replay.mcap");
        let mut config = ReplayConfig::default();
        config.recorder.lidar_data = lidar_data;
        replay(
            Rosbag2Source::open(&path).unwrap(),
            &config,
            &out,
            &no_progress,
        )
        .unwrap();
        let recording = Recording::open(&out).unwrap();
        let both = replayed(Rosbag2Source::open(&path).unwrap()).recording;
        let messages = |recording: &Recording, topic: &str| -> Vec<Vec<u8>> {
            let messages = recording.messages(topic).unwrap();
            messages.map(|message| message.unwrap().bytes).collect()
        };
        assert_eq!(messages(&recording, kept), messages(&both, kept));
        assert!(recording.messages(left_out).is_err());
    }
}

#[test]
fn vlp16_pcap_with_gps_has_utc() {
    let name = "vlp16_pcap_with_gps_has_utc";
    let Some(path) = recordings(name, "lidar/mrpt/sample_velodyne_vlp16_gps.pcap") else {
        return;
    };
    let replayed = replayed(PcapSource::open(&path, &[2368, 8308]).unwrap());
    assert_eq!(
        (replayed.packets(), replayed.points(), replayed.report.lost),
        (293, 73_486, 0)
    );
    assert_eq!(
        replayed.recording.packets(LIDAR_POSITION).unwrap().count(),
        57
    );
    // 2016-01-21T08:00:00Z and the first packet's microseconds of the hour.
    let first = replayed.recording.scans().unwrap().next().unwrap().unwrap();
    assert_eq!(
        first.time.nanos(),
        1_453_363_200_000_000_000 + 1_082_340_595_000
    );
    let lidar = &replayed.report.streams[0];
    let [note] = &lidar.notes[..] else {
        panic!("only what it is is worth a word: {lidar:?}");
    };
    assert!(
        note.starts_with("VLP-16 at 10.0.0.100, returns: strongest"),
        "{note}"
    );
}

#[test]
fn hdl32e_pcap_becomes_a_recording() {
    let Some(path) = recordings(
        "hdl32e_pcap_becomes_a_recording",
        "lidar/mrpt/sample_velodyne_hdl32.pcap",
    ) else {
        return;
    };
    let replayed = replayed(PcapSource::open(&path, &[]).unwrap());
    assert_eq!(
        (replayed.packets(), replayed.points(), replayed.report.lost),
        (500, 146_705, 0)
    );
    // Its laser at -2.67° is dead: in the bytes of the capture all 6 000 of its distances are 0, and its neighbours saw something 5 335 and
    // 4 346 times. Of four turns nothing was said.
    let notes = replayed.report.streams[0].notes.join("\n");
    assert!(notes.contains("laser 22 of 32"), "{notes}");
}

#[test]
fn a_pcap_that_is_cut_off_gives_what_is_there_and_says_so() {
    let name = "a_pcap_that_is_cut_off_gives_what_is_there_and_says_so";
    let Some(path) = recordings(name, "lidar/mrpt/sample_velodyne_hdl32.pcap") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.pcap");
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&cut, &whole[..300_000]).unwrap();
    let replayed = replayed(PcapSource::open(&cut, &[2368]).unwrap());
    assert_eq!(replayed.packets(), 237);
    let stream = &replayed.report.streams[0];
    assert!(
        matches!(&stream.ending, Ending::Lost(why) if why.contains("cut.pcap") && why.contains("frame 237"))
    );
    assert!(replayed.report.lost > 0);
}
