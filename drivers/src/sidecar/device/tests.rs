use super::*;
use crate::sidecar::model::CLOCK_UTC;
use crate::sidecar::wire::{Advertise, Hello};
use crate::sidecar::{ClientConfig, SidecarClient};

const TIMEOUT: Duration = Duration::from_secs(5);

fn bind() -> (SidecarServer, ClientConfig) {
    let server = SidecarServer::bind(&SidecarConfig {
        address: SocketAddr::from(([127, 0, 0, 1], 0)),
        ..Default::default()
    })
    .unwrap();
    let config = ClientConfig {
        address: server.address(),
        ack_timeout_secs: 5,
        ..Default::default()
    };
    (server, config)
}

fn spawn<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> JoinHandle<T> {
    thread::Builder::new()
        .name("glasses".to_owned())
        .spawn(work)
        .unwrap()
}

fn images() -> Advertise {
    Advertise {
        channel: 1,
        topic: "/sidecar/glasses/cam0/image".to_owned(),
        encoding: "cdr".to_owned(),
        schema_name: "sensor_msgs/msg/Image".to_owned(),
        schema: b"uint32 height".to_vec(),
        clock_id: CLOCK_UTC.to_owned(),
        metadata_json: "{\"rig_toml\":\"[imu]\"}".to_owned(),
    }
}

fn next(server: &mut SidecarServer) -> SidecarEvent {
    server.recv(TIMEOUT).unwrap().expect("nothing arrived")
}

#[test]
fn a_walk_of_images_arrives_complete_through_a_small_window() {
    const IMAGES: u64 = 200;
    let (mut server, config) = bind();
    let glasses = spawn(move || -> Result<(), Error> {
        let mut client = SidecarClient::connect(config)?;
        client.advertise(&images())?;
        let mut payload = vec![0; 256_000];
        for i in 0..IMAGES {
            payload[..8].copy_from_slice(&i.to_le_bytes());
            client.send(1, 100 * i.cast_signed(), &payload)?;
        }
        client.bye()
    });
    let SidecarEvent::Message { message, .. } = next(&mut server) else {
        panic!("no hello");
    };
    let hello = Hello {
        session: "session".to_owned(),
        first_unacked: 1,
        device: "glasses".to_owned(),
    };
    assert_eq!(message, SidecarMessage::Hello(hello));
    let SidecarEvent::Message { message, .. } = next(&mut server) else {
        panic!("no channel");
    };
    assert_eq!(message, SidecarMessage::Advertise(images()));
    for i in 0..IMAGES {
        let SidecarEvent::Message {
            connection,
            arrival,
            message:
                SidecarMessage::Data {
                    channel,
                    seq,
                    device_time_ns,
                    payload,
                },
        } = next(&mut server)
        else {
            panic!("no data");
        };
        assert_eq!((connection, channel, seq), (1, 1, i + 1));
        assert_eq!(device_time_ns, 100 * i.cast_signed());
        assert!(arrival.nanos() > 0);
        assert_eq!(
            (payload.len(), &payload[..8]),
            (256_000, &i.to_le_bytes()[..])
        );
    }
    assert!(matches!(
        next(&mut server),
        SidecarEvent::Message {
            message: SidecarMessage::Bye { last_seq: IMAGES },
            ..
        }
    ));
    let SidecarEvent::Closed {
        counters, error, ..
    } = next(&mut server)
    else {
        panic!("not closed");
    };
    assert!(error.is_none(), "{error:?}");
    assert_eq!(
        counters,
        SidecarCounters {
            data: IMAGES,
            payload_bytes: IMAGES * 256_000,
            ..Default::default()
        }
    );
    glasses.join().unwrap().unwrap();
}

#[test]
fn nothing_is_acknowledged_before_it_is_stored() {
    let (mut server, config) = bind();
    let config = ClientConfig {
        window_messages: 2,
        ack_timeout_secs: 1,
        ..config
    };
    let glasses = spawn(move || -> Result<(), Error> {
        let mut client = SidecarClient::connect(config)?;
        client.advertise(&images())?;
        (0..3).try_for_each(|i| client.send(1, i, &[0]))
    });
    // The caller takes the first message and never comes back for the next.
    for _ in 0..3 {
        next(&mut server);
    }
    let error = glasses.join().unwrap().unwrap_err().to_string();
    assert!(error.contains("2 messages are under way"), "{error}");
}

