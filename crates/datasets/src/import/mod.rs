//! Recordings of other programs become recordings of ours: phones' recorders, and the folders of datasets.
//!
//! A reader of `readers` knows one format and nothing else: it fills `collected` with records. Order, doubles, stamps that cannot
//! be, and the file are the same for all. What a source holds and a recording has no place for is listed, and every record is counted.
//!
//! There was no host when these records were made: their arrival is the device's own stamp, and nothing is known about its clock
//! but whether it tells the time of day.

mod collected;
mod format;
mod image_files;
mod inertial;
mod inventory;
mod overlap;
mod payload;
mod readers;
mod report;
mod set_back;
mod stamp;
mod stream;
mod table;
mod video;
mod vrs;
mod write;

use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;
use lsfb_recording::write_tum;
use lsfb_types::{ProgressFn, StampUnit};
use serde::Serialize;

use collected::Collected;
pub use format::Format;
pub use image_files::{EurocImages, ImageFile, euroc_images};
use payload::{Payload, Pixels};
pub use report::{ClockOf, ImportReport, LeftOut, RecordCount};
use write::Said;

use crate::Error;

/// How a recording is imported.
#[derive(Clone, Debug, Serialize)]
pub struct ImportConfig {
    /// Its format; `None`: by what is in it.
    pub format: Option<Format>,
    /// Name of the device in the topics.
    pub device: String,
    /// Unit of the stamps, where the format does not fix one; `None`: by their size, where they are of this century.
    pub stamp_unit: Option<StampUnit>,
    /// The rig to attach, instead of the source's own calibration.
    pub rig: Option<Rig>,
    /// Whether trajectories that stand beside the recording may be replaced by the source's.
    #[serde(skip)]
    pub replace_trajectories: bool,
}

impl Default for ImportConfig {
    fn default() -> Self {
        Self {
            format: None,
            device: "phone".to_owned(),
            stamp_unit: None,
            rig: None,
            replace_trajectories: false,
        }
    }
}

/// Imports a file or folder. The recording gets its name when it is whole.
pub fn import(
    source: &Path,
    out: &Path,
    config: &ImportConfig,
    progress: ProgressFn<'_>,
) -> Result<ImportReport, Error> {
    let format = match config.format {
        Some(format) => format,
        None => Format::of(source)?,
    };
    let mut collected = Collected::default();
    readers::read(format, source, config, &mut collected, progress)?;
    if config.rig.is_some() {
        collected.rig.clone_from(&config.rig);
    }
    leave_out_videos_that_do_not_match(&mut collected);
    let clock = collected.settle(source)?;
    inventory::list_unused(source, &mut collected)?;
    let said = Said {
        format: format.name(),
        source,
        device: &config.device,
        clock,
    };
    let beside = |name: &str| out.with_extension(format!("{name}.tum"));
    for (name, _) in &collected.trajectories {
        if beside(name).exists() && !config.replace_trajectories {
            return Err(io(
                &beside(name),
                std::io::Error::other(
                    "exists already, and the source has such a trajectory too: --force replaces it, another --out keeps both",
                ),
            ));
        }
    }
    let unfinished = out.with_extension("mcap.part");
    let written = write::write(&mut collected, &said, &unfinished, progress)
        .and_then(|written| {
            let renamed = std::fs::rename(&unfinished, out);
            renamed.map_err(|e| io(out, e)).map(|()| written)
        })
        .inspect_err(|_| {
            // Half a recording is none; what is wrong with the disk is told by the first error.
            let _ = std::fs::remove_file(&unfinished);
        })?;
    let mut trajectories = Vec::new();
    for (name, trajectory) in &collected.trajectories {
        let path = beside(name);
        write_tum(&path, trajectory)?;
        trajectories.push(path);
    }
    Ok(report(collected, &said, out, written, trajectories))
}

/// The system's refusal.
fn io(path: &Path, source: std::io::Error) -> Error {
    Error::Io {
        path: path.to_owned(),
        source,
    }
}

/// A frame belongs to the stamp of its number: where there are more of one than of the other, nobody knows which.
fn leave_out_videos_that_do_not_match(collected: &mut Collected) {
    for (video, path) in collected.videos.iter().enumerate() {
        let counted = video::count_frames(path);
        let mut stamped = 0;
        for stream in &mut collected.streams {
            let is_of_it = |payload: &Payload| match payload {
                Payload::Image(image) => {
                    matches!(image.pixels, Pixels::Frame { video: of, .. } if of == video)
                }
                _ => false,
            };
            let own = stream.records.iter().filter(|r| is_of_it(&r.payload));
            let own = own.count() as u64;
            stamped += own;
            if own == 0 {
                continue;
            }
            let why = match &counted {
                Err(why) => why.clone(),
                Ok(frames) if *frames != stream.counts.read => format!(
                    "{frames} frames but {} stamps: which belong together is unknown",
                    stream.counts.read
                ),
                Ok(_) => continue,
            };
            stream.records.retain(|r| !is_of_it(&r.payload));
            stream.lose(own, || format!("{}: {why}", path.display()));
        }
        if stamped == 0 {
            collected.notes.push(format!(
                "{}: its frames have no stamps: no image of it is imported",
                path.display()
            ));
        }
    }
}

fn report(
    collected: Collected,
    said: &Said<'_>,
    out: &Path,
    written: Vec<u64>,
    trajectories: Vec<PathBuf>,
) -> ImportReport {
    let times = collected.streams.iter().flat_map(|s| &s.records);
    let times = times.map(|r| r.time);
    let (first, last) = (times.clone().min(), times.max());
    let records = collected.streams.into_iter().zip(written);
    let records = records.map(|(stream, written)| RecordCount {
        topic: stream.full_topic(said.device),
        what: stream.what,
        read: stream.counts.read,
        written,
        unreadable: stream.counts.unreadable,
        first_problem: stream.counts.first_problem,
        repeated: stream.counts.repeated,
        reordered: stream.counts.reordered,
        derived: stream.derived,
    });
    ImportReport {
        recording: out.to_owned(),
        format: said.format,
        device: said.device.to_owned(),
        clock: said.clock,
        duration_secs: first.zip(last).map_or(0.0, |(a, b)| b.secs_since(a)),
        records: records.collect(),
        left_out: collected.left_out,
        has_rig: collected.rig.is_some(),
        trajectories,
        notes: collected.notes,
        inputs: collected.used.into_iter().chain(collected.videos).collect(),
    }
}

#[cfg(test)]
mod tests;
