//! The thread that writes.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use lsfb_recording::{Channel, Summary};

use super::displacement::Displacement;
use super::latency::Latencies;
use super::parts::{Parts, Turn};
use super::{Entry, OwnMessage, Queued, Shared, WritingProgress, Written};
use crate::Error;
use crate::config::LidarData;
use crate::receipt::Receipt;
use crate::report::{HealthAttachment, StreamReport};
use crate::sync::{Group, Groups};

/// An open chunk goes to the file after this. Large images close theirs at once and take along what waited, but they come every
/// 50 ms, the recorder promises that no message waits longer, and a kill costs what waits.
const FLUSH_AFTER: Duration = Duration::from_millis(25);
/// How long the thread sleeps when there is nothing to write.
const IDLE: Duration = Duration::from_millis(250);

/// Takes entries from the queue and puts them into files.
pub(super) struct Writing {
    parts: Parts,
    groups: Groups,
    streams: Vec<StreamReport>,
    shared: Shared,
    /// When each entry of the open chunk was queued.
    waiting: Vec<Instant>,
    receipts: Vec<Receipt>,
    latencies: Latencies,
    /// Latest clock model of each device: each part begins with them.
    clock_models: BTreeMap<String, OwnMessage>,
    lost: u64,
    failure: Option<String>,
    displaced: Vec<String>,
    /// The first message of a sidecar that could not be written.
    refused: Option<String>,
    lidar_data: LidarData,
}

impl Writing {
    pub(super) fn new(parts: Parts, groups: Groups, shared: Shared) -> Self {
        Self {
            lidar_data: parts.lidar_data(),
            parts,
            groups,
            streams: Vec::new(),
            shared,
            waiting: Vec::new(),
            receipts: Vec::new(),
            latencies: Latencies::default(),
            clock_models: BTreeMap::new(),
            lost: 0,
            failure: None,
            displaced: Vec::new(),
            refused: None,
        }
    }

    pub(super) fn run(mut self, entries: &Receiver<Queued>) -> Result<Written, Error> {
        self.show();
        loop {
            let done = match entries.recv_timeout(self.patience()) {
                Ok(queued) => {
                    self.shared.left(queued.bytes);
                    let taken = self.take(queued);
                    // Where the chunk before it cannot be written, this entry has no place either.
                    self.lost += u64::from(taken.is_err());
                    taken
                }
                Err(RecvTimeoutError::Timeout) => Ok(()),
                Err(RecvTimeoutError::Disconnected) => break,
            };
            let done = done
                .and_then(|()| self.flush_when_due())
                .and_then(|()| self.keep_in_place());
            if let Err(error) = done {
                self.recover_from(error)?;
            }
            if self.failure.is_some() {
                // What still waits has no place to go.
                self.lost += entries.try_iter().count() as u64;
                break;
            }
        }
        self.finish()
    }

    /// How long to wait for the next entry before the open chunk must be written.
    fn patience(&self) -> Duration {
        match self.waiting.first() {
            Some(oldest) => FLUSH_AFTER.saturating_sub(oldest.elapsed()),
            None => IDLE,
        }
    }

    fn take(&mut self, queued: Queued) -> Result<(), Error> {
        let before = self.parts.writer().bytes();
        let mut receipt = self.write(queued.entry)?;
        if self.parts.writer().bytes() != before {
            // The chunk was full: everything before this entry is in the file, and this one too where nothing is open.
            if self.parts.writer().open_messages() == 0 {
                self.waiting.push(queued.at);
                self.receipts.extend(receipt.take());
                return self.written();
            }
            self.written()?;
        }
        if self.parts.writer().open_messages() > 0 {
            self.waiting.push(queued.at);
            self.receipts.extend(receipt);
        } else {
            self.acknowledge(receipt.into_iter().collect());
        }
        Ok(())
    }

    /// What is in the file is acknowledged as soon as it is on the disk.
    fn acknowledge(&mut self, mut receipts: Vec<Receipt>) {
        receipts.iter_mut().for_each(Receipt::settle);
        self.parts.acknowledge(receipts);
    }

    fn flush_when_due(&mut self) -> Result<(), Error> {
        let due = self
            .waiting
            .first()
            .is_some_and(|oldest| oldest.elapsed() >= FLUSH_AFTER);
        if due {
            self.parts.writer().flush()?;
            self.written()?;
        }
        Ok(())
    }

