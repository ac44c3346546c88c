//! The doctor on a file that is far larger than memory: only its indexes are looked at.
//!
//! ```sh
//! LSFB_LARGE_GB=100 cargo test --release -p lsfb-recording -p lsfb-capture --test large -- --nocapture
//! ```
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::Instant;

use lsfb_capture::doctor::{DoctorConfig, examine};
use lsfb_recording::Recording;
use lsfb_types::{Verdict, no_progress};

const START: u64 = 1_772_359_200_000_000_000;
/// Four images of a megabyte each, every 50 ms.
const CHUNK_BYTES: u64 = 4 << 20;
const CHUNK_NS: u64 = 50_000_000;
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// A record, by the specification of MCAP.
fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut out = vec![opcode];
    out.extend((body.len() as u64).to_le_bytes());
    out.extend(body);
    out
}

fn text(value: &str) -> Vec<u8> {
    [&(value.len() as u32).to_le_bytes(), value.as_bytes()].concat()
}

/// A recording whose chunks are holes in the file, with a silence of a second after `gap_after` chunks.
fn sparse_recording(path: &Path, chunks: u64, gap_after: u64) {
    let file = File::create(path).unwrap();
    let header = record(0x01, &[text("ros2"), text("sparse")].concat());
    file.write_all_at(&[MAGIC, &header].concat(), 0).unwrap();
    let mut chunk_indexes = Vec::new();
    let mut end_of_file = (MAGIC.len() + header.len()) as u64;
    for n in 0..chunks {
        let late = if n > gap_after { 1_200_000_000 } else { 0 };
        let time = START + n * CHUNK_NS + late;
        let times = [time, time, time, time];
        let head = [
            &time.to_le_bytes()[..],
            &time.to_le_bytes(),
            &CHUNK_BYTES.to_le_bytes(),
            &[0; 4],
            &text(""),
            &CHUNK_BYTES.to_le_bytes(),
        ]
        .concat();
        let start = end_of_file;
        let mut bytes = vec![0x06];
        bytes.extend((head.len() as u64 + CHUNK_BYTES).to_le_bytes());
        bytes.extend(&head);
        file.write_all_at(&bytes, start).unwrap();
        let index_at = start + bytes.len() as u64 + CHUNK_BYTES;
        let mut index = 0_u16.to_le_bytes().to_vec();
        index.extend((times.len() as u32 * 16).to_le_bytes());
        for time in times {
            index.extend(time.to_le_bytes());
            index.extend(0_u64.to_le_bytes());
        }
        let index = record(0x07, &index);
        file.write_all_at(&index, index_at).unwrap();
        end_of_file = index_at + index.len() as u64;
        let offsets = [&0_u16.to_le_bytes()[..], &index_at.to_le_bytes()].concat();
        let body = [
            &time.to_le_bytes()[..],
            &time.to_le_bytes(),
            &start.to_le_bytes(),
            &(index_at - start).to_le_bytes(),
            &(offsets.len() as u32).to_le_bytes(),
            &offsets,
            &(index.len() as u64).to_le_bytes(),
            &text(""),
            &CHUNK_BYTES.to_le_bytes(),
            &CHUNK_BYTES.to_le_bytes(),
        ]
        .concat();
        chunk_indexes.extend(record(0x08, &body));
    }
    let schema = [
        &1_u16.to_le_bytes()[..],
        &text("sensor_msgs/msg/Image"),
        &text("ros2msg"),
        &text(""),
    ]
    .concat();
    let channel = [
        &0_u16.to_le_bytes()[..],
        &1_u16.to_le_bytes(),
        &text("/cam0/image"),
        &text("cdr"),
        &0_u32.to_le_bytes(),
    ]
    .concat();
    let statistics = [
        &(4 * chunks).to_le_bytes()[..],
        &1_u16.to_le_bytes(),
        &1_u32.to_le_bytes(),
        &[0; 8],
        &(chunks as u32).to_le_bytes(),
        &START.to_le_bytes(),
        &START.to_le_bytes(),
        &10_u32.to_le_bytes(),
        &0_u16.to_le_bytes(),
        &(4 * chunks).to_le_bytes(),
    ]
    .concat();
    let end = record(0x0F, &[0; 4]);
    let summary_at = end_of_file + end.len() as u64;
    let footer = [&summary_at.to_le_bytes()[..], &[0; 12]].concat();
    let rest = [
        end,
        record(0x03, &schema),
        record(0x04, &channel),
        record(0x0B, &statistics),
        chunk_indexes,
        record(0x02, &footer),
        MAGIC.to_vec(),
    ]
    .concat();
    file.write_all_at(&rest, end_of_file).unwrap();
}

#[test]
fn the_doctor_reads_the_indexes_of_a_large_file_only() {
    let gigabytes: u64 = std::env::var("LSFB_LARGE_GB").map_or(4, |n| n.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.mcap");
    let chunks = gigabytes * 1_000_000_000 / CHUNK_BYTES;
    sparse_recording(&path, chunks, chunks / 2);
    let began = Instant::now();
    let recording = Recording::open(&path).unwrap();
    let diagnosis = examine(&recording, &DoctorConfig::default(), &no_progress).unwrap();
    let took = began.elapsed();
    println!(
        "{:.1} GB, {} chunks: {:.3} s",
        diagnosis.facts.bytes as f64 / 1e9,
        chunks,
        took.as_secs_f64()
    );
    assert!(diagnosis.facts.bytes >= gigabytes * 990_000_000);
    assert_eq!(diagnosis.facts.messages, 4 * chunks);
    let camera = diagnosis
        .judgement
        .findings()
        .iter()
        .find(|f| f.subject == "/cam0/image" && f.code == "silence");
    let camera = camera.unwrap();
    assert_eq!(camera.verdict, Verdict::Fail, "{camera:?}");
    assert!(
        camera.what.contains("longest silence 1250 ms at"),
        "{camera:?}"
    );
    // Far below a second on an idle machine; this one may be busy.
    assert!(
        took.as_secs_f64() < 2.0 + 0.1 * gigabytes as f64,
        "{took:?}"
    );
}
