//! The operator's screen from another machine: at the address of the phones, by TLS, for whoever knows its PIN.

use std::time::Duration;

use lsfb_tests::{Lacks, skip};
use nix::sys::signal::Signal;
use serde_json::json;

use crate::chromium::Tab;
use crate::running::Running;
use crate::sidecar_rig::SidecarRig;

const TAP: Duration = Duration::from_millis(30);
/// A name of this machine under which a browser trusts it no more than any other machine of the network.
const NAME: &str = "rig.example";

/// Links of the screen as the terminal shows them: for this machine, and for others.
fn links(scan: &mut Running) -> (String, String) {
    scan.wait_for("screen: https:");
    let said = scan.said();
    let link = |scheme: &str| {
        let mut lines = said.lines().filter_map(|l| l.strip_prefix("screen: "));
        let link = lines.find(|link| link.starts_with(scheme)).expect("a link");
        link.split(' ').next().expect("a link").to_owned()
    };
    (link("http:"), link("https:"))
}

/// The same link under the machine's name.
fn by_name(link: &str) -> String {
    link.replacen("127.0.0.1", NAME, 1)
}

/// Over the network the page could neither keep the screen awake nor use a camera: browsers let only secure pages do so.
#[test]
fn the_screen_is_a_secure_page_at_the_address_of_the_phones() {
    let rig = SidecarRig::new();
    let arguments = "scan --devices devices.toml --out walk.mcap --screen 127.0.0.1:0 --screen-name rig.example";
    let mut scan = Running::lsfb(rig.folder.path(), arguments.split(' ').map(str::to_owned));
    let (plain, secure) = links(&mut scan);
    assert!(
        secure.starts_with(&format!("https://{}/operator/#pin=", rig.address)),
        "{secure}"
    );
    let Some(mut tab) = Tab::open(&by_name(&plain)) else {
        let test = "the_screen_is_a_secure_page_at_the_address_of_the_phones";
        return skip(test, Lacks::Program, "no Chromium is installed");
    };
    tab.wait_for(
        "document.body.dataset.phase === 'ready' && !document.querySelector('#awake').hidden",
    );
    let allowed = "[isSecureContext, 'wakeLock' in navigator, 'mediaDevices' in navigator]";
    assert_eq!(tab.value(allowed), json!([false, false, false]));
    drop(tab);

    let mut tab = Tab::open(&by_name(&secure)).expect("a browser");
    tab.wait_for("document.body.dataset.phase === 'ready' && document.querySelector('#tile-disk .value').textContent !== '–'");
    assert_eq!(tab.value(allowed), json!([true, true, true]));
    assert_eq!(tab.value("location.hostname"), json!(NAME));
    // What the page asks for by itself is given.
    tab.wait_for("document.querySelector('#awake').hidden && !document.querySelector('#ask').open");
    tab.value(
        "{ const ask = navigator.wakeLock.request.bind(navigator.wakeLock); \
         navigator.wakeLock.request = (what) => ask(what).then((lock) => { window.lock = lock; return lock; }); \
         document.dispatchEvent(new Event('visibilitychange')); }",
    );
    tab.wait_for("window.lock?.type === 'screen' && !window.lock.released");
    // Before a recording begins phones are told so, and the page is served all the same.
    let asked = "fetch('/v1/hello').then(async (answer) => { window.hello = [answer.status, await answer.text()]; })";
    tab.value(asked);
    tab.wait_for("window.hello?.[0] === 503");
    tab.press("#run", TAP);
    // It stays at that until a phone sends something.
    tab.wait_for("document.body.dataset.phase === 'starting'");
    tab.value(asked);
    tab.wait_for("window.hello[0] === 200 && JSON.parse(window.hello[1]).recording");
    scan.signal(Signal::SIGINT);
    scan.wait();
    tab.wait_for("!document.querySelector('#offline').hidden");
}

/// Whoever may send as a phone, or is on the network at all, starts, stops and sees no scan.
#[test]
fn what_pairs_a_phone_opens_no_screen() {
    let rig = SidecarRig::new();
    let arguments = "scan --devices devices.toml --out walk.mcap --screen 127.0.0.1:0 --screen-name rig.example --now";
    let mut scan = Running::lsfb(rig.folder.path(), arguments.split(' ').map(str::to_owned));
    let (_, secure) = links(&mut scan);
    let page = by_name(secure.split('#').next().expect("a link"));
    let Some(mut tab) = Tab::open(&page) else {
        let test = "what_pairs_a_phone_opens_no_screen";
        return skip(test, Lacks::Program, "no Chromium is installed");
    };
    tab.wait_for("document.querySelector('#ask')?.open");
    let code = rig.invite(rig.address).to_text();
    let token = code.rsplit_once("tok=").expect("a token").1;
    let talk = |name: &str, path: &str, said: &[String]| {
        let said = json!(said);
        format!(
            "{{ window.{name} = []; const s = new WebSocket('{path}'.replace('https', 'wss')); let left = {said}; \
             const next = () => left.length ? s.send(left.shift()) : s.close(); \
             s.onmessage = (m) => {{ window.{name}.push(m.data); next(); }}; s.onclose = () => window.{name}.push('closed'); }}"
        )
    };
    let said = [
        json!({ "pin": token }).to_string(),
        json!({ "command": "stop" }).to_string(),
        "{\"pin\":null}".to_owned(),
    ];
    tab.value(&talk("token", &format!("{page}live"), &said));
    tab.wait_for("window.token.at(-1) === 'closed'");
    let refused = json!([
        "{\"pin\":\"needed\"}",
        "{\"pin\":\"wrong\"}",
        "{\"pin\":\"wrong\"}",
        "{\"pin\":\"wrong\"}",
        "closed"
    ]);
    assert_eq!(tab.value("window.token"), refused);
    // Nor is it found by other ways: beside its path, or under the path of the phones.
    for path in ["live", "v1/operator/live", "operator%2flive"] {
        let root = page.trim_end_matches("operator/");
        tab.value(&talk("other", &format!("{root}{path}"), &[]));
        tab.wait_for("window.other.at(-1) === 'closed'");
        assert_eq!(tab.value("window.other"), json!(["closed"]), "{path}");
    }
    assert_eq!(
        tab.value("document.body.dataset.phase"),
        json!("ready"),
        "shown"
    );
    scan.signal(Signal::SIGINT);
    scan.wait();
}
