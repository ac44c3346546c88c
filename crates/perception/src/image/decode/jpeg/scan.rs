//! Whether the data of a JPEG's scans are as long as its picture takes.
//!
//! Each code is read, none is transformed: where bytes were lost, zeroed or written over, codes that follow are other codes, and the data
//! end before or after the last block does. Pictures of one pass with Huffman codes are looked at (what cameras send and OpenCV,
//! libjpeg and phones write); those in several passes (progressive) and arithmetic codes are taken as they are.

use std::fmt;

use super::huffman::{Bits, Codes, Stop};

/// Coefficients of a block beside its mean.
const DETAILS: usize = 63;
/// The end of a block, and sixteen zeros, among the symbols of details.
const END_OF_BLOCK: u8 = 0x00;
const SIXTEEN_ZEROS: u8 = 0xf0;
/// Restart markers are numbered in turn.
const RESTARTS: u8 = 8;
const FIRST_RESTART: u8 = 0xd0;

/// What is wrong with the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Damage {
    /// They end too early.
    Short { blocks: u64, of: u64 },
    /// They go on behind the last block.
    Long { bytes: usize },
    /// Something that no code begins with, or a block of too many coefficients.
    NoCode { block: u64, of: u64 },
    /// All details of a block are the same: zeros were written over its data.
    Constant { block: u64, of: u64 },
    /// A restart marker is missing, or another one is there.
    Restart { number: u64 },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Short { blocks, of } => write!(f, "its data ends after {blocks} of {of} blocks"),
            Self::Long { bytes } => {
                write!(
                    f,
                    "its data continues for {bytes} bytes after the last block"
                )
            }
            Self::NoCode { block, of } => write!(f, "block {block} of {of} has no valid code"),
            Self::Constant { block, of } => {
                write!(f, "block {block} of {of} was overwritten with one value")
            }
            Self::Restart { number } => write!(f, "restart marker {number} is missing"),
        }
    }
}

/// A component of the picture as its frame has it.
#[derive(Clone, Copy)]
struct Component {
    id: u8,
    /// Blocks beside and above each other in a unit of the picture.
    sampling: [u32; 2],
}

/// The picture.
struct Frame {
    /// Width and height, pixels.
    size: [u32; 2],
    components: Vec<Component>,
}

impl Frame {
    /// `None` of a frame that says nothing that can be checked.
    fn parse(segment: &[u8]) -> Option<Self> {
        let &[_, h1, h0, w1, w0, count, ref rest @ ..] = segment else {
            return None;
        };
        let size = [[w1, w0], [h1, h0]].map(|b| u32::from(u16::from_be_bytes(b)));
        let components: Vec<Component> = rest
            .chunks_exact(3)
            .map(|c| Component {
                id: c[0],
                sampling: [u32::from(c[1] >> 4), u32::from(c[1] & 15)],
            })
            .collect();
        let is_possible = components.len() == usize::from(count)
            && !components.is_empty()
            && size.iter().all(|s| *s > 0)
            && components
                .iter()
                .all(|c| c.sampling.iter().all(|s| (1..=4).contains(s)));
        is_possible.then_some(Self { size, components })
    }

    /// Units of a scan, and blocks of each component in a unit: of one component alone a unit is a block.
    fn units(&self, of: &[Component]) -> (u64, Vec<u32>) {
        let most = [0, 1].map(|k| self.components.iter().map(|c| c.sampling[k]).max());
        let most = most.map(|m| m.unwrap_or(1));
        let units = |across: [u32; 2]| across.iter().map(|n| u64::from(*n)).product();
        match of {
            [one] => {
                let across = |k: usize| {
                    let pixels = (self.size[k] * one.sampling[k]).div_ceil(most[k]);
                    pixels.div_ceil(8)
                };
                (units([0, 1].map(across)), vec![1])
            }
            _ => {
                let across = |k: usize| self.size[k].div_ceil(8 * most[k]);
                let blocks = of.iter().map(|c| c.sampling[0] * c.sampling[1]);
                (units([0, 1].map(across)), blocks.collect())
            }
        }
    }
}

/// Looks through a JPEG that is whole. What is not understood is left to the decoder.
pub(super) fn check(bytes: &[u8]) -> Result<(), Damage> {
    let mut frame = None;
    let mut codes: [[Option<Codes>; 4]; 2] = Default::default();
    let mut restart_units = 0u64;
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = bytes.get(at..at + 4) {
        if marker == 0xff {
            at += 1;
            continue;
        }
        let length = usize::from(u16::from_be_bytes([high, low]));
        let Some(segment) = bytes.get(at + 4..at + 2 + length) else {
            return Ok(());
        };
        at += 2 + length;
        match marker {
            0xc0 | 0xc1 => frame = Frame::parse(segment),
            0xc4 if read_codes(segment, &mut codes).is_none() => return Ok(()),
            0xc4 => {}
            // Several passes, no loss, or arithmetic codes.
            0xc2..=0xcf => return Ok(()),
            0xdd => {
                restart_units = match segment {
                    &[high, low] => u64::from(u16::from_be_bytes([high, low])),
                    _ => return Ok(()),
                }
            }
            0xda => {
                let Some(frame) = &frame else {
                    return Ok(());
                };
                let Some(scan) = Scan::parse(segment, frame, &codes, restart_units) else {
                    return Ok(());
                };
                at = scan.check(bytes, at)?;
            }
            _ => {}
        }
    }
    Ok(())
}

