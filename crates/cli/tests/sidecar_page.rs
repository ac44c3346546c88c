//! A browser records a walk beside a rig that is killed and cut off, and its page is loaded again: everything is in the recordings, once.

use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::chromium::Tab;
use crate::sidecar_rig::SidecarRig;
use lsfb_recording::Recording;
use lsfb_recording::message::{decode_image, decode_imu, decode_time_reference};
use lsfb_tests::{Lacks, skip};
use nix::sys::signal::Signal;
use serde_json::json;

const NAME: &str = "phone-in-a-browser";
const TAP: Duration = Duration::from_millis(50);
/// Motion that a machine without sensors does not have: 1, 2 and 3 degrees a second, lying on its back.
const MOTION: &str = "setInterval(() => dispatchEvent(new DeviceMotionEvent('devicemotion', { interval: 16, \
    rotationRate: { alpha: 1, beta: 2, gamma: 3 }, accelerationIncludingGravity: { x: 0, y: 0, z: 9.81 } })), 16)";

/// A network between browser and rig that can be cut.
struct Network {
    address: SocketAddr,
    open: Arc<Mutex<Vec<TcpStream>>>,
}

impl Network {
    fn to(rig: SocketAddr) -> Self {
        let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).expect("a port");
        let address = listener.local_addr().expect("a port");
        let open: Arc<Mutex<Vec<TcpStream>>> = Arc::default();
        let connections = Arc::clone(&open);
        let accept = move || {
            for near in listener.incoming().flatten() {
                // The rig may be gone: then so is this connection.
                let Ok(far) = TcpStream::connect(rig) else {
                    continue;
                };
                let both = || {
                    (
                        near.try_clone().expect("socket"),
                        far.try_clone().expect("socket"),
                    )
                };
                let mut open = connections.lock().expect("connections");
                let ((near_in, far_out), (near_out, far_in)) = (both(), both());
                open.extend([
                    near_in.try_clone().expect("socket"),
                    far_in.try_clone().expect("socket"),
                ]);
                pass_on(near_in, far_out);
                pass_on(far_in, near_out);
            }
        };
        let thread = std::thread::Builder::new().name("network".to_owned());
        thread.spawn(accept).expect("thread");
        Self { address, open }
    }

    /// Whatever was under way is lost.
    fn cut(&self) {
        for socket in self.open.lock().expect("connections").drain(..) {
            // It may be gone already.
            let _ = socket.shutdown(Shutdown::Both);
        }
    }
}

fn pass_on(mut from: TcpStream, mut to: TcpStream) {
    let thread = std::thread::Builder::new().name("network-way".to_owned());
    let pass = move || {
        let mut part = vec![0; 64 << 10];
        while let Ok(got @ 1..) = from.read(&mut part) {
            if to.write_all(&part[..got]).is_err() {
                break;
            }
        }
        // The other side may be gone already.
        let _ = to.shutdown(Shutdown::Both);
        let _ = from.shutdown(Shutdown::Both);
    };
    thread.spawn(pass).expect("thread");
}

/// Until so many more messages are with the rig than the walk had, and so many more exchanges of time as a clock takes: each is told
/// with the next one.
fn wait_for_more(tab: &mut Tab) {
    let last = tab.value("sidecar.spool.session.last");
    let asked = tab.value("sidecar.link.exchanges");
    tab.wait_for(&format!(
        "sidecar.spool.session.stored > {last} + 20 && sidecar.link.exchanges > {asked} + 7"
    ));
}

/// Messages of each topic, by their stamps: clock and time on it.
fn recorded(recordings: &[PathBuf]) -> BTreeMap<String, Vec<(String, u64)>> {
    let mut found: BTreeMap<String, Vec<(String, u64)>> = BTreeMap::new();
    for path in recordings {
        let recording = Recording::open(path).expect("a recording");
        for kind in ["cam0/image", "imu"] {
            let topic = format!("/sidecar/{NAME}/{kind}");
            let count = recording.messages(&topic).expect("a topic").count();
            let stamps = recording
                .messages(&format!("{topic}/device_time"))
                .expect("stamps");
            let stamps: Vec<(String, u64)> = stamps
                .map(|stamp| {
                    let stamp =
                        decode_time_reference(&stamp.expect("whole").bytes).expect("a stamp");
                    (stamp.source, stamp.device_ticks)
                })
                .collect();
            assert_eq!(count, stamps.len(), "{topic}");
            found.entry(kind.to_owned()).or_default().extend(stamps);
        }
    }
    found
}

