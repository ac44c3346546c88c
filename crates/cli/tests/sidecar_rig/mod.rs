//! A rig that records phones and nothing else, in a process of its own.

use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU16, Ordering};

use lsfb_capture::{DevicesConfig, INVITATION, PairingFolder, SidecarConfig};
use lsfb_drivers::sidecar::credentials::PairingCode;
use tempfile::TempDir;

use crate::running::Running;

/// Its folder, and where it listens.
pub struct SidecarRig {
    pub folder: TempDir,
    pub address: SocketAddr,
    pairing: PairingFolder,
}

impl SidecarRig {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let address = free_address();
        let pairing = PairingFolder::open(&folder.path().join("sidecar")).expect("folder");
        let config = DevicesConfig {
            sidecar: Some(SidecarConfig {
                come_back_secs: 60,
                ..SidecarConfig::new(address, PathBuf::from("sidecar"))
            }),
            ..DevicesConfig::default()
        };
        std::fs::write(folder.path().join("devices.toml"), config.to_toml()).expect("written");
        Self {
            folder,
            address,
            pairing,
        }
    }

    /// A code that pairs one phone, which finds the rig there.
    pub fn invite(&self, address: SocketAddr) -> PairingCode {
        PairingCode {
            address: address.to_string(),
            fingerprint: self.pairing.fingerprint(),
            token: self.pairing.invite(INVITATION).expect("an invitation"),
        }
    }

    /// A recorder, and its recording.
    pub fn recorder(&self, number: u32) -> (Running, PathBuf) {
        let out = self.folder.path().join(format!("walk{number}.mcap"));
        let to = out.to_str().expect("UTF-8");
        let arguments = ["scan", "--devices", "devices.toml", "--out", to];
        let process = Running::lsfb(self.folder.path(), arguments.map(str::to_owned));
        (process, out)
    }

    /// Until a recorder listens; one that ended says why.
    pub fn wait_for(&self, recorder: &mut Running) {
        recorder.wait_for(&format!("phones connect to {}", self.address));
    }
}

/// One that nobody listens at, below the ports that the system gives to connections that go out: between the look at it here and the
/// recorder that listens there nobody is given it.
fn free_address() -> SocketAddr {
    const FIRST: u16 = 20_000;
    const COUNT: u16 = 10_000;
    static TRIED: AtomicU16 = AtomicU16::new(0);
    let start = std::process::id() % u32::from(COUNT);
    let start = u16::try_from(start).expect("below their count");
    let free = (0..COUNT).find_map(|_| {
        let next = start.wrapping_add(TRIED.fetch_add(1, Ordering::Relaxed)) % COUNT;
        let address = SocketAddr::from(([127, 0, 0, 1], FIRST + next));
        TcpListener::bind(address).ok().map(|_| address)
    });
    free.expect("a free port")
}