    /// Everything noted so far is in the file.
    fn written(&mut self) -> Result<(), Error> {
        self.settle();
        let turn = self.parts.turn();
        match turn {
            None => {}
            Some(Turn::LowSpace) if !self.parts.can_move() => {
                self.failure = Some(format!(
                    "{}: the disk is full; the recording was closed",
                    self.parts.path().display()
                ));
            }
            Some(turn) => {
                self.parts.next(turn)?;
                self.introduce()?;
            }
        }
        self.show();
        Ok(())
    }

    /// Looks whether the file is still where it was made, and goes on in another where it is not.
    fn keep_in_place(&mut self) -> Result<(), Error> {
        let Some(displacement) = self.parts.displaced() else {
            return Ok(());
        };
        self.parts.writer().flush()?;
        self.settle();
        match self.parts.leave_displaced() {
            Ok(messages) => {
                let next = self.parts.path();
                self.report_displaced(&displacement, messages, Some(&next));
                self.introduce()?;
            }
            Err(error) => {
                self.report_displaced(&displacement, None, None);
                self.failure = Some(error.to_string());
            }
        }
        self.show();
        Ok(())
    }

    fn report_displaced(
        &mut self,
        displacement: &Displacement,
        messages: Option<u64>,
        next: Option<&Path>,
    ) {
        self.displaced.push(displacement.sentence(messages, next));
        self.lost += displacement.lost(messages);
    }

    /// What waited is in the file.
    fn settle(&mut self) {
        let now = Instant::now();
        for at in self.waiting.drain(..) {
            self.latencies.add(now.saturating_duration_since(at));
        }
        let receipts = std::mem::take(&mut self.receipts);
        self.acknowledge(receipts);
    }

    /// What a new part must know from its beginning on.
    fn introduce(&mut self) -> Result<(), Error> {
        let models: Vec<OwnMessage> = self.clock_models.values().cloned().collect();
        models.iter().try_for_each(|model| self.write_own(model))
    }

    /// Goes on with the second disk after a failed write, or ends with what there is.
    fn recover_from(&mut self, error: Error) -> Result<(), Error> {
        let is_disk = matches!(
            &error,
            Error::Recording(lsfb_recording::Error::WriterFailed { .. })
        );
        if !is_disk {
            return Err(error);
        }
        self.lost += self.parts.writer().open_messages();
        self.waiting.clear();
        // What was not written is not acknowledged: the sidecar keeps it.
        self.receipts.clear();
        if self.parts.can_move() {
            self.parts.replace_failed()?;
            return self.introduce();
        }
        let nothing_written = self.parts.finished_messages() == 0 && self.latencies_empty();
        if nothing_written {
            return Err(error);
        }
        self.failure = Some(error.to_string());
        Ok(())
    }

    fn latencies_empty(&self) -> bool {
        self.latencies.longest_ms() == 0.0
    }

    fn finish(mut self) -> Result<Written, Error> {
        let decided = self.groups.finish();
        let mut groups = decided.report;
        let failed = self.failure.is_some();
        let displacement = self.parts.displaced_now();
        if !failed {
            for group in &decided.groups {
                self.write_group(group)?;
            }
        }
        groups.missing_by_camera.retain(|_, missing| *missing > 0);
        let lost = self.lost
            + self.streams.iter().map(StreamReport::lost).sum::<u64>()
            + groups.incomplete;
        let health = HealthAttachment {
            streams: &self.streams,
            groups: &groups,
            lost,
        };
        // Numbers and strings always serialise.
        let json = serde_json::to_vec_pretty(&health).unwrap_or_default();
        let parts = if failed {
            self.parts.salvage()
        } else {
            self.parts
                .attach("health.json", "application/json", &json)?;
            let now = Instant::now();
            for at in self.waiting.drain(..) {
                self.latencies.add(now.saturating_duration_since(at));
            }
            self.parts.finish(self.receipts)?
        };
        let mut warnings = self.displaced;
        let mut lost = lost;
        if let Some(displacement) = displacement {
            // Too late to go on elsewhere.
            let messages = parts.last().map(|part: &Summary| part.messages);
            warnings.push(displacement.sentence(messages, None));
            lost += displacement.lost(messages);
        }
        warnings.extend(self.refused);
        // A file that has no name is none.
        let parts = parts
            .into_iter()
            .filter(|part| part.path.exists())
            .collect();
        Ok(Written {
            parts,
            groups,
            lost,
            failure: self.failure,
            warnings,
            write_p99_ms: self.latencies.quantile_ms(0.99),
            write_longest_ms: self.latencies.longest_ms(),
        })
    }

