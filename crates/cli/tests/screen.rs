//! The operator's screen in a browser, in front of the mock rig.

use std::path::Path;
use std::time::Duration;

use crate::chromium::Tab;
use crate::running::Running;
use crate::simulated_session::{Ports, one_rig_at_a_time, recorded, text};
use lsfb_recording::message::decode_remark;
use lsfb_recording::{REMARKS, Recording};
use lsfb_tests::{Lacks, skip};
use nix::sys::signal::Signal;
use serde_json::json;

/// A tap, and longer than the stop key wants to be held.
const TAP: Duration = Duration::from_millis(30);
const HOLD: Duration = Duration::from_millis(1_300);
/// Every key that can be seen is at least this large, pixels: for gloves.
const GLOVE_PX: u32 = 64;

fn url_of(scan: &Running) -> String {
    let said = scan.said();
    let line = said.lines().find_map(|line| line.strip_prefix("screen: "));
    line.expect("an address").trim().to_owned()
}

/// Keys that are too small, and whether the page is wider than its window.
fn check_layout(tab: &mut Tab, size: &str) {
    let small = tab.value(&format!(
        "[...document.querySelectorAll('button')].filter(b => b.offsetParent).map(b => [b.id, b.getBoundingClientRect()]) \
         .filter(([, r]) => r.width < {GLOVE_PX} || r.height < {GLOVE_PX} || r.right > innerWidth + 0.5 || r.bottom > innerHeight + 0.5) \
         .map(([id, r]) => `${{id}} ${{r.width}}×${{r.height}} at ${{r.x}},${{r.y}}`)"
    ));
    assert_eq!(small, json!([]), "{size}");
    let cut = tab.value(
        "[...document.querySelectorAll('#tiles .value, #phase-word, #clock, #keys button')] \
         .filter(e => e.offsetParent && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline').map(e => e.outerHTML)",
    );
    assert_eq!(cut, json!([]), "{size}");
    let wide = tab.value("document.documentElement.scrollWidth > innerWidth");
    assert_eq!(wide, json!(false), "{size}");
}

#[test]
fn an_operator_starts_watches_marks_and_stops() {
    let Some(probe) = Tab::open("about:blank") else {
        let test = "an_operator_starts_watches_marks_and_stops";
        skip(test, Lacks::Program, "no Chromium is installed");
        return;
    };
    drop(probe);
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let _alone = one_rig_at_a_time();
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
        "--power-supplies",
        "power",
    ];
    let battery = root.join("power/BAT0");
    std::fs::create_dir_all(&battery).expect("folder");
    let tell = |file: &str, text: &str| std::fs::write(battery.join(file), text).expect("battery");
    tell("type", "Battery\n");
    tell("status", "Discharging\n");
    tell("capacity", "83\n");
    let mut scan = Running::lsfb(root, arguments.map(str::to_owned));
    scan.wait_for("screen: ");
    let mut tab = Tab::open(&url_of(&scan)).expect("a browser");

    // The state may arrive before the style does.
    tab.wait_for("document.readyState === 'complete' && document.body.dataset.phase === 'ready' && document.querySelector('#run').textContent === 'START'");
    check_layout(&mut tab, "ready");
    let shows = |percent: u32, level: &str| {
        format!(
            "document.querySelector('#tile-battery .value').textContent === '{percent} %' && \
             document.querySelector('#tile-battery').dataset.level === '{level}'"
        )
    };
    tab.wait_for(&shows(83, "good"));
    tell("capacity", "9\n");
    tab.wait_for(&shows(9, "bad"));
    assert_eq!(
        tab.value("document.querySelector('#note').disabled"),
        json!(true)
    );
    tab.press("#run", TAP);
    tab.wait_for("document.body.dataset.phase === 'recording'");
    tab.wait_for("document.querySelector('#map-empty').hidden");
    tab.wait_for("document.querySelector('#tile-sync').dataset.level === 'good'");
    // The recorder says twice a second how its devices are.
    tab.wait_for("document.querySelector('#tile-lost .value').textContent === '0'");
    tab.wait_for("document.querySelectorAll('#streams li[data-level=good]').length === 4");

    tab.press("#note", TAP);
    tab.press("#say-quick button", TAP);
    tab.wait_for("document.querySelector('#toast').textContent.includes('Note saved')");
    tab.press("#point", TAP);
    tab.press("#say-yes", TAP);
    tab.wait_for("document.querySelector('#toast').textContent.includes('P1')");

    let shots = Path::new(env!("CARGO_TARGET_TMPDIR")).join("screen-shots");
    std::fs::create_dir_all(&shots).expect("folder");
    for (name, width, height) in [
        ("phone", 390, 844),
        ("tablet", 1024, 768),
        ("across", 844, 390),
    ] {
        tab.resize(width, height);
        std::thread::sleep(Duration::from_millis(300));
        check_layout(&mut tab, name);
        let bytes = tab.screenshot(&shots.join(name).with_extension("png"));
        assert!(bytes > 10_000, "{name}: {bytes}");
    }
    tab.resize(390, 844);
    // A touch in passing does not stop it; holding the key does.
    tab.press("#run", TAP);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(tab.value("document.body.dataset.phase"), json!("recording"));
    tab.press("#run", HOLD);
    tab.wait_for("document.body.dataset.phase === 'ready'");
    tab.wait_for("document.querySelector('#alarm').textContent.includes('walk.mcap saved')");
    assert_eq!(
        tab.value("document.querySelector('#tile-lost').dataset.level"),
        json!("good")
    );

    scan.signal(Signal::SIGINT);
    assert_eq!(scan.wait().code(), Some(0), "{}", scan.said());
    tab.wait_for("!document.querySelector('#offline').hidden");
    let recording = Recording::open(&root.join("walk.mcap")).expect("recording");
    assert!(recording.damage().is_empty());
    let remarks: Vec<_> = recording
        .messages(REMARKS)
        .expect("remarks")
        .map(|message| decode_remark(&message.expect("message").bytes).expect("remark"))
        .collect();
    let said = |i: usize| (remarks[i].kind.as_str(), remarks[i].text.as_str());
    assert_eq!(remarks.len(), 2);
    assert_eq!(
        (said(0), said(1)),
        (("note", "Door moved"), ("control-point", "P1"))
    );
    assert!(remarks[1].position_in_world_m.is_some(), "{remarks:?}");
}
