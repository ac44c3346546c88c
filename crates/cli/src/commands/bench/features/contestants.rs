//! The features that are compared: ours, and what other programs found in the same images.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_networks::Model;
use lsfb_pipeline::features::{
    DESCRIPTOR_LEN, Descriptor, FeatureDetector, Features, Keypoint, SiftConfig,
};
use lsfb_types::{Image, Progress, ProgressFn, median};

use crate::commands::bench::cpu_time::cpu_ms;
use crate::commands::models::ModelFolder;

/// Images by which the time is taken, at most, each the better of two runs.
const TIMED: usize = 6;

/// A feature.
pub struct Contestant {
    pub name: String,
    /// Numbers of a descriptor as it is published.
    pub values: usize,
    by: By,
}

enum By {
    Detector(Box<FeatureDetector>),
    /// A folder with a file for each image.
    Peer(PathBuf),
}

/// What it found in some images, and what an image cost.
pub struct FoundFeatures {
    /// In the order of the images.
    pub features: Vec<Features>,
    /// CPU time of an image on one thread, median; `None` where a peer does not say.
    pub cpu_ms: Option<f64>,
}

impl Contestant {
    /// One of ours.
    pub fn ours(name: &str, folder: &ModelFolder) -> anyhow::Result<Self> {
        let learned = folder.feature(name)?;
        let model = learned
            .as_ref()
            .and_then(|l| Model::named(&l.feature.model));
        let detector = FeatureDetector::new(&SiftConfig::default(), learned.as_ref())?;
        Ok(Self {
            name: name.to_owned(),
            values: model.map_or(DESCRIPTOR_LEN, Model::descriptor_len),
            by: By::Detector(Box::new(detector)),
        })
    }

    /// Another program's.
    pub fn peer(name: &str, folder: &Path) -> Self {
        Self {
            name: name.to_owned(),
            values: DESCRIPTOR_LEN,
            by: By::Peer(folder.to_owned()),
        }
    }

    /// Its features in images that have these numbers.
    pub fn find(
        &self,
        images: &[(usize, &Image)],
        progress: ProgressFn,
    ) -> anyhow::Result<FoundFeatures> {
        match &self.by {
            By::Detector(detector) => {
                let cpu_ms = time(detector, images)?;
                let images: Vec<&Image> = images.iter().map(|(_, image)| *image).collect();
                Ok(FoundFeatures {
                    features: detector.detect_all(&images, progress)?,
                    cpu_ms,
                })
            }
            By::Peer(folder) => {
                let mut found = FoundFeatures {
                    features: Vec::new(),
                    cpu_ms: None,
                };
                let mut times = Vec::new();
                for (done, (number, _)) in images.iter().enumerate() {
                    let path = folder.join(file_of(*number, "txt"));
                    let text = std::fs::read_to_string(&path).with_context(|| {
                        format!("{}: the peer was not run on this image", path.display())
                    })?;
                    let (features, cpu_ms) =
                        parse(&text).with_context(|| path.display().to_string())?;
                    found.features.push(features);
                    // By the same images as ours.
                    let is_timed = done.is_multiple_of(timing_step(images.len()));
                    times.extend(cpu_ms.filter(|_| is_timed));
                    progress(Progress {
                        stage: "",
                        done: done as u64 + 1,
                        total: images.len() as u64,
                    })?;
                }
                found.cpu_ms = median(times);
                Ok(found)
            }
        }
    }
}

/// The file of an image, or of what was found in it.
pub fn file_of(number: usize, extension: &str) -> String {
    format!("{number:04}.{extension}")
}

/// Every so many images one tells the time.
fn timing_step(images: usize) -> usize {
    images.div_ceil(TIMED).max(1)
}

/// CPU time of an image, on one thread.
fn time(detector: &FeatureDetector, images: &[(usize, &Image)]) -> anyhow::Result<Option<f64>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let step = timing_step(images.len());
    let chosen: Vec<&Image> = images
        .iter()
        .step_by(step)
        .map(|(_, image)| *image)
        .collect();
    let times = pool.install(|| -> anyhow::Result<Vec<f64>> {
        let mut detector = detector.clone();
        let mut once = |image: &Image| -> anyhow::Result<f64> {
            let begun = cpu_ms()?;
            detector.detect(image);
            Ok(cpu_ms()? - begun)
        };
        chosen
            .iter()
            .map(|image| Ok(once(image)?.min(once(image)?)))
            .collect()
    })?;
    Ok(median(times))
}

/// A peer's file: `cpu_ms VALUE`, then a line for each keypoint with its pixel, (0, 0) the centre of the first, its scale, and the
/// numbers of its descriptor, from 0 to 255.
fn parse(text: &str) -> anyhow::Result<(Features, Option<f64>)> {
    let mut features = Features::default();
    let mut cpu_ms = None;
    for (number, line) in text.lines().enumerate() {
        let refuse = || {
            format!(
                "line {}: expected a pixel, a scale and {DESCRIPTOR_LEN} numbers from 0 to 255: {line:.60}",
                number + 1
            )
        };
        if let Some(time) = line.strip_prefix("cpu_ms ") {
            cpu_ms = Some(time.trim().parse().with_context(refuse)?);
            continue;
        }
        let mut words = line.split_whitespace();
        let mut coordinate = || {
            let value = words.next().and_then(|w| w.parse::<f32>().ok());
            value.filter(|v| v.is_finite()).with_context(refuse)
        };
        let [x, y, scale_px] = [coordinate()?, coordinate()?, coordinate()?];
        let numbers: Vec<u8> = words
            .map(str::parse)
            .collect::<Result<_, _>>()
            .with_context(refuse)?;
        let descriptor: Descriptor = numbers.try_into().ok().with_context(refuse)?;
        features.keypoints.push(Keypoint {
            pixel: [x, y],
            scale_px,
            angle_rad: 0.0,
            response: 1.0,
        });
        features.descriptors.push(descriptor);
    }
    Ok((features, cpu_ms))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_peers_are_read_or_refused_with_their_line() {
        let bytes: Vec<String> = (0..DESCRIPTOR_LEN).map(|k| k.to_string()).collect();
        let bytes = bytes.join(" ");
        let (features, cpu_ms) = parse(&format!("cpu_ms 12.5\n1.5 2 3 {bytes}\n")).expect("reads");
        assert_eq!((features.len(), cpu_ms), (1, Some(12.5)));
        assert_eq!(features.keypoints[0].pixel, [1.5, 2.0]);
        assert_eq!(features.descriptors[0][127], 127);
        for wrong in [
            "cpu_ms soon".to_owned(),
            format!("nan 2 3 {bytes}"),
            format!("1 2 3 {bytes} 7"),
            "1 2 3 4".to_owned(),
            format!("1 2 3 300 {}", &bytes[2..]),
        ] {
            let error = parse(&wrong).map(|_| ()).expect_err(&wrong);
            assert!(format!("{error:#}").contains("line 1"), "{error:#}");
        }
        assert!(parse("").expect("no feature").0.is_empty());
    }
}
