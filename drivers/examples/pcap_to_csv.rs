//! Writes the points of a LiDAR's capture as CSV: `pcap_to_csv FILE.pcap [DATA_PORT] > points.csv`.

use std::error::Error;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use lsfb_drivers::any_lidar::{Decoder, Settings, whose};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_types::LidarScan;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments
        .next()
        .ok_or("usage: pcap_to_csv FILE.pcap [DATA_PORT]")?;
    let port = arguments.next().map_or(Ok(2368), |port| port.parse())?;
    let mut source = PcapSource::open(Path::new(&path), &[port])?;
    let mut decoder = Decoder::new(Settings::default());
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    writeln!(out, "scan,x_m,y_m,z_m,intensity,ring,echo,time_ns")?;
    let mut scans = 0;
    let mut write = |scan: &LidarScan| -> std::io::Result<()> {
        scans += 1;
        for point in &scan.points {
            let [x, y, z] = point.position_m;
            let (ring, echo, time_ns) = (point.ring, point.echo, point.time_offset_ns);
            writeln!(
                out,
                "{scans},{x},{y},{z},{},{ring},{echo:?},{time_ns}",
                point.intensity
            )?;
        }
        Ok(())
    };
    loop {
        match source.recv(Duration::ZERO) {
            // What is no packet of the sensor is passed over.
            Ok(Some(packet)) => {
                if let Ok(Some(scan)) = decoder.push(&packet) {
                    write(&scan.sample)?;
                }
            }
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
            Err(error) => return Err(error.into()),
        }
    }
    while let Some(scan) = decoder.finish() {
        write(&scan.sample)?;
    }
    if decoder.counters().packets == 0 {
        let beside = source.survey().describe(whose);
        return Err(format!("no packet of a LiDAR to port {port}; beside it: {beside}").into());
    }
    Ok(())
}
