//! A short simulated session, recorded from `lsfb sim` in another process.

use std::collections::BTreeMap;
use std::net::{TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde_json::Value;

use crate::process::lsfb;
use crate::running::Running;

/// Small cameras, so that two cores render them faster than they are played.
const TINY: &str = "texel_m = 0.012\n\
    [scan]\nduration_s = SECS\nrest_s = 0.5\n[glasses]\nduration_s = 4.0\nrest_s = 0.5\nheight_m = 1.62\n\
    [scan_cameras]\nwidth = 160\nheight = 100\n[glasses_cameras]\nwidth = 160\nheight = 100\n";

/// Three ports that nobody has.
pub struct Ports(pub [u16; 3]);

impl Ports {
    /// Below those that the system gives to connections, of which one may come before the port is used.
    pub fn free() -> Self {
        static TRIED: AtomicU32 = AtomicU32::new(0);
        let first = std::process::id().wrapping_mul(16);
        let is_free = |port: &u16| {
            let address = ("127.0.0.1", *port);
            UdpSocket::bind(address).is_ok() && TcpListener::bind(address).is_ok()
        };
        let mut ports = std::iter::repeat_with(|| {
            let n = first.wrapping_add(TRIED.fetch_add(1, Ordering::Relaxed));
            20_000 + (n % 12_000) as u16
        })
        .filter(is_free);
        Self([0; 3].map(|_| ports.next().expect("one of 12 000")))
    }

    /// As `lsfb sim` and `lsfb mock` take them.
    pub fn arguments(&self) -> Vec<String> {
        let names = ["--lidar-data", "--lidar-position", "--sidecar"];
        let pairs = names.iter().zip(self.0);
        pairs
            .flat_map(|(name, port)| [(*name).to_owned(), format!("127.0.0.1:{port}")])
            .collect()
    }
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// Records what a folder's list of devices names, to the end of the devices.
pub fn scan(folder: &Path, devices: &str, out: &str) -> Value {
    let output = lsfb(
        folder,
        &["scan", "--devices", devices, "--out", out, "--json"],
    );
    let errors = String::from_utf8_lossy(&output.stderr);
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}\n{errors}");
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// Settings of a short session with a scan of so many seconds.
pub fn settings(scan_secs: u32) -> String {
    TINY.replace("SECS", &format!("{scan_secs}.0"))
}

/// For whoever plays a rig: several rigs, recorders and browsers at once are too much for two cores.
pub fn one_rig_at_a_time() -> MutexGuard<'static, ()> {
    static PLAYED: Mutex<()> = Mutex::new(());
    PLAYED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A simulated scan of so many seconds and a walk, recorded from `lsfb sim` in another process: made once for all tests.
pub fn recorded(scan_secs: u32) -> PathBuf {
    static RECORDED: Mutex<BTreeMap<u32, PathBuf>> = Mutex::new(BTreeMap::new());
    let mut recorded = RECORDED.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = recorded
        .entry(scan_secs)
        .or_insert_with(|| record(scan_secs));
    folder.clone()
}

fn record(scan_secs: u32) -> PathBuf {
    let name = format!("{}_{scan_secs}", env!("CARGO_CRATE_NAME"));
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("folder");
    std::fs::write(folder.join("tiny.toml"), settings(scan_secs)).expect("settings");
    let ports = Ports::free().arguments();
    let arguments = ["sim", "--out", "sim", "--config", "tiny.toml"];
    let arguments = arguments.into_iter().map(str::to_owned).chain(ports);
    let mut sim = Running::lsfb(&folder, arguments);
    sim.wait_for("backpack-devices.toml");
    // The units' own IMUs are asked too.
    let listed = std::fs::read_to_string(folder.join("sim/backpack-devices.toml"));
    let listed = listed
        .expect("devices")
        .replace("\"cam1\"]", "\"cam1\"]\nimu = \"imu1\"")
        .replace("\"cam3\"]", "\"cam3\"]\nimu = \"imu2\"");
    std::fs::write(folder.join("sim/all-devices.toml"), listed).expect("devices");
    let report = scan(&folder, "sim/all-devices.toml", "scan.mcap");
    assert_eq!(report["groups"]["complete"], 10 * scan_secs, "{report}");
    sim.wait_for("glasses-devices.toml");
    scan(&folder, "sim/glasses-devices.toml", "walk.mcap");
    assert_eq!(sim.wait().code(), Some(0), "{}", sim.said());
    folder
}
