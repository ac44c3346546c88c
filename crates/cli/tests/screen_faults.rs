//! The operator's screen in a browser when something is wrong: a rig without power, a screen that goes dark.

use std::path::Path;
use std::sync::MutexGuard;
use std::time::Duration;

use crate::chromium::Tab;
use crate::running::Running;
use crate::simulated_session::{Ports, one_rig_at_a_time, recorded, text};
use lsfb_tests::{Lacks, skip};
use nix::sys::signal::Signal;
use serde_json::json;

const TAP: Duration = Duration::from_millis(30);

/// A mock rig, and a recorder in front of it whose page a browser shows.
struct Session {
    _alone: MutexGuard<'static, ()>,
    mock: Running,
    scan: Running,
    tab: Tab,
}

/// `None` where there is no browser, which is said.
fn start(test: &'static str, root: &Path) -> Option<Session> {
    let Some(probe) = Tab::open("about:blank") else {
        skip(test, Lacks::Program, "no Chromium is installed");
        return None;
    };
    drop(probe);
    let alone = one_rig_at_a_time();
    let source = recorded(10).join("scan.mcap");
    let ports = Ports::free().arguments();
    let arguments = ["mock", text(&source), "--out", "mock", "--speed", "0.5"];
    let mut mock = Running::lsfb(root, arguments.map(str::to_owned).into_iter().chain(ports));
    mock.wait_for("devices.toml");
    let arguments = [
        "scan",
        "--devices",
        "mock/devices.toml",
        "--out",
        "walk.mcap",
        "--screen",
        "127.0.0.1:0",
    ];
    let mut scan = Running::lsfb(root, arguments.map(str::to_owned));
    scan.wait_for("screen: ");
    let said = scan.said();
    let address = said.lines().find_map(|line| line.strip_prefix("screen: "));
    let mut tab = Tab::open(address.expect("an address").trim()).expect("a browser");
    // The state may arrive before the style does.
    tab.wait_for("document.readyState === 'complete' && document.body.dataset.phase === 'ready' && document.querySelector('#run').textContent === 'START'");
    Some(Session {
        _alone: alone,
        mock,
        scan,
        tab,
    })
}

/// The rig loses its power while it records: the map stands still and sends nobody back, and what follows is no invitation.
#[test]
fn devices_that_die_leave_no_arrows_and_no_green_start() {
    let folder = tempfile::tempdir().expect("folder");
    let test = "devices_that_die_leave_no_arrows_and_no_green_start";
    let Some(session) = start(test, folder.path()) else {
        return;
    };
    let Session {
        _alone,
        mock,
        mut scan,
        mut tab,
    } = session;
    let colour = "getComputedStyle(document.querySelector('#run')).backgroundColor";
    let inviting = tab.value(colour);
    tab.press("#run", TAP);
    tab.wait_for("document.body.dataset.phase === 'recording' && document.querySelector('#map-empty').hidden");
    mock.signal(Signal::SIGKILL);
    tab.wait_for("document.querySelector('#alarm').dataset.level === 'bad' && !document.querySelector('#alarm').hidden");
    tab.wait_for("document.querySelectorAll('#go-back li').length === 0");
    // With its last device the recording ends by itself.
    tab.wait_for("document.body.dataset.phase === 'ready'");
    assert_eq!(
        tab.value("[document.body.dataset.failed, document.querySelector('#run').textContent]"),
        json!(["true", "START AGAIN"])
    );
    assert_ne!(tab.value(colour), inviting);
    scan.signal(Signal::SIGINT);
    assert_eq!(scan.wait().code(), Some(3), "{}", scan.said());
}

/// Over plain HTTP a browser lets no page keep the screen on: the page says so until the operator knows.
#[test]
fn a_screen_that_may_go_dark_is_told() {
    let folder = tempfile::tempdir().expect("folder");
    let test = "a_screen_that_may_go_dark_is_told";
    let Some(mut session) = start(test, folder.path()) else {
        return;
    };
    let tab = &mut session.tab;
    tab.value("navigator.wakeLock.request = () => Promise.reject(new Error('not a secure page')); document.dispatchEvent(new Event('visibilitychange'))");
    tab.wait_for("!document.querySelector('#awake').hidden");
    let shot = Path::new(env!("CARGO_TARGET_TMPDIR")).join("screen-goes-dark.png");
    assert!(tab.screenshot(&shot) > 10_000);
    tab.value("document.querySelector('#awake-ok').click()");
    tab.wait_for("document.querySelector('#awake').hidden");
    session.scan.signal(Signal::SIGINT);
    session.scan.wait();
}
