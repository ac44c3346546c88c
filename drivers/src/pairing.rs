//! Accelerometer and gyroscope that sample in turn, each with stamps of its own, into samples of both.

use std::collections::VecDeque;

use lsfb_types::{ImuSample, Timestamp};

use crate::Decoded;

/// Gyroscope readings that may wait for the accelerometer's next one: a second's worth.
const MAX_WAITING: usize = 500;

/// One reading of one sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    pub(crate) arrival: Timestamp,
    pub(crate) ticks: u64,
    /// SI units.
    pub(crate) xyz: [f64; 3],
}

/// Interpolates the specific force at the gyroscope's stamps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pairing {
    specific_force: Option<Reading>,
    waiting: VecDeque<Reading>,
    unpaired: u64,
}

impl Pairing {
    /// Gyroscope readings given up because no accelerometer reading stands on both sides of them.
    pub(crate) fn unpaired(&self) -> u64 {
        self.unpaired
    }

    pub(crate) fn push_angular_velocity(&mut self, reading: Reading) {
        if self.waiting.len() == MAX_WAITING {
            self.waiting.pop_front();
            self.unpaired += 1;
        }
        self.waiting.push_back(reading);
    }

    pub(crate) fn push_specific_force(
        &mut self,
        after: Reading,
        samples: &mut Vec<Decoded<ImuSample>>,
    ) {
        let before = self.specific_force.replace(after);
        while let Some(gyro) = self.waiting.front().copied() {
            if gyro.ticks > after.ticks {
                return;
            }
            self.waiting.pop_front();
            let Some(before) = before.filter(|before| before.ticks <= gyro.ticks) else {
                // Before the first accelerometer reading there is nothing to interpolate from.
                self.unpaired += 1;
                continue;
            };
            samples.push(Decoded {
                arrival: gyro.arrival,
                device_ticks: gyro.ticks,
                sample: ImuSample {
                    angular_velocity_rad_s: gyro.xyz,
                    specific_force_m_s2: interpolate(before, after, gyro.ticks),
                },
            });
        }
    }
}

fn interpolate(before: Reading, after: Reading, at: u64) -> [f64; 3] {
    let span = after.ticks.saturating_sub(before.ticks);
    if span == 0 {
        return after.xyz;
    }
    let weight = at.saturating_sub(before.ticks) as f64 / span as f64;
    std::array::from_fn(|i| before.xyz[i] + weight * (after.xyz[i] - before.xyz[i]))
}
