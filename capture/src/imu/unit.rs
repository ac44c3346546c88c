//! The families of inertial units, behind one face: what opens them, and what makes readings of their packets.

use std::time::Duration;

use lsfb_drivers::microstrain::{self, MipConfig, MipImu};
use lsfb_drivers::mynt_d::{self, MyntDConfig, MyntDImu, MyntDReading};
use lsfb_drivers::sbg::{self, SbgConfig, SbgImu};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::xsens::model::SAMPLE_TIME_FINE_NS;
use lsfb_drivers::xsens::{self, ImuConfig, XsensImu};
use lsfb_drivers::{Decoded, Error, ImuFamily};
use lsfb_types::{ImuSample, Packet, Timestamp};

use crate::config::ImuLineConfig;

/// `SampleTimeFine` of Xsens units wraps at 2³² ticks.
const XSENS_PERIOD_TICKS: i64 = 1 << 32;

/// What the counter of a family means. A period of 0: the decoder continues it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counter {
    pub(super) tick_ns: u64,
    pub(super) period_ticks: i64,
}

impl Counter {
    /// Of the units of a family.
    pub(super) fn of(family: ImuFamily) -> Self {
        let (tick_ns, period_ticks) = match family {
            ImuFamily::Xsens => (SAMPLE_TIME_FINE_NS, XSENS_PERIOD_TICKS),
            ImuFamily::Microstrain => (1, 0),
            ImuFamily::Sbg => (1_000, 0),
            ImuFamily::MyntD => (mynt_d::model::TICK_NS, 0),
        };
        Self {
            tick_ns,
            period_ticks,
        }
    }
}

/// An open unit.
#[derive(Debug)]
pub(crate) enum ImuUnit {
    Xsens(XsensImu),
    Microstrain(MipImu),
    Sbg(SbgImu),
    MyntD(MyntDImu),
}

impl ImuUnit {
    pub(crate) fn open(config: &ImuLineConfig) -> Result<Self, Error> {
        let path = config.path.clone();
        let (baud, rate_hz) = (config.baud, config.rate_hz);
        Ok(match config.family {
            ImuFamily::Xsens => Self::Xsens(XsensImu::open(&ImuConfig {
                path,
                baud,
                rate_hz,
            })?),
            ImuFamily::Microstrain => Self::Microstrain(MipImu::open(&MipConfig {
                path,
                baud,
                rate_hz,
            })?),
            ImuFamily::Sbg => Self::Sbg(SbgImu::open(&SbgConfig {
                interface: path.to_string_lossy().into_owned(),
            })?),
            ImuFamily::MyntD => Self::MyntD(MyntDImu::open(&MyntDConfig { path })?),
        })
    }

    pub(super) fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        match self {
            Self::Xsens(unit) => unit.recv(timeout),
            Self::Microstrain(unit) => unit.recv(timeout),
            Self::Sbg(unit) => unit.recv(timeout),
            Self::MyntD(unit) => unit.recv(timeout),
        }
    }

    /// What the kernel dropped because nobody took it; only a bus is told.
    pub(super) fn kernel_drops(&self) -> u64 {
        match self {
            Self::Sbg(unit) => unit.kernel_drops(),
            Self::Xsens(_) | Self::Microstrain(_) | Self::MyntD(_) => 0,
        }
    }
}

/// What a unit said at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub(super) arrival: Timestamp,
    pub(super) device_ticks: u64,
    pub(super) sample: Option<ImuSample>,
    /// UTC, where the unit knows it for certain.
    pub(super) utc: Option<Timestamp>,
    pub(super) temperature_celsius: Option<f64>,
}

/// What has gone wrong so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    pub(super) bad: u64,
    pub(super) missing: u64,
    pub(super) duplicated: u64,
    /// Counts that are worth a word at the end, and the word.
    pub(super) remarks: Vec<(u64, &'static str)>,
}

/// Packets in, readings out.
#[derive(Debug)]
pub(super) enum ImuDecoder {
    Xsens(xsens::Decoder),
    Microstrain(microstrain::Decoder),
    Sbg(sbg::Decoder),
    MyntD(mynt_d::Decoder),
}

impl ImuDecoder {
    pub(super) fn new(family: ImuFamily) -> Self {
        match family {
            ImuFamily::Xsens => Self::Xsens(xsens::Decoder::new(xsens::DecoderConfig::default())),
            ImuFamily::Microstrain => Self::Microstrain(microstrain::Decoder::new()),
            ImuFamily::Sbg => Self::Sbg(sbg::Decoder::new()),
            ImuFamily::MyntD => Self::MyntD(mynt_d::Decoder::new()),
        }
    }

