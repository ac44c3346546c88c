//! Whatever a rig sends, whenever it arrives: packets of every device through the functions used live, into a recording.
#![no_main]


use libfuzzer_sys::fuzz_target;
use lsfb_capture::{
    CameraUnitConfig, DevicesConfig, ImuFamily, ImuLineConfig, Incoming, LidarNetConfig,
    RecorderConfig, SidecarConfig, record_incoming,
};
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_drivers::mynt_s::wire::{TimeSource, Trailer, emit_frame};
use lsfb_drivers::xsens::wire::Message;
use lsfb_drivers::microstrain::wire::MipPacket;
use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_drivers::sidecar::credentials::DeviceKey;
use lsfb_drivers::sidecar::wire::{Advertise, Hello};
use lsfb_drivers::velodyne::wire::{DATA_PACKET_LEN, POSITION_PACKET_LEN};
use lsfb_recording::{Compression, Existing, LAST_STAMP};
use lsfb_types::{Packet, Timestamp};

const FRAME_PX: [u32; 2] = [16, 2];
/// Kind, length, four bytes of time.
const HEAD: usize = 6;
const MOST_ITEMS: usize = 64;

fn config(family: u8) -> DevicesConfig {
    let unit = |names: [&str; 2]| CameraUnitConfig {
        frame_px: FRAME_PX,
        imu: None,
        ..CameraUnitConfig::stereo("".into(), names.map(str::to_owned))
    };
    DevicesConfig {
        lidars: vec![LidarNetConfig::default()],
        cameras: vec![unit(["cam0", "cam1"]), unit(["cam2", "cam3"])],
        imus: vec![ImuLineConfig {
            name: "imu0".to_owned(),
            family: match family % 4 {
                0 => ImuFamily::Xsens,
                1 => ImuFamily::Microstrain,
                2 => ImuFamily::Sbg,
                _ => ImuFamily::MyntD,
            },
            path: "".into(),
            baud: 115_200,
            rate_hz: 100,
        }],
        sidecar: Some(SidecarConfig::new(
            ([127, 0, 0, 1], 0).into(),
            "sidecar".into(),
        )),
        recorder: RecorderConfig {
            compression: Compression::None,
            existing: Existing::Replace,
            least_space_secs: 0.0,
            reserve_bytes: 0,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    }
}

fn data_packet(given: &[u8]) -> Vec<u8> {
    let at = |k: usize| given.get(k).copied().unwrap_or(k as u8);
    let azimuth = u16::from_le_bytes([at(0), at(1)]);
    let mut bytes = vec![at(2); DATA_PACKET_LEN];
    for block in 0..12u16 {
        let start = 100 * usize::from(block);
        bytes[start..start + 2].copy_from_slice(&[0xFF, 0xEE]);
        let turned = azimuth.wrapping_add(block.wrapping_mul(at(3).into())) % 36_000;
        bytes[start + 2..start + 4].copy_from_slice(&turned.to_le_bytes());
    }
    bytes[1200..1204].copy_from_slice(&[at(4), at(5), at(6), at(7)]);
    bytes[1204..].copy_from_slice(&[0x37 + (at(8) & 3), 0x21 + (at(9) & 15)]);
    bytes
}

fn position_packet(given: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; POSITION_PACKET_LEN];
    for (to, from) in bytes[0xBB..].iter_mut().zip(given) {
        *to = *from;
    }
    bytes
}

fn imu_packet(family: u8, given: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    match family % 4 {
        0 => {
            let message = Message {
                id: 0x36,
                data: given,
            };
            // What is too long is sent as it is.
            let _ = message.emit(&mut bytes);
        }
        1 => {
            let packet = MipPacket {
                descriptor_set: 0x80,
                payload: given,
            };
            let _ = packet.emit(&mut bytes);
        }
        2 => {
            bytes.extend(given);
            bytes.resize(16, 0);
            bytes[1] &= 7;
            (bytes[2], bytes[3], bytes[4]) = (0, 0, 8);
        }
        _ => {
            bytes.extend(given);
            bytes.resize(63, 0);
            bytes.push(bytes[3..].iter().fold(0, |sum, byte| sum ^ byte));
        }
    }
    if bytes.is_empty() {
        given.to_vec()
    } else {
        bytes
    }
}

