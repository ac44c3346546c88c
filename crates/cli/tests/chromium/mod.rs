//! A headless Chromium, driven by its DevTools protocol.

use std::io::{BufRead as _, BufReader, ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Error, Message, WebSocket};

/// Names under which it is installed.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
const PATIENCE: Duration = Duration::from_secs(60);

/// A window of a browser.
pub struct Tab {
    browser: Child,
    socket: WebSocket<TcpStream>,
    sent: u64,
    _profile: TempDir,
}

impl Tab {
    /// Opens a page; `None` where there is no browser.
    pub fn open(url: &str) -> Option<Self> {
        let profile = TempDir::new().expect("folder");
        let mut browser = NAMES.iter().find_map(|name| {
            Command::new(name)
                .args([
                    "--headless=new",
                    "--no-sandbox",
                    "--disable-gpu",
                    "--hide-scrollbars",
                ])
                .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
                .args([
                    "--remote-debugging-port=0",
                    "--no-first-run",
                    "--disable-dev-shm-usage",
                ])
                // A name of this machine that is not trusted for being local, as addresses of a network are not.
                .arg("--host-resolver-rules=MAP rig.example 127.0.0.1")
                // A rig's certificate is its own, and a machine for tests has no camera.
                .args([
                    "--ignore-certificate-errors",
                    "--use-fake-device-for-media-stream",
                    "--use-fake-ui-for-media-stream",
                ])
                .arg(format!("--user-data-dir={}", profile.path().display()))
                .arg("about:blank")
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                .spawn()
                .ok()
        })?;
        let errors = BufReader::new(browser.stderr.take().expect("stderr"));
        let mut lines = errors.lines().map(|line| line.expect("what it says"));
        let address = lines.find_map(|line| {
            let rest = line.split_once("ws://")?.1;
            Some(rest.split('/').next()?.to_owned())
        });
        let address = address.expect("a browser that listens");
        // Somebody must go on reading what it says.
        std::thread::Builder::new()
            .name("chromium-stderr".to_owned())
            .spawn(move || lines.for_each(drop))
            .expect("thread");
        let stream = TcpStream::connect(&address).expect("browser");
        stream.set_read_timeout(Some(PATIENCE)).expect("timeout");
        let page = page_socket(&address);
        let (socket, _) = tungstenite::client(page, stream).expect("DevTools");
        let mut tab = Self {
            browser,
            socket,
            sent: 0,
            _profile: profile,
        };
        tab.resize(390, 844);
        tab.command("Page.navigate", &json!({ "url": url }));
        Some(tab)
    }

    /// Gives the window a size, pixels.
    pub fn resize(&mut self, width: u32, height: u32) {
        self.command(
            "Emulation.setDeviceMetricsOverride",
            &json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": true }),
        );
    }

    /// The value of an expression.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true });
        let result = self.command("Runtime.evaluate", &parameters);
        assert!(
            result.get("exceptionDetails").is_none(),
            "{expression}: {result}"
        );
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn wait_for(&mut self, expression: &str) {
        let began = Instant::now();
        // The page may not be there yet.
        let test = format!(
            "(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()"
        );
        while self.value(&test) != json!(true) {
            let page = self.value("document.body?.innerText");
            assert!(began.elapsed() < PATIENCE, "in vain: {expression}\n{page}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Presses a key of the page for a while, as a finger does.
    pub fn press(&mut self, selector: &str, duration: Duration) {
        let centre = format!(
            "(() => {{ const r = document.querySelector('{selector}').getBoundingClientRect(); \
             return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        );
        let at = self.value(&centre);
        let at = [0, 1].map(|axis| at[axis].as_f64().expect("a number"));
        let left = json!({ "button": "left", "clickCount": 1 });
        self.mouse("mousePressed", at, &left);
        std::thread::sleep(duration);
        self.mouse("mouseReleased", at, &left);
    }

    /// What a mouse does at a place in the window, pixels: `mouseMoved`, `mousePressed`, `mouseReleased` or `mouseWheel`, with the
    /// parameters that DevTools want of each.
    pub fn mouse(&mut self, kind: &str, [x, y]: [f64; 2], parameters: &Value) {
        let mut event = parameters.clone();
        event["type"] = json!(kind);
        (event["x"], event["y"]) = (json!(x), json!(y));
        self.command("Input.dispatchMouseEvent", &event);
    }

    /// Saves a picture of the page, and gives its size in bytes.
    pub fn screenshot(&mut self, path: &Path) -> usize {
        let shot = self.command("Page.captureScreenshot", &json!({}));
        let bytes = from_base64(shot["data"].as_str().expect("a picture"));
        std::fs::write(path, &bytes).expect("picture");
        bytes.len()
    }

    fn command(&mut self, method: &str, parameters: &Value) -> Value {
        self.sent += 1;
        let message = json!({ "id": self.sent, "method": method, "params": parameters });
        self.socket
            .send(Message::text(message.to_string()))
            .expect("browser");
        loop {
            let text = match self.socket.read() {
                Ok(Message::Text(text)) => text,
                Ok(_) => continue,
                // By a signal that another test waits for.
                Err(Error::Io(error)) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => panic!("browser: {error}"),
            };
            let answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["id"] == self.sent {
                assert!(answer.get("error").is_none(), "{method}: {answer}");
                return answer["result"].clone();
            }
        }
    }
}

impl Drop for Tab {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.browser.kill();
        let _ = self.browser.wait();
    }
}

/// Address of the first page.
fn page_socket(address: &str) -> String {
    let began = Instant::now();
    loop {
        let mut stream = TcpStream::connect(address).expect("browser");
        let request = format!("GET /json HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("browser");
        stream
            .set_read_timeout(Some(Duration::from_millis(500)))
            .expect("timeout");
        // The browser leaves the connection open.
        let mut answer = Vec::new();
        let mut part = [0; 4096];
        while let Ok(got) = stream.read(&mut part) {
            answer.extend_from_slice(&part[..got]);
            if got == 0 {
                break;
            }
        }
        let answer = String::from_utf8_lossy(&answer);
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        let tabs: Value = serde_json::from_str(body).unwrap_or_default();
        let mut tabs = tabs.as_array().into_iter().flatten();
        if let Some(tab) = tabs.find(|tab| tab["type"] == "page") {
            return tab["webSocketDebuggerUrl"]
                .as_str()
                .expect("address")
                .to_owned();
        }
        assert!(began.elapsed() < PATIENCE, "no page: {answer}");
    }
}

fn from_base64(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let (mut bits, mut count, mut out) = (0_u32, 0, Vec::new());
    for c in text.bytes().filter(|c| *c != b'=') {
        bits = bits << 6 | u32::from(digit(c));
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push((bits >> count) as u8);
        }
    }
    out
}
