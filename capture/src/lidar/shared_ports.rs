//! LiDARs that send to the same ports, live or in one capture file: told apart by their addresses, so that two sensors never make
//! one cloud.

use std::net::IpAddr;

use lsfb_drivers::any_lidar::{Settings, is_of_a_lidar};
use lsfb_geometry::MAIN_LIDAR;
use lsfb_types::Packet;

use super::LidarStream;
use super::senders::Strangers;
use crate::Error;
use crate::health::{Ending, Meter, StreamReport};
use crate::recorder::{RecorderSender, WriterGone};

/// LiDARs in one capture file that are told apart. Each takes memory, and a file may name any number of senders.
const MOST_FOUND: usize = 16;

/// What became of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// One of the LiDARs took it.
    Taken,
    /// It is of nobody who is recorded here.
    KeptOut,
}

/// The LiDARs of some ports.
pub(crate) struct Lidars {
    lidars: Vec<Lidar>,
    policy: Policy,
    strangers: Strangers,
}

struct Lidar {
    stream: LidarStream,
    /// Where its packets come from, once that is known.
    address: Option<IpAddr>,
}

/// Who is recorded.
enum Policy {
    /// Those that were named, by address.
    Chosen,
    /// The one LiDAR that there should be: the first that sends what a LiDAR sends.
    First,
    /// Whoever sends what a LiDAR sends, up to so many.
    Everyone { settings: Settings, most: usize },
}

impl Lidars {
    /// LiDARs that are expected, each with its address where that is known; several must have one each.
    pub(crate) fn named(lidars: impl IntoIterator<Item = (LidarStream, Option<IpAddr>)>) -> Self {
        let lidars = lidars.into_iter().map(|(mut stream, address)| {
            stream.address = address;
            Lidar { stream, address }
        });
        let lidars: Vec<Lidar> = lidars.collect();
        let is_chosen = lidars.iter().all(|lidar| lidar.address.is_some());
        Self {
            lidars,
            policy: if is_chosen {
                Policy::Chosen
            } else {
                Policy::First
            },
            strangers: Strangers::default(),
        }
    }

    /// Every LiDAR that is found: `lidar`, `lidar2`, … in the order in which they were first heard.
    pub(crate) fn as_found(settings: Settings) -> Self {
        // A file of beam angles is of one unit.
        let most = match settings.scans.angles {
            Some(_) => 1,
            None => MOST_FOUND,
        };
        let mut lidars = Self {
            lidars: Vec::new(),
            policy: Policy::Everyone { settings, most },
            strangers: Strangers::default(),
        };
        // Of a file without any LiDAR something is reported too.
        lidars.add(None);
        lidars
    }

    /// Gives a datagram to the LiDAR that sent it.
    pub(crate) fn push(
        &mut self,
        packet: Packet,
        sender: Option<IpAddr>,
        to_recorder: &RecorderSender,
    ) -> Result<Admission, WriterGone> {
        let Some(lidar) = self.of(sender, &packet.bytes) else {
            return Ok(Admission::KeptOut);
        };
        lidar.stream.push(packet, to_recorder)?;
        Ok(Admission::Taken)
    }

    /// Whose packet it is; `None` where it is kept out.
    fn of(&mut self, sender: Option<IpAddr>, bytes: &[u8]) -> Option<&mut Lidar> {
        let Some(sender) = sender else {
            return self.lidars.first_mut();
        };
        let known = self.lidars.iter().position(|l| l.address == Some(sender));
        let index = known.or_else(|| self.newcomer(sender, is_of_a_lidar(bytes)));
        self.lidars.get_mut(index?)
    }

    /// The place of a sender that was not heard before.
    fn newcomer(&mut self, sender: IpAddr, is_of_a_lidar: bool) -> Option<usize> {
        let unclaimed = self.lidars.iter().position(|l| l.address.is_none());
        let index = match unclaimed {
            Some(index) => {
                if let (true, Some(lidar)) = (is_of_a_lidar, self.lidars.get_mut(index)) {
                    lidar.address = Some(sender);
                    lidar.stream.address = Some(sender);
                }
                Some(index)
            }
            None if is_of_a_lidar => self.add(Some(sender)),
            None => None,
        };
        if index.is_none() {
            self.strangers.count(sender, is_of_a_lidar);
            self.report_kept_out();
        }
        index
    }

    /// One more LiDAR, where whoever sends is recorded.
    fn add(&mut self, sender: Option<IpAddr>) -> Option<usize> {
        let Policy::Everyone { settings, most } = &self.policy else {
            return None;
        };
        let index = self.lidars.len();
        if index >= *most {
            return None;
        }
        let name = match index {
            0 => MAIN_LIDAR.to_owned(),
            _ => format!("{MAIN_LIDAR}{}", index + 1),
        };
        let mut stream = LidarStream::new(&name, settings.clone(), &Meter::new(&name));
        stream.address = sender;
        self.lidars.push(Lidar {
            stream,
            address: sender,
        });
        Some(index)
    }

    /// Where nobody chose which LiDAR counts, what another one sent should have been recorded too.
    fn report_kept_out(&mut self) {
        if let (false, Some(first)) = (self.is_chosen(), self.lidars.first_mut()) {
            first.stream.report.kept_out = self.strangers.of_lidars();
            first.stream.meter.count(&first.stream.report);
        }
    }

    fn is_chosen(&self) -> bool {
        matches!(self.policy, Policy::Chosen)
    }

    /// One that is two, where there is such a one.
    pub(crate) fn mixture(&self) -> Option<Error> {
        self.lidars.iter().find_map(|lidar| lidar.stream.mixture())
    }

    /// Decodes what was held back, as nothing more comes, and refuses packets of two sensors.
    pub(crate) fn drain(&mut self, to_recorder: &RecorderSender) -> Result<(), Error> {
        let mut streams = self.lidars.iter_mut();
        streams.try_for_each(|lidar| lidar.stream.drain(to_recorder))
    }

    /// Ends the streams: one report for each LiDAR.
    pub(crate) fn finish(self, ending: &Ending, to_recorder: &RecorderSender) -> Vec<StreamReport> {
        let streams = self.lidars.into_iter();
        let mut reports: Vec<StreamReport> = streams
            .map(|lidar| lidar.stream.finish(ending.clone(), to_recorder))
            .collect();
        if let Some(first) = reports.first_mut() {
            first.notes.extend(self.strangers.remarks());
        }
        reports
    }
}
