//! Byte vectors computed from the format's description by a script of its own.

use super::*;
use crate::WireError;
use crate::test_random::Random;
use crate::transport::uvc::{FrameFormat, XuQuery, XuRefusal, XuSelector};

/// As it lies at the end of a frame: frame 258, 171 323 050 µs, exposure 333.
const TRAILER: &[u8] = &[
    0x00, 0xF7, 0x4D, 0x01, 0xAA, 0x2E, 0x36, 0x0A, 0x00, 0x00, 0x00, 0x00, 0x02, 0x01, 0x0C, 0x3B,
];
/// The largest frame id, a stamp beyond 32 bits, external time.
const EXTERNAL_TRAILER: &[u8] = &[
    0x00, 0x88, 0x01, 0x00, 0x89, 0x67, 0x45, 0x23, 0x01, 0x00, 0x00, 0x00, 0xFF, 0xFF, 0x0C, 0xBB,
];
/// An accelerometer and a gyroscope segment, protocol 1.
const PROTOCOL_1: &[u8] = &[
    0x5B, 0x00, 0x00, 0x2A, 0x00, 0x00, 0x03, 0xE8, 0x00, 0x00, 0x00, 0x00, 0x0A, 0x36, 0x1D, 0xB6,
    0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x2A, 0xAB, 0x00, 0x00, 0x03, 0xE9, 0x00, 0x00, 0x00,
    0x00, 0x0A, 0x36, 0x1D, 0xB6, 0x02, 0x00, 0x00, 0x00, 0x42, 0xFF, 0xBE, 0x00, 0x00, 0x80,
];
/// The same with protocol 2, the second with external time.
const PROTOCOL_2: &[u8] = &[
    0x5B, 0x00, 0x00, 0x3A, 0x00, 0x00, 0x07, 0xD0, 0x00, 0x00, 0x00, 0x00, 0x0A, 0x36, 0x1D, 0xB6,
    0x01, 0x00, 0x00, 0xFC, 0x41, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80,
    0x3F, 0x00, 0x00, 0x07, 0xD1, 0x00, 0x00, 0x00, 0x00, 0x0A, 0x36, 0x1D, 0xB8, 0x06, 0x00, 0x00,
    0xFC, 0x41, 0x00, 0x00, 0x00, 0x3F, 0x00, 0x00, 0x80, 0xBE, 0x00, 0x00, 0x00, 0x3E, 0x88,
];
/// One segment with both sensors.
const PAIRED: &[u8] = &[
    0x5B, 0x00, 0x00, 0x29, 0x00, 0x00, 0x0B, 0xB8, 0x00, 0x00, 0x00, 0x00, 0x0A, 0x36, 0x2E, 0xAA,
    0x03, 0x00, 0x00, 0xFC, 0x41, 0x00, 0x00, 0x00, 0x3F, 0x00, 0x00, 0x80, 0xBE, 0x00, 0x00, 0x00,
    0x3E, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80, 0x3F, 0x35,
];
/// Device information of an S2110.
const DEVICE_INFO: &[u8] = &[
    0x01, 0x00, 0x41, 0x01, 0x00, 0x3E, 0x04, 0xB4, 0x00, 0xF9, 0x4D, 0x59, 0x4E, 0x54, 0x2D, 0x45,
    0x59, 0x45, 0x2D, 0x53, 0x32, 0x31, 0x31, 0x30, 0x20, 0x20, 0x30, 0x37, 0x43, 0x34, 0x31, 0x41,
    0x31, 0x39, 0x30, 0x30, 0x30, 0x39, 0x30, 0x37, 0x31, 0x46, 0x20, 0x20, 0x20, 0x20, 0x00, 0x01,
    0x03, 0x00, 0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x01, 0x00, 0x50, 0x01, 0x04, 0x02, 0x01, 0x02,
    0x01, 0x01, 0x00, 0x00, 0x57,
];

const SMALL: FrameFormat = FrameFormat {
    width: 32,
    height: 3,
};

#[test]
fn trailers_with_every_field() {
    let trailer = Trailer {
        time_source: TimeSource::Device,
        frame_id: 0x0102,
        timestamp_us: 171_323_050,
        exposure_steps: 333,
        checksum: 0xF7,
    };
    assert_eq!(Trailer::parse(TRAILER), Ok(trailer));
    assert_eq!(trailer.emit(), TRAILER);
    assert_eq!(trailer.expected_checksum(), 0xF7);

    let external = Trailer {
        time_source: TimeSource::External,
        frame_id: 65_535,
        timestamp_us: 0x1_2345_6789,
        exposure_steps: 1,
        checksum: 0x88,
    };
    assert_eq!(Trailer::parse(EXTERNAL_TRAILER), Ok(external));
    assert_eq!(external.emit(), EXTERNAL_TRAILER);
    let unsigned = Trailer {
        checksum: 0,
        ..external
    };
    assert_eq!(unsigned.with_checksum(), external);
}

