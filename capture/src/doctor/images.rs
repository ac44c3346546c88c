//! Whether cameras saw something, and something new.

use lsfb_recording::Recording;
use lsfb_recording::message::{self, CdrError, decode_image};
use lsfb_types::{Finding, Image, Timestamp, Verdict};

use super::inertial::SET_BEFORE;
use super::{Depth, DoctorConfig, Findings};
use crate::counted::counted;
use crate::grey::{is_black, saturated_share, some_pixels};
use crate::health::Repeats;
use crate::order::Order;

/// Images that are looked at where not everything is read: 5 to 10 s of them.
const IMAGES: usize = 100;
/// Share of white pixels from which an image is white.
const WHITE_SHARE: f64 = 0.5;

/// What a camera saw.
#[derive(Default)]
struct CameraCounts {
    images: usize,
    black: usize,
    white: usize,
    unreadable: usize,
    is_of_another_encoding: bool,
    repeats: Repeats<Vec<u8>>,
    stamps: Order,
    arrivals: Order,
}

impl CameraCounts {
    fn note(&mut self, time: Timestamp, image: &Image) {
        self.images += 1;
        self.stamps.note(time);
        let some = some_pixels(image);
        self.black += usize::from(is_black(&some));
        self.white += usize::from(saturated_share(&some) >= WHITE_SHARE);
        self.repeats.note(some, time);
    }
}

impl Findings {
    /// Each camera's images: the first, or all where everything is read.
    pub(super) fn images(
        &mut self,
        recording: &Recording,
        config: &DoctorConfig,
    ) -> Result<(), lsfb_recording::Error> {
        let topics = recording.topics().iter();
        for topic in topics.filter(|topic| topic.schema == message::IMAGE.name) {
            let mut seen = CameraCounts::default();
            for (n, recorded) in recording.messages(&topic.topic)?.enumerate() {
                // What is damaged is said elsewhere.
                let is_enough = config.read == Depth::Indexes && (n >= IMAGES || recorded.is_err());
                if is_enough {
                    break;
                }
                let Ok(recorded) = recorded else {
                    continue;
                };
                seen.arrivals.note(recorded.arrival);
                match decode_image(&recorded.bytes) {
                    Ok(image) => seen.note(recorded.time, &image),
                    Err(CdrError::Value { field: "encoding" }) => {
                        seen.is_of_another_encoding = true;
                        break;
                    }
                    Err(_) => seen.unreadable += 1,
                }
            }
            self.seen_by(&topic.topic, &seen);
        }
        Ok(())
    }

