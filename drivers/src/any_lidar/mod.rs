//! One decoder for whatever LiDAR sends.
//!
//! A new LiDAR is a folder in `lidar_vendors/` and a line in the list there. Its module offers the same names as its siblings:
//! `Model`, `Decoder`, `DecoderConfig`, `DecodeError`, `FACTORY_PORTS`, `PAGE`, `recognise`, `is_beside`, `device_ns`, `position`
//! and `blank_packets`. Nobody outside this crate names a vendor's module to record, so that all take the new one from the list.
//!
//! ```
//! use lsfb_drivers::any_lidar::{Decoder, Settings};
//! use lsfb_types::{Packet, Timestamp};
//!
//! let mut decoder = Decoder::new(Settings::default());
//! let datagram = Packet { arrival: Timestamp::from_nanos(0), bytes: b"not a LiDAR".to_vec() };
//! let error = decoder.push(&datagram).expect_err("nothing that a LiDAR sends");
//! assert_eq!(error.to_string(), "a datagram of 11 bytes is not from a supported LiDAR");
//! ```

mod looks_like;
mod reorder;

use lsfb_types::{LidarScan, Packet, Timestamp};

use crate::lidar::{Counters, Found, Page, Position, ScanSettings};
use crate::lidar_vendors::each_lidar;
use crate::{Decoded, WireError};

pub use looks_like::looks_like;
pub use reorder::Reorder;

/// How the packets of a LiDAR become scans.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// The sensor it must be; `None` takes whatever the packets say.
    pub model: Option<Model>,
    /// What does not depend on the sensor.
    pub scans: ScanSettings,
}

