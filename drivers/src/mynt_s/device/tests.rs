use std::thread;

use tempfile::TempDir;

use super::*;
use crate::mynt_s::wire::{
    ImuSegment, ImuValues, TimeSource, Trailer, Version, XuDevice, emit_frame,
};
use crate::mynt_s::{Decoder, DecoderConfig, ImuDecoder};
use crate::transport::camera_socket::{CameraListener, CameraUnit, UnitRequest};

const FRAMES: u16 = 20;

fn listen() -> (TempDir, CameraListener, CameraConfig) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mynt");
    let listener = CameraListener::bind(&path).unwrap();
    let config = CameraConfig {
        path,
        serial: "07C41A19".to_owned(),
        options: vec![(CameraOption::ImuFrequency, 250)],
        ..Default::default()
    };
    (dir, listener, config)
}

fn new_device() -> XuDevice {
    let info = DeviceInfo {
        serial: "07C41A19".to_owned(),
        spec: Version { major: 1, minor: 3 },
        ..Default::default()
    };
    XuDevice::new(info, ImuProtocol::Float)
}

fn serve_until_start(unit: &mut CameraUnit, device: &mut XuDevice) -> Result<u32, Error> {
    loop {
        if let Some(UnitRequest::Start { format, rate_hz }) =
            device.serve(unit, Duration::from_secs(5))?
        {
            assert_eq!(format, FrameFormat::S2_1280X400);
            return Ok(rate_hz);
        }
    }
}

fn spawn<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> thread::JoinHandle<T> {
    thread::Builder::new()
        .name("mock-camera".to_owned())
        .spawn(work)
        .unwrap()
}

#[test]
fn a_unit_is_configured_streams_and_ends() {
    let (_dir, listener, config) = listen();
    let mock = spawn(move || -> Result<u16, Error> {
        let mut device = new_device();
        let mut unit = listener.accept(Duration::from_secs(5))?.unwrap();
        assert_eq!(serve_until_start(&mut unit, &mut device)?, 10);
        let mut reads = 0;
        let pixels = vec![50; 640 * 400];
        let mut bytes = Vec::new();
        for frame_id in 0..FRAMES {
            let trailer = Trailer {
                frame_id,
                timestamp_us: 100_000 * u64::from(frame_id),
                ..Default::default()
            };
            let trailer = trailer.with_checksum();
            emit_frame(
                FrameFormat::S2_1280X400,
                &[&pixels, &pixels],
                &trailer,
                &mut bytes,
            )
            .unwrap();
            for (serial, values) in [
                (1, ImuValues::AccelerometerG([0.0, 0.0, 1.0])),
                (2, ImuValues::GyroscopeDegS([0.0; 3])),
            ] {
                device.push_imu(ImuSegment {
                    serial: 2 * u32::from(frame_id) + serial,
                    timestamp_us: trailer.timestamp_us,
                    time_source: TimeSource::Device,
                    temperature: 30.0,
                    values,
                });
            }
            // Requests that have come meanwhile.
            while let Some(request) = device.serve(&mut unit, Duration::ZERO)? {
                reads += u32::from(matches!(request, UnitRequest::XuGet { .. }));
            }
            unit.send_frame(&bytes)?;
        }
        // Five polls and one option.
        while reads < 6 {
            let request = device.serve(&mut unit, Duration::from_secs(5))?;
            reads += u32::from(matches!(request, Some(UnitRequest::XuGet { .. })));
        }
        unit.finish()?;
        Ok(device.options().value(CameraOption::ImuFrequency))
    });

    let mut camera = MyntCamera::open(&config).unwrap();
    assert_eq!(camera.info().serial, "07C41A19");
    let mut frames = Decoder::new(DecoderConfig::default());
    let mut imu = ImuDecoder::new(camera.imu_protocol());
    let mut samples = 0;
    for expected in 0..u32::from(FRAMES) {
        if expected % 5 == 0 {
            // Frames that come before the answer are kept.
            let answer = camera.poll_imu(imu.last_serial()).unwrap();
            samples += imu.push(&answer).unwrap().len();
        }
        let packet = camera.recv(Duration::from_secs(5)).unwrap().unwrap();
        let pair = frames.push(&packet).unwrap().unwrap();
        assert_eq!(pair.sample.images[0].frame_id, expected);
        assert_eq!(pair.sample.images[0].pixels, vec![50; 640 * 400]);
        assert_eq!(pair.device_ticks, 100_000 * u64::from(expected));
    }
    assert_eq!(camera.option(CameraOption::ImuFrequency).unwrap(), 250);
    let answer = camera.poll_imu(imu.last_serial()).unwrap();
    samples += imu.push(&answer).unwrap().len();
    assert_eq!((imu.counters().segments, imu.counters().missing), (40, 0));
    assert!(samples >= 19, "{samples}");
    for _ in 0..2 {
        assert!(matches!(
            camera.recv(Duration::from_secs(5)),
            Err(Error::EndOfStream { .. })
        ));
    }
    assert_eq!(mock.join().unwrap().unwrap(), 250);
}

