//! How often one sender may upload.

use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use lsfb_web::network_of;

/// Uploads of one sender, and in which time.
const LIMITS: [(usize, Duration); 2] = [
    (6, Duration::from_secs(60)),
    (60, Duration::from_secs(3600)),
];
/// Senders that are remembered; more at once are refused.
const MOST_SENDERS: usize = 4096;

/// Remembers who uploaded when.
#[derive(Default)]
pub struct RateLimit(Mutex<BTreeMap<IpAddr, VecDeque<Instant>>>);

impl RateLimit {
    /// Whether a sender may upload now; if so, it is counted.
    pub fn admits(&self, sender: IpAddr, now: Instant) -> bool {
        let Ok(mut senders) = self.0.lock() else {
            return false;
        };
        let [.., (_, longest)] = LIMITS;
        senders.retain(|_, times| times.back().is_some_and(|last| now - *last < longest));
        let sender = network_of(sender);
        if !senders.contains_key(&sender) && senders.len() >= MOST_SENDERS {
            return false;
        }
        let times = senders.entry(sender).or_default();
        times.retain(|time| now - *time < longest);
        let within = |(most, time): (usize, Duration)| {
            times.iter().filter(|t| now - **t < time).count() < most
        };
        let admitted = LIMITS.into_iter().all(within);
        if admitted {
            times.push_back(now);
        }
        admitted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sender_waits_and_others_do_not() {
        let limit = RateLimit::default();
        let began = Instant::now();
        let of = |text: &str| text.parse().expect("address");
        let at =
            |sender: &str, secs: u64| limit.admits(of(sender), began + Duration::from_secs(secs));
        assert!((0..6).all(|_| at("10.0.0.1", 0)));
        assert!(!at("10.0.0.1", 1) && at("10.0.0.2", 1));
        assert!(!at("::ffff:10.0.0.1", 2), "the same sender");
        assert!(at("10.0.0.1", 61));
        // One network, however many addresses it has.
        assert!((0..6).all(|i| at(&format!("2001:db8::{i}"), 61)));
        assert!(!at("2001:db8::99", 62) && at("2001:db8:0:1::1", 62));
        // No more than sixty an hour, however slowly.
        let in_time = (0..100).filter(|i| at("10.0.0.9", 70 + 20 * i)).count();
        assert_eq!(in_time, 60);
    }
}
