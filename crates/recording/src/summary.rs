//! The end of an MCAP file in an order that does not depend on hash seeds: same messages, same bytes.

/// How rosbag2 marks a latched topic: keep the last message, reliable, transient local.
pub(crate) const TRANSIENT_LOCAL: &str = "- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
";

const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const RECORD_HEAD_BYTES: usize = 9;
const DATA_END_BYTES: usize = RECORD_HEAD_BYTES + 4;
const FOOTER_BYTES: usize = RECORD_HEAD_BYTES + 20;
const CRC_BYTES: usize = 4;

/// Reorders the schemas and the channels of the summary by their numbers and renews its checksum. `end` runs from the
/// data-end record to the end of the file. Each group keeps its size and place, so that no offset changes.
pub(crate) fn in_fixed_order(end: &[u8]) -> Vec<u8> {
    let mut sorted = end.to_vec();
    let footer_start = end.len().saturating_sub(FOOTER_BYTES + mcap::MAGIC.len());
    let Some(summary) = end.get(DATA_END_BYTES..footer_start) else {
        return sorted;
    };
    let mut records = split_records(summary);
    // Stable: only schemas among themselves and channels among themselves change places, each within its group.
    for opcode in [SCHEMA, CHANNEL] {
        let group = records.iter_mut().filter(|r| r[0] == opcode);
        let mut group: Vec<_> = group.collect();
        let mut by_number: Vec<&[u8]> = group.iter().map(|r| **r).collect();
        by_number.sort_by_key(|r| {
            r.get(RECORD_HEAD_BYTES..RECORD_HEAD_BYTES + 2)
                .map(|n| [n[1], n[0]])
        });
        for (slot, record) in group.iter_mut().zip(by_number) {
            **slot = record;
        }
    }
    sorted.truncate(DATA_END_BYTES);
    records.iter().for_each(|r| sorted.extend_from_slice(r));
    sorted.extend_from_slice(&end[sorted.len()..]);
    let crc_at = footer_start + FOOTER_BYTES - CRC_BYTES;
    let crc = crc32fast::hash(&sorted[DATA_END_BYTES..crc_at]);
    sorted[crc_at..crc_at + CRC_BYTES].copy_from_slice(&crc.to_le_bytes());
    sorted
}

fn split_records(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut records = Vec::new();
    while let Some(length) = bytes.get(1..RECORD_HEAD_BYTES) {
        let length = length
            .iter()
            .rev()
            .fold(0, |value, byte| value << 8 | usize::from(*byte));
        let Some((record, rest)) = bytes.split_at_checked(RECORD_HEAD_BYTES + length) else {
            break;
        };
        records.push(record);
        bytes = rest;
    }
    records
}