/// What is made of the list of vendors.
macro_rules! lidars {
    ($($Lidar:ident $module:ident,)+) => {
        /// Why a packet gave no points. Every such packet is counted in [`Counters`] too.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
        #[non_exhaustive]
        pub enum DecodeError {
            /// Not of the sensor that sends here.
            #[error(transparent)]
            Wire(#[from] WireError),
            /// Of a sensor that is recognised by the look of its packets, and not decoded.
            #[error("a datagram of {bytes} bytes that looks like {name}, which is not supported")]
            LooksLike {
                /// Whose it seems to be.
                name: &'static str,
                /// Its length.
                bytes: usize,
            },
            /// Of another sensor than the configured one.
            #[error("packets of another sensor, but a {expected} is configured")]
            WrongSensor {
                /// The configured model.
                expected: Model,
            },
            /// Of nobody that is known.
            #[error("a datagram of {bytes} bytes is not from a supported LiDAR")]
            Unknown {
                /// Its length.
                bytes: usize,
            },
            $(
                /// The sensor's own decoder refused it.
                #[error(transparent)]
                $Lidar(crate::lidar_vendors::$module::DecodeError),
            )+
        }

        /// A sensor that can be decoded.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Model {
            $(
                #[doc = concat!("One of [`crate::lidar_vendors::", stringify!($module), "`].")]
                $Lidar(crate::lidar_vendors::$module::Model),
            )+
        }

        impl Model {
            /// All that can be decoded.
            pub fn all() -> Vec<Self> {
                let mut all = Vec::new();
                $(
                    all.extend(crate::lidar_vendors::$module::Model::ALL.into_iter().map(Self::$Lidar));
                )+
                all
            }

            /// How many lasers it has.
            pub fn lasers(self) -> usize {
                match self {
                    $(
                        Self::$Lidar(model) => model.lasers(),
                    )+
                }
            }
        }

        impl std::fmt::Display for Model {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                match self {
                    $(
                        Self::$Lidar(model) => model.fmt(f),
                    )+
                }
            }
        }

        enum Unit {
            $(
                $Lidar(Box<crate::lidar_vendors::$module::Decoder>),
            )+
        }

        impl Unit {
            /// The decoder of whoever sends such packets.
            fn recognise(bytes: &[u8], settings: &Settings) -> Option<Self> {
                $(
                    if crate::lidar_vendors::$module::recognise(bytes) {
                        let model = match settings.model {
                            Some(Model::$Lidar(model)) => Ok(Some(model)),
                            None => Ok(None),
                            Some(other) => Err(other),
                        };
                        let config = crate::lidar_vendors::$module::DecoderConfig::new(model.ok()?, &settings.scans);
                        let decoder = crate::lidar_vendors::$module::Decoder::new(config);
                        return Some(Self::$Lidar(Box::new(decoder)));
                    }
                )+
                None
            }

            fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<LidarScan>>, DecodeError> {
                match self {
                    $(
                        Self::$Lidar(decoder) => decoder.push(packet).map_err(|error| match error {
                            crate::lidar_vendors::$module::DecodeError::Wire(error) => DecodeError::Wire(error),
                            error => DecodeError::$Lidar(error),
                        }),
                    )+
                }
            }

            fn ready(&mut self) -> Option<Decoded<LidarScan>> {
                match self {
                    $(
                        Self::$Lidar(decoder) => decoder.ready(),
                    )+
                }
            }

            fn finish(&mut self) -> Option<Decoded<LidarScan>> {
                match self {
                    $(
                        Self::$Lidar(decoder) => decoder.finish(),
                    )+
                }
            }

            fn counters(&self) -> &Counters {
                match self {
                    $(
                        Self::$Lidar(decoder) => decoder.counters(),
                    )+
                }
            }

            fn found(&self) -> Option<Found<Model>> {
                match self {
                    $(
                        Self::$Lidar(decoder) => decoder.found().map(|found| Found {
                            model: Model::$Lidar(found.model),
                            returns: found.returns,
                            rpm: found.rpm,
                        }),
                    )+
                }
            }

            /// Whether a datagram is one of its data packets, good or bad.
            fn recognises(&self, bytes: &[u8]) -> bool {
                match self {
                    $(
                        Self::$Lidar(_) => crate::lidar_vendors::$module::recognise(bytes),
                    )+
                }
            }

            fn position(&self, bytes: &[u8], arrival: Timestamp) -> Option<Result<Position, WireError>> {
                match self {
                    $(
                        Self::$Lidar(_) => crate::lidar_vendors::$module::position(bytes, arrival),
                    )+
                }
            }
        }

        /// Whether a datagram is one beside the data that is recorded and not read, whichever LiDAR's it is.
        fn is_beside(bytes: &[u8]) -> bool {
            $(
                if crate::lidar_vendors::$module::is_beside(bytes) {
                    return true;
                }
            )+
            false
        }

        /// Ports of data packets and of those beside them, as the sensors leave the factory.
        const FACTORY_PORTS: &[[u16; 2]] = &[
            $(
                crate::lidar_vendors::$module::FACTORY_PORTS,
            )+
        ];

        /// The page on which sensors of a model are set; where it is not known, that of the first LiDAR in the list that has one.
        pub fn page_of(model: Option<Model>) -> Option<Page> {
            $(
                if let (None | Some(Model::$Lidar(_)), Some(page)) = (model, crate::lidar_vendors::$module::PAGE) {
                    return Some(page);
                }
            )+
            None
        }

        /// Time of a data packet past the sensor's hour, nanoseconds; `None` where it is no data packet of a known LiDAR.
        pub fn device_ns(bytes: &[u8]) -> Option<i64> {
            $(
                if let Some(time_ns) = crate::lidar_vendors::$module::device_ns(bytes) {
                    return Some(time_ns);
                }
            )+
            None
        }

        /// Who makes the LiDAR that sends such data packets.
        fn maker(bytes: &[u8]) -> Option<&'static str> {
            $(
                if crate::lidar_vendors::$module::recognise(bytes) {
                    return Some(stringify!($Lidar));
                }
            )+
            None
        }

        /// Data packets without a return, one of each model and way of sending echoes: what simulators and tests begin with.
        pub fn blank_packets() -> Vec<(Model, Vec<u8>)> {
            let mut all = Vec::new();
            $(
                let blank = crate::lidar_vendors::$module::blank_packets();
                all.extend(blank.into_iter().map(|(model, bytes)| (Model::$Lidar(model), bytes)));
            )+
            all
        }

        /// What a packet beside the data says, whichever LiDAR's it is; `None` where it is none.
        fn any_position(bytes: &[u8], arrival: Timestamp) -> Option<Result<Position, WireError>> {
            $(
                if let Some(position) = crate::lidar_vendors::$module::position(bytes, arrival) {
                    return Some(position);
                }
            )+
            None
        }
    };
}

each_lidar!(lidars);

/// Ports of data packets and of those beside them, unless told otherwise: those of the first LiDAR in the list.
pub const DEFAULT_PORTS: [u16; 2] = FACTORY_PORTS[0];

