//! The files of one recording: split by size and time, continued on a second disk, each complete in itself.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lsfb_geometry::Rig;
use lsfb_recording::{Summary, Writer, WriterConfig};

use super::disk_sync::DiskSync;
use super::displacement::Displacement;
use super::space;
use crate::Error;
use crate::config::{LidarData, RecorderConfig};
use crate::device_note::DeviceNote;
use crate::receipt::Receipt;

/// How often the disk is asked how much room it has.
const SPACE_PERIOD: Duration = Duration::from_millis(200);
/// How often it is looked whether the file is still where it was made.
const PLACE_PERIOD: Duration = Duration::from_millis(500);

/// Why a part ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    /// It is large or long enough.
    Split,
    /// Its disk is nearly full.
    LowSpace,
    /// The file is not where it was made: removed, renamed, or its disk is gone.
    Displaced,
}

/// The open file and those before it.
pub(crate) struct Parts {
    out: PathBuf,
    config: RecorderConfig,
    writer: Writer,
    rig: Option<Rig>,
    /// Rigs of sidecars, by device.
    sidecars: BTreeMap<String, Rig>,
    /// Whether the rig's poses are among the messages.
    has_odometry: bool,
    /// What is known of the devices, by name of the metadata record.
    devices: BTreeMap<String, BTreeMap<String, String>>,
    /// Attachments that every part carries, by name.
    attachments: BTreeMap<String, (String, Vec<u8>)>,
    finished: Vec<Summary>,
    number: u32,
    began: Instant,
    on_second: bool,
    space_checked: Instant,
    place_checked: Instant,
    sync: DiskSync,
}

impl Parts {
    pub(crate) fn create(
        out: &Path,
        config: &RecorderConfig,
        rig: Option<Rig>,
    ) -> Result<Self, Error> {
        let sync = DiskSync::start()?;
        let writer = open(out, config, 1, None)?;
        let mut parts = Self {
            out: out.to_owned(),
            config: config.clone(),
            writer,
            rig,
            sidecars: BTreeMap::new(),
            has_odometry: false,
            devices: BTreeMap::new(),
            attachments: BTreeMap::new(),
            finished: Vec::new(),
            number: 1,
            began: Instant::now(),
            on_second: false,
            space_checked: Instant::now(),
            place_checked: Instant::now(),
            sync,
        };
        parts.introduce()?;
        Ok(parts)
    }

    pub(crate) fn writer(&mut self) -> &mut Writer {
        &mut self.writer
    }

    pub(crate) fn number(&self) -> u32 {
        self.number
    }

    /// The open file.
    pub(crate) fn path(&self) -> PathBuf {
        path_of(&self.out, self.number, self.folder_override())
    }

    /// Bytes in all files.
    pub(crate) fn bytes(&self) -> u64 {
        self.finished.iter().map(|s| s.bytes).sum::<u64>() + self.writer.bytes()
    }

    /// Messages in the files that are finished.
    pub(crate) fn finished_messages(&self) -> u64 {
        self.finished.iter().map(|s| s.messages).sum()
    }

    pub(crate) fn has_rig(&self) -> bool {
        self.rig.is_some()
    }

    pub(crate) fn attach_rig(&mut self, rig: Rig) -> Result<(), Error> {
        self.writer.attach_rig(&rig)?;
        self.rig = Some(rig);
        Ok(())
    }

    /// Says where the sensors of a sidecar are, in this part and in all that follow.
    pub(crate) fn place_sidecar(&mut self, device: String, rig: Rig) {
        self.writer.place_sidecar(&device, &rig);
        self.sidecars.insert(device, rig);
    }

    /// What is kept of LiDARs.
    pub(crate) fn lidar_data(&self) -> LidarData {
        self.config.lidar_data
    }