#[test]
fn a_trailer_needs_its_header() {
    let mut bytes = TRAILER.to_vec();
    bytes[15] = 0x3A;
    assert_eq!(
        Trailer::parse(&bytes),
        Err(WireError::Constant {
            offset: 15,
            expected: 0x3B,
            got: 0x3A
        })
    );
    assert_eq!(
        Trailer::parse(&bytes[1..]),
        Err(WireError::Length {
            expected: 16,
            got: 15
        })
    );
}

#[test]
fn a_frame_holds_both_images_and_repairs_the_corner() {
    let left: Vec<u8> = (0..48).collect();
    let right: Vec<u8> = (100..148).collect();
    let trailer = Trailer::parse(TRAILER).unwrap();
    let mut bytes = vec![9; 5];
    emit_frame(SMALL, &[&left, &right], &trailer, &mut bytes).unwrap();
    assert_eq!(bytes.len(), SMALL.frame_bytes());
    // First row: 16 pixels of the left image, then 16 of the right, each with neutral chroma.
    for x in 0..16 {
        assert_eq!(bytes[2 * x..2 * x + 2], [left[x], 128]);
        assert_eq!(bytes[32 + 2 * x..34 + 2 * x], [right[x], 128]);
    }
    assert_eq!(bytes[176..], *TRAILER);

    let frame = Frame::new(&bytes, SMALL).unwrap();
    assert_eq!(frame.trailer(), trailer);
    let mut repaired = right.clone();
    repaired[40..].fill(right[39]);
    assert_eq!(frame.images(2), Ok(vec![left.clone(), repaired.clone()]));

    let mut again = Vec::new();
    emit_frame(SMALL, &[&left, &repaired], &trailer, &mut again).unwrap();
    assert_eq!(again, bytes);
}

#[test]
fn frames_of_both_sizes_round_trip() {
    let mut random = Random::new(3);
    for format in [FrameFormat::S2_1280X400, FrameFormat::S2_2560X800] {
        let count = format.frame_bytes() / 4;
        let mut image = || (0..count).map(|_| random.next() as u8).collect::<Vec<_>>();
        let (left, mut right) = (image(), image());
        let corner = right[count - 9];
        let mut bytes = Vec::new();
        let trailer = Trailer::default().with_checksum();
        emit_frame(format, &[&left, &right], &trailer, &mut bytes).unwrap();
        let frame = Frame::new(&bytes, format).unwrap();
        right[count - 8..].fill(corner);
        assert!(frame.images(2) == Ok(vec![left, right]));
    }
}

#[test]
fn frames_and_images_of_wrong_sizes_are_refused() {
    let trailer = Trailer::default();
    let mut out = Vec::new();
    assert_eq!(
        emit_frame(SMALL, &[&[0; 48], &[0; 47]], &trailer, &mut out),
        Err(WireError::Length {
            expected: 48,
            got: 47
        })
    );
    emit_frame(SMALL, &[&[0; 48], &[0; 48]], &trailer, &mut out).unwrap();
    out.push(0);
    assert_eq!(
        Frame::new(&out, SMALL).unwrap_err(),
        WireError::Length {
            expected: 192,
            got: 193
        }
    );
}

fn segment(serial: u32, timestamp_us: u64, temperature: f32, values: ImuValues) -> ImuSegment {
    ImuSegment {
        serial,
        timestamp_us,
        time_source: TimeSource::Device,
        temperature,
        values,
    }
}

