//! Prints what an Xsens unit measures: `imu /dev/ttyUSB0 [BAUD]`.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use std::error::Error;
use std::time::Duration;

use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::xsens::{Decoder, DecoderConfig, ImuConfig, XsensImu, model};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: imu /dev/ttyUSB0 [BAUD]")?;
    let baud = arguments
        .next()
        .map_or(Ok(model::DEFAULT_BAUD), |baud| baud.parse())?;
    let mut unit = XsensImu::open(&ImuConfig {
        path: path.into(),
        baud,
        rate_hz: 100,
    })?;
    let mut decoder = Decoder::new(DecoderConfig::default());
    loop {
        let Some(packet) = unit.recv(Duration::from_secs(1))? else {
            println!("silent for a second");
            continue;
        };
        decoder.push(&packet);
        while let Some(reading) = decoder.next_reading() {
            if let Some(sample) = reading.sample.sample {
                println!(
                    "{:>10} {:+.4?} rad/s {:+.3?} m/s²",
                    reading.device_ticks, sample.angular_velocity_rad_s, sample.specific_force_m_s2
                );
            }
        }
    }
}
