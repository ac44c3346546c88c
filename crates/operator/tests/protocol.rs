//! The screen and Foxglove as programs see them: HTTP and WebSocket, without a browser.

#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use lsfb_geometry::{Se3, Vector3};
use lsfb_operator::{
    Command, Error, Foxglove, LiveMap, LiveMessage, MapConfig, Phase, Preview, Request, Screen,
    ScreenConfig, ScreenState, SecureScreen, UnseenKind, UnseenMotion,
};
use lsfb_recording::message;
use lsfb_types::{Image, ImuSample, Timestamp};
use lsfb_web::{Listener, Server};
use serde_json::{Value, json};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

const LOOPBACK: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);
const PATIENCE: Duration = Duration::from_secs(10);

fn open(pin: Option<&str>) -> (Screen, Receiver<Request>) {
    let config = ScreenConfig {
        address: Some(LOOPBACK),
        pin: pin.map(str::to_owned),
        ..ScreenConfig::default()
    };
    Screen::open(&config).unwrap()
}

/// The whole answer to a request.
fn ask(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(address: SocketAddr, path: &str) -> String {
    ask(
        address,
        &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n"),
    )
}

fn connect(address: SocketAddr, path: &str, protocol: &str) -> WebSocket<TcpStream> {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let uri = format!("ws://{address}{path}").parse().unwrap();
    let request = ClientRequestBuilder::new(uri).with_sub_protocol(protocol);
    let (socket, response) = tungstenite::client(request, stream).unwrap();
    assert_eq!(response.headers()["sec-websocket-protocol"], protocol);
    socket
}

fn at(screen: &Screen) -> SocketAddr {
    screen.address().unwrap()
}

fn live(screen: &Screen) -> WebSocket<TcpStream> {
    connect(at(screen), "/live", "lsfb.operator.v1")
}

/// The next JSON message for which `wanted` holds.
fn json_until(socket: &mut WebSocket<TcpStream>, wanted: impl Fn(&Value) -> bool) -> Value {
    let began = Instant::now();
    while began.elapsed() < PATIENCE {
        if let Message::Text(text) = socket.read().unwrap() {
            let value: Value = serde_json::from_str(&text).unwrap();
            if wanted(&value) {
                return value;
            }
        }
    }
    panic!("in vain");
}

fn binary(socket: &mut WebSocket<TcpStream>) -> Vec<u8> {
    loop {
        if let Message::Binary(bytes) = socket.read().unwrap() {
            return bytes.to_vec();
        }
    }
}

fn send(socket: &mut WebSocket<TcpStream>, value: &Value) {
    socket.send(Message::text(value.to_string())).unwrap();
}

#[test]
fn the_page_is_served_whole_and_loads_nothing_from_elsewhere() {
    let (screen, _requests) = open(None);
    let page = get(at(&screen), "/");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n"), "{page}");
    assert!(page.contains("default-src 'none'"));
    let mut files = 0;
    let is_file = |part: &&str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
        part.chars().all(plain)
            && [".js", ".css", ".svg", ".json"]
                .iter()
                .any(|e| part.ends_with(e))
    };
    for part in page.split(['"', '\'']).filter(is_file) {
        let file = get(at(&screen), &format!("/{part}"));
        assert!(file.starts_with("HTTP/1.1 200 OK\r\n"), "{part}");
        files += 1;
    }
    assert!(files >= 4, "{files}");
    for path in ["/", "/style.css", "/screen.js", "/map.js"] {
        let text = get(at(&screen), path);
        let body = text.split_once("\r\n\r\n").unwrap().1;
        // The only address in it is that of a drawing's namespace.
        assert!(
            !body.contains("https://") && !body.contains("//cdn"),
            "{path}"
        );
    }
    assert!(get(at(&screen), "/../Cargo.toml").starts_with("HTTP/1.1 404"));
    assert!(get(at(&screen), "/nothing").starts_with("HTTP/1.1 404"));
}