#[test]
fn imu_answers_of_all_layouts() {
    let accelerometer = ImuValues::AccelerometerG([0.0, 0.0, 1.0]);
    let gyroscope = ImuValues::GyroscopeDegS([0.5, -0.25, 0.125]);
    let paired = ImuValues::Paired {
        gyroscope_deg_s: [0.5, -0.25, 0.125],
        accelerometer_g: [0.0, 0.0, 1.0],
    };
    let external = ImuSegment {
        time_source: TimeSource::External,
        ..segment(2001, 171_318_712, 31.5, gyroscope)
    };
    for (bytes, protocol, segments) in [
        (
            PROTOCOL_1,
            ImuProtocol::Integer,
            vec![
                segment(
                    1000,
                    171_318_710,
                    0.0,
                    ImuValues::RawAccelerometer([0, 0, 10_923]),
                ),
                segment(
                    1001,
                    171_318_710,
                    0.0,
                    ImuValues::RawGyroscope([66, -66, 0]),
                ),
            ],
        ),
        (
            PROTOCOL_2,
            ImuProtocol::Float,
            vec![segment(2000, 171_318_710, 31.5, accelerometer), external],
        ),
        (
            PAIRED,
            ImuProtocol::FloatPaired,
            vec![segment(3000, 171_323_050, 31.5, paired)],
        ),
    ] {
        let response = ImuResponse { segments };
        assert_eq!(ImuResponse::parse(protocol, bytes).as_ref(), Ok(&response));
        assert_eq!(response.emit(protocol).unwrap(), bytes);
        // What follows the checksum up to 2000 bytes means nothing.
        let mut padded = bytes.to_vec();
        padded.resize(2000, 0xAA);
        assert_eq!(ImuResponse::parse(protocol, &padded), Ok(response));
    }
}

#[test]
fn imu_answers_name_their_faults() {
    let parse = |bytes: &[u8]| ImuResponse::parse(ImuProtocol::Float, bytes);
    let damaged = |at: usize, value: u8| {
        let mut bytes = PROTOCOL_2.to_vec();
        bytes[at] = value;
        parse(&bytes).unwrap_err()
    };
    assert!(matches!(
        damaged(0, 0x5C),
        WireError::Constant { offset: 0, .. }
    ));
    assert_eq!(
        damaged(1, 2),
        WireError::Value {
            field: "state",
            offset: 1,
            got: 2
        }
    );
    assert!(matches!(damaged(30, 0x99), WireError::Checksum { .. }));
    assert!(matches!(damaged(2, 0xFF), WireError::Length { .. }));
    assert!(matches!(
        parse(&PROTOCOL_2[..60]),
        Err(WireError::Length { .. })
    ));
    // 21-byte segments do not fill 58 bytes.
    assert!(matches!(
        ImuResponse::parse(ImuProtocol::Integer, PROTOCOL_2),
        Err(WireError::Length { .. })
    ));
    // An empty answer is none.
    let empty = [0x5B, 0, 0, 0, 0];
    assert_eq!(parse(&empty), Ok(ImuResponse::default()));
    assert_eq!(
        ImuResponse::default().emit(ImuProtocol::Float).unwrap(),
        empty
    );
    // Layouts are not mixed, and no more than 2000 bytes are sent.
    let one = segment(1, 2, 3.0, ImuValues::GyroscopeDegS([0.0; 3]));
    let mut response = ImuResponse {
        segments: vec![one],
    };
    assert!(response.emit(ImuProtocol::Integer).is_err());
    response.segments = vec![one; 69];
    assert!(response.emit(ImuProtocol::Float).is_err());
    response.segments.pop();
    assert_eq!(response.emit(ImuProtocol::Float).unwrap().len(), 1977);
}

#[test]
fn imu_requests() {
    for (request, bytes) in [
        (ImuRequest::After(0x0102_0304), [0x5A, 1, 2, 3, 4]),
        (ImuRequest::Single, [0x5A, 0, 0, 0, 0]),
        (ImuRequest::Paired, [0x5A, 1, 0, 0, 0]),
    ] {
        assert_eq!(request.emit(), bytes);
        assert_eq!(ImuRequest::parse(request.protocol(), &bytes), Ok(request));
    }
    assert!(ImuRequest::parse(ImuProtocol::Float, &[0x5A, 2, 0, 0, 0]).is_err());
    assert!(ImuRequest::parse(ImuProtocol::Float, &[0x5B, 0, 0, 0, 0]).is_err());
}

fn info() -> DeviceInfo {
    let version = |major, minor| Version { major, minor };
    DeviceInfo {
        usb_vendor: 0x04B4,
        usb_product: 0x00F9,
        name: "MYNT-EYE-S2110".to_owned(),
        serial: "07C41A190009071F".to_owned(),
        spec: version(1, 3),
        lens: [0, 1],
        imu: [0, 1],
        baseline_mm: 80,
        auxiliary_chip: version(1, 4),
        image_processor: version(2, 1),
        firmware: version(2, 1),
        hardware: version(1, 0),
        hardware_flags: 0,
    }
}