/// UDP ports to which LiDARs send unless told otherwise, each once.
pub fn factory_ports() -> Vec<u16> {
    let mut ports = Vec::new();
    for port in FACTORY_PORTS.iter().flatten() {
        if !ports.contains(port) {
            ports.push(*port);
        }
    }
    ports
}

/// Whose a datagram seems to be, decoded here or not.
pub fn whose(bytes: &[u8]) -> Option<&'static str> {
    looks_like(bytes).or_else(|| maker(bytes))
}

/// Whether a datagram is one beside the data, whichever LiDAR's: about its clock, or recorded and not read.
pub fn is_beside_data(bytes: &[u8]) -> bool {
    is_beside(bytes) || any_position(bytes, Timestamp::default()).is_some()
}

/// Whether a datagram is one that a LiDAR sends, by its content and not by its length alone.
pub fn is_of_a_lidar(bytes: &[u8]) -> bool {
    device_ns(bytes).is_some()
        || is_beside(bytes)
        || matches!(any_position(bytes, Timestamp::default()), Some(Ok(_)))
}

impl Model {
    /// Its name in settings: `vlp-32c`, `xt32`.
    pub fn key(self) -> String {
        self.to_string().to_lowercase().replace(' ', "-")
    }

    /// The names of all, as a message lists them.
    pub fn keys() -> String {
        let keys: Vec<String> = Self::all().into_iter().map(Self::key).collect();
        keys.join(", ")
    }

    /// The model of that name; case, blanks and dashes do not matter.
    pub fn from_key(key: &str) -> Option<Self> {
        let plain = |text: &str| text.to_lowercase().replace([' ', '-', '_'], "");
        Self::all()
            .into_iter()
            .find(|model| plain(&model.key()) == plain(key))
    }
}

/// Turns the packets of one sensor into scans, whichever sensor it is: the first data packet decides.
///
/// `device_ticks` of a scan are nanoseconds since the top of the sensor's hour at its first firing.
pub struct Decoder {
    settings: Settings,
    unit: Option<Unit>,
    refused: Counters,
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            unit: None,
            refused: Counters::default(),
        }
    }

    /// Takes one data packet and returns a scan where one is complete.
    pub fn push(&mut self, packet: &Packet) -> Result<Option<Decoded<LidarScan>>, DecodeError> {
        if self.unit.is_none() {
            self.unit = Unit::recognise(&packet.bytes, &self.settings);
        }
        match &mut self.unit {
            Some(unit) => unit.push(packet),
            None => {
                self.refused.refused += 1;
                let bytes = packet.bytes.len();
                Err(match (looks_like(&packet.bytes), self.settings.model) {
                    (_, Some(expected)) if maker(&packet.bytes).is_some() => {
                        DecodeError::WrongSensor { expected }
                    }
                    (Some(name), _) => DecodeError::LooksLike { name, bytes },
                    (None, _) => DecodeError::Unknown { bytes },
                })
            }
        }
    }

    /// Another scan that the last packet completed: one that ends two of them returns the first.
    pub fn ready(&mut self) -> Option<Decoded<LidarScan>> {
        self.unit.as_mut()?.ready()
    }

    /// Ends the stream: what is left, one scan per call, until `None`.
    pub fn finish(&mut self) -> Option<Decoded<LidarScan>> {
        self.unit.as_mut()?.finish()
    }

    /// What was seen so far.
    pub fn counters(&self) -> &Counters {
        self.unit.as_ref().map_or(&self.refused, Unit::counters)
    }

    /// What the sensor turned out to be; `None` before its first data packet.
    pub fn found(&self) -> Option<Found<Model>> {
        self.unit.as_ref()?.found()
    }

    /// Whether a datagram is a data packet, good or bad: of its sensor where that is known already.
    pub fn is_data(&self, bytes: &[u8]) -> bool {
        match &self.unit {
            Some(unit) => unit.recognises(bytes),
            None => maker(bytes).is_some(),
        }
    }

    /// Whether a datagram is one beside the data that is recorded and not read.
    pub fn is_beside(&self, bytes: &[u8]) -> bool {
        is_beside(bytes)
    }

    /// What a packet beside the data says; `None` where it is no such packet of this sensor.
    pub fn position(
        &self,
        bytes: &[u8],
        arrival: Timestamp,
    ) -> Option<Result<Position, WireError>> {
        match &self.unit {
            Some(unit) => unit.position(bytes, arrival),
            None => any_position(bytes, arrival),
        }
    }
}

#[cfg(test)]
mod tests;
