//! A rig that records phones and nothing else, in a process of its own.

use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use lsfb_capture::{DevicesConfig, INVITATION, PairingFolder, SidecarConfig};
use lsfb_drivers::sidecar::credentials::PairingCode;
use tempfile::TempDir;

/// Its folder, and where it listens.
pub struct SidecarRig {
    pub folder: TempDir,
    pub address: SocketAddr,
    pairing: PairingFolder,
}

impl SidecarRig {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let address = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0)))
            .and_then(|listener| listener.local_addr())
            .expect("a free port");
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
    pub fn recorder(&self, number: u32) -> (Child, PathBuf) {
        let out = self.folder.path().join(format!("walk{number}.mcap"));
        let process = Command::new(env!("CARGO_BIN_EXE_lsfb"))
            .args(["scan", "--devices", "devices.toml", "--out"])
            .arg(&out)
            .current_dir(self.folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the built binary");
        (process, out)
    }
}

/// Until somebody listens.
pub fn wait_for(address: SocketAddr) {
    for _ in 0..400 {
        if TcpStream::connect(address).is_ok() {
            return;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    panic!("nobody listens at {address}");
}