#[test]
fn odd_requests_are_refused_and_the_server_goes_on() {
    let (screen, _requests) = open(None);
    let address = at(&screen);
    assert!(ask(address, "POST / HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 405"));
    assert!(ask(address, "\u{0}\u{1}\r\n\r\n").starts_with("HTTP/1.1 400"));
    let endless = format!("GET / HTTP/1.1\r\nX: {}\r\n", "x".repeat(20_000));
    assert!(ask(address, &endless).starts_with("HTTP/1.1 431"));
    // A page of somebody else must not press keys here.
    let stranger = format!(
        "GET /live HTTP/1.1\r\nHost: {address}\r\nOrigin: http://evil.example\r\nUpgrade: websocket\r\n\
         Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    );
    assert!(ask(address, &stranger).starts_with("HTTP/1.1 403"));
    assert!(get(address, "/live").starts_with("HTTP/1.1 400"));
    assert!(get(address, "/").starts_with("HTTP/1.1 200"));
}

/// A page that has its own name lead to this machine is of one site with what it loads from here: only `Host` tells.
#[test]
fn a_page_that_rebinds_its_name_presses_no_keys() {
    let (screen, _requests) = open(None);
    let port = at(&screen).port();
    let asked_as = |host: &str, path: &str| {
        let request = format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        );
        let mut stream = TcpStream::connect(at(&screen)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut status = [0; 12];
        stream.read_exact(&mut status).unwrap();
        String::from_utf8_lossy(&status).into_owned()
    };
    for path in ["/live", "/", "/screen.js"] {
        let answer = asked_as(&format!("evil.example:{port}"), path);
        assert_eq!(answer, "HTTP/1.1 421", "{path}");
    }
    assert_eq!(
        asked_as(&format!("localhost:{port}"), "/live"),
        "HTTP/1.1 101"
    );
    assert!(ask(at(&screen), "GET / HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 421"));
    drop(screen);
    let config = ScreenConfig {
        address: Some(LOOPBACK),
        names: vec!["scanner.example".to_owned()],
        ..ScreenConfig::default()
    };
    let (screen, _requests) = Screen::open(&config).unwrap();
    let request = "GET / HTTP/1.1\r\nHost: Scanner.example\r\n\r\n";
    assert!(ask(at(&screen), request).starts_with("HTTP/1.1 200"));
}

/// Phones that left the network take no place for ever: sixteen of them used to lock the operator out. Who answers stays.
#[test]
fn clients_that_have_gone_make_room() {
    let (screen, _requests) = open(None);
    let mut answering = live(&screen);
    let gone: Vec<_> = (0..15).map(|_| live(&screen)).collect();
    let (leave, left) = std::sync::mpsc::sync_channel::<()>(1);
    let stays = std::thread::Builder::new().name("answers".to_owned());
    let stays = stays.spawn(move || {
        while left.try_recv().is_err() {
            answering.read().unwrap();
        }
    });
    let began = Instant::now();
    let mut operator = loop {
        assert!(began.elapsed() < 2 * PATIENCE, "locked out");
        let stream = TcpStream::connect(at(&screen)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let uri = format!("ws://{}/live", at(&screen)).parse().unwrap();
        let request = ClientRequestBuilder::new(uri).with_sub_protocol("lsfb.operator.v1");
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => break socket,
            Err(_) => std::thread::sleep(Duration::from_millis(300)),
        }
    };
    json_until(&mut operator, |v| v["phase"] == "ready");
    leave.send(()).expect("it stayed");
    stays.unwrap().join().expect("it was answered to the end");
    drop(gone);
}

#[test]
fn what_the_cameras_see_arrives_in_small() {
    let (screen, _requests) = open(None);
    let mut socket = live(&screen);
    let image = Image {
        width: 640,
        height: 400,
        pixels: vec![77; 640 * 400],
        ..Image::default()
    };
    screen.publish_preview("cam1", Preview::of(&image).unwrap());
    loop {
        let bytes = binary(&mut socket);
        if bytes[0] == 2 {
            assert_eq!(bytes[1..10], *b"\x04\xa0\x00\x64\x00cam1");
            assert!(bytes.len() == 10 + 160 * 100 && bytes[10..].iter().all(|grey| *grey == 77));
            break;
        }
    }
}

#[test]
fn states_and_the_map_arrive_and_keys_are_answered() {
    let (screen, requests) = open(None);
    let mut socket = live(&screen);
    let mut state = ScreenState {
        phase: Phase::Recording,
        lost: 7,
        ..ScreenState::default()
    };
    screen.publish(&state);
    let shown = json_until(&mut socket, |v| v["lost"] == 7);
    assert_eq!(shown["phase"], "recording");

    // Seen within a second, whatever the client does.
    state.lost = 8;
    let published = Instant::now();
    screen.publish(&state);
    json_until(&mut socket, |v| v["lost"] == 8);
    assert!(
        published.elapsed() < Duration::from_secs(1),
        "{:?}",
        published.elapsed()
    );

    // In the words that the page reads.
    state.unseen = Some(UnseenMotion {
        kind: UnseenKind::Shift,
        direction_in_map: [0.6, 0.8, 0.0],
    });
    screen.publish(&state);
    let shown = json_until(&mut socket, |v| !v["unseen"].is_null());
    let expected = json!({ "kind": "shift", "direction_in_map": [0.6, 0.8, 0.0] });
    assert_eq!(shown["unseen"], expected);

    let mut map = LiveMap::new(MapConfig::default(), Vec::new());
    let wall: Vec<_> = (0..20)
        .map(|i| Vector3::new(2.0, 0.0, -1.0 + 0.1 * f64::from(i)))
        .collect();
    map.push(Timestamp::from_nanos(0), &Se3::identity(), &wall);
    screen.publish_map(map.snapshot());
    loop {
        let piece = binary(&mut socket);
        assert_eq!(piece[0], 1);
        let cells = u32::from_le_bytes(piece[8..12].try_into().unwrap());
        if cells > 0 {
            // A square of 0.2 m at (2.0, 0.0): number (10, 0), a wall.
            assert_eq!(piece[16..22], [10, 0, 0, 0, 1, 0]);
            break;
        }
    }

    for (key, command) in [
        (json!({ "command": "start" }), Command::Start),
        (json!({ "command": "stop" }), Command::Stop),
        (
            json!({ "command": "note", "text": "Tür offen" }),
            Command::Note {
                text: "Tür offen".to_owned(),
            },
        ),
        (
            json!({ "command": "control-point", "name": "P1" }),
            Command::ControlPoint {
                name: "P1".to_owned(),
            },
        ),
    ] {
        send(&mut socket, &key);
        let request = requests.recv_timeout(PATIENCE).unwrap();
        assert_eq!(request.command, command);
        let refuse = command == Command::Start;
        request.answer(if refuse {
            Err("no disk".to_owned())
        } else {
            Ok("done".to_owned())
        });
        let answer = json_until(&mut socket, |v| v.get("answer").is_some());
        assert_eq!(answer["answer"], key["command"]);
        assert_eq!(
            answer["error"],
            if refuse {
                json!("no disk")
            } else {
                Value::Null
            }
        );
    }
    for nonsense in [
        "",
        "{}",
        "[1]",
        "{\"command\":\"format\"}",
        "{\"command\":\"note\"}",
    ] {
        socket.send(Message::text(nonsense)).unwrap();
        let answer = json_until(&mut socket, |v| v.get("answer").is_some());
        assert!(answer["error"].is_string(), "{nonsense:?}: {answer}");
    }
    drop(requests);
    send(&mut socket, &json!({ "command": "stop" }));
    let answer = json_until(&mut socket, |v| v.get("answer").is_some());
    assert!(
        answer["error"].as_str().unwrap().contains("ended"),
        "{answer}"
    );
}

#[test]
fn without_the_pin_nothing_is_shown_and_nothing_is_taken() {
    let (screen, requests) = open(Some("4711"));
    let mut socket = live(&screen);
    assert_eq!(json_until(&mut socket, |_| true)["pin"], "needed");
    for wrong in [
        json!({ "pin": "4712" }),
        json!({ "command": "stop" }),
        json!({ "pin": "" }),
    ] {
        send(&mut socket, &wrong);
        assert_eq!(json_until(&mut socket, |_| true)["pin"], "wrong");
    }
    assert!(requests.try_recv().is_err());
    send(&mut socket, &json!({ "pin": "4711" }));
    assert_eq!(json_until(&mut socket, |_| true)["pin"], "right");
    json_until(&mut socket, |v| v["phase"] == "ready");
}

/// What is said on the network is read by whoever is there: without TLS the screen is served to this machine alone.
#[test]
fn an_address_that_others_can_reach_needs_tls() {
    let config = ScreenConfig {
        address: Some(SocketAddr::from(([0, 0, 0, 0], 0))),
        pin: Some("4711".to_owned()),
        ..ScreenConfig::default()
    };
    assert!(matches!(Screen::open(&config), Err(Error::Plain { .. })));
    let plain = Listener::open(&Server::start("test").unwrap(), LOOPBACK, None).unwrap();
    let config = ScreenConfig {
        secure: Some(SecureScreen {
            listeners: vec![Arc::new(plain)],
            pin: "4711".to_owned(),
        }),
        ..ScreenConfig::default()
    };
    assert!(matches!(Screen::open(&config), Err(Error::Plain { .. })));
}

/// Nobody tries all PINs from one address: after ten wrong ones within a minute the right one is not taken there either.
#[test]
fn an_address_that_guesses_is_not_let_in() {
    let (screen, requests) = open(Some("4711"));
    let guesses = (0..10).map(|guess| {
        let mut socket = live(&screen);
        json_until(&mut socket, |v| v["pin"] == "needed");
        send(&mut socket, &json!({ "pin": format!("{guess:04}") }));
        socket
    });
    let mut guessing: Vec<_> = guesses.collect();
    for socket in &mut guessing {
        assert_eq!(json_until(socket, |_| true)["pin"], "wrong");
    }
    let mut socket = live(&screen);
    json_until(&mut socket, |v| v["pin"] == "needed");
    send(&mut socket, &json!({ "pin": "4711" }));
    assert_eq!(json_until(&mut socket, |_| true)["pin"], "barred");
    assert!(requests.try_recv().is_err());
}

#[test]
fn a_client_that_does_not_read_holds_nobody() {
    let (screen, _requests) = open(None);
    let _asleep = live(&screen);
    let mut awake = live(&screen);
    let began = Instant::now();
    for lost in 1..=20_000 {
        screen.publish(&ScreenState {
            lost,
            ..ScreenState::default()
        });
    }
    assert!(
        began.elapsed() < Duration::from_secs(2),
        "{:?}",
        began.elapsed()
    );
    json_until(&mut awake, |v| v["lost"] == 20_000);
}

fn imu_message(arrival: Timestamp) -> LiveMessage<'static> {
    LiveMessage {
        topic: "/imu0/data_raw",
        schema_name: message::IMU.name,
        schema_text: message::IMU.text,
        arrival,
    }
}

