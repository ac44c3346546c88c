//! Parts of a recording that a phone sends afterwards, in any order and more than once, damaged and cut off: each is kept once, whole.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lsfb_capture::PairingFolder;
use lsfb_drivers::sidecar::credentials::{DeviceKey, to_hex};
use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest as _, Sha256};
use tokio_rustls::rustls;

use super::*;

const SEGMENTS: u32 = 6;
const SESSION: &str = "walk-1";

/// An app that uploads.
struct Uploader {
    rig: SocketAddr,
    tls: Arc<rustls::ClientConfig>,
    key: DeviceKey,
}

impl Uploader {
    /// Status of a segment that is sent up to a byte.
    fn put(&self, number: u32, bytes: &[u8], digest: &[u8], end: usize) -> u16 {
        let name = "lsfb-rig".try_into().unwrap();
        let connection = rustls::ClientConnection::new(Arc::clone(&self.tls), name).unwrap();
        let tcp = TcpStream::connect(self.rig).unwrap();
        let mut stream = rustls::StreamOwned::new(connection, tcp);
        let head = format!(
            "PUT /v1/sessions/{SESSION}/segments/{number} HTTP/1.1\r\nHost: rig\r\nAuthorization: Bearer visor.{}\r\nContent-Length: {}\r\n\
             Digest: sha-256={}\r\nConnection: close\r\n\r\n",
            to_hex(&self.key.0),
            bytes.len(),
            STANDARD.encode(digest),
        );
        // Who is refused may be answered before all is sent.
        let _ = stream
            .write_all(head.as_bytes())
            .and_then(|()| stream.write_all(&bytes[..end]))
            .and_then(|()| stream.flush());
        if end < bytes.len() {
            stream.sock.shutdown(Shutdown::Both).unwrap();
            return 0;
        }
        let mut answer = Vec::new();
        // Nor does every server say that it ends.
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8_lossy(&answer).into_owned();
        let status = answer.split(' ').nth(1).and_then(|s| s.parse().ok());
        status.unwrap_or_else(|| panic!("{number}: {answer}"))
    }
}

/// A whole recording of one note.
fn segment(folder: &Path, number: u32) -> Vec<u8> {
    let path = folder.join(format!("sent{number}.mcap"));
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    let channel = Channel {
        topic: "/sidecar/visor/note",
        schema_name: "std_msgs/msg/UInt32",
        schema_text: "uint32 data",
    };
    let time = Timestamp::from_nanos(START_NS + i64::from(number));
    let payload = [&[0, 1, 0, 0][..], &number.to_le_bytes()].concat();
    writer.write_cdr(&channel, time, time, &payload).unwrap();
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn segments_in_any_order_are_kept_once_and_whole() {
    let folder = tempfile::tempdir().unwrap();
    let sidecar = mock::sidecar(folder.path());
    PairingFolder::open(&sidecar.folder).unwrap();
    let certificate = std::fs::read(sidecar.folder.join("certificate.der")).unwrap();
    let config = DevicesConfig {
        sidecar: Some(sidecar),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let invited = mock::invited(&session, folder.path());
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificate.into()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let tls = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let app = Uploader {
        rig: session.sidecar_address().unwrap(),
        tls: Arc::new(tls),
        key: invited.device_key,
    };
    let out = folder.path().join("walk.mcap");
    let running = {
        let out = out.clone();
        mock::spawn("session", move || run(session, &out))
    };
    let mut visor = mock::visor(invited);
    mock::send_note(&mut visor, 0);
    let sent: Vec<Vec<u8>> = (0..SEGMENTS).map(|n| segment(folder.path(), n)).collect();
    for seed in 0..8 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut order: Vec<u32> = (0..SEGMENTS).chain(0..SEGMENTS).collect();
        order.shuffle(&mut rng);
        let mut stored = [seed > 0; SEGMENTS as usize];
        for number in order {
            let bytes = &sent[number as usize];
            let digest = Sha256::digest(bytes);
            app.put(number, bytes, &digest, bytes.len() / 2);
            assert_eq!(app.put(number, bytes, &[7; 32], bytes.len()), 400);
            let expected = if stored[number as usize] { 200 } else { 201 };
            assert_eq!(app.put(number, bytes, &digest, bytes.len()), expected);
            stored[number as usize] = true;
            let other = &sent[((number + 1) % SEGMENTS) as usize];
            assert_eq!(
                app.put(number, other, &Sha256::digest(other), other.len()),
                409
            );
        }
    }
    visor.bye().unwrap();
    assert_eq!(running.join().unwrap().lost, 0);
    let kept = out.with_extension("segments").join("visor").join(SESSION);
    let mut names: Vec<String> = std::fs::read_dir(&kept)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected: Vec<String> = (0..SEGMENTS).map(|n| format!("{n}.mcap")).collect();
    assert_eq!(names, expected);
    for (name, bytes) in names.iter().zip(&sent) {
        assert_eq!(&std::fs::read(kept.join(name)).unwrap(), bytes, "{name}");
    }
}
