//! How mock phones of this machine get to know its recorder.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use anyhow::Context as _;
use lsfb_capture::PairingFolder;
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_drivers::sidecar::credentials::PairingCode;

/// Name of the folder, among a session's files, of what recorder and phones know each other by.
pub const FOLDER: &str = "sidecar";
/// Name, in that folder, of the key by which identifiers of access points and beacons are hashed.
const IDENTIFIERS_KEY: &str = "identifiers.key";
/// How long a mock phone may wait for its recorder.
const INVITATION: Duration = Duration::from_secs(3600);
/// How long a mock phone looks for a recorder that it has lost, seconds. On a machine with too much to do either may be silent
/// for so long that the other takes it for gone.
const RECONNECT_SECS: u32 = 5;

/// How a mock phone connects: it is invited as any other would be. One that an earlier mock left behind under this name is
/// forgotten.
pub fn invite(
    folder: &Path,
    address: SocketAddr,
    device: &str,
    session: &str,
) -> anyhow::Result<ClientConfig> {
    let pairing = PairingFolder::open(folder)?;
    pairing.unpair(device)?;
    let code = PairingCode {
        address: address.to_string(),
        fingerprint: pairing.fingerprint(),
        token: pairing.invite(INVITATION)?,
    };
    Ok(ClientConfig {
        device: device.to_owned(),
        session: session.to_owned(),
        reconnect_secs: RECONNECT_SECS,
        ..ClientConfig::invited(address, &code)?
    })
}

/// Has a recorder hash identifiers by a key that another one used.
pub fn give_identifiers_key(folder: &Path, key: &Path) -> anyhow::Result<()> {
    PairingFolder::open(folder)?;
    copy(key, &folder.join(IDENTIFIERS_KEY))
}

/// Keeps the key by which a recorder hashes identifiers, for others.
pub fn keep_identifiers_key(folder: &Path, key: &Path) -> anyhow::Result<()> {
    copy(&folder.join(IDENTIFIERS_KEY), key)
}

fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    std::fs::copy(from, to).with_context(|| format!("{} to {}", from.display(), to.display()))?;
    Ok(())
}
