//! CDR messages of a recording.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_recording::message;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    match kind % 7 {
        0 => drop(message::decode_image(data)),
        1 => drop(message::decode_imu(data)),
        2 => drop(message::decode_time_reference(data)),
        3 => drop(message::decode_velodyne_scan(data)),
        4 => drop(message::decode_points(data)),
        5 => drop(message::decode_raw_packet(data)),
        _ => drop(message::decode_frame_meta(data)),
    }
});
