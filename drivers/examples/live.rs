//! Shows the scans of a LiDAR on the network: `live [DATA_PORT]`. Whatever sends first decides what it is.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use std::error::Error;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use lsfb_drivers::any_lidar::{Decoder, Settings};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::udp::{UdpConfig, UdpSource};

fn main() -> Result<(), Box<dyn Error>> {
    let port = std::env::args()
        .nth(1)
        .map_or(Ok(2368), |port| port.parse())?;
    let mut source = UdpSource::bind(&UdpConfig {
        binds: vec![SocketAddr::from((Ipv4Addr::UNSPECIFIED, port))],
        sender: None,
        receive_buffer_bytes: 8 << 20,
    })?;
    let mut decoder = Decoder::new(Settings::default());
    loop {
        let Some(packet) = source.recv(Duration::from_secs(1))? else {
            println!("nothing arrives at port {port}");
            continue;
        };
        match decoder.push(&packet) {
            Ok(Some(scan)) => {
                let model = decoder.found().map(|found| found.model.to_string());
                println!(
                    "{} at {:?}: {} points, {} packets lost, {} dropped by the kernel",
                    model.unwrap_or_default(),
                    source.sender(),
                    scan.sample.points.len(),
                    decoder.counters().lost,
                    source.kernel_drops()
                );
            }
            Ok(None) => {}
            Err(error) => println!("{error}"),
        }
    }
}