fn read_codes(mut segment: &[u8], into: &mut [[Option<Codes>; 4]; 2]) -> Option<()> {
    while let Some((head, rest)) = segment.split_at_checked(17) {
        let counts: &[u8; 16] = head[1..].try_into().ok()?;
        let count = counts.iter().map(|c| usize::from(*c)).sum();
        let (symbols, rest) = rest.split_at_checked(count)?;
        let place = into
            .get_mut(usize::from(head[0] >> 4))?
            .get_mut(usize::from(head[0] & 15))?;
        *place = Some(Codes::new(counts, symbols)?);
        segment = rest;
    }
    Some(())
}

/// A scan: for each block of a unit the codes of its mean and of its details.
struct Scan<'a> {
    blocks: Vec<[&'a Codes; 2]>,
    units: u64,
    /// Units from one restart marker to the next; 0 where there are none.
    restart_units: u64,
}

impl<'a> Scan<'a> {
    fn parse(
        segment: &[u8],
        frame: &Frame,
        codes: &'a [[Option<Codes>; 4]; 2],
        restart_units: u64,
    ) -> Option<Self> {
        let (count, rest) = segment.split_first()?;
        let chosen: Vec<(Component, [&Codes; 2])> = rest
            .chunks_exact(2)
            .take(usize::from(*count))
            .map(|c| {
                let component = frame.components.iter().find(|own| own.id == c[0])?;
                let mean = codes[0].get(usize::from(c[1] >> 4))?.as_ref()?;
                let details = codes[1].get(usize::from(c[1] & 15))?.as_ref()?;
                Some((*component, [mean, details]))
            })
            .collect::<Option<_>>()?;
        if chosen.is_empty() || chosen.len() != usize::from(*count) {
            return None;
        }
        let components: Vec<Component> = chosen.iter().map(|c| c.0).collect();
        let (units, blocks) = frame.units(&components);
        let blocks = chosen.iter().zip(blocks);
        let blocks = blocks.flat_map(|((_, codes), n)| std::iter::repeat_n(*codes, n as usize));
        Some(Self {
            blocks: blocks.collect(),
            units,
            restart_units,
        })
    }

    /// Reads all its data; where it ends.
    fn check(&self, bytes: &[u8], mut at: usize) -> Result<usize, Damage> {
        let of = self.units * self.blocks.len() as u64;
        let mut block = 0;
        let mut restarts = 0;
        let mut done = 0;
        loop {
            let units = match self.restart_units {
                0 => self.units,
                between => between.min(self.units - done),
            };
            let mut bits = Bits::new(bytes, at);
            for _ in 0..units {
                for codes in &self.blocks {
                    match read_block(&mut bits, codes) {
                        Ok(Details::Differ) => block += 1,
                        Ok(Details::AllAlike) => return Err(Damage::Constant { block, of }),
                        Err(Stop::Ended) => return Err(Damage::Short { blocks: block, of }),
                        Err(Stop::NoCode) => return Err(Damage::NoCode { block, of }),
                    }
                }
            }
            done += units;
            let (end, rest) = bits.rest();
            // Some encoders fill up to a multiple of their bus, with zeros or ones.
            if rest.iter().any(|byte| ![0x00, 0xff].contains(byte)) {
                return Err(Damage::Long { bytes: rest.len() });
            }
            at = end;
            while bytes.get(at..at + 2) == Some(&[0xff, 0xff]) {
                at += 1;
            }
            if done == self.units {
                // A marker too many would begin another interval.
                return match bytes.get(at + 1) {
                    Some(m) if self.restart_units > 0 && is_restart(*m) => {
                        Err(Damage::Restart { number: restarts })
                    }
                    _ => Ok(at),
                };
            }
            let expected = FIRST_RESTART + (restarts % u64::from(RESTARTS)) as u8;
            if bytes.get(at + 1) != Some(&expected) {
                return Err(Damage::Restart { number: restarts });
            }
            restarts += 1;
            at += 2;
        }
    }
}

fn is_restart(marker: u8) -> bool {
    (FIRST_RESTART..FIRST_RESTART + RESTARTS).contains(&marker)
}

/// What the details of a block are.
enum Details {
    Differ,
    /// All 63 have the same code and the same value: what zeros read as where that is not a block without any.
    AllAlike,
}

fn read_block(bits: &mut Bits<'_>, [mean, details]: &[&Codes; 2]) -> Result<Details, Stop> {
    let size = u32::from(bits.symbol(mean)?);
    if size > 15 {
        return Err(Stop::NoCode);
    }
    bits.value(size)?;
    let mut first = None;
    let mut is_alike = true;
    let mut read = 0;
    while read < DETAILS {
        let symbol = bits.symbol(details)?;
        if symbol == END_OF_BLOCK {
            return Ok(Details::Differ);
        }
        let size = u32::from(symbol & 15);
        // Some encoders end a block with them; they may go beyond it.
        if symbol == SIXTEEN_ZEROS {
            is_alike = false;
            read += 16;
            continue;
        }
        if size == 0 {
            return Err(Stop::NoCode);
        }
        let own = (symbol, bits.value(size)?);
        is_alike &= symbol >> 4 == 0 && *first.get_or_insert(own) == own;
        read += usize::from(symbol >> 4) + 1;
        if read > DETAILS {
            return Err(Stop::NoCode);
        }
    }
    Ok(match is_alike {
        true => Details::AllAlike,
        false => Details::Differ,
    })
}