    /// Packets that cannot be read are counted.
    pub(super) fn push(&mut self, packet: &Packet) -> Vec<Reading> {
        match self {
            Self::Xsens(decoder) => {
                decoder.push(packet);
                std::iter::from_fn(|| decoder.next_reading())
                    .map(of_xsens)
                    .collect()
            }
            Self::Microstrain(decoder) => {
                decoder.push(packet);
                std::iter::from_fn(|| decoder.next_reading())
                    .map(of_microstrain)
                    .collect()
            }
            Self::Sbg(decoder) => {
                let reading = decoder.push(packet).ok().flatten();
                reading.into_iter().map(of_sbg).collect()
            }
            Self::MyntD(decoder) => {
                // The readings before a damaged part are good.
                let _ = decoder.push(packet);
                let mut readings = Vec::new();
                while let Some(reading) = decoder.next_reading() {
                    if let MyntDReading::Imu(sample) = reading.sample {
                        let celsius = decoder.temperature_celsius();
                        readings.push(with(&reading, Some(sample), None, celsius));
                    }
                }
                readings
            }
        }
    }

    /// What is left at the end of the stream.
    pub(super) fn finish(&mut self) -> Vec<Reading> {
        match self {
            Self::Xsens(decoder) => decoder.finish().into_iter().map(of_xsens).collect(),
            Self::Microstrain(decoder) => {
                decoder.finish().into_iter().map(of_microstrain).collect()
            }
            Self::Sbg(decoder) => {
                decoder.finish();
                Vec::new()
            }
            Self::MyntD(_) => Vec::new(),
        }
    }

    pub(super) fn tally(&self) -> Tally {
        const STRAY_BYTES: &str = "bytes outside of any message";
        match self {
            Self::Xsens(decoder) => {
                let counters = decoder.counters();
                Tally {
                    bad: counters.bad_checksums + counters.bad_items,
                    missing: counters.missing,
                    duplicated: counters.duplicated,
                    remarks: vec![
                        (counters.skipped_bytes, STRAY_BYTES),
                        (counters.device_errors, "errors reported by the unit"),
                    ],
                }
            }
            Self::Microstrain(decoder) => {
                let counters = decoder.counters();
                Tally {
                    bad: counters.bad_checksums + counters.bad_fields,
                    missing: counters.missing,
                    duplicated: counters.duplicated,
                    remarks: vec![(counters.skipped_bytes, STRAY_BYTES)],
                }
            }
            Self::Sbg(decoder) => {
                let counters = decoder.counters();
                Tally {
                    bad: counters.malformed + counters.stray,
                    missing: counters.missing + counters.incomplete,
                    duplicated: 0,
                    remarks: vec![
                        (counters.bus_errors, "errors of the bus"),
                        (counters.foreign, "frames of other devices on the bus"),
                    ],
                }
            }
            Self::MyntD(decoder) => {
                let counters = decoder.counters();
                Tally {
                    bad: counters.bad_reports,
                    missing: counters.missing,
                    duplicated: counters.duplicated,
                    remarks: vec![(
                        counters.unpaired,
                        "gyroscope readings without an accelerometer reading",
                    )],
                }
            }
        }
    }
}

fn of_xsens(decoded: Decoded<xsens::ImuReading>) -> Reading {
    let reading = &decoded.sample;
    let utc = reading.utc_ns.map(Timestamp::from_nanos);
    with(&decoded, reading.sample, utc, reading.temperature_celsius)
}

fn of_microstrain(decoded: Decoded<microstrain::MipReading>) -> Reading {
    with(&decoded, decoded.sample.sample, None, None)
}

fn of_sbg(decoded: Decoded<sbg::SbgReading>) -> Reading {
    let reading = &decoded.sample;
    with(
        &decoded,
        Some(reading.sample),
        // The unit sends a date whether or not it has one from a satellite.
        None,
        Some(reading.temperature_celsius),
    )
}

fn with<T>(
    decoded: &Decoded<T>,
    sample: Option<ImuSample>,
    utc: Option<Timestamp>,
    temperature_celsius: Option<f64>,
) -> Reading {
    Reading {
        arrival: decoded.arrival,
        device_ticks: decoded.device_ticks,
        sample,
        utc,
        temperature_celsius,
    }
}
