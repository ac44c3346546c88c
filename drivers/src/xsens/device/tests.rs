use std::thread;

use super::*;
use crate::transport::serial::Pty;
use crate::xsens::wire::{Item, Vector};
use crate::xsens::{Decoder, Framer, ImuReading};

/// A unit on a pseudo-terminal that answers requests, and then sends `packets` at full speed.
struct MockUnit {
    pty: Pty,
    framer: Framer,
    refuse: Option<u8>,
    accepted_rate_hz: u16,
}

impl MockUnit {
    fn new() -> Self {
        Self {
            pty: Pty::open().unwrap(),
            framer: Framer::new(512),
            refuse: None,
            accepted_rate_hz: 200,
        }
    }

    fn config(&self) -> ImuConfig {
        ImuConfig {
            path: self.pty.path().to_owned(),
            ..Default::default()
        }
    }

    fn send(&mut self, id: u8, data: &[u8]) -> Result<(), Error> {
        let mut bytes = Vec::new();
        Message { id, data }.emit(&mut bytes).unwrap();
        self.pty.send(&bytes)
    }

    /// Answers until measuring begins.
    fn configure(&mut self) -> Result<(), Error> {
        loop {
            if let Some(bytes) = self.pty.recv(Duration::from_secs(5))? {
                self.framer.push(Default::default(), &bytes);
            }
            while let Some(request) = self.framer.next_message() {
                if self.refuse == Some(request.id) {
                    self.send(message::ERROR, &[4])?;
                    continue;
                }
                match request.id {
                    message::REQ_DID => self.send(1, &[0x03, 0x80, 0xA2, 0xC1])?,
                    message::SET_OUTPUT_CONFIGURATION => {
                        let mut settings = OutputSetting::parse_all(&request.data).unwrap();
                        for setting in &mut settings {
                            if setting.rate_hz == 200 {
                                setting.rate_hz = self.accepted_rate_hz;
                            }
                        }
                        self.send(0xC1, &OutputSetting::emit_all(&settings))?;
                    }
                    message::GO_TO_MEASUREMENT => return self.send(0x11, &[]),
                    id => self.send(id + 1, &[])?,
                }
            }
        }
    }

    fn send_packets(&mut self, count: u32) -> Result<(), Error> {
        for i in 0..count {
            let items = [
                Item::PacketCounter(i as u16),
                Item::SampleTimeFine(50 * i),
                Item::Acceleration(Vector::single([0.0, 0.0, 9.8125])),
                Item::RateOfTurn(Vector::single([0.0, 0.0, f64::from(i)])),
            ];
            let mut data = Vec::new();
            for item in &items {
                item.emit(&mut data).unwrap();
            }
            self.send(message::MT_DATA2, &data)?;
        }
        Ok(())
    }
}

fn read_to_end(imu: &mut XsensImu) -> (Vec<ImuReading>, u64) {
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut readings = Vec::new();
    loop {
        match imu.recv(Duration::from_secs(5)) {
            Ok(packet) => decoder.push(&packet.expect("the unit went silent")),
            Err(Error::EndOfStream { .. }) => break,
            Err(e) => panic!("{e}"),
        }
        while let Some(reading) = decoder.next_reading() {
            readings.push(reading.sample);
        }
    }
    (readings, decoder.counters().skipped_bytes)
}

#[test]
fn a_minute_at_full_speed_arrives_complete() {
    const PACKETS: u32 = 200 * 60;
    let mut unit = MockUnit::new();
    let config = unit.config();
    let mock = thread::Builder::new()
        .name("mock-imu".to_owned())
        .spawn(move || {
            unit.configure()?;
            unit.send_packets(PACKETS)?;
            unit.pty.finish(Duration::from_secs(20))
        })
        .unwrap();
    let mut imu = XsensImu::open(&config).unwrap();
    assert_eq!(imu.id(), DeviceId(0x0380_A2C1));
    let (readings, skipped_bytes) = read_to_end(&mut imu);
    mock.join().unwrap().unwrap();
    assert_eq!((readings.len(), skipped_bytes), (PACKETS as usize, 0));
    for (i, reading) in readings.iter().enumerate() {
        let sample = reading.sample.unwrap();
        assert_eq!(sample.angular_velocity_rad_s[2], i as f64);
    }
    // The end stays the end.
    assert!(matches!(
        imu.recv(Duration::ZERO),
        Err(Error::EndOfStream { .. })
    ));
}

#[test]
fn refusals_and_other_rates_are_errors() {
    for (refuse, accepted_rate_hz, expected) in [
        (
            Some(message::SET_OUTPUT_CONFIGURATION),
            200,
            "rejected request 0xc0",
        ),
        (None, 100, "choose a rate it can deliver"),
    ] {
        let mut unit = MockUnit {
            refuse,
            accepted_rate_hz,
            ..MockUnit::new()
        };
        let config = unit.config();
        let mock = thread::Builder::new()
            .name("mock-imu".to_owned())
            .spawn(move || unit.configure())
            .unwrap();
        let error = XsensImu::open(&config).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        // The driver gave up and closed the line: the unit notices.
        assert!(matches!(mock.join().unwrap(), Err(Error::Lost { .. })));
    }
}

#[test]
fn a_driver_that_goes_away_does_not_block_the_unit() {
    let mut unit = MockUnit::new();
    let config = unit.config();
    let mock = thread::Builder::new()
        .name("mock-imu".to_owned())
        .spawn(move || {
            unit.configure()?;
            unit.send_packets(u32::MAX)
        })
        .unwrap();
    let mut imu = XsensImu::open(&config).unwrap();
    imu.recv(Duration::from_secs(5)).unwrap().unwrap();
    drop(imu);
    assert!(matches!(mock.join().unwrap(), Err(Error::Lost { .. })));
}

#[test]
fn an_absent_line_is_named() {
    let config = ImuConfig {
        path: "/nonexistent/imu".into(),
        ..Default::default()
    };
    let error = XsensImu::open(&config).unwrap_err().to_string();
    assert!(
        error.starts_with("/nonexistent/imu: cannot open"),
        "{error}"
    );
}