/// Foxglove knows the messages by their MCAP schemas.
#[test]
fn foxglove_gets_the_recordings_own_messages() {
    let foxglove = Foxglove::open(LOOPBACK, "walk").unwrap();
    let arrival = Timestamp::from_nanos(1_772_359_200_000_000_007);
    let sample = ImuSample {
        angular_velocity_rad_s: [0.1, 0.2, 0.3],
        specific_force_m_s2: [0.0, 0.0, 9.81],
    };
    let bytes = || message::encode_imu(arrival, "imu0", &sample, message::ImuVariance::UNKNOWN);
    // Nobody listens: nothing is made.
    foxglove.publish(&imu_message(arrival), || {
        unreachable!("nobody has subscribed")
    });
    foxglove.publish_latched(
        &LiveMessage {
            topic: "/tf_static",
            schema_name: message::TF_MESSAGE.name,
            schema_text: message::TF_MESSAGE.text,
            arrival,
        },
        vec![0, 1, 0, 0, 9],
    );
    for protocol in ["foxglove.sdk.v1", "foxglove.websocket.v1"] {
        let mut socket = connect(foxglove.address(), "/", protocol);
        let info = json_until(&mut socket, |_| true);
        assert_eq!(
            (&info["op"], &info["sessionId"]),
            (&json!("serverInfo"), &json!("walk"))
        );
        let advertised = json_until(&mut socket, |v| v["op"] == "advertise");
        let channels = advertised["channels"].as_array().unwrap();
        assert_eq!(channels.len(), 2);
        let id = |topic: &str| channels.iter().find(|c| c["topic"] == topic).unwrap()["id"].clone();
        let imu = channels
            .iter()
            .find(|c| c["topic"] == "/imu0/data_raw")
            .unwrap();
        assert_eq!(imu["encoding"], "cdr");
        assert_eq!(imu["schemaEncoding"], "ros2msg");
        assert_eq!(imu["schemaName"], "sensor_msgs/msg/Imu");
        assert_eq!(imu["schema"], message::IMU.text);
        send(
            &mut socket,
            &json!({ "op": "subscribe", "subscriptions": [
                { "id": 70, "channelId": id("/imu0/data_raw") }, { "id": 71, "channelId": id("/tf_static") },
            ] }),
        );
        // What was said once comes with the subscription.
        let latched = binary(&mut socket);
        assert_eq!(latched[..5], [1, 71, 0, 0, 0]);
        assert_eq!(latched[13..], [0, 1, 0, 0, 9]);
        foxglove.publish(&imu_message(arrival), bytes);
        let data = binary(&mut socket);
        assert_eq!(data[..5], [1, 70, 0, 0, 0]);
        assert_eq!(data[5..13], arrival.nanos().to_le_bytes());
        assert_eq!(message::decode_imu(&data[13..]), Ok(sample));

        send(
            &mut socket,
            &json!({ "op": "unsubscribe", "subscriptionIds": [70] }),
        );
        send(
            &mut socket,
            &json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": 99 }] }),
        );
        let status = json_until(&mut socket, |v| v["op"] == "status");
        assert!(
            status["message"].as_str().unwrap().contains("99"),
            "{status}"
        );
        foxglove.publish(&imu_message(arrival), || {
            unreachable!("nobody has subscribed")
        });
        // Asked of other servers, and none of our business.
        send(
            &mut socket,
            &json!({ "op": "getParameters", "parameterNames": [] }),
        );
        send(&mut socket, &json!({ "nonsense": 1 }));
        json_until(&mut socket, |v| v["op"] == "status");
        socket.close(None).unwrap();
        while socket.read().is_ok() {}
    }
    assert!(get(foxglove.address(), "/").contains("Foxglove"));
}

#[test]
fn a_slow_foxglove_misses_messages_and_is_told() {
    let foxglove = Foxglove::open(LOOPBACK, "walk").unwrap();
    let arrival = Timestamp::from_nanos(5);
    foxglove.publish(&imu_message(arrival), Vec::new);
    let mut socket = connect(foxglove.address(), "/", "foxglove.sdk.v1");
    json_until(&mut socket, |v| v["op"] == "advertise");
    let subscribe = json!({ "op": "subscribe", "subscriptions": [{ "id": 3, "channelId": 1 }] });
    send(&mut socket, &subscribe);
    std::thread::sleep(Duration::from_millis(200));
    let began = Instant::now();
    for _ in 0..20_000 {
        foxglove.publish(&imu_message(arrival), || vec![0; 4_096]);
    }
    assert!(
        began.elapsed() < Duration::from_secs(3),
        "{:?}",
        began.elapsed()
    );
    let status = json_until(&mut socket, |v| v["op"] == "status");
    assert!(
        status["message"].as_str().unwrap().contains("left out"),
        "{status}"
    );
}