/// A client that says whatever it likes.
fn raw_client(server: &SidecarServer) -> WebSocketConnection {
    let mut socket = WebSocketConnection::connect(server.address(), ENDPOINT).unwrap();
    let payload = Hello {
        session: "s".to_owned(),
        first_unacked: 1,
        device: "d".to_owned(),
    }
    .emit();
    socket
        .send(envelope(EnvelopeKind::Hello, 0, &payload))
        .unwrap();
    let payload = images().emit();
    socket
        .send(envelope(EnvelopeKind::Advertise, 0, &payload))
        .unwrap();
    socket
}

fn envelope(kind: EnvelopeKind, seq: u64, payload: &[u8]) -> Vec<u8> {
    let envelope = Envelope {
        channel: 1,
        payload,
        ..Envelope::bare(kind, seq)
    };
    envelope.emit().unwrap()
}

/// What the connection met, and why it closed, after all its messages.
fn closed(server: &mut SidecarServer) -> (SidecarCounters, Option<Error>) {
    loop {
        if let SidecarEvent::Closed {
            counters, error, ..
        } = next(server)
        {
            return (counters, error);
        }
    }
}

#[test]
fn damaged_repeated_and_missing_messages_are_counted() {
    let (mut server, _) = bind();
    let mut socket = raw_client(&server);
    socket.send(envelope(EnvelopeKind::Data, 1, &[1])).unwrap();
    let mut damaged = envelope(EnvelopeKind::Data, 2, &[1]);
    let at = damaged.len() - 1;
    damaged[at] ^= 1;
    socket.send(damaged).unwrap();
    for seq in [3, 3, 6] {
        socket
            .send(envelope(EnvelopeKind::Data, seq, &[1]))
            .unwrap();
    }
    socket.send(vec![0xFF; 9]).unwrap();
    socket.send(envelope(EnvelopeKind::Bye, 6, &[])).unwrap();
    let (counters, error) = closed(&mut server);
    assert!(error.is_none());
    assert_eq!(
        counters,
        SidecarCounters {
            data: 3,
            payload_bytes: 3,
            bad_checksum: 1,
            malformed: 1,
            missing: 3,
            duplicated: 1,
        }
    );
    // The last acknowledgement covers everything that came.
    let mut last_ack = 0;
    while let Ok(Some(packet)) = socket.recv(TIMEOUT) {
        last_ack = Envelope::parse(&packet.bytes).unwrap().seq;
    }
    assert_eq!(last_ack, 6);
}

#[test]
fn an_app_that_vanishes_is_lost_and_others_go_on() {
    let (mut server, config) = bind();
    let mut socket = raw_client(&server);
    socket.send(envelope(EnvelopeKind::Data, 1, &[1])).unwrap();
    drop(socket);
    let (counters, error) = closed(&mut server);
    assert_eq!(counters.data, 1);
    assert!(matches!(error, Some(Error::Lost { .. })), "{error:?}");

    let glasses = spawn(move || SidecarClient::connect(config)?.bye());
    let (counters, error) = closed(&mut server);
    assert_eq!(
        (counters, error.is_none()),
        (SidecarCounters::default(), true)
    );
    glasses.join().unwrap().unwrap();
}

#[test]
fn too_long_messages_end_the_connection() {
    let (mut server, config) = bind();
    let mut socket = raw_client(&server);
    // The other side may close before all of it is sent.
    let _ = socket.send(vec![0; MAX_ENVELOPE_BYTES + 1]);
    let (_, error) = closed(&mut server);
    assert!(matches!(error, Some(Error::Protocol { .. })), "{error:?}");
    let mut client = SidecarClient::connect(config).unwrap();
    let error = client.send(1, 0, &vec![0; MAX_ENVELOPE_BYTES]).unwrap_err();
    assert!(error.to_string().contains("cannot be sent"), "{error}");
}

#[test]
fn other_paths_and_protocols_are_refused() {
    let (server, _) = bind();
    for (endpoint, expected) in [
        (
            Endpoint {
                path: "/v2/stream",
                ..ENDPOINT
            },
            "404 Not Found: the stream is at /v1/stream",
        ),
        (
            Endpoint {
                subprotocol: "foxglove.websocket.v1",
                ..ENDPOINT
            },
            "only subprotocol lsfb.sidecar.v1 is spoken",
        ),
    ] {
        let error = WebSocketConnection::connect(server.address(), endpoint).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn a_rig_that_stops_is_noticed_by_the_app() {
    let (mut server, config) = bind();
    let mut client = SidecarClient::connect(config).unwrap();
    client.advertise(&images()).unwrap();
    next(&mut server);
    drop(server);
    let outcome = (0..1000).try_for_each(|i| client.send(1, i, &[0; 1000]));
    assert!(outcome.is_err());
}
