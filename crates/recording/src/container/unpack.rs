//! Unpacking the data of a chunk: in one pass into memory that is used again, where the chunk is one that this can be done with,
//! else piece by piece.

use std::io::{Error, ErrorKind, Read, Result};

use crate::container::pack::{LZ4_BLOCK_BYTES, LZ4_FRAME, LZ4_STORED};
use crate::container::record::Packing;

/// A chunk that claims to unpack to more than this is unpacked piece by piece, so that a length that lies costs no memory.
const AT_ONCE_BYTES: u64 = 64 << 20;
/// No LZ4 block unpacks to more times its size.
const LZ4_MOST_RATIO: u64 = 256;

/// Replaces `out` by what `data` unpacks to, one byte more than `unpacked_bytes` at most: enough to notice.
pub(crate) fn unpack(
    packing: Packing,
    data: &[u8],
    unpacked_bytes: u64,
    out: &mut Vec<u8>,
) -> Result<()> {
    let at_once = match packing {
        Packing::Plain => false,
        Packing::Lz4 => unpacked_bytes <= data.len() as u64 * LZ4_MOST_RATIO,
        Packing::Zstd => true,
    };
    if at_once && unpacked_bytes <= AT_ONCE_BYTES {
        // Memory that is overwritten anyway is not cleared first.
        out.resize(unpacked_bytes as usize, 0);
        let unpacked = match packing {
            Packing::Zstd => zstd::bulk::Decompressor::new()
                .and_then(|mut d| d.decompress_to_buffer(data, out.as_mut_slice())),
            _ => lz4_frame_of_ours(data, out),
        };
        // What is not as long as it should be is judged by its caller.
        if let Ok(len) = unpacked {
            out.truncate(len);
            return Ok(());
        }
    }
    // Another writer's frame, or a damaged one: the library says which.
    out.clear();
    let limit = unpacked_bytes.saturating_add(1);
    match packing {
        Packing::Plain => data.take(limit).read_to_end(out),
        Packing::Lz4 => lz4::Decoder::new(data).and_then(|d| d.take(limit).read_to_end(out)),
        Packing::Zstd => {
            zstd::stream::read::Decoder::new(data).and_then(|d| d.take(limit).read_to_end(out))
        }
    }?;
    Ok(())
}

/// Unpacks a frame with the header that [`crate::container::pack`] writes: independent blocks without checksums. Returns its length.
fn lz4_frame_of_ours(data: &[u8], out: &mut [u8]) -> Result<usize> {
    let broken = || Error::from(ErrorKind::InvalidData);
    let mut rest = data.strip_prefix(&LZ4_FRAME).ok_or_else(broken)?;
    let mut len = 0;
    loop {
        let (size, behind) = rest.split_first_chunk().ok_or_else(broken)?;
        let size = u32::from_le_bytes(*size);
        if size == 0 {
            return if behind.is_empty() {
                Ok(len)
            } else {
                Err(broken())
            };
        }
        let packed_bytes = (size & !LZ4_STORED) as usize;
        let (block, behind) = behind.split_at_checked(packed_bytes).ok_or_else(broken)?;
        rest = behind;
        let room = out.get_mut(len..).unwrap_or_default();
        len += if size & LZ4_STORED == 0 {
            let most = room.len().min(LZ4_BLOCK_BYTES) as i32;
            lz4::block::decompress_to_buffer(block, Some(most), room)?
        } else {
            room.get_mut(..block.len())
                .ok_or_else(broken)?
                .copy_from_slice(block);
            block.len()
        };
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;
    use crate::container::pack::Packer;
    use crate::layout::Compression;

    fn samples() -> Vec<Vec<u8>> {
        let noise: Vec<u8> = (0..9_000_000_u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        let mixed = [&vec![7; 5_000_000][..], &noise[..1_000_000]].concat();
        vec![noise[..3].to_vec(), noise, mixed]
    }

    /// Frames of this crate, and those of other writers: linked blocks, checksums, several frames.
    fn frames(packing: Packing, data: &[u8]) -> Vec<Vec<u8>> {
        let compression = match packing {
            Packing::Lz4 => Compression::Lz4,
            _ => Compression::Zstd,
        };
        let mut ours = Vec::new();
        let mut packer = Packer::new(3);
        packer.pack(compression, data, &mut ours, 0).unwrap();
        let theirs = match packing {
            Packing::Lz4 => {
                let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
                encoder.write_all(data).unwrap();
                encoder.finish().0
            }
            _ => zstd::stream::encode_all(data, 1).unwrap(),
        };
        vec![ours, theirs]
    }

    #[test]
    fn frames_of_any_writer_unpack_into_used_memory() {
        let mut out = vec![9; 17];
        for packing in [Packing::Lz4, Packing::Zstd] {
            for data in samples() {
                for frame in frames(packing, &data) {
                    unpack(packing, &frame, data.len() as u64, &mut out).unwrap();
                    assert!(out == data, "{packing:?}, {} bytes", data.len());
                }
            }
        }
    }

    #[test]
    fn lengths_that_lie_and_damage_are_noticed() {
        let data = &samples()[2];
        let mut out = Vec::new();
        for packing in [Packing::Lz4, Packing::Zstd] {
            for frame in frames(packing, data) {
                for claimed in [0, data.len() as u64 - 1, data.len() as u64 + 1, 1 << 29] {
                    let found = unpack(packing, &frame, claimed, &mut out);
                    assert!(found.is_err() || out.len() as u64 != claimed, "{claimed}");
                    assert!(out.capacity() as u64 <= AT_ONCE_BYTES, "{claimed}");
                }
                // Of a frame with checksums the data may be whole up to its last bytes.
                for end in [0, 3, 7, 11, frame.len() / 2, frame.len() - 16] {
                    let torn = &frame[..end];
                    let found = unpack(packing, torn, data.len() as u64, &mut out);
                    assert!(found.is_err() || out != *data, "{packing:?} {end}");
                }
                for at in (0..frame.len()).step_by(frame.len() / 97 + 1) {
                    let mut bad = frame.clone();
                    bad[at] ^= 0x55;
                    // Whatever comes of it, the chunk's checksum decides.
                    let _ = unpack(packing, &bad, data.len() as u64, &mut out);
                    assert!(out.len() <= data.len() + 1);
                }
            }
        }
    }
}
