//! Who sends to a LiDAR's ports: one is the sensor, others are counted by address and kept out, so that two sensors never make
//! one cloud.

use std::collections::BTreeMap;
use std::net::IpAddr;

/// Strangers that are told apart; what comes beyond is counted together.
const MOST_STRANGERS: usize = 16;

/// The sensor's address, and what came from elsewhere.
#[derive(Debug, Default)]
pub(super) struct Senders {
    sensor: Option<IpAddr>,
    strangers: BTreeMap<IpAddr, Stranger>,
    more: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Stranger {
    packets: u64,
    /// Those that a LiDAR sends.
    of_a_lidar: u64,
}

impl Senders {
    /// With the sensor's address where that is configured; else the first that sends what a LiDAR sends is the sensor.
    pub(super) fn new(sensor: Option<IpAddr>) -> Self {
        Self {
            sensor,
            ..Self::default()
        }
    }

    /// Whether a packet is the sensor's. Packets without a sender are.
    pub(super) fn admits(&mut self, sender: Option<IpAddr>, is_of_a_lidar: bool) -> bool {
        let Some(sender) = sender else {
            return true;
        };
        match self.sensor {
            None => {
                if is_of_a_lidar {
                    self.sensor = Some(sender);
                }
                true
            }
            Some(sensor) if sensor == sender => true,
            Some(_) => {
                let is_known = self.strangers.contains_key(&sender);
                if is_known || self.strangers.len() < MOST_STRANGERS {
                    let stranger = self.strangers.entry(sender).or_default();
                    stranger.packets += 1;
                    stranger.of_a_lidar += u64::from(is_of_a_lidar);
                } else {
                    self.more += 1;
                }
                false
            }
        }
    }

    /// The sensor's address, where it is known.
    pub(super) fn sensor(&self) -> Option<IpAddr> {
        self.sensor
    }

    /// What is worth a word at the end.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        for (sender, stranger) in &self.strangers {
            let kept_out = format!("{} packets of {sender} were kept out", stranger.packets);
            remarks.push(if stranger.of_a_lidar > 0 {
                format!("{kept_out}: another LiDAR sends to the same port; give each a port of its own, or name the one that counts")
            } else {
                format!("{kept_out}: it is not the sensor")
            });
        }
        if self.more > 0 {
            remarks.push(format!(
                "{} packets of more senders were kept out",
                self.more
            ));
        }
        remarks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_lidar_is_the_sensor_and_others_are_counted() {
        let ip = |last: u8| Some(IpAddr::from([192, 168, 1, last]));
        let mut senders = Senders::new(None);
        assert!(senders.admits(ip(9), false), "nobody is known yet");
        assert!(senders.admits(ip(201), true));
        for _ in 0..3 {
            assert!(!senders.admits(ip(202), true));
            assert!(senders.admits(ip(201), false));
            assert!(senders.admits(None, true));
        }
        assert!(!senders.admits(ip(9), false));
        assert_eq!(senders.sensor(), ip(201));
        let remarks = senders.remarks().join("\n");
        assert!(
            remarks.contains("3 packets of 192.168.1.202 were kept out: another LiDAR"),
            "{remarks}"
        );
        assert!(
            remarks.contains("1 packets of 192.168.1.9 were kept out: it is not"),
            "{remarks}"
        );
        let mut configured = Senders::new(ip(202));
        assert!(!configured.admits(ip(201), true) && configured.admits(ip(202), true));
    }
}
