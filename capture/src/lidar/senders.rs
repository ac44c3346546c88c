//! Who else sends to a LiDAR's ports: counted by address and kept out, so that no stranger's packets come into a cloud.

use std::collections::BTreeMap;
use std::net::IpAddr;

/// Strangers that are told apart; what comes beyond is counted together.
const MOST_STRANGERS: usize = 16;

/// What came from elsewhere.
#[derive(Debug, Default)]
pub(super) struct Strangers {
    by_address: BTreeMap<IpAddr, Stranger>,
    more: u64,
    /// Packets that a LiDAR sends.
    of_lidars: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Stranger {
    packets: u64,
    of_a_lidar: u64,
}

impl Strangers {
    /// A packet of `sender` was kept out.
    pub(super) fn count(&mut self, sender: IpAddr, is_of_a_lidar: bool) {
        self.of_lidars += u64::from(is_of_a_lidar);
        if self.by_address.contains_key(&sender) || self.by_address.len() < MOST_STRANGERS {
            let stranger = self.by_address.entry(sender).or_default();
            stranger.packets += 1;
            stranger.of_a_lidar += u64::from(is_of_a_lidar);
        } else {
            self.more += 1;
        }
    }

    /// Packets of LiDARs among them.
    pub(super) fn of_lidars(&self) -> u64 {
        self.of_lidars
    }

    /// What is worth a word at the end.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        for (sender, stranger) in &self.by_address {
            let kept_out = format!("{} packets of {sender} were rejected", stranger.packets);
            remarks.push(if stranger.of_a_lidar > 0 {
                format!("{kept_out}: another LiDAR sends to the same port; configure the address of each LiDAR to record (`sensor`)")
            } else {
                format!("{kept_out}: it is not the sensor")
            });
        }
        if self.more > 0 {
            remarks.push(format!(
                "{} packets of further senders were rejected",
                self.more
            ));
        }
        remarks
    }
}
