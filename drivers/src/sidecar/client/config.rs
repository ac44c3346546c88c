//! Whom an app talks to, who it is, and how much may be under way.

use std::net::SocketAddr;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::Error;
use crate::sidecar::credentials::{DeviceKey, Fingerprint, PairingCode, PairingToken};

/// Where the rig is, who we are, and how much may be under way.
#[derive(Clone, Debug, PartialEq)]
pub struct ClientConfig {
    /// Address of the rig.
    pub address: SocketAddr,
    /// The certificate that the rig must show.
    pub fingerprint: Fingerprint,
    /// Name of the device.
    pub device: String,
    /// What it proves with that it was paired.
    pub device_key: DeviceKey,
    /// The invitation, for a device that was never paired.
    pub pairing_token: Option<PairingToken>,
    /// Name of the session.
    pub session: String,
    /// DATA messages without acknowledgement at most.
    pub window_messages: usize,
    /// Bytes without acknowledgement at most, unless one message alone has more.
    pub window_bytes: usize,
    /// How long the rig may take to acknowledge before it counts as lost, seconds.
    pub ack_timeout_secs: u32,
    /// How long a rig that was lost is looked for, seconds; 0: not at all.
    pub reconnect_secs: u32,
    /// The clock that stamps the measurements, to be compared with the rig's; `None`: it is not compared.
    pub clock: Option<ClientClock>,
    /// Seed of faults made on purpose, to try a rig with; `None`: none are.
    pub faults: Option<u64>,
}

impl ClientConfig {
    /// A device called `glasses` with a new key, invited by a pairing code: 256 messages or 4 MiB under way, half a minute for an
    /// acknowledgement, no second connection, a clock that is not compared.
    pub fn invited(address: SocketAddr, code: &PairingCode) -> Result<Self, Error> {
        Ok(Self {
            address,
            fingerprint: code.fingerprint,
            device: "glasses".to_owned(),
            device_key: DeviceKey::random()?,
            pairing_token: Some(code.token),
            session: "session".to_owned(),
            window_messages: 256,
            window_bytes: 4 << 20,
            ack_timeout_secs: 30,
            reconnect_secs: 0,
            clock: None,
            faults: None,
        })
    }
}

/// A device's clock, as this machine's with another beginning and another rate.
#[derive(Clone, Debug, PartialEq)]
pub struct ClientClock {
    /// Its name, as channels give it.
    pub id: String,
    /// What it shows in 1970, nanoseconds.
    pub offset_ns: i64,
    /// How much faster it runs, parts per million.
    pub skew_ppm: f64,
}

impl ClientClock {
    /// What it shows now, nanoseconds.
    pub fn now_ns(&self) -> i64 {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
        let host_ns = since_1970.map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX));
        self.at_ns(host_ns)
    }

    /// What it shows at a moment of this machine's clock, nanoseconds since 1970.
    pub fn at_ns(&self, host_ns: i64) -> i64 {
        let gained_ns = (host_ns as f64 * self.skew_ppm * 1e-6) as i64;
        host_ns
            .saturating_add(gained_ns)
            .saturating_add(self.offset_ns)
    }
}