fn frame(given: &[u8]) -> Vec<u8> {
    let at = |k: usize| given.get(k).copied().unwrap_or_default();
    let trailer = Trailer {
        time_source: if at(0) & 1 == 0 {
            TimeSource::Device
        } else {
            TimeSource::External
        },
        frame_id: u16::from_le_bytes([at(1), at(2)]),
        timestamp_us: u64::from_le_bytes([at(3), at(4), at(5), at(6), at(7), at(8), 0, at(9)]),
        exposure_steps: u16::from_le_bytes([at(10), at(11)]),
        checksum: 0,
    }
    .with_checksum();
    let format = FrameFormat {
        width: FRAME_PX[0],
        height: FRAME_PX[1],
    };
    let mut bytes = Vec::new();
    let image = [at(12); 16];
    let _ = emit_frame(format, &[&image, &image], &trailer, &mut bytes);
    bytes
}

fn said(given: &[u8]) -> SidecarMessage {
    let (&kind, rest) = given.split_first().unwrap_or((&0, &[]));
    let number = |rest: &[u8]| rest.first().copied().unwrap_or_default();
    match kind & 3 {
        0 => SidecarMessage::Hello(Hello::parse(rest).unwrap_or(Hello {
            session: "fuzz".to_owned(),
            first_unacked: 1,
            device: "glasses".to_owned(),
            device_key: DeviceKey([0; 32]),
            pairing_token: None,
        })),
        1 => SidecarMessage::Advertise(Advertise::parse(rest).unwrap_or_default()),
        2 => SidecarMessage::Data {
            channel: u32::from(kind >> 2) & 7,
            seq: number(rest).into(),
            device_time_ns: rest.first_chunk().map_or(0, |b| i64::from_le_bytes(*b)),
            payload: rest.get(8..).unwrap_or_default().to_vec(),
        },
        _ => SidecarMessage::Bye {
            last_seq: number(rest).into(),
        },
    }
}

fuzz_target!(|data: &[u8]| {
    let Some((&family, mut data)) = data.split_first() else {
        return;
    };
    let mut items = Vec::new();
    let mut arrival = Timestamp::from_nanos(1_772_359_200_000_000_000);
    while let Some((&[kind, len, a, b, c, d], rest)) = data.split_first_chunk::<HEAD>()
        && items.len() < MOST_ITEMS
    {
        let time = i32::from_le_bytes([a, b, c, d]);
        // Of a host's clock that no recording can hold nothing is asked.
        let nanos = if kind & 0x80 == 0 {
            arrival.nanos() + i64::from(time) * 1_000
        } else {
            i64::from(time & i32::MAX) * 1_000_000_000
        };
        arrival = Timestamp::from_nanos(nanos.clamp(0, LAST_STAMP.nanos()));
        let (given, after) = rest.split_at(usize::from(len).min(rest.len()));
        data = after;
        let packet = |bytes| Packet { arrival, bytes };
        items.push(match kind & 7 {
            0 => Incoming::Lidar { lidar: 0, packet: packet(data_packet(given)) },
            1 => Incoming::Lidar { lidar: 0, packet: packet(position_packet(given)) },
            2 => Incoming::Lidar { lidar: 0, packet: packet(given.to_vec()) },
            3 => Incoming::Imu { imu: 0, packet: packet(imu_packet(family, given)) },
            4 | 5 => Incoming::Frame {
                unit: usize::from(kind & 1),
                packet: packet(frame(given)),
            },
            _ => Incoming::Sidecar {
                arrival,
                message: said(given),
            },
        });
    }
    let out = std::env::temp_dir().join(format!("lsfb-fuzz-{}-incoming.mcap", std::process::id()));
    let taken = items.into_iter();
    let report = record_incoming(
        taken,
        &config(family),
        &out,
        &lsfb_types::no_progress,
    );
    let report = report.expect("a scratch file");
    assert!(report.failure.is_none(), "{:?}", report.failure);
});
