use std::thread;

use super::*;
use crate::microstrain::wire::Field;
use crate::microstrain::{Decoder, MipReading, MipUnit};
use crate::transport::serial::Pty;

const SAMPLES: u64 = 2_000;

/// A unit on a pseudo-terminal that takes commands until it may stream, and then sends `count` packets.
fn serve(mut pty: Pty, mut unit: MipUnit, count: u64) -> Result<MipUnit, Error> {
    // It may still be sending when its host comes.
    pty.send(&packet(0, 1_000_000))?;
    while !unit.is_streaming() {
        if let Some(bytes) = pty.recv(Duration::from_secs(5))? {
            let answer = unit.handle(&bytes).unwrap();
            pty.send(&answer)?;
        }
    }
    let decimation = u64::from(unit.format()[0].decimation);
    for n in 1..=count {
        pty.send(&packet(n, decimation * 1_000_000))?;
    }
    pty.finish(Duration::from_secs(10))?;
    Ok(unit)
}

fn packet(n: u64, period_ns: u64) -> Vec<u8> {
    let fields = [
        Field::ReferenceTimeNs(n * period_ns),
        Field::ReferenceDeltaNs(period_ns),
        Field::AccelerometerG([0.0, 0.0, 1.0]),
        Field::GyroscopeRadS([0.0, 0.0, n as f32]),
    ];
    let (mut payload, mut bytes) = (Vec::new(), Vec::new());
    for field in &fields {
        field.emit(&mut payload).unwrap();
    }
    let packet = MipPacket {
        descriptor_set: set::SENSOR,
        payload: &payload,
    };
    packet.emit(&mut bytes).unwrap();
    bytes
}

fn start(base_rate_hz: u16) -> (MipConfig, thread::JoinHandle<Result<MipUnit, Error>>) {
    let pty = Pty::open().unwrap();
    let config = MipConfig {
        path: pty.path().to_owned(),
        ..MipConfig::default()
    };
    let mock = thread::Builder::new()
        .name("mock-mip".to_owned())
        .spawn(move || serve(pty, MipUnit::new(base_rate_hz), SAMPLES))
        .unwrap();
    (config, mock)
}

#[test]
fn a_unit_is_configured_and_every_sample_arrives() {
    let (config, mock) = start(1000);
    let mut imu = MipImu::open(&config).unwrap();
    assert_eq!(imu.base_rate_hz(), 1000);
    let mut decoder = Decoder::new();
    let mut readings: Vec<MipReading> = Vec::new();
    loop {
        match imu.recv(Duration::from_secs(5)) {
            Ok(packet) => decoder.push(&packet.expect("the unit went silent")),
            Err(Error::EndOfStream { .. }) => break,
            Err(error) => panic!("{error}"),
        }
        readings.extend(std::iter::from_fn(|| decoder.next_reading()).map(|r| r.sample));
    }
    let unit = mock.join().unwrap().unwrap();
    let expected = FIELDS.map(|descriptor| FormatEntry {
        descriptor,
        decimation: 5,
    });
    assert_eq!(unit.format(), expected);
    assert_eq!(readings.len() as u64, SAMPLES);
    for (reading, n) in readings.iter().zip(1u32..) {
        let sample = reading.sample.unwrap();
        assert_eq!(sample.angular_velocity_rad_s, [0.0, 0.0, f64::from(n)]);
        assert_eq!(sample.specific_force_m_s2, [0.0, 0.0, 9.806_65]);
    }
    let counters = decoder.counters();
    assert_eq!(
        (counters.readings, counters.missing, counters.skipped_bytes),
        (SAMPLES, 0, 0)
    );
}

#[test]
fn a_rate_that_does_not_divide_and_a_refusal_are_errors() {
    let (config, _mock) = start(500);
    let error = MipImu::open(&config).unwrap_err().to_string();
    assert!(
        error.contains("200 Hz is not possible with the unit's 500 Hz"),
        "{error}"
    );

    let (config, mock) = start(0);
    let error = MipImu::open(&config).unwrap_err().to_string();
    assert!(error.contains("0 Hz"), "{error}");
    // Its host has gone.
    assert!(mock.join().unwrap().is_err());

    // What the unit does not take is refused, and said so.
    let mut unit = MipUnit::new(1000);
    let command = Command::MessageFormat {
        data_set: set::FILTER,
        entries: Vec::new(),
    };
    let mut request = Vec::new();
    command.emit(&mut request).unwrap();
    let answer = unit.handle(&request).unwrap();
    let packet = MipPacket::parse(&answer).unwrap().unwrap().packet;
    let (ack, _) = answer_of(&packet, set::THREE_DM).unwrap();
    assert_eq!((ack.descriptor, ack.code), (command.descriptor(), 3));
}