#[test]
fn device_information() {
    assert_eq!(DeviceInfo::parse(DEVICE_INFO), Ok(info()));
    assert_eq!(info().emit(), DEVICE_INFO);
    let mut damaged = DEVICE_INFO.to_vec();
    damaged[20] ^= 1;
    assert!(matches!(
        DeviceInfo::parse(&damaged),
        Err(WireError::Checksum { .. })
    ));
    // Another file before it is passed over.
    let mut files = vec![2, 0, 3, 7, 8, 9];
    files.extend(&DEVICE_INFO[3..68]);
    let checksum = files.iter().fold(0, |sum, byte| sum ^ byte);
    let mut both = vec![3, 0, files.len() as u8];
    both.extend(&files);
    both.push(checksum);
    assert_eq!(DeviceInfo::parse(&both), Ok(info()));
    // Without it there is nothing to be read.
    assert!(DeviceInfo::parse(&[2, 0, 0, 0]).is_err());
}

#[test]
fn options_are_set_read_and_bounded() {
    let set = OptionCommand::Set {
        option: CameraOption::ImuFrequency,
        value: 0x0102,
    };
    assert_eq!(set.emit(), [4, 1, 2]);
    let select = OptionCommand::Select(CameraOption::ImuFrequency);
    assert_eq!(select.emit(), [0x84, 0, 0]);
    for option in CameraOption::ALL {
        for command in [
            OptionCommand::Select(option),
            OptionCommand::Set { option, value: 513 },
        ] {
            assert_eq!(OptionCommand::parse(&command.emit()), Ok(command));
        }
    }
    // 7 belongs to another family; three bytes are three bytes.
    assert!(OptionCommand::parse(&[7, 0, 0]).is_err());
    assert!(OptionCommand::parse(&[4, 0]).is_err());
    assert_eq!(
        OptionCommand::parse_value(CameraOption::ImuFrequency, &[4, 1, 2]),
        Ok(0x0102)
    );
    assert!(OptionCommand::parse_value(CameraOption::ImuFrequency, &[5, 1, 2]).is_err());

    let mut table = OptionTable::default();
    table.apply(set).unwrap();
    assert_eq!(table.value(CameraOption::ImuFrequency), 0x0102);
    let too_fast = OptionCommand::Set {
        option: CameraOption::ImuFrequency,
        value: 501,
    };
    assert!(table.apply(too_fast).is_err());
    table.apply(select).unwrap();
    assert_eq!(table.answer(XuQuery::GetCur), Some([4, 1, 2]));
    assert_eq!(table.answer(XuQuery::GetMin), Some([4, 0, 100]));
    assert_eq!(table.answer(XuQuery::GetMax), Some([4, 1, 244]));
    assert_eq!(table.answer(XuQuery::GetDef), Some([4, 0, 200]));
    assert_eq!(table.answer(XuQuery::SetCur), None);
}

fn poll(device: &mut XuDevice, request: ImuRequest) -> Vec<u32> {
    device.set(XuSelector::ImuWrite, &request.emit()).unwrap();
    let bytes = device.get(XuSelector::ImuRead, XuQuery::GetCur).unwrap();
    assert_eq!(bytes.len(), 2000);
    let response = ImuResponse::parse(request.protocol(), &bytes).unwrap();
    response.segments.iter().map(|s| s.serial).collect()
}

#[test]
fn the_device_side_answers_as_a_unit_does() {
    let mut device = XuDevice::new(info(), ImuProtocol::Float);
    let mut request = vec![0; 2000];
    request[0] = DeviceInfo::REQUEST;
    device.set(XuSelector::File, &request).unwrap();
    let answer = device.get(XuSelector::File, XuQuery::GetCur).unwrap();
    assert_eq!(answer.len(), 2000);
    assert_eq!(answer[..69], *DEVICE_INFO);

    // Protocol 2 sends each segment once, as many as fit.
    for serial in 1..=100 {
        device.push_imu(segment(serial, 0, 0.0, ImuValues::GyroscopeDegS([0.0; 3])));
    }
    assert_eq!(
        poll(&mut device, ImuRequest::Single),
        (1..=68).collect::<Vec<_>>()
    );
    assert_eq!(
        poll(&mut device, ImuRequest::Single),
        (69..=100).collect::<Vec<_>>()
    );
    assert!(poll(&mut device, ImuRequest::Single).is_empty());

    // Protocol 1 repeats what is not confirmed.
    let mut old = XuDevice::new(info(), ImuProtocol::Integer);
    for serial in 1..=5 {
        old.push_imu(segment(serial, 0, 0.0, ImuValues::RawGyroscope([0; 3])));
    }
    assert_eq!(poll(&mut old, ImuRequest::After(0)), [1, 2, 3, 4, 5]);
    assert_eq!(poll(&mut old, ImuRequest::After(3)), [4, 5]);
    assert_eq!(poll(&mut old, ImuRequest::After(3)), [4, 5]);

    // What a unit does not know, it refuses.
    let single = ImuRequest::Single.emit();
    assert_eq!(
        device.set(XuSelector::ImuWrite, &ImuRequest::Paired.emit()),
        Err(XuRefusal)
    );
    assert_eq!(
        device.set(XuSelector::ImuWrite, &single[..4]),
        Err(XuRefusal)
    );
    assert_eq!(device.set(XuSelector::HalfDuplex, &[0; 20]), Err(XuRefusal));
    assert_eq!(
        device.get(XuSelector::ImuRead, XuQuery::GetCur),
        Err(XuRefusal)
    );
    assert_eq!(
        device.get(XuSelector::ImuRead, XuQuery::GetMin),
        Err(XuRefusal)
    );
}