    fn seen_by(&mut self, topic: &str, seen: &CameraCounts) {
        let looked_at = seen.images + seen.unreadable;
        let of = format!(
            "in {} checked",
            counted(looked_at as u64, "image", "images")
        );
        let mut problem = |verdict, found: String, remedy: &str| {
            let found = format!("{found}, {of}");
            self.add(Finding::new("images", verdict, topic, found).remedy(remedy));
        };
        let mut is_well = true;
        if seen.unreadable > 0 {
            let found = format!(
                "{} cannot be read",
                counted(seen.unreadable as u64, "image", "images")
            );
            problem(Verdict::Fail, found, "check the program that wrote them");
            is_well = false;
        }
        if let Some(found) = seen.stamps.problem() {
            let remedy = "run `lsfb clock` for details";
            problem(Verdict::Fail, format!("stamps {found}"), remedy);
            is_well = false;
        }
        if let Some(back) = seen.arrivals.back() {
            let found = format!("arrivals {back}: the host's clock was set");
            problem(Verdict::Warn, found, SET_BEFORE);
            is_well = false;
        }
        let stretches = seen.repeats.stale().stretches();
        if stretches > 0 {
            let stretches = counted(stretches, "stretch", "stretches");
            let found = format!("{stretches} of the same image for more than a second");
            problem(Verdict::Fail, found, "restart the camera; check its cable");
            is_well = false;
        }
        for (count, what, remedy) in [
            (
                seen.black,
                "black",
                "remove the lens cap, or increase the exposure",
            ),
            (seen.white, "white", "reduce the exposure"),
        ] {
            if 2 * count > seen.images {
                let found = format!("{count} of them are {what}");
                problem(Verdict::Warn, found, remedy);
                is_well = false;
            }
        }
        if seen.images == 0 {
            let found = match seen.is_of_another_encoding {
                true => "content not checked: only grey images are supported",
                false => "content not checked",
            };
            self.add(Finding::new("images", Verdict::Unknown, topic, found));
        } else if is_well && seen.images == 1 {
            let found = format!("images have content; whether they change takes two, {of}");
            self.add(Finding::new("images", Verdict::Unknown, topic, found));
        } else if is_well {
            let found = format!("images have content and change, {of}");
            self.add(Finding::new("images", Verdict::Pass, topic, found));
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_recording::message::encode_image;
    use lsfb_recording::{Channel, Writer, WriterConfig};
    use lsfb_types::no_progress;

    use super::*;
    use crate::doctor::examine;

    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 4;

    /// The verdict and the words on four seconds of a camera at 20 Hz: message and stamp, milliseconds, of the n-th image.
    fn found(message: impl Fn(i64, Timestamp) -> Vec<u8>, at_ms: impl Fn(i64) -> i64) -> String {
        found_at(message, at_ms, |n| 50 * n)
    }

    fn found_at(
        message: impl Fn(i64, Timestamp) -> Vec<u8>,
        at_ms: impl Fn(i64) -> i64,
        arrives_ms: impl Fn(i64) -> i64,
    ) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mcap");
        let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
        let at = |ms: i64| Timestamp::from_nanos(1_772_359_200_000_000_000 + ms * 1_000_000);
        let channel = Channel {
            topic: "/cam0/image",
            schema_name: message::IMAGE.name,
            schema_text: message::IMAGE.text,
        };
        for n in 0..80 {
            let (time, arrival) = (at(at_ms(n)), at(arrives_ms(n)));
            let bytes = message(n, time);
            writer.write_cdr(&channel, time, arrival, &bytes).unwrap();
        }
        writer.finish().unwrap();
        let recording = Recording::open(&path).unwrap();
        let diagnosis = examine(&recording, &DoctorConfig::default(), &no_progress).unwrap();
        let findings = diagnosis.judgement.findings().iter();
        let words = findings.filter(|f| f.code == "images");
        let words = words.map(|f| format!("{}: {}", f.verdict, f.what));
        words.collect::<Vec<_>>().join("; ")
    }

    fn grey(n: i64, time: Timestamp, pixel: impl Fn(i64) -> i64) -> Vec<u8> {
        let image = Image {
            width: WIDTH,
            height: HEIGHT,
            pixels: (0..i64::from(WIDTH * HEIGHT))
                .map(|k| pixel(n + k) as u8)
                .collect(),
            ..Image::default()
        };
        encode_image(time, "cam0", &image)
    }

    fn of_pixels(pixel: impl Fn(i64) -> i64) -> String {
        found(|n, time| grey(n, time, &pixel), |n| 50 * n)
    }

    /// At its rate and without a gap, each of them was a good recording.
    #[test]
    fn a_camera_that_shows_nothing_or_nothing_new_is_no_pass() {
        let good = of_pixels(|n| n * 7);
        assert!(good.starts_with("PASS"), "{good}");
        let frozen = found(|n, time| grey(n.min(30), time, |n| n * 7), |n| 50 * n);
        assert!(
            frozen.contains("FAIL: 1 stretch of the same image"),
            "{frozen}"
        );
        let capped = of_pixels(|n| n * 7 % 3);
        assert!(capped.contains("WARN: 80 of them are black"), "{capped}");
        let white = of_pixels(|n| 255 - i64::from(n % 7 == 0));
        assert!(white.contains("80 of them are white"), "{white}");
        let cut = |n: i64, time| {
            let bytes = grey(n, time, |n| n * 7);
            bytes[..bytes.len() - (n as usize % 2)].to_vec()
        };
        let cut = found(cut, |n| 50 * n);
        assert!(cut.contains("FAIL: 40 images cannot be read"), "{cut}");
        let set = |n| if n < 40 { 50 * n } else { 50 * n - 1_000 };
        let arrivals = found_at(|n, time| grey(n, time, |n| n * 7), |n| 50 * n, set);
        assert!(
            arrivals.contains("WARN: arrivals go back once, by up to 0.9 s"),
            "{arrivals}"
        );
        let back = found(|n, time| grey(n, time, |n| n * 7), set);
        assert!(
            back.contains("FAIL: stamps go back once, by up to 0.9 s"),
            "{back}"
        );
        let none = found(|n, time| grey(n, time, |n| n * 7), |_| 0);
        assert!(none.contains("FAIL: stamps are all the same"), "{none}");
    }
}
