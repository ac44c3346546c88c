use std::io::Write;
use std::os::unix::net::UnixListener;
use std::thread::{self, JoinHandle};

use tempfile::TempDir;

use super::*;
use crate::transport::uvc::XuRefusal;

fn listen() -> (TempDir, std::path::PathBuf, CameraListener) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("camera");
    let listener = CameraListener::bind(&path).unwrap();
    (dir, path, listener)
}

fn spawn<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> JoinHandle<T> {
    thread::Builder::new()
        .name("mock-camera".to_owned())
        .spawn(work)
        .unwrap()
}

/// A unit that writes exactly these bytes and closes.
fn raw_unit(bytes: Vec<u8>) -> (TempDir, SocketLink) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("camera");
    let listener = UnixListener::bind(&path).unwrap();
    let link = SocketLink::connect(&path).unwrap();
    let (mut socket, _) = listener.accept().unwrap();
    socket.write_all(&bytes).unwrap();
    (dir, link)
}

fn message(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![kind, 0, 0, 0];
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(body);
    bytes
}

const TIMEOUT: Duration = Duration::from_secs(5);

#[test]
fn a_slow_host_blocks_the_unit_and_loses_nothing() {
    let (_dir, path, listener) = listen();
    let mock = spawn(move || {
        let mut unit = listener.accept(TIMEOUT).unwrap().unwrap();
        let mut frame = vec![0; 1_024_000];
        for i in 0..40u32 {
            frame[..4].copy_from_slice(&i.to_le_bytes());
            unit.send_frame(&frame).unwrap();
        }
        unit.finish().unwrap();
    });
    let mut link = SocketLink::connect(&path).unwrap();
    for i in 0..40u32 {
        if i % 10 == 0 {
            thread::sleep(Duration::from_millis(5));
        }
        let packet = link.next_frame(TIMEOUT).unwrap().unwrap();
        assert_eq!(packet.bytes.len(), 1_024_000);
        assert_eq!(packet.bytes[..4], i.to_le_bytes());
    }
    for _ in 0..2 {
        assert!(matches!(
            link.next_frame(TIMEOUT),
            Err(Error::EndOfStream { .. })
        ));
    }
    mock.join().unwrap();
}

#[test]
fn a_frame_in_pieces_is_kept_across_timeouts() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("camera");
    let listener = UnixListener::bind(&path).unwrap();
    let mut link = SocketLink::connect(&path).unwrap();
    let (mut socket, _) = listener.accept().unwrap();
    let bytes = message(3, &[1, 2, 3, 4, 5, 6]);
    for piece in bytes.chunks(5) {
        assert_eq!(link.next_frame(Duration::from_millis(1)).unwrap(), None);
        socket.write_all(piece).unwrap();
    }
    let packet = link.next_frame(TIMEOUT).unwrap().unwrap();
    assert_eq!(packet.bytes, [1, 2, 3, 4, 5, 6]);
    assert!(packet.arrival.nanos() > 0);
}

#[test]
fn a_unit_that_vanishes_is_lost_wherever_it_stops() {
    let whole = message(3, &[7; 100]);
    for len in [0, 3, 8, 50, 107] {
        let (_dir, mut link) = raw_unit(whole[..len].to_vec());
        let error = link.next_frame(TIMEOUT).unwrap_err();
        assert!(matches!(error, Error::Lost { .. }), "{len}: {error}");
    }
}

#[test]
fn broken_framing_is_an_error_and_no_allocation() {
    let mut endless = message(3, &[]);
    endless[4..].copy_from_slice(&u32::MAX.to_le_bytes());
    for (bytes, expected) in [
        (endless, "a message of 4294967295 bytes"),
        (message(77, &[]), "message kind 77"),
        (message(1, &[0; 12]), "unexpected message"),
    ] {
        let (_dir, mut link) = raw_unit(bytes);
        let error = link.next_frame(TIMEOUT).unwrap_err();
        assert!(matches!(error, Error::Protocol { .. }));
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn transactions_pass_and_are_refused() {
    let (_dir, path, listener) = listen();
    let mock = spawn(move || {
        let mut unit = listener.accept(TIMEOUT).unwrap().unwrap();
        let mut requests = Vec::new();
        while let Ok(request) = unit.next_request(TIMEOUT) {
            match request.clone().unwrap() {
                UnitRequest::XuSet { selector, .. } => {
                    // A frame that was already on its way.
                    unit.send_frame(&[8; 10]).unwrap();
                    unit.reply_set(selector, Ok(())).unwrap();
                }
                UnitRequest::XuGet { selector, query } => {
                    let outcome = match query {
                        XuQuery::GetCur => Ok(vec![1, 2, 3]),
                        XuQuery::GetMin => Ok(vec![1]),
                        _ => Err(XuRefusal),
                    };
                    unit.reply_get(selector, query, outcome).unwrap();
                }
                UnitRequest::Start { .. } => {}
            }
            requests.push(request.unwrap());
        }
        requests
    });
    let mut link = SocketLink::connect(&path).unwrap();
    link.start(FrameFormat::S2_2560X800, 20).unwrap();
    let selector = XuSelector::CamCtrl;
    link.xu_set(selector, &[4, 0, 200]).unwrap();
    assert_eq!(link.xu_get(selector, XuQuery::GetCur).unwrap(), [1, 2, 3]);
    let wrong_length = link.xu_get(selector, XuQuery::GetMin).unwrap_err();
    assert!(wrong_length.to_string().contains("1 bytes in a reply"));
    let refused = link.xu_get(selector, XuQuery::GetDef).unwrap_err();
    assert!(refused.to_string().contains("rejected query 0x87"));
    assert_eq!(link.recv(TIMEOUT).unwrap().unwrap().bytes, [8; 10]);
    drop(link);
    assert_eq!(
        mock.join().unwrap(),
        [
            UnitRequest::Start {
                format: FrameFormat::S2_2560X800,
                rate_hz: 20
            },
            UnitRequest::XuSet {
                selector,
                bytes: vec![4, 0, 200]
            },
            UnitRequest::XuGet {
                selector,
                query: XuQuery::GetCur
            },
            UnitRequest::XuGet {
                selector,
                query: XuQuery::GetMin
            },
            UnitRequest::XuGet {
                selector,
                query: XuQuery::GetDef
            },
        ]
    );
}

#[test]
fn a_host_that_vanishes_is_noticed() {
    let (_dir, path, listener) = listen();
    let link = SocketLink::connect(&path).unwrap();
    let mut unit = listener.accept(TIMEOUT).unwrap().unwrap();
    assert_eq!(unit.next_request(Duration::from_millis(1)).unwrap(), None);
    drop(link);
    assert!(matches!(
        unit.next_request(TIMEOUT),
        Err(Error::Lost { .. })
    ));
    assert!(matches!(
        unit.send_frame(&[0; 1 << 20]),
        Err(Error::Lost { .. })
    ));
    drop(listener);
    assert!(!path.exists());
    assert!(matches!(
        SocketLink::connect(&path),
        Err(Error::Open { .. })
    ));
}
