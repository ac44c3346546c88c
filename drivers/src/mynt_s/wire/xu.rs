//! Extension unit transactions, and the device's side of them.

use std::collections::{BTreeMap, VecDeque};

use super::files::UnitFile;
use super::imu::{ImuProtocol, ImuRequest, ImuResponse, ImuSegment};
use super::info::DeviceInfo;
use super::options::{OptionCommand, OptionTable};
use crate::transport::uvc::{XuQuery, XuRefusal, XuSelector};

/// The device's side of the extension unit, byte for byte: a mock unit holds one and asks it for every answer.
#[derive(Clone, Debug)]
pub struct XuDevice {
    options: OptionTable,
    files: BTreeMap<UnitFile, Vec<u8>>,
    protocol: ImuProtocol,
    pending: VecDeque<ImuSegment>,
    ready_made: VecDeque<Vec<u8>>,
    request: Option<ImuRequest>,
    file: Option<Vec<u8>>,
}

impl XuDevice {
    /// A unit that has just powered up. `protocol`: layout of its IMU segments.
    pub fn new(info: DeviceInfo, protocol: ImuProtocol) -> Self {
        Self {
            options: OptionTable::default(),
            files: BTreeMap::from([(UnitFile::DeviceInfo, info.emit())]),
            protocol,
            pending: VecDeque::new(),
            ready_made: VecDeque::new(),
            request: None,
            file: None,
        }
    }

    /// Current options.
    pub fn options(&self) -> &OptionTable {
        &self.options
    }

    /// Gives the unit a calibration: the content of its file. One that is too long for an answer is not kept.
    pub fn set_file(&mut self, file: UnitFile, content: &[u8]) {
        if let Ok(answer) = file.emit(content) {
            self.files.insert(file, answer);
        }
    }

    /// Gives the unit a file as another one answered with it, envelope and all.
    pub fn set_file_answer(&mut self, file: UnitFile, answer: &[u8]) {
        self.files.insert(file, answer.to_vec());
    }

    /// Puts a segment, in the unit's layout, into the queue that the host polls.
    pub fn push_imu(&mut self, segment: ImuSegment) {
        self.pending.push_back(segment);
    }

    /// Answers the next poll of the IMU with exactly these bytes, whatever they are.
    pub fn push_imu_answer(&mut self, answer: &[u8]) {
        self.ready_made.push_back(answer.to_vec());
    }

    /// Whether the host has everything of the IMU: confirmed it, where the protocol asks for that.
    pub fn imu_is_taken(&self) -> bool {
        self.pending.is_empty() && self.ready_made.is_empty()
    }

    /// Carries out a write.
    pub fn set(&mut self, selector: XuSelector, bytes: &[u8]) -> Result<(), XuRefusal> {
        if bytes.len() != selector.len_bytes() {
            return Err(XuRefusal);
        }
        match selector {
            XuSelector::CamCtrl => {
                let command = OptionCommand::parse(bytes).map_err(|_| XuRefusal)?;
                self.options.apply(command).map_err(|_| XuRefusal)
            }
            XuSelector::ImuWrite => {
                let request = ImuRequest::parse(self.protocol, bytes).map_err(|_| XuRefusal)?;
                if request.protocol() != self.protocol {
                    return Err(XuRefusal);
                }
                if let ImuRequest::After(serial) = request {
                    // Protocol 1 repeats what the host has not confirmed. Zero asks for everything, and so does what is
                    // not there.
                    let confirmed = self.pending.iter().position(|s| s.serial == serial);
                    if let Some(last) = confirmed.filter(|_| serial != 0) {
                        self.pending.drain(..=last);
                    }
                }
                self.request = Some(request);
                Ok(())
            }
            XuSelector::File => {
                let asked = bytes.first().copied().and_then(UnitFile::from_request);
                let answer = asked.and_then(|file| self.files.get(&file));
                self.file = Some(answer.ok_or(XuRefusal)?.clone());
                Ok(())
            }
            XuSelector::HalfDuplex | XuSelector::ImuRead => Err(XuRefusal),
        }
    }

    /// Answers a read with exactly the bytes of its channel.
    pub fn get(&mut self, selector: XuSelector, query: XuQuery) -> Result<Vec<u8>, XuRefusal> {
        let mut bytes = match (selector, query) {
            (XuSelector::CamCtrl, query) => self.options.answer(query).ok_or(XuRefusal)?.to_vec(),
            (XuSelector::ImuRead, XuQuery::GetCur) => self.imu_answer()?,
            (XuSelector::File, XuQuery::GetCur) => self.file.take().ok_or(XuRefusal)?,
            _ => return Err(XuRefusal),
        };
        bytes.resize(selector.len_bytes(), 0);
        Ok(bytes)
    }

    fn imu_answer(&mut self) -> Result<Vec<u8>, XuRefusal> {
        let request = self.request.take().ok_or(XuRefusal)?;
        if let Some(answer) = self.ready_made.pop_front() {
            return Ok(answer);
        }
        let count = ImuResponse::capacity(self.protocol).min(self.pending.len());
        let segments = match request {
            ImuRequest::After(_) => self.pending.iter().take(count).copied().collect(),
            ImuRequest::Single | ImuRequest::Paired => self.pending.drain(..count).collect(),
        };
        ImuResponse { segments }
            .emit(self.protocol)
            .map_err(|_| XuRefusal)
    }
}