#[test]
fn swapped_units_and_refused_options_are_errors() {
    for (change, expected) in [
        (
            CameraConfig {
                serial: "OTHER".to_owned(),
                ..Default::default()
            },
            "are the cables swapped",
        ),
        (
            CameraConfig {
                options: vec![(CameraOption::ImuFrequency, 9000)],
                ..Default::default()
            },
            "rejected query 0x01 of selector 1",
        ),
    ] {
        let (_dir, listener, config) = listen();
        let mock = spawn(move || {
            let mut unit = listener.accept(Duration::from_secs(5))?.unwrap();
            serve_until_start(&mut unit, &mut new_device())
        });
        let config = CameraConfig {
            path: config.path,
            ..change
        };
        let error = MyntCamera::open(&config).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(matches!(mock.join().unwrap(), Err(Error::Lost { .. })));
    }
}

/// Serves until the stream starts, then sends `frames`; the unit afterwards.
fn run_unit(
    listener: CameraListener,
    mut device: XuDevice,
    frames: Vec<Vec<u8>>,
) -> thread::JoinHandle<Result<(CameraUnit, XuDevice), Error>> {
    spawn(move || {
        let mut unit = listener.accept(Duration::from_secs(5))?.unwrap();
        serve_until_start(&mut unit, &mut device)?;
        for frame in frames {
            unit.send_frame(&frame)?;
        }
        Ok((unit, device))
    })
}

#[test]
fn exposure_and_gain_are_set_and_read_back() {
    for exposure in [
        Exposure::Automatic {
            max_gain: 48,
            max_exposure_steps: 200,
            desired_brightness: 100,
        },
        Exposure::Manual {
            gain: 32,
            exposure: 120,
        },
    ] {
        let (_dir, listener, config) = listen();
        let mock = run_unit(listener, new_device(), Vec::new());
        let config = CameraConfig { exposure, ..config };
        let _camera = MyntCamera::open(&config).unwrap();
        let (unit, device) = mock.join().unwrap().unwrap();
        let option = |option| device.options().value(option);
        match exposure {
            Exposure::Manual { .. } => {
                assert_eq!(option(CameraOption::ExposureMode), 1);
                assert_eq!(unit.control(ImageControl::Gain), Some(32));
                assert_eq!(unit.control(ImageControl::Brightness), Some(120));
            }
            _ => {
                assert_eq!(option(CameraOption::ExposureMode), 0);
                assert_eq!(option(CameraOption::MaxGain), 48);
                assert_eq!(option(CameraOption::MaxExposureTime), 200);
                assert_eq!(option(CameraOption::DesiredBrightness), 100);
                assert_eq!(unit.control(ImageControl::Gain), None);
            }
        }
    }
    let (_dir, listener, config) = listen();
    let _mock = run_unit(listener, new_device(), Vec::new());
    let exposure = Exposure::Manual {
        gain: 5_000,
        exposure: 1,
    };
    let error = MyntCamera::open(&CameraConfig { exposure, ..config }).unwrap_err();
    assert!(error.to_string().contains("rejected"), "{error}");
}

#[test]
fn the_calibration_that_a_unit_carries_is_read() {
    let (_dir, listener, config) = listen();
    let images = ImageCalibration {
        version: Version { major: 1, minor: 2 },
        resolutions: Vec::new(),
    };
    let mut device = new_device();
    device.set_file(UnitFile::Images, &images.emit().unwrap());
    let mock = spawn(move || -> Result<(), Error> {
        let mut unit = listener.accept(Duration::from_secs(5))?.unwrap();
        serve_until_start(&mut unit, &mut device)?;
        while device.serve(&mut unit, Duration::from_secs(5))?.is_some() {}
        Ok(())
    });
    let mut camera = MyntCamera::open(&config).unwrap();
    assert_eq!(camera.image_calibration().unwrap(), images);
    // This unit has none of its IMU.
    let error = camera.imu_calibration().unwrap_err().to_string();
    assert!(
        error.contains("rejected query 0x01 of selector 5"),
        "{error}"
    );
    drop(camera);
    assert!(mock.join().unwrap().is_err());
}

