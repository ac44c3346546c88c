//! What clients of the operator's screen say: heads of requests, messages of the page, messages of Foxglove.
#![no_main]

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::mpsc::Receiver;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use lsfb_operator::{Command, Foxglove, Request, Screen, ScreenConfig};
use tungstenite::{Message, WebSocket};

/// Nothing here takes as long.
const PATIENCE: Duration = Duration::from_secs(10);

fn anywhere() -> SocketAddr {
    ([127, 0, 0, 1], 0).into()
}

/// One connection to each server, for all that is said.
struct Clients {
    requests: Receiver<Request>,
    page: WebSocket<TcpStream>,
    foxglove: WebSocket<TcpStream>,
    number: u32,
    address: SocketAddr,
    _servers: (Screen, Foxglove),
}

static CLIENTS: LazyLock<Mutex<Clients>> = LazyLock::new(|| {
    let config = ScreenConfig {
        address: Some(anywhere()),
        ..ScreenConfig::default()
    };
    let (screen, requests) = Screen::open(&config).expect("a free port");
    let foxglove = Foxglove::open(anywhere(), "fuzz").expect("a free port");
    let address = screen.address().expect("it listens");
    let page = connect(&format!("ws://{address}/live"), None);
    let app = connect(
        &format!("ws://{}/", foxglove.address()),
        Some("foxglove.sdk.v1"),
    );
    Mutex::new(Clients {
        requests,
        page,
        foxglove: app,
        number: 0,
        address,
        _servers: (screen, foxglove),
    })
});

fn connect(url: &str, protocol: Option<&str>) -> WebSocket<TcpStream> {
    let uri: tungstenite::http::Uri = url.parse().expect("an address");
    let stream = TcpStream::connect(uri.authority().expect("a host").as_str()).expect("it listens");
    stream.set_nodelay(true).expect("a socket");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    let mut request = tungstenite::ClientRequestBuilder::new(uri);
    if let Some(protocol) = protocol {
        request = request.with_sub_protocol(protocol);
    }
    tungstenite::client(request, stream).expect("a WebSocket").0
}

/// Reads until `is_it` has been told of `count` texts.
fn wait(socket: &mut WebSocket<TcpStream>, mut count: usize, is_it: impl Fn(&str) -> bool) {
    while count > 0 {
        match socket.read() {
            Ok(Message::Text(text)) if is_it(&text) => count -= 1,
            Ok(_) => {}
            // libFuzzer's own alarm.
            Err(tungstenite::Error::Io(e)) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => panic!("the server goes on: {error}"),
        }
    }
}

/// What the server makes of a connection.
fn ask(address: SocketAddr, data: &[u8]) {
    let mut client = TcpStream::connect(address).expect("it listens");
    client.set_read_timeout(Some(PATIENCE)).expect("a socket");
    // It may be closed before it has said all.
    let _ = client.write_all(data);
    let _ = client.shutdown(Shutdown::Write);
    let _ = client.read_to_end(&mut Vec::new());
}

fuzz_target!(|data: &[u8]| {
    let data = data.get(..8192).unwrap_or(data);
    let Some((&kind, said)) = data.split_first() else {
        return;
    };
    let mut clients = CLIENTS.lock().unwrap_or_else(PoisonError::into_inner);
    if !matches!(kind, b'{' | b'[') {
        return ask(clients.address, data);
    }
    let Clients {
        requests,
        page,
        foxglove,
        number,
        ..
    } = &mut *clients;
    if kind == b'{' {
        let text = String::from_utf8_lossy(data).into_owned();
        let unknown = 1 + usize::from(serde_json::from_str::<Command>(&text).is_err());
        page.send(Message::text(text)).expect("the server goes on");
        page.send(Message::text("?")).expect("the server goes on");
        wait(page, unknown, |text| text.contains("not understood"));
        while let Ok(request) = requests.try_recv() {
            request.answer(Ok("done".to_owned()));
        }
        return;
    }
    let text = String::from_utf8_lossy(said).into_owned();
    *number = number.wrapping_add(1) | 1 << 31;
    let subscribe = serde_json::json!({
        "op": "subscribe",
        "subscriptions": [{ "id": 1, "channelId": *number }],
    });
    foxglove
        .send(Message::text(text))
        .expect("the server goes on");
    foxglove
        .send(Message::text(subscribe.to_string()))
        .expect("the server goes on");
    let answer = format!("no channel {number}");
    wait(foxglove, 1, |text| text.contains(&answer));
});
