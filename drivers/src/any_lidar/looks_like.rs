//! Whose packets those are that no decoder here takes. Lengths and first bytes are those of the vendors' manuals.

/// The sensor that a datagram seems to be of: one that is not decoded here.
pub fn looks_like(bytes: &[u8]) -> Option<&'static str> {
    let byte = |at: usize| bytes.get(at).copied().unwrap_or_default();
    match (bytes.len(), bytes) {
        // Ouster's legacy profile: 16 columns of 16, 32, 64 or 128 pixels of 12 bytes, 20 bytes around each.
        (3_392 | 6_464 | 12_608 | 24_896, _) => Some("Ouster"),
        // Its profiles of one or two returns: packet type 1, then the number of the sensor's start.
        (1_280.., [0x01, 0x00, ..]) if bytes.len().is_multiple_of(64) => Some("Ouster"),
        // RoboSense MSOP: RS-16 and RS-32, then the newer header.
        (1_248, [0x55, 0xAA, 0x05, 0x0A, ..] | [0x55, 0xAA, 0x05, 0x5A, ..]) => Some("RoboSense"),
        (_, [0xA5, 0xFF, 0x00, 0x5A, ..]) => Some("RoboSense"),
        // Livox SDK 2: protocol version 0, then the length of the whole.
        (1_380, [0x00, ..]) if u16::from_le_bytes([byte(1), byte(2)]) == 1_380 => Some("Livox"),
        (_, [0xEE, 0xFF, ..]) => Some("Hesai"),
        // Blocks of Pandar20 and Pandar40 begin with the flag of Velodyne's.
        (1_262 | 1_266, [0xFF, 0xEE, ..]) => Some("Hesai Pandar40P"),
        _ => None,
    }
}
