//! A LiDAR's position packets: what it knows of the time, and the last sentence of its receiver.

use lsfb_drivers::velodyne::nmea::{Gga, Rmc};
use lsfb_drivers::velodyne::wire::{POSITION_PACKET_LEN, PositionPacket, PpsStatus};
use lsfb_drivers::xsens::wire::UtcTime;
use lsfb_types::Timestamp;

use crate::ambient::{GnssEpoch, course_deg};
use crate::config::{NmeaSentence, PulseSource};
use crate::timing::{Clocked, Discipline};
use crate::{Error, Geodetic, RigSim};

/// A GPS receiver's sentence names the second that has begun, and is complete this long after its pulse.
const SENTENCE_DELAY_NS: i64 = 300_000_000;
const SECOND_NS: i64 = 1_000_000_000;
const HOUR_US: i64 = 3_600_000_000;
/// A pulse that comes back is trusted after this many seconds (VLP-32C 63-9325, appendix G: the factory's setting).
const QUALIFIED_S: usize = 5;
/// Arc minutes times 10⁵ in a degree.
const E5_MIN_PER_DEG: f64 = 6_000_000.0;
/// Knots times 1000 in a metre per second.
const E3_KNOTS_PER_M_S: f64 = 1_943.844;
/// Height of the geoid above the ellipsoid that the receiver knows, mm: that of Munich.
const GEOID_MM: i64 = 46_000;

pub(super) fn top_of_hour_us(time: Timestamp) -> u32 {
    // The counter is truncated, as the sensor does.
    time.nanos().div_euclid(1000).rem_euclid(HOUR_US) as u32
}

/// The packet that is sent `offset_ns` after the beginning.
pub(super) fn position_packet(
    rig: &RigSim,
    offset_ns: i64,
) -> Result<[u8; POSITION_PACKET_LEN], Error> {
    let clock = rig.clocks().of(Clocked::Lidar);
    let mut packet = PositionPacket::init([0; POSITION_PACKET_LEN])?;
    packet.set_temperatures_celsius(46, 41, 24);
    let device = Timestamp::from_nanos(clock.device_ns(offset_ns));
    packet.set_timestamp_us(top_of_hour_us(device));
    if clock.discipline() == Discipline::Free {
        packet.set_pps_status(PpsStatus::Absent);
        return Ok(packet.into_inner());
    }
    let heard_ns = (offset_ns - SENTENCE_DELAY_NS).div_euclid(SECOND_NS) * SECOND_NS;
    packet.set_pps_status(pulse(rig, offset_ns.div_euclid(SECOND_NS)));
    let sentence = match rig.time_feed().sentence {
        NmeaSentence::Rmc => rmc(rig, heard_ns).map(|s| s.emit()),
        NmeaSentence::Gga => gga(rig, heard_ns).map(|s| s.emit()),
    };
    if let Some(sentence) = sentence {
        packet.set_nmea(sentence.as_bytes())?;
    }
    Ok(packet.into_inner())
}

/// What the receiver said in a second; before the beginning what it says at it.
fn epoch(rig: &RigSim, second: i64) -> Option<&GnssEpoch> {
    let epochs = &rig.time_feed().epochs;
    epochs.get(
        usize::try_from(second)
            .unwrap_or(0)
            .min(epochs.len().saturating_sub(1)),
    )
}

fn has_fix(rig: &RigSim, second: i64) -> bool {
    epoch(rig, second).is_some_and(|e| e.reading.fix.is_some())
}

/// Whether the LiDAR's second follows the pulse.
fn pulse(rig: &RigSim, second: i64) -> PpsStatus {
    if rig.time_feed().pulse == PulseSource::SyncBoard {
        return PpsStatus::Locked;
    }
    let fixes = |from: i64| (from.max(0)..=second).all(|s| has_fix(rig, s));
    let since_qualified = second - QUALIFIED_S as i64;
    match has_fix(rig, second) {
        // One that was there before the recording began is trusted from its beginning.
        true if fixes(since_qualified) => PpsStatus::Locked,
        true => PpsStatus::Synchronizing,
        false if (0..second).any(|s| has_fix(rig, s)) => PpsStatus::Error,
        false => PpsStatus::Absent,
    }
}

/// Where the sentence of a second says that the receiver is, and whether that is a fix.
fn place(rig: &RigSim, second: i64) -> Option<Geodetic> {
    let geodetic = |e: &GnssEpoch| {
        e.reading.fix.map(|fix| Geodetic {
            latitude_deg: fix.latitude_deg,
            longitude_deg: fix.longitude_deg,
            altitude_m: fix.altitude_m,
        })
    };
    let feed = rig.time_feed();
    match feed.pulse {
        PulseSource::Receiver => epoch(rig, second).and_then(geodetic),
        // The board repeats the last position that it was given, at first that of the site.
        PulseSource::SyncBoard => {
            let until = usize::try_from(second + 1)
                .unwrap_or(0)
                .min(feed.epochs.len());
            let last = feed.epochs[..until].iter().rev().find_map(geodetic);
            Some(last.unwrap_or(feed.home))
        }
    }
}

fn e5_min(degrees: f64) -> i64 {
    (degrees * E5_MIN_PER_DEG).round() as i64
}

fn rmc(rig: &RigSim, heard_ns: i64) -> Option<Rmc> {
    let utc = UtcTime::from_unix_nanos(rig.time(heard_ns).nanos())?;
    let second = heard_ns.div_euclid(SECOND_NS);
    let place = place(rig, second);
    let velocity = match has_fix(rig, second) {
        true => rig.walk().at(heard_ns as f64 * 1e-9).velocity_m_s,
        false => Default::default(),
    };
    let speed_m_s = velocity.xy().norm();
    // A receiver that stands knows no course.
    let course = if speed_m_s > 0.3 {
        course_deg(velocity)
    } else {
        0.0
    };
    Some(Rmc {
        hour: utc.hour,
        minute: utc.minute,
        second: utc.second,
        millis: 0,
        valid: place.is_some(),
        latitude_e5_min: place.map(|p| e5_min(p.latitude_deg)),
        longitude_e5_min: place.map(|p| e5_min(p.longitude_deg)),
        speed_e3_knots: place.map(|_| (speed_m_s * E3_KNOTS_PER_M_S).round() as u32),
        course_e3_deg: place.map(|_| (1e3 * course).round() as u32 % 360_000),
        day: utc.day,
        month: utc.month,
        year: utc.year,
        mode: Some(if place.is_some() { 'A' } else { 'N' }),
    })
}

fn gga(rig: &RigSim, heard_ns: i64) -> Option<Gga> {
    let utc = UtcTime::from_unix_nanos(rig.time(heard_ns).nanos())?;
    let second = heard_ns.div_euclid(SECOND_NS);
    let place = place(rig, second);
    let satellites = epoch(rig, second).map_or(0, |e| e.satellites);
    Some(Gga {
        hour: utc.hour,
        minute: utc.minute,
        second: utc.second,
        millis: 0,
        latitude_e5_min: place.map(|p| e5_min(p.latitude_deg)),
        longitude_e5_min: place.map(|p| e5_min(p.longitude_deg)),
        quality: u8::from(place.is_some()),
        satellites: u8::try_from(satellites).ok(),
        hdop_e2: None,
        altitude_mm: place.map(|p| (1e3 * p.altitude_m).round() as i64 - GEOID_MM),
        geoid_mm: Some(GEOID_MM),
    })
}

#[cfg(test)]
mod tests;
