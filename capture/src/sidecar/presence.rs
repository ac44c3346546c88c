//! Which devices are there, which said goodbye, and which are gone.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// All that ever came.
#[derive(Debug, Default)]
pub(super) struct Presence(BTreeMap<String, DeviceState>);

#[derive(Debug)]
enum DeviceState {
    There { connection: u64 },
    SaidGoodbye,
    Gone { since: Instant, why: String },
}

impl Presence {
    /// A device is there. What an operator should know: that it was gone.
    pub(super) fn come(&mut self, device: &str, connection: u64) -> Option<String> {
        let there = DeviceState::There { connection };
        match self.0.insert(device.to_owned(), there) {
            Some(DeviceState::Gone { since, why }) => {
                let secs = since.elapsed().as_secs_f64();
                Some(format!("{device}: disconnected for {secs:.1} s ({why})"))
            }
            _ => None,
        }
    }

    /// Its connection is over; one that was replaced says nothing.
    pub(super) fn leave(&mut self, device: &str, connection: u64, why: Option<String>) {
        let Some(known) = self.0.get_mut(device) else {
            return;
        };
        if !matches!(known, DeviceState::There { connection: own } if *own == connection) {
            return;
        }
        *known = match why {
            None => DeviceState::SaidGoodbye,
            Some(why) => DeviceState::Gone {
                since: Instant::now(),
                why,
            },
        };
    }

    /// Whether somebody came and nobody is there.
    pub(super) fn is_all_gone(&self) -> bool {
        let is_there = |w: &DeviceState| matches!(w, DeviceState::There { .. });
        !self.0.is_empty() && !self.0.values().any(is_there)
    }

    /// Whether everybody who is gone has been for so long.
    pub(super) fn gave_up(&self, come_back: Duration) -> bool {
        self.gone().all(|(_, since, _)| since.elapsed() > come_back)
    }

    /// Who is gone, for every screen; `None`: nobody.
    pub(super) fn sentence(&self) -> Option<String> {
        let words: Vec<String> = self
            .gone()
            .map(|(device, since, _)| format!("{device}, {} s ago", since.elapsed().as_secs()))
            .collect();
        (!words.is_empty()).then(|| format!("PHONE DISCONNECTED: {}", words.join("; ")))
    }

    /// Why the first of those who are gone is.
    pub(super) fn lost(&self) -> Option<String> {
        let (device, since, why) = self.gone().next()?;
        let secs = since.elapsed().as_secs();
        Some(format!(
            "{device} has been disconnected for {secs} s: {why}"
        ))
    }

    fn gone(&self) -> impl Iterator<Item = (&String, &Instant, &String)> {
        self.0.iter().filter_map(|(device, known)| match known {
            DeviceState::Gone { since, why } => Some((device, since, why)),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_gone_is_said_until_it_is_back() {
        let mut presence = Presence::default();
        assert!(!presence.is_all_gone() && presence.sentence().is_none());
        assert_eq!(presence.come("phone", 1), None);
        assert_eq!(presence.come("visor", 2), None);
        presence.leave("visor", 2, None);
        assert!(!presence.is_all_gone());
        // It has connected again before the old connection was found to be dead.
        assert_eq!(presence.come("phone", 3), None);
        presence.leave("phone", 1, Some("lost".to_owned()));
        assert!(!presence.is_all_gone() && presence.sentence().is_none());
        presence.leave("phone", 3, Some("lost".to_owned()));
        assert!(presence.is_all_gone());
        assert_eq!(
            presence.sentence().as_deref(),
            Some("PHONE DISCONNECTED: phone, 0 s ago")
        );
        assert!(!presence.gave_up(Duration::from_secs(60)) && presence.gave_up(Duration::ZERO));
        assert!(presence.lost().unwrap().contains("phone"));
        assert!(
            presence
                .come("phone", 4)
                .unwrap()
                .contains("disconnected for")
        );
        assert!(presence.sentence().is_none() && presence.lost().is_none());
    }
}