#[test]
fn a_unit_that_stamps_the_end_of_exposure_5_ms_late_shows_both() {
    use crate::mynt_s::{StampInstant, Trigger};
    // The truth: the middle of each exposure of 4 ms. The unit stamps its end, and 5 ms late.
    const DELAY_US: u64 = 5_000;
    const HALF_EXPOSURE_US: u64 = 2_000;
    let truth_us = |n: u64| 1_000_000 + 100_000 * n;
    let pixels = vec![50; 640 * 400];
    let frame = |n: u16| {
        let trailer = Trailer {
            frame_id: n,
            timestamp_us: truth_us(n.into()) + HALF_EXPOSURE_US + DELAY_US,
            exposure_steps: 40,
            ..Default::default()
        };
        let mut bytes = Vec::new();
        let trailer = trailer.with_checksum();
        emit_frame(
            FrameFormat::S2_1280X400,
            &[&pixels, &pixels],
            &trailer,
            &mut bytes,
        )
        .unwrap();
        bytes
    };
    let (_dir, listener, config) = listen();
    // Trigger 2 is skipped.
    let mock = run_unit(listener, new_device(), [0, 1, 3].map(frame).to_vec());
    let mut camera = MyntCamera::open(&config).unwrap();
    let mut decoder = Decoder::new(DecoderConfig {
        stamp: StampInstant::ExposureEnd,
        ..DecoderConfig::default()
    });
    for n in [0, 1, 3] {
        let packet = camera.recv(Duration::from_secs(5)).unwrap().unwrap();
        let pair = decoder.push(&packet).unwrap().unwrap();
        assert_eq!(pair.sample.trigger, Trigger { epoch: 0, index: n });
        let middle_us = pair.device_ticks as i64 + pair.sample.mid_exposure_from_stamp_ns / 1_000;
        // The exposure is taken out; the delay is constant, and left to the calibration of the time offset.
        assert_eq!(middle_us, (truth_us(n) + DELAY_US) as i64);
    }
    mock.join().unwrap().unwrap();
}

#[test]
fn a_unit_of_an_older_spec_speaks_protocol_1() {
    let (_dir, listener, config) = listen();
    let mock = spawn(move || -> Result<(), Error> {
        let info = DeviceInfo {
            serial: "07C41A19".to_owned(),
            spec: Version { major: 1, minor: 2 },
            ..Default::default()
        };
        let mut device = XuDevice::new(info, ImuProtocol::Integer);
        for serial in 1..=7 {
            let raw = [serial as i16, 0, 0];
            let values = if serial % 2 == 1 {
                ImuValues::RawAccelerometer(raw)
            } else {
                ImuValues::RawGyroscope(raw)
            };
            device.push_imu(ImuSegment {
                serial,
                timestamp_us: 2_500 * u64::from(serial),
                time_source: TimeSource::Device,
                temperature: 0.0,
                values,
            });
        }
        let mut unit = listener.accept(Duration::from_secs(5))?.unwrap();
        serve_until_start(&mut unit, &mut device)?;
        while device.serve(&mut unit, Duration::from_secs(5))?.is_some() {}
        Ok(())
    });
    let mut camera = MyntCamera::open(&config).unwrap();
    assert_eq!(camera.imu_protocol(), ImuProtocol::Integer);
    let mut decoder = ImuDecoder::new(camera.imu_protocol());
    // An answer that never arrived is asked for again; what came twice is left out.
    camera.poll_imu(decoder.last_serial()).unwrap();
    let mut samples = Vec::new();
    for _ in 0..2 {
        let answer = camera.poll_imu(0).unwrap();
        samples.extend(decoder.push(&answer).unwrap());
    }
    assert_eq!(decoder.last_serial(), 7);
    let answer = camera.poll_imu(decoder.last_serial()).unwrap();
    assert_eq!(decoder.push(&answer), Ok(Vec::new()));
    let ticks: Vec<u64> = samples.iter().map(|sample| sample.device_ticks).collect();
    assert_eq!(ticks, [5_000, 10_000, 15_000]);
    let counters = decoder.counters();
    assert_eq!(
        (counters.segments, counters.duplicated, counters.missing),
        (7, 7, 0)
    );
    drop(camera);
    assert!(mock.join().unwrap().is_err());
}