    /// Puts an entry into the open chunk; the receipt is due when that is in the file.
    fn write(&mut self, entry: Entry) -> Result<Option<Receipt>, Error> {
        match entry {
            Entry::Image {
                camera,
                image,
                trailer,
            } => {
                let decided = self.groups.note(&camera, &image);
                let written = self
                    .parts
                    .writer()
                    .write_image_with_trailer(&camera, &image, &trailer);
                written?;
                for group in decided {
                    self.write_group(&group)?;
                }
            }
            Entry::Imu { imu, sample } => self.parts.writer().write_imu(&imu, &sample)?,
            Entry::Scan {
                lidar,
                scan,
                packets,
            } => {
                let writer = self.parts.writer();
                if self.lidar_data != LidarData::Clouds {
                    writer.write_lidar_packets(&lidar, scan.time, &packets)?;
                }
                if self.lidar_data != LidarData::Packets {
                    writer.write_scan(&lidar, &scan)?;
                }
            }
            Entry::Packets {
                lidar,
                time,
                packets,
            } => {
                if self.lidar_data != LidarData::Clouds {
                    self.parts
                        .writer()
                        .write_lidar_packets(&lidar, time, &packets)?;
                }
            }
            Entry::Raw {
                source,
                kind,
                sequence,
                packet,
                time,
            } => self
                .parts
                .writer()
                .write_raw(&source, kind, sequence, &packet, time)?,
            Entry::Cdr {
                topic,
                schema_name,
                schema_text,
                time,
                arrival,
                bytes,
                receipt,
            } => {
                if receipt.as_ref().is_some_and(Receipt::comes_again) {
                    return Ok(None);
                }
                let channel = Channel {
                    topic: &topic,
                    schema_name: &schema_name,
                    schema_text: &schema_text,
                };
                let written = self
                    .parts
                    .writer()
                    .write_cdr(&channel, time, arrival, &bytes);
                if let Err(error) = written {
                    self.refuse(error)?;
                }
                return Ok(receipt);
            }
            Entry::Attachment(file) => {
                self.parts
                    .attach(&file.name, &file.media_type, &file.bytes)?;
            }
            Entry::OdometryFollows => self.parts.expect_odometry(),
            Entry::Device(note) => self.parts.note_device(&note)?,
            Entry::Rig { owner, rig } if self.parts.has_rig() => {
                let name = format!("sidecar/{owner}/rig.toml");
                self.parts
                    .attach(&name, "application/toml", rig.to_toml().as_bytes())?;
                self.parts.place_sidecar(owner, *rig);
            }
            Entry::Rig { owner, rig } => {
                self.parts.attach_rig((*rig).clone())?;
                self.parts.place_sidecar(owner, *rig);
            }
            Entry::Own(message) => self.write_own(&message)?,
            Entry::ClockModel { device, message } => {
                self.write_own(&message)?;
                self.clock_models.insert(device, message);
            }
            Entry::Ended(streams) => self.streams = streams,
        }
        Ok(None)
    }

    /// Leaves out one message that cannot be written (another schema on its topic, say): whoever sent it must not end the
    /// recording of all. A disk that failed is another matter.
    fn refuse(&mut self, error: lsfb_recording::Error) -> Result<(), Error> {
        if matches!(error, lsfb_recording::Error::WriterFailed { .. }) {
            return Err(error.into());
        }
        self.lost += 1;
        self.refused.get_or_insert_with(|| error.to_string());
        Ok(())
    }

    fn write_own(&mut self, message: &OwnMessage) -> Result<(), Error> {
        let channel = Channel {
            topic: &message.topic,
            schema_name: message.schema.name,
            schema_text: message.schema.text,
        };
        self.parts
            .writer()
            .write_cdr(&channel, message.time, message.arrival, &message.bytes)?;
        Ok(())
    }

    fn write_group(&mut self, group: &Group) -> Result<(), Error> {
        self.write_own(&OwnMessage::camera_group(group))
    }

    /// Tells the monitor where the recording is.
    fn show(&self) {
        let (bytes, number, path) = (self.parts.bytes(), self.parts.number(), self.parts.path());
        let groups = self.groups.report().clone();
        self.shared.show(WritingProgress {
            written_bytes: bytes,
            part_number: number,
            part: path,
            groups,
            lost: self.lost,
            displaced: self.displaced.clone(),
            write_p99_ms: self.latencies.quantile_ms(0.99),
        });
    }
}
