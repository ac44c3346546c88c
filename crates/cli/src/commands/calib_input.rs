//! What calibration steps read: images, samples of the IMU, and when they were recorded.

use std::path::Path;

use anyhow::Context as _;
use lsfb_calib::Target;
use lsfb_calib::camera::{
    CameraViews, image_from_folder, views_from_bag, views_from_folder, views_from_recording,
};
use lsfb_calib::camera_imu::read_imu_table;
use lsfb_datasets::RosBag;
use lsfb_recording::{Provenance, Recording};
use lsfb_types::{Image, ImuSample, Timestamp};

use crate::context::Context;

/// Where images and samples come from for which no folder or table is named.
pub enum Source {
    /// A recording of ours.
    Recording(Recording),
    /// A bag of ROS.
    Bag(RosBag),
}

impl Source {
    /// Opens what `--recording` names: a ROS bag by its name, and an `.mcap` by the topics that cameras are taken from.
    pub fn open(path: &Path, cameras: &[&str], context: &Context) -> anyhow::Result<Self> {
        if RosBag::is_one(path) || cameras.iter().any(|c| topic_of(c).is_some()) {
            super::expect_file(path, "record one")?;
            let bag = RosBag::open(path)?;
            for damage in bag.damage() {
                context.lose_data();
                context.say(&format!("warning: {damage}"));
            }
            return Ok(Self::Bag(bag));
        }
        Ok(Self::Recording(context.open(path)?))
    }

    /// The recording, where it is one of ours.
    pub fn recording(&self) -> anyhow::Result<&Recording> {
        match self {
            Self::Recording(recording) => Ok(recording),
            Self::Bag(_) => anyhow::bail!("scans cannot be read from ROS bags: give --clouds"),
        }
    }
}

/// The topic in `NAME=TOPIC`: a place that could be a folder's, where there is none.
fn topic_of(camera: &str) -> Option<&str> {
    let (_, place) = camera.split_once('=')?;
    let is_folder = folder_and_prefix(place).0.exists();
    (place.starts_with('/') && !is_folder).then_some(place)
}

/// What a camera saw: `NAME` in the recording, `NAME=TOPIC` in a bag, `NAME=FOLDER` or `NAME=FOLDER/PREFIX*`.
pub fn views_of(
    camera: &str,
    source: Option<&Source>,
    target: &Target,
    context: &Context,
) -> anyhow::Result<CameraViews> {
    context.check_stop()?;
    let show = |p| context.show(p);
    Ok(match (camera.split_once('='), source) {
        (Some((name, topic)), Some(Source::Bag(bag))) if topic_of(camera).is_some() => {
            views_from_bag(name, bag, topic, target, &show)?
        }
        (Some((name, place)), _) => {
            let (folder, prefix) = folder_and_prefix(place);
            views_from_folder(name, folder, prefix, target, &show)?
        }
        (None, Some(Source::Recording(recording))) => {
            views_from_recording(camera, recording, target, &show)?
        }
        (None, Some(Source::Bag(bag))) => views_from_bag(camera, bag, camera, target, &show)?,
        (None, None) => {
            anyhow::bail!("camera {camera} has no images: give NAME=FOLDER, or --recording")
        }
    })
}

/// The image that a camera took at an instant of [`views_of`]; `None` where there is none.
pub fn image_at(
    camera: &str,
    source: Option<&Source>,
    instant: i64,
) -> anyhow::Result<Option<Image>> {
    match (camera.split_once('='), source) {
        (Some((_, topic)), Some(Source::Bag(bag))) if topic_of(camera).is_some() => {
            image_in_bag(bag, topic, instant)
        }
        (Some((_, place)), _) => {
            let (folder, prefix) = folder_and_prefix(place);
            Ok(image_from_folder(folder, prefix, instant)?)
        }
        (None, Some(Source::Recording(recording))) => {
            for image in recording.images(camera)? {
                let image = image?;
                if image.time.nanos() == instant {
                    return Ok(Some(image.sample));
                }
            }
            Ok(None)
        }
        (None, Some(Source::Bag(bag))) => image_in_bag(bag, camera, instant),
        (None, None) => Ok(None),
    }
}

fn image_in_bag(bag: &RosBag, topic: &str, instant: i64) -> anyhow::Result<Option<Image>> {
    let mut found = None;
    bag.images(topic, &mut |stamp, image| {
        if stamp == instant {
            found = Some(image);
        }
        Ok::<(), lsfb_datasets::Error>(())
    })?;
    Ok(found)
}

/// Names a file, or all files of a bag's folder, in the provenance of a result.
pub fn add_input(provenance: &mut Provenance, path: &Path) -> anyhow::Result<()> {
    if !path.is_dir() {
        return Ok(provenance.add_input(path)?);
    }
    let entries = std::fs::read_dir(path).with_context(|| path.display().to_string())?;
    let mut files = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<std::io::Result<Vec<_>>>()?;
    files.sort();
    for file in files.iter().filter(|f| f.is_file()) {
        provenance.add_input(file)?;
    }
    Ok(())
}

/// The name in `NAME` or `NAME=FOLDER`.
pub fn name_of_camera(camera: &str) -> &str {
    camera.split_once('=').map_or(camera, |(name, _)| name)
}

/// The IMU's samples: of a table or, in a bag, of a topic if one is named, else of the recording. Messages of a bag that cannot be
/// read are data that is lost.
pub fn imu_of(
    named: Option<&Path>,
    source: Option<&Source>,
    context: &Context,
) -> anyhow::Result<Vec<(Timestamp, ImuSample)>> {
    let topic = named.and_then(Path::to_str);
    Ok(match (named, source) {
        (_, Some(Source::Bag(bag))) if topic.is_none_or(|t| bag.has_topic(t)) => {
            let imu = bag.imu(topic)?;
            if let Some(first) = &imu.unread.first {
                context.lose_data();
                context.say(&format!(
                    "warning: {} messages of {} could not be read and are left out; the first: {first}",
                    imu.unread.count, imu.topic
                ));
            }
            imu.samples
        }
        (Some(path), _) => read_imu_table(path)?,
        (None, Some(Source::Recording(recording))) => recording
            .imu()?
            .map(|s| s.map(|s| (s.time, s.sample)))
            .collect::<Result<_, _>>()?,
        (None, _) => anyhow::bail!("no IMU data: give --imu or --recording"),
    })
}

/// 1 January 2000 in seconds since 1970: stamps before it count from the start of something.
const YEAR_2000_UNIX_S: i64 = 946_684_800;

/// When the data of a step ended, for `Rig::calibrated_unix_s`: the end of the recording, else the last of `stamps_ns`. `None`
/// where that is no time of day.
pub fn calibrated_unix_s(
    source: Option<&Source>,
    stamps_ns: impl Iterator<Item = i64>,
) -> anyhow::Result<Option<i64>> {
    let end_ns = match source {
        Some(Source::Recording(recording)) => recording.end_time()?.map(Timestamp::nanos),
        _ => stamps_ns.max(),
    };
    let end_s = end_ns.map(|ns| ns.div_euclid(1_000_000_000));
    Ok(end_s.filter(|s| *s >= YEAR_2000_UNIX_S))
}

/// `FOLDER` or `FOLDER/PREFIX*`.
pub fn folder_and_prefix(place: &str) -> (&Path, &str) {
    let Some(pattern) = place.strip_suffix('*') else {
        return (Path::new(place), "");
    };
    match pattern.rsplit_once('/') {
        Some((folder, prefix)) => (Path::new(folder), prefix),
        None => (Path::new("."), pattern),
    }
}
