//! What all LiDARs have in common: settings, counters, beam angles, and the cut into scans.

mod angles;
mod azimuths;
mod order;
mod page;
mod scan_builder;

use lsfb_types::Timestamp;

pub use angles::{AnglesError, BeamAngles};
pub use azimuths::{Azimuths, SECTORS};
pub use order::Instants;
pub(crate) use order::{LATE_NS, MOST_LATE, Step, elapsed_ns, is_crowded, step};
pub use page::{Destination, Page, SensorSettings, SettingsError};
#[cfg(test)]
pub(crate) use scan_builder::HOUR_NS;
pub use scan_builder::TURN_CENTIDEG;
pub(crate) use scan_builder::{ScanBuilder, turn};

/// Kernel receive buffer that is wanted for a sensor, bytes: seconds of its data.
pub const RECEIVE_BUFFER_BYTES: usize = 8 << 20;

/// Which echoes a sensor sends, as one asks for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "kebab-case")
)]
pub enum Returns {
    /// The strongest of each shot.
    #[default]
    Strongest,
    /// The last of each shot.
    Last,
    /// Both.
    Dual,
}

impl Returns {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Strongest, Self::Last, Self::Dual];

    /// Its name in settings.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Strongest => "strongest",
            Self::Last => "last",
            Self::Dual => "dual",
        }
    }
}

/// How packets become scans, whichever sensor sent them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanSettings {
    /// The packets are of the configured model with these returns, whatever they say themselves: old firmware of Velodyne
    /// sensors lies.
    pub force_returns: Option<Returns>,
    /// A scan ends where the rotor passes this angle, 0.01°. With a field-of-view window, choose one outside it.
    pub cut_azimuth_centideg: u16,
    /// Beam angles of this very unit, for sensors that come with a file of them; `None` takes those of the model.
    pub angles: Option<BeamAngles>,
}

/// What a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Data packets decoded.
    pub packets: u64,
    /// Returns decoded.
    pub points: u64,
    /// Scans finished.
    pub scans: u64,
    /// Packets of a wrong length, flag or azimuth.
    pub malformed: u64,
    /// Packets of another model or mode than can be decoded.
    pub refused: u64,
    /// Packets that never came, by the counters or timestamps of their neighbours.
    pub lost: u64,
    /// Packets that came after a later one; left out of the scan, and not among the lost.
    pub reordered: u64,
    /// Packets that came twice; the second is left out.
    pub duplicates: u64,
    /// Packets that came too soon after the one before, by the sensor's own time, to be of one sensor.
    pub crowded: u64,
    /// Times the sensor's clock was set.
    pub clock_jumps: u64,
    /// Times model or return mode changed.
    pub mode_changes: u64,
    /// Packets decoded as [`ScanSettings::force_returns`] says whose factory bytes name another model or mode.
    pub contradicting: u64,
    /// Scans ended because the rotor did not come round.
    pub overlong: u64,
    /// Where around the sensor something came back.
    pub azimuths: Azimuths,
}

impl Counters {
    /// Takes a shot of all lasers to which so many echoes came.
    pub(crate) fn shot(&mut self, azimuth_centideg: u16, echoes: usize) {
        self.points += echoes as u64;
        self.azimuths.note(azimuth_centideg, echoes);
    }
}

/// What a sensor turned out to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found<M> {
    /// Its model.
    pub model: M,
    /// Which echoes it sends: `strongest`, `last + strongest`.
    pub returns: &'static str,
    /// Speed of its rotor, where its packets say it, revolutions per minute.
    pub rpm: Option<u16>,
}

/// What a packet beside the data says about the sensor's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// The sensor's time past the hour, nanoseconds.
    pub toh_ns: i64,
    /// Whether its seconds follow a pulse.
    pub pps_locked: bool,
    /// The second that its NMEA sentence names, UTC.
    pub sentence: Option<Timestamp>,
    /// Temperature of the sensor, °C.
    pub temperature_celsius: Option<f64>,
}