#[test]
fn selectors_and_queries_keep_their_numbers() {
    for id in 0..=255 {
        if let Some(selector) = XuSelector::from_id(id) {
            assert_eq!(selector.id(), id);
        }
        if let Some(query) = XuQuery::from_code(id) {
            assert_eq!(query.code(), id);
        }
    }
    assert_eq!(XuSelector::from_id(5), Some(XuSelector::File));
    assert_eq!(XuQuery::from_code(0x87), Some(XuQuery::GetDef));
}

#[test]
fn no_bytes_make_the_parsers_panic() {
    let mut random = Random::new(4);
    for round in 0..20_000 {
        for seed in [TRAILER, PROTOCOL_1, PROTOCOL_2, PAIRED, DEVICE_INFO] {
            let mut bytes = seed.to_vec();
            if round % 4 == 0 {
                bytes = random.bytes(80);
            } else {
                random.mutate(&mut bytes);
            }
            if let Ok(trailer) = Trailer::parse(&bytes) {
                trailer.emit();
            }
            for protocol in [
                ImuProtocol::Integer,
                ImuProtocol::Float,
                ImuProtocol::FloatPaired,
            ] {
                if let Ok(response) = ImuResponse::parse(protocol, &bytes) {
                    response.emit(protocol).unwrap();
                }
                let _ = ImuRequest::parse(protocol, &bytes);
            }
            if let Ok(info) = DeviceInfo::parse(&bytes) {
                info.emit();
            }
            let _ = OptionCommand::parse(&bytes);
            let _ = Frame::new(&bytes, SMALL);
        }
    }
}

#[test]
fn older_units_tell_less_about_themselves() {
    let version = |major, minor| Version { major, minor };
    for (minor, len) in [(0, 49), (1, 49), (2, 53), (3, 62)] {
        let has_chips = minor >= 2;
        let has_usb = minor >= 3;
        let expected = DeviceInfo {
            usb_vendor: if has_usb { 0x04B4 } else { 0 },
            usb_product: if has_usb { 0x00F9 } else { 0 },
            name: "MYNT-EYE-S2000".to_owned(),
            serial: "0123456789ABCDEF".to_owned(),
            spec: version(1, minor),
            lens: [1, 2],
            imu: [3, 4],
            baseline_mm: 120,
            auxiliary_chip: if has_chips {
                version(5, 6)
            } else {
                version(0, 0)
            },
            image_processor: if has_chips {
                version(7, 8)
            } else {
                version(0, 0)
            },
            firmware: version(2, 3),
            hardware: version(2, 0),
            hardware_flags: 9,
        };
        let answer = expected.emit();
        // Envelope, file header, file, checksum.
        assert_eq!(answer.len(), 3 + 3 + len + 1);
        assert_eq!(DeviceInfo::parse(&answer), Ok(expected.clone()));
        if minor == 2 {
            // Name, serial, firmware, hardware with its flag, spec, lens, IMU, baseline, chips.
            assert_eq!(answer[6 + 32..6 + 39], [2, 3, 2, 0, 9, 1, 2]);
            assert_eq!(answer[6 + 39..6 + 49], [0, 1, 0, 2, 0, 3, 0, 4, 0, 120]);
        }
        // A layout that its spec version does not have.
        let mut wrong = answer;
        let at = 6 + if has_usb { 42 } else { 38 };
        let other = if has_usb { 2 } else { 3 };
        let end = wrong.len() - 1;
        wrong[end] ^= wrong[at] ^ other;
        wrong[at] = other;
        assert!(matches!(
            DeviceInfo::parse(&wrong),
            Err(WireError::Value { .. })
        ));
    }
}
