//! Messages of the camera socket, towards the host and towards the unit.
#![no_main]

use std::io::Write;
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::mynt_s::wire::{DeviceInfo, ImuProtocol, XuDevice};
use lsfb_drivers::transport::uvc::{XuQuery, XuSelector};
use lsfb_drivers::transport::camera_socket::{CameraListener, SocketLink};

fuzz_target!(|data: &[u8]| {
    let name = |side| std::env::temp_dir().join(format!("lsfb-fuzz-{}-{side}", std::process::id()));
    let path = name("host");
    let _ = std::fs::remove_file(&path);
    let unit = UnixListener::bind(&path).expect("a scratch socket");
    let mut link = SocketLink::connect(&path).expect("it listens");
    let (mut socket, _) = unit.accept().expect("it connected");
    let data = data.get(..4096).unwrap_or(data);
    socket.write_all(data).expect("it fits the buffer");
    // Closed for writing alone: a write into a closed socket would be a signal here, below libFuzzer's `main`.
    socket.shutdown(Shutdown::Write).expect("it is open");
    let _ = link.xu_get(XuSelector::CamCtrl, XuQuery::GetCur);
    while let Ok(Some(_)) = link.next_frame(Duration::ZERO) {}

    let path = name("unit");
    let listener = CameraListener::bind(&path).expect("a scratch socket");
    let mut host = UnixStream::connect(&path).expect("it listens");
    host.write_all(data).expect("it fits the buffer");
    host.shutdown(Shutdown::Write).expect("it is open");
    let mut unit = listener
        .accept(Duration::from_secs(1))
        .expect("it connected")
        .expect("it connected");
    // Replies need a reader: a unit waits for its host, and the buffer between them holds a few hundred.
    let mut replies = host.try_clone().expect("a second handle");
    let reader = std::thread::spawn(move || std::io::copy(&mut replies, &mut std::io::sink()));
    let mut device = XuDevice::new(DeviceInfo::default(), ImuProtocol::Float);
    while let Ok(Some(_)) = device.serve(&mut unit, Duration::ZERO) {}
    drop(unit);
    let _ = reader.join();
});
