//! Packing a chunk: each codec in one pass from the chunk into the record, without a copy on the way.

use std::io::{Error, ErrorKind, Result};

use crate::container::emit;
use crate::layout::Compression;

/// Start of an LZ4 frame: magic, version 1 with independent blocks of up to 4 MiB and no checksums (the chunk has one), and
/// the checksum of these two bytes.
pub(crate) const LZ4_FRAME: [u8; 7] = [0x04, 0x22, 0x4D, 0x18, 0x60, 0x70, 0x73];
/// Largest block of such a frame.
pub(crate) const LZ4_BLOCK_BYTES: usize = 4 << 20;
/// Set in the size of a block that is stored as it is.
pub(crate) const LZ4_STORED: u32 = 1 << 31;
/// Images hardly shrink: looking less often for what might costs next to nothing in size.
const LZ4_ACCELERATION: i32 = 2;
/// Packs chunks; what a codec needs is kept between them.
pub(crate) struct Packer {
    zstd_level: i32,
    zstd: Option<zstd::bulk::Compressor<'static>>,
}

impl Packer {
    pub fn new(zstd_level: i32) -> Self {
        Self {
            zstd_level,
            zstd: None,
        }
    }

    /// Replaces what `out` holds behind its first `at` bytes by `data`, packed.
    pub fn pack(
        &mut self,
        compression: Compression,
        data: &[u8],
        out: &mut Vec<u8>,
        at: usize,
    ) -> Result<()> {
        let end = match compression {
            Compression::None => return Err(Error::from(ErrorKind::InvalidInput)),
            Compression::Lz4 => lz4_frame(data, out, at)?,
            Compression::Zstd => self.zstd(data, out, at)?,
        };
        out.truncate(end);
        Ok(())
    }

    fn zstd(&mut self, data: &[u8], out: &mut Vec<u8>, at: usize) -> Result<usize> {
        let compressor = match &mut self.zstd {
            Some(compressor) => compressor,
            none => none.insert(zstd::bulk::Compressor::new(self.zstd_level)?),
        };
        grow(out, at + zstd::zstd_safe::compress_bound(data.len()));
        let room = out.get_mut(at..).unwrap_or_default();
        Ok(at + compressor.compress_to_buffer(data, room)?)
    }
}

/// Appends an LZ4 frame at `at`, and tells where it ends.
fn lz4_frame(data: &[u8], out: &mut Vec<u8>, at: usize) -> Result<usize> {
    let blocks = data.len().div_ceil(LZ4_BLOCK_BYTES);
    let bound = lz4::block::compress_bound(LZ4_BLOCK_BYTES.min(data.len()))?;
    grow(out, at + LZ4_FRAME.len() + blocks * (4 + bound) + 4);
    emit::put_at(out, at, &LZ4_FRAME);
    let mut end = at + LZ4_FRAME.len();
    for block in data.chunks(LZ4_BLOCK_BYTES) {
        let room = out.get_mut(end + 4..).unwrap_or_default();
        let mode = lz4::block::CompressionMode::FAST(LZ4_ACCELERATION);
        let packed_bytes = lz4::block::compress_to_buffer(block, Some(mode), false, room)?;
        let (size, bytes) = if packed_bytes < block.len() {
            (packed_bytes as u32, packed_bytes)
        } else {
            emit::put_at(out, end + 4, block);
            (block.len() as u32 | LZ4_STORED, block.len())
        };
        emit::put_at(out, end, &size.to_le_bytes());
        end += 4 + bytes;
    }
    // No further block.
    emit::put_at(out, end, &[0; 4]);
    Ok(end + 4)
}

/// Makes room without shrinking.
fn grow(out: &mut Vec<u8>, bytes: usize) {
    if out.len() < bytes {
        out.resize(bytes, 0);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    #[test]
    fn other_decoders_unpack_what_is_packed() {
        let noise: Vec<u8> = (0..10_000_000_u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        let mixed = [&vec![7; 5_000_000][..], &noise].concat();
        let mut packer = Packer::new(1);
        for data in [&noise[..3], &noise, &mixed, &mixed[..4 << 20], &[]] {
            let mut out = vec![9; 5];
            packer.pack(Compression::Lz4, data, &mut out, 5).unwrap();
            assert_eq!(out[..5], [9; 5]);
            let mut back = Vec::new();
            let mut decoder = lz4::Decoder::new(&out[5..]).unwrap();
            decoder.read_to_end(&mut back).unwrap();
            assert!(decoder.finish().1.is_ok());
            assert!(back == data, "{} bytes", data.len());
            // Smaller, and larger again: what is left in the buffer does not matter.
            packer.pack(Compression::Zstd, data, &mut out, 5).unwrap();
            let back = zstd::stream::decode_all(&out[5..]).unwrap();
            assert!(back == data, "{} bytes", data.len());
        }
    }
}
