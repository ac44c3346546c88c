//! CDR messages of a recording.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_recording::message;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    match kind % 19 {
        0 => drop(message::decode_image(data)),
        1 => drop(message::decode_imu(data)),
        2 => drop(message::decode_time_reference(data)),
        3 => {
            for schema in message::lidar_packet_types() {
                drop(message::decode_lidar_packets(schema, data));
            }
        }
        4 => {
            drop(message::decode_cloud(message::Layout::Cdr, data));
            drop(message::decode_cloud(message::Layout::Ros1, data));
        }
        5 => drop(message::decode_raw_packet(data)),
        6 => drop(message::decode_frame_meta(data)),
        7 => drop(message::decode_clock_model(data)),
        8 => drop(message::decode_camera_group(data)),
        9 => drop(message::decode_health_value(data)),
        10 => drop(message::decode_remark(data)),
        11 => drop(message::decode_wifi(data)),
        12 => {
            drop(message::decode_ble(data));
            drop(message::Beacon::decode(data));
        }
        13 => drop(message::decode_magnetic(data)),
        14 => drop(message::decode_pressure(data)),
        15 => drop(message::decode_gnss(data)),
        16 => drop(message::decode_wifi_scan(data)),
        17 => drop(message::decode_vector(data)),
        _ => drop(message::decode_orientation(data)),
    }
});
