//! What clients of the operator's screen say: heads of requests, messages of the page, messages of Foxglove.
#![no_main]
#![feature(tcp_linger)]

use std::io::Write;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::Receiver;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use lsfb_operator::http;
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
    _servers: (Screen, Foxglove),
}

static CLIENTS: LazyLock<Mutex<Clients>> = LazyLock::new(|| {
    let config = ScreenConfig {
        address: anywhere(),
        ..ScreenConfig::default()
    };
    let (screen, requests) = Screen::open(&config).expect("a free port");
    let foxglove = Foxglove::open(anywhere(), "fuzz").expect("a free port");
    let url = screen.url().replace("http://", "ws://");
    let page = connect(&format!("{}/live", url.trim_end_matches('/')), None);
    let app = connect(
        &format!("ws://{}/", foxglove.address()),
        Some("foxglove.sdk.v1"),
    );
    Mutex::new(Clients {
        requests,
        page,
        foxglove: app,
        number: 0,
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

/// What a server makes of a connection.
fn ask(data: &[u8]) {
    static LISTENER: LazyLock<TcpListener> =
        LazyLock::new(|| TcpListener::bind(anywhere()).expect("a free port"));
    let mut client = TcpStream::connect(LISTENER.local_addr().expect("bound")).expect("it listens");
    let (mut server, _) = LISTENER.accept().expect("it connected");
    client.write_all(data).expect("it fits the buffer");
    client.shutdown(Shutdown::Write).expect("it is open");
    // Closed at once, so that ports are not used up.
    client.set_linger(Some(Duration::ZERO)).expect("a socket");
    let Ok(request) = http::read(&mut server) else {
        return;
    };
    if request.websocket_key.is_some() {
        let protocol = request.protocols.first().cloned();
        let mut socket = http::upgrade(server, request, protocol.as_deref()).expect("it has a key");
        while let Err(error) = socket.read().map(drop) {
            if !http::is_quiet(&error) {
                break;
            }
        }
        return;
    }
    let status = match request.path.as_str() {
        _ if !request.is_ours() => http::Status::Forbidden,
        "/" => http::Status::Ok,
        _ => http::Status::NotFound,
    };
    http::answer(&mut server, status, "text/plain", &request.rest).expect("it fits the buffer");
}

fuzz_target!(|data: &[u8]| {
    let data = data.get(..8192).unwrap_or(data);
    let Some((&kind, said)) = data.split_first() else {
        return;
    };
    if !matches!(kind, b'{' | b'[') {
        return ask(data);
    }
    let mut clients = CLIENTS.lock().unwrap_or_else(PoisonError::into_inner);
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
