//! Inertial samples of a gyroscope and an accelerometer that are stamped each for itself.

use lsfb_types::ImuSample;

use super::collected::{Collected, StreamId, measured};
use super::payload::{Kind, Payload};
use super::stream::Record;

/// Between two samples of the accelerometer that lie further apart than this, nanoseconds, nothing is known: a fifth of a second.
const WIDEST_GAP_NS: i64 = 200_000_000;

impl Collected {
    /// Adds the stream `imu`: at each sample of the gyroscope the specific force, taken linearly between its neighbours. Samples of the
    /// gyroscope outside those of the accelerometer have none; they stay on their own topic alone, which is told.
    pub(super) fn combine(&mut self, gyro: StreamId, accel: StreamId) {
        let sorted = |collected: &mut Self, id: StreamId| {
            collected.streams.get_mut(id).map(|stream| {
                stream.put_in_order();
                stream.records.clone()
            })
        };
        let (Some(gyro), Some(accel)) = (sorted(self, gyro), sorted(self, accel)) else {
            return;
        };
        if gyro.is_empty() || accel.is_empty() {
            return;
        }
        let combined: Vec<Record> = gyro.iter().filter_map(|g| at(g, &accel)).collect();
        let alone = gyro.len() - combined.len();
        if alone > 0 {
            self.notes.push(format!(
                "imu: {alone} gyroscope samples have no accelerometer samples before and after: they are on the topic gyro only"
            ));
        }
        let imu = self.stream("gyroscope with accelerometer", "imu", Kind::Imu);
        if let Some(stream) = self.streams.get_mut(imu) {
            stream.derived = true;
            stream.records = combined;
        }
    }
}

/// A sample of both at that of the gyroscope.
fn at(gyro: &Record, accel: &[Record]) -> Option<Record> {
    let Payload::Vector(angular_velocity_rad_s) = gyro.payload else {
        return None;
    };
    let next = accel.partition_point(|a| a.time < gyro.time);
    let after = accel.get(next)?;
    let specific_force_m_s2 = match (after, next.checked_sub(1).and_then(|n| accel.get(n))) {
        (after, _) if after.time == gyro.time => vector(after)?,
        (after, Some(before)) if after.time - before.time <= WIDEST_GAP_NS => {
            let share = (gyro.time - before.time) as f64 / (after.time - before.time) as f64;
            let (a, b) = (vector(before)?, vector(after)?);
            std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]))
        }
        _ => return None,
    };
    let sample = ImuSample {
        angular_velocity_rad_s,
        specific_force_m_s2,
    };
    Some(measured(gyro.time.nanos(), Payload::Imu(sample)))
}

fn vector(record: &Record) -> Option<[f64; 3]> {
    match record.payload {
        Payload::Vector(vector) => Some(vector),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specific_force_is_taken_between_its_neighbours_and_nowhere_else() {
        let mut collected = Collected::default();
        let gyro = collected.stream("gyro", "gyro", Kind::Vector);
        let accel = collected.stream("accel", "accel", Kind::Vector);
        let mut put = |stream, ms: i64, x: f64| {
            let record = measured(ms * 1_000_000, Payload::Vector([x, 0.0, 0.0]));
            collected.take(stream, String::new, Ok(record));
        };
        for ms in [5, 15, 30, 500, 990] {
            put(gyro, ms, 1.0);
        }
        for (ms, x) in [(10, 2.0), (20, 4.0), (30, 8.0), (980, 1.0), (985, 1.0)] {
            put(accel, ms, x);
        }
        collected.combine(gyro, accel);
        let imu = collected.streams.last().expect("a stream");
        let found: Vec<(i64, f64)> = imu
            .records
            .iter()
            .map(|r| match r.payload {
                Payload::Imu(sample) => (r.time.nanos() / 1_000_000, sample.specific_force_m_s2[0]),
                _ => panic!("an inertial sample"),
            })
            .collect();
        // Before the first, in a gap of a second, and behind the last there is none.
        assert_eq!(found, [(15, 3.0), (30, 8.0)]);
        assert!(
            collected.notes[0].contains("3 gyroscope samples"),
            "{:?}",
            collected.notes
        );
    }
}