    /// Attaches a file to this part and to all that follow.
    pub(crate) fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        bytes: &[u8],
    ) -> Result<(), Error> {
        self.writer.attach(name, media_type, bytes)?;
        self.attachments
            .insert(name.to_owned(), (media_type.to_owned(), bytes.to_vec()));
        Ok(())
    }

    /// Says that the rig's poses follow, in this part and in all that follow.
    pub(crate) fn expect_odometry(&mut self) {
        self.has_odometry = true;
        self.writer.expect_odometry();
    }

    /// Says what a device is, in this part and in all that follow.
    pub(crate) fn note_device(&mut self, note: &DeviceNote) -> Result<(), Error> {
        let (record, entries) = (note.record(), note.entries().clone());
        self.writer.write_metadata(&record, entries.clone())?;
        self.devices.insert(record, entries);
        Ok(())
    }

    /// Whether this part should end now; asked whenever a chunk has been written.
    pub(crate) fn turn(&mut self) -> Option<Turn> {
        let bytes = self.writer.bytes();
        let long = self.config.split_secs > 0.0
            && self.began.elapsed().as_secs_f64() >= self.config.split_secs;
        if long || (self.config.split_bytes > 0 && bytes >= self.config.split_bytes) {
            return Some(Turn::Split);
        }
        if self.space_checked.elapsed() >= SPACE_PERIOD {
            self.space_checked = Instant::now();
            let path = self.path();
            let folder = path.parent().unwrap_or(Path::new(""));
            // A disk that cannot be asked will say so when it is written to.
            let low = space::free_bytes(folder).is_ok_and(|free| free < self.config.reserve_bytes);
            return low.then_some(Turn::LowSpace);
        }
        None
    }

    /// What became of the open file where it is no longer what its path leads to; asked again and again, it looks twice a second.
    pub(crate) fn displaced(&mut self) -> Option<Displacement> {
        if self.place_checked.elapsed() < PLACE_PERIOD {
            return None;
        }
        self.place_checked = Instant::now();
        self.displaced_now()
    }

    /// The same, looking in any case.
    pub(crate) fn displaced_now(&self) -> Option<Displacement> {
        Displacement::of(&self.path(), self.writer.file().ok()?.metadata().ok()?)
    }

    /// Whether there is another disk to go on with.
    pub(crate) fn can_move(&self) -> bool {
        self.config.second_folder.is_some() && !self.on_second
    }

    /// Closes this part and begins the next, on the second disk where `turn` asks for it.
    pub(crate) fn next(&mut self, turn: Turn) -> Result<(), Error> {
        let next = self.open_next(turn)?;
        let last = std::mem::replace(&mut self.writer, next);
        self.finished.push(last.finish()?);
        self.introduce()
    }

    /// Goes on in another file after this one was taken away; it is closed where it is. How many messages are in it; `None` where it
    /// could not be closed.
    pub(crate) fn leave_displaced(&mut self) -> Result<Option<u64>, Error> {
        let next = self.open_next(Turn::Displaced)?;
        let last = std::mem::replace(&mut self.writer, next);
        let messages = match last.finish() {
            Ok(summary) => {
                let messages = summary.messages;
                self.finished.push(summary);
                Some(messages)
            }
            // Its disk is gone.
            Err(_) => None,
        };
        self.introduce()?;
        Ok(messages)
    }

    /// Goes on behind a part whose disk failed; what it holds is closed as far as the disk allows.
    pub(crate) fn replace_failed(&mut self) -> Result<(), Error> {
        let next = self.open_next(Turn::LowSpace)?;
        let failed = std::mem::replace(&mut self.writer, next);
        if let Ok(summary) = failed.salvage() {
            self.finished.push(summary);
        }
        self.introduce()
    }

    /// Of messages that are in the open file: acknowledged when that is on the disk.
    pub(crate) fn acknowledge(&mut self, receipts: Vec<Receipt>) {
        self.sync.acknowledge(receipts);
    }

    /// Closes the last part, and acknowledges what waited for that when it is on the disk.
    pub(crate) fn finish(mut self, receipts: Vec<Receipt>) -> Result<Vec<Summary>, Error> {
        self.finished.push(self.writer.finish()?);
        self.sync.acknowledge(receipts);
        Ok(self.finished)
    }

    /// Closes the last part after a failure, as far as the disk allows.
    pub(crate) fn salvage(mut self) -> Vec<Summary> {
        if let Ok(summary) = self.writer.salvage() {
            self.finished.push(summary);
        }
        self.finished
    }

    fn open_next(&mut self, turn: Turn) -> Result<Writer, Error> {
        let previous = self.path();
        // A file that was taken away may be followed by its whole disk.
        self.on_second |= turn == Turn::LowSpace
            || turn == Turn::Displaced && self.config.second_folder.is_some();
        let mut number = self.number + 1;
        let mut path = path_of(&self.out, number, self.folder_override());
        // Whoever moved files may have put others there; nobody may be made to choose a name now.
        while turn == Turn::Displaced && path.exists() {
            number += 1;
            path = path_of(&self.out, number, self.folder_override());
        }
        super::make_folder(&path)?;
        let writer = open(&path, &self.config, number, Some(&previous))?;
        self.number = number;
        self.began = Instant::now();
        Ok(writer)
    }

    fn folder_override(&self) -> Option<&Path> {
        self.config
            .second_folder
            .as_deref()
            .filter(|_| self.on_second)
    }

    /// What makes a part complete in itself.
    fn introduce(&mut self) -> Result<(), Error> {
        if let Some(rig) = &self.rig {
            self.writer.attach_rig(rig)?;
        }
        for (device, rig) in &self.sidecars {
            self.writer.place_sidecar(device, rig);
        }
        for (name, (media_type, bytes)) in &self.attachments {
            self.writer.attach(name, media_type, bytes)?;
        }
        if self.has_odometry {
            self.writer.expect_odometry();
        }
        for (record, entries) in &self.devices {
            self.writer.write_metadata(record, entries.clone())?;
        }
        let path = self.path();
        self.sync.follow(self.writer.file(), &path);
        Ok(())
    }
}

fn open(
    path: &Path,
    config: &RecorderConfig,
    number: u32,
    previous: Option<&Path>,
) -> Result<Writer, Error> {
    let mut session = BTreeMap::from([("part".to_owned(), number.to_string())]);
    if let Some(name) = previous.and_then(Path::file_name) {
        session.insert("previous".to_owned(), name.to_string_lossy().into_owned());
    }
    let layout = WriterConfig {
        chunk_bytes: config.chunk_bytes,
        compression: config.compression,
        durability: config.durability,
        existing: config.existing,
        session,
        ..WriterConfig::default()
    };
    Ok(Writer::create(path, &layout)?)
}

/// `scan.mcap`, `scan-0002.mcap`, …
/// The parts of a recording that are there, in order.
pub(crate) fn parts_of(out: &Path, second_folder: Option<&Path>) -> Vec<PathBuf> {
    let first = path_of(out, 1, None);
    let others = (2..).map_while(|number| {
        let folders = [None, second_folder];
        let mut paths = folders
            .map(|folder| path_of(out, number, folder))
            .into_iter();
        paths.find(|path| path.exists())
    });
    std::iter::once(first).chain(others).collect()
}

fn path_of(out: &Path, number: u32, folder: Option<&Path>) -> PathBuf {
    let numbered = match number {
        1 => out.to_owned(),
        _ => {
            let stem = out.file_stem().unwrap_or_default().to_string_lossy();
            out.with_file_name(format!("{stem}-{number:04}.mcap"))
        }
    };
    match (folder, numbered.file_name()) {
        (Some(folder), Some(name)) => folder.join(name),
        _ => numbered,
    }
}
