//! How mock phones of this machine get to know its recorder.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use lsfb_capture::PairingFolder;
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_drivers::sidecar::credentials::PairingCode;

/// Name of the folder, among a session's files, of what recorder and phones know each other by.
pub const FOLDER: &str = "sidecar";
/// How long a mock phone may wait for its recorder.
const INVITATION: Duration = Duration::from_secs(3600);

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
        ..ClientConfig::invited(address, &code)?
    })
}