/// What the page says, another reads.
fn check_messages(path: &Path) {
    let recording = Recording::open(path).expect("a recording");
    let first = |kind: &str| {
        let topic = format!("/sidecar/{NAME}/{kind}");
        let message = recording.messages(&topic).expect("a topic").next();
        message.expect("a message").expect("whole").bytes
    };
    let image = decode_image(&first("cam0/image")).expect("an image");
    assert_eq!((image.width, image.height), (640, 480));
    assert!(image.pixels.iter().max() > image.pixels.iter().min());
    let imu = decode_imu(&first("imu")).expect("a sample");
    let degrees = imu
        .angular_velocity_rad_s
        .map(|rate| rate.to_degrees().round());
    assert_eq!(degrees, [1.0, 2.0, 3.0]);
    assert_eq!(imu.specific_force_m_s2, [0.0, 0.0, 9.81]);
}

/// Its walk, of its own file, and no second time.
fn check_walk(recording: &Path) {
    let walks = |arguments: &[&str]| {
        let mut lsfb = Command::new(env!("CARGO_BIN_EXE_lsfb"));
        lsfb.args(["sidecar", "walks"])
            .arg(recording)
            .args(["--out", "walks", "--json"]);
        lsfb.args(arguments)
            .current_dir(recording.parent().expect("folder"));
        lsfb.output().expect("the built binary")
    };
    let made = walks(&[]);
    let said = String::from_utf8_lossy(&made.stderr);
    let found = String::from_utf8_lossy(&made.stdout);
    assert_eq!(made.status.code(), Some(0), "{said}{found}");
    let report: serde_json::Value = serde_json::from_slice(&made.stdout).expect("JSON");
    let walk = &report["walks"][0];
    assert_eq!(
        (&walk["unmapped"], &walk["unreadable"]),
        (&json!(0), &json!(0)),
        "{report}"
    );
    assert_eq!(walk["mapped"], walk["messages"], "{report}");
    assert_eq!(walks(&[]).status.code(), Some(1));
    assert_eq!(walks(&["--force"]).status.code(), Some(0));
}

#[test]
fn a_browser_loses_nothing_when_rig_network_and_page_are_gone() {
    let rig = SidecarRig::new();
    let network = Network::to(rig.address);
    let (mut running, first) = rig.recorder(0);
    let mut recordings = vec![first];
    rig.wait_for(&mut running);
    let Some(mut tab) = Tab::open(&rig.invite(network.address).to_link()) else {
        return skip(
            "a_browser_loses_nothing_when_rig_network_and_page_are_gone",
            Lacks::Program,
            "no Chromium is installed",
        );
    };
    tab.wait_for("document.body.dataset.phase === 'idle'");
    assert_eq!(tab.value("location.hash"), json!(""));
    tab.value(MOTION);
    tab.value(&format!("document.querySelector('#name').value = '{NAME}'"));
    tab.press("#run", TAP);
    tab.wait_for("sidecar.spool.session?.stored > 50 && sidecar.link.exchanges > 10");

    running.signal(Signal::SIGKILL);
    running.wait();
    tab.wait_for("document.body.dataset.link === 'gone' && sidecar.spool.count > 50");
    let (next, out) = rig.recorder(1);
    running = next;
    recordings.push(out);
    wait_for_more(&mut tab);

    network.cut();
    wait_for_more(&mut tab);

    tab.value("location.reload()");
    tab.wait_for(
        "document.body.dataset.phase === 'paused' && document.body.dataset.link === 'connected'",
    );
    tab.value(MOTION);
    tab.press("#run", TAP);
    tab.wait_for("document.body.dataset.phase === 'running'");
    wait_for_more(&mut tab);

    tab.press("#run", TAP);
    tab.wait_for("document.body.dataset.phase === 'idle' && sidecar.spool.done");
    let done = tab.value("sidecar.spool.done");
    let shot = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sidecar-page.png");
    assert!(tab.screenshot(&shot) > 5_000);
    running.signal(Signal::SIGINT);
    running.wait();

    let found = recorded(&recordings);
    let sent = |channels: [&str; 2]| -> u64 {
        channels
            .iter()
            .map(|n| done["counts"][n].as_u64().expect("a number"))
            .sum()
    };
    for (kind, channels) in [("cam0/image", ["1", "3"]), ("imu", ["2", "4"])] {
        let stamps = &found[kind];
        assert_eq!(stamps.len() as u64, sent(channels), "{kind}");
        // In order on each clock, and none twice.
        for clock in stamps.chunk_by(|a, b| a.0 == b.0) {
            assert!(clock.is_sorted_by(|a, b| a.1 < b.1), "{kind}");
        }
    }
    let all: usize = found.values().map(Vec::len).sum();
    assert_eq!(json!(all), done["last"]);
    check_messages(&recordings[1]);
    check_walk(&recordings[1]);
}
