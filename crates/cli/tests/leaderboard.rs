//! `lsfb bench serve`: uploads by form, hostile ones among them, and the page in a browser.

use std::fmt::Write as _;
use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::time::Duration;

use crate::chromium::Tab;
use crate::running::Running;
use lsfb_tests::{Lacks, skip};
use nix::sys::signal::Signal;

/// A coordinate of the truth that no answer may contain.
const SECRET: &str = "7.654321";
const SEQUENCE: &str = "C3-android";

/// A loop of a minute, one pose each tenth of a second; of the estimate every second one is `off_m` aside.
fn walk(off_m: f64) -> String {
    let mut text = String::new();
    for i in 0..600 {
        let t = f64::from(i) * 0.1;
        let aside = if i % 2 == 0 { off_m } else { -off_m };
        let (x, y) = (
            7.654_321 + (0.1 * t).cos() * (3.0 + aside),
            (0.1 * t).sin() * (3.0 + aside),
        );
        let _ = writeln!(text, "{t:.3} {x:.6} {y:.6} {:.6} 0 0 0 1", 0.01 * t);
    }
    text
}

fn dataset(root: &Path) {
    let at = root.join("ds");
    fs::create_dir_all(at.join("truth/query")).expect("folder");
    fs::write(
        at.join("truth/query").join(format!("{SEQUENCE}.tum")),
        walk(0.0),
    )
    .expect("truth");
    let text = "format = 1\ntitle = \"<b>test</b>\"\nrate_hz = 30\nscale_percent = 100\ntruth_sums_sha256 = \"\"\n\
        [[environment]]\nname = \"hall\"\ntitle = \"hall\"\nsize_m = [9, 9]\nradio = false\ndescription = \"\"\n\
        [[query]]\nname = \"C3-android\"\nmotion = \"C3\"\nenvironment = \"hall\"\ndevice = \"android\"\ngait = \"walk\"\n\
        gaze = \"ahead\"\nframes = 600\nlength_m = 18\ndescription = \"\"\n";
    fs::write(at.join("dataset.toml"), text).expect("description");
}

fn serve(root: &Path) -> (Running, String) {
    dataset(root);
    let line = "bench serve ds --out board --listen 127.0.0.1:0 --max-mb 1";
    let mut server = Running::lsfb(root, line.split(' ').map(str::to_owned));
    server.wait_for("leaderboard: ");
    let said = server.said();
    let url = said
        .lines()
        .find_map(|l| l.strip_prefix("leaderboard: http://"));
    let address = url.expect("an address").trim_end_matches('/').to_owned();
    (server, address)
}

/// Sends bytes as they are, and takes all that is answered. A server that refuses may have answered and hung up before all is sent.
fn talk(address: &str, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).expect("server");
    let sent = stream
        .write_all(request)
        .and_then(|()| stream.shutdown(Shutdown::Write));
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer);
    assert!(!answer.is_empty(), "no answer: {sent:?}, {read:?}");
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(address: &str, path: &str) -> String {
    talk(
        address,
        format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes(),
    )
}

fn form(team: &str, sequence: &str, trajectory: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    for (field, bytes) in [
        ("team", team.as_bytes()),
        ("sequence", sequence.as_bytes()),
        ("trajectory", trajectory),
    ] {
        let head = format!(
            "--b\r\nContent-Disposition: form-data; name=\"{field}\"; filename=\"../../../tmp/owned\"\r\n\r\n"
        );
        body.extend([head.as_bytes(), bytes, b"\r\n"].concat());
    }
    body.extend(b"--b--\r\n");
    body
}

fn post(address: &str, headers: &str, body: &[u8]) -> String {
    let head = format!(
        "POST /submit HTTP/1.1\r\nHost: {address}\r\nContent-Type: multipart/form-data; boundary=b\r\n{headers}\r\n"
    );
    talk(address, &[head.as_bytes(), body].concat())
}

fn upload(address: &str, team: &str, sequence: &str, trajectory: &[u8]) -> String {
    let body = form(team, sequence, trajectory);
    post(
        address,
        &format!("Content-Length: {}\r\n", body.len()),
        &body,
    )
}

#[track_caller]
fn expect(answer: &str, status: &str, words: &str) {
    assert!(
        answer.starts_with(&format!("HTTP/1.1 {status}")),
        "{status}: {answer}"
    );
    assert!(answer.contains(words), "{words}: {answer}");
    assert!(!answer.contains(SECRET), "the truth: {answer}");
}

