//! From a device to its host: when what was sent arrives.

use lsfb_types::{Bounds, OutOfBounds};
use serde::{Deserialize, Serialize};

use crate::noise::{hash, unit};

/// A link's latency changes this often: what is sent within it goes the same way.
const LATENCY_NS: i64 = 5_000_000;

/// How long messages are under way.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinkConfig {
    /// Shortest time from measurement to arrival, seconds.
    pub delay_s: f64,
    /// How far arrival varies to either side of its mean, seconds: delays are spread evenly from the shortest to the
    /// shortest and twice this.
    pub jitter_s: f64,
    /// Messages that are sent together, when the last of them is ready.
    pub batch: u32,
    /// How long nothing comes through in a stall, seconds; what was sent meanwhile comes at its end.
    pub stall_s: f64,
    /// Mean time between stalls, seconds; 0 for none.
    pub stall_every_s: f64,
}

impl Default for LinkConfig {
    fn default() -> Self {
        Self {
            delay_s: 0.0,
            jitter_s: 0.0,
            batch: 1,
            stall_s: 0.0,
            stall_every_s: 0.0,
        }
    }
}

lsfb_types::bounds! {
    LinkConfig {
        delay_s: number(Bounds::Within(0.0, 10.0)),
        jitter_s: number(Bounds::Within(0.0, 10.0)),
        batch: number(Bounds::Within(1.0, 4096.0)),
        stall_s: number(Bounds::Within(0.0, 60.0)),
        stall_every_s: number(Bounds::Within(0.0, 1e6)),
    }
    also stalls_end
}

impl LinkConfig {
    fn stalls_end(&self, section: &str) -> Result<(), OutOfBounds> {
        if self.stall_every_s == 0.0 || self.stall_every_s > 2.0 * self.stall_s {
            return Ok(());
        }
        let bounds = "0, or more than twice as long as stall_s";
        let every_s = &self.stall_every_s;
        Err(OutOfBounds::new(section, "stall_every_s", every_s, &bounds))
    }
}

/// A link that keeps messages in their order.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    config: LinkConfig,
    seed: u64,
}

impl Link {
    pub(super) fn new(config: &LinkConfig, seed: u64) -> Self {
        Self {
            config: *config,
            seed,
        }
    }

    /// Messages that are sent together.
    pub fn batch(&self) -> usize {
        self.config.batch.max(1) as usize
    }

    /// When messages arrive that are ready at these times, which do not fall; nanoseconds after the beginning.
    pub fn arrivals(&self, ready_ns: &[i64]) -> Vec<i64> {
        let mut arrivals = Vec::with_capacity(ready_ns.len());
        let mut last = i64::MIN;
        for batch in ready_ns.chunks(self.batch()) {
            if let Some(sent) = batch.last() {
                last = last.max(self.through(*sent));
            }
            arrivals.extend(batch.iter().map(|_| last));
        }
        arrivals
    }

    /// When something arrives that is sent alone.
    fn through(&self, sent_ns: i64) -> i64 {
        let LinkConfig {
            delay_s,
            jitter_s,
            stall_s,
            stall_every_s,
            ..
        } = self.config;
        let moment = sent_ns.div_euclid(LATENCY_NS).cast_unsigned();
        let late = 2.0 * jitter_s * unit(hash(self.seed ^ hash(moment)));
        let arrival = sent_ns + (1e9 * (delay_s + late)) as i64;
        if stall_every_s == 0.0 || stall_s == 0.0 {
            return arrival;
        }
        // One stall in each stretch, anywhere in it.
        let every_ns = (1e9 * stall_every_s) as i64;
        let stall_ns = (1e9 * stall_s) as i64;
        let stretch = arrival.div_euclid(every_ns);
        let draw = unit(hash(!self.seed ^ hash(stretch.cast_unsigned())));
        let begin = stretch * every_ns + (draw * (every_ns - stall_ns) as f64) as i64;
        if (begin..begin + stall_ns).contains(&arrival) {
            begin + stall_ns
        } else {
            arrival
        }
    }
}