#[test]
fn uploads_are_scored_and_what_is_hostile_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let (mut server, address) = serve(root);
    let address = address.as_str();
    let scripted = "<script>alert(1)</script>";
    expect(
        &upload(address, scripted, SEQUENCE, walk(0.05).as_bytes()),
        "200",
        "0.050",
    );
    let page = get(address, "/");
    expect(&page, "200", "&lt;script&gt;alert(1)");
    assert!(
        !page.contains("<script>alert") && !page.contains("<b>test"),
        "{page}"
    );
    expect(&get(address, "/scores.json"), "200", "\"rank\": 1");
    // What is refused before it is looked at.
    for path in [
        "/truth/query/C3-android.tum",
        "/../ds/truth",
        "/submissions.jsonl",
        "//etc/passwd",
    ] {
        expect(&get(address, path), "404", "");
    }
    expect(
        &talk(address, b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"),
        "421",
        "",
    );
    expect(
        &talk(address, b"DELETE / HTTP/1.1\r\nHost: x\r\n\r\n"),
        "405",
        "",
    );
    expect(&talk(address, b"\x16\x03\x01\x00\r\n\r\n"), "400", "");
    expect(
        &post(
            address,
            "Origin: http://evil.example\r\nContent-Length: 9\r\n",
            b"",
        ),
        "403",
        "",
    );
    let twice = "Content-Length: 9\r\nContent-Length: 8\r\n";
    expect(&post(address, twice, b""), "400", "");
    // What is looked at, six a minute at most, the first of them above.
    expect(
        &post(address, "Content-Length: 999999999\r\n", b""),
        "413",
        "too large",
    );
    expect(
        &post(address, "Transfer-Encoding: chunked\r\n", b"0\r\n\r\n"),
        "411",
        "",
    );
    expect(
        &post(address, "Content-Length: 5000\r\n", b"--b\r\n"),
        "400",
        "",
    );
    expect(
        &upload(address, "zip", SEQUENCE, b"\x1f\x8b\x08\x00\xff"),
        "400",
        "must be text",
    );
    let answer = upload(
        address,
        "bad",
        SEQUENCE,
        b"0 nan 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
    );
    expect(&answer, "422", "your file");
    assert!(!answer.contains(&root.display().to_string()), "{answer}");
    expect(
        &upload(address, "more", SEQUENCE, walk(0.0).as_bytes()),
        "429",
        "too many uploads",
    );
    // Nothing but the score is left.
    let left = fs::read_dir(root.join("board"))
        .expect("folder")
        .map(|e| e.expect("file").file_name());
    assert_eq!(left.collect::<Vec<_>>(), ["submissions.jsonl"]);
    assert!(!Path::new("/tmp/owned").exists());
    server.signal(Signal::SIGTERM);
    // As all commands that are stopped, and once 0.
    assert_eq!(server.wait().code(), Some(143), "{}", server.said());
    // What was scored is still known.
    let (server, address) = serve(root);
    expect(&get(&address, "/scores.json"), "200", "0.05");
    drop(server);
}

#[test]
fn somebody_uploads_in_a_browser() {
    let folder = tempfile::tempdir().expect("folder");
    let (_server, address) = serve(folder.path());
    let Some(mut tab) = Tab::open(&format!("http://{address}/")) else {
        let test = "somebody_uploads_in_a_browser";
        skip(test, Lacks::Program, "no Chromium is installed");
        return;
    };
    tab.resize(900, 700);
    tab.wait_for("document.querySelector('input[type=file]')");
    let text = serde_json::to_string(&walk(0.02)).expect("text");
    tab.value(&format!(
        "(() => {{ const files = new DataTransfer(); files.items.add(new File([{text}], 'slam.tum')); \
         document.querySelector('input[type=file]').files = files.files; \
         document.querySelector('[name=team]').value = 'us & them'; }})()"
    ));
    tab.press("button", Duration::from_millis(30));
    tab.wait_for("document.querySelector('h1').textContent === 'Your result'");
    let shown = tab.value("document.body.innerText").to_string();
    assert!(
        shown.contains("0.020") && shown.contains("us & them") && !shown.contains(SECRET),
        "{shown}"
    );
    tab.value("document.querySelector('a').click()");
    tab.wait_for("document.querySelector('form') && document.body.innerText.includes('us & them')");
    assert!(tab.screenshot(&folder.path().join("board.png")) > 10_000);
}
