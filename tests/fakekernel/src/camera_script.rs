//! What the unit does, written beforehand by the test: records of an 8-byte header and a body.
//!
//! | byte | content |
//! | --- | --- |
//! | 0 | kind |
//! | 1 | selector of the extension unit, else 0 |
//! | 2 | query code, else 0 |
//! | 3 | 0 |
//! | 4–7 | length of the body, little-endian |
//!
//! | kind | body |
//! | --- | --- |
//! | 1 frame | sequence number u32, flags of the buffer u32, little-endian; frame bytes |
//! | 2 write | bytes that the unit takes for this selector; it refuses others |
//! | 3 read | answer to this query, after the write above it in the script |
//! | 4 unplug | empty: the unit vanishes after the frames above; without it, it stalls |

use std::collections::VecDeque;

pub struct Frame {
    pub sequence: u32,
    pub flags: u32,
    pub bytes: Vec<u8>,
}

pub struct Answer {
    pub selector: u8,
    pub query: u8,
    /// Write that it follows.
    pub written: Vec<u8>,
    pub bytes: Vec<u8>,
}

#[derive(PartialEq, Eq)]
pub enum End {
    Stall,
    Unplug,
}

pub struct Script {
    pub frames: VecDeque<Frame>,
    pub writes: Vec<(u8, Vec<u8>)>,
    pub answers: Vec<Answer>,
    pub end: End,
}

impl Script {
    /// `None`: not a script.
    pub fn parse(mut bytes: &[u8]) -> Option<Self> {
        let mut script = Self {
            frames: VecDeque::new(),
            writes: Vec::new(),
            answers: Vec::new(),
            end: End::Stall,
        };
        while let Some((&[kind, selector, query, _, l0, l1, l2, l3], rest)) =
            bytes.split_first_chunk()
        {
            let len = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
            let (body, rest) = rest.split_at_checked(len)?;
            match kind {
                1 => {
                    let (sequence, body) = body.split_first_chunk()?;
                    let (flags, body) = body.split_first_chunk()?;
                    script.frames.push_back(Frame {
                        sequence: u32::from_le_bytes(*sequence),
                        flags: u32::from_le_bytes(*flags),
                        bytes: body.to_vec(),
                    });
                }
                2 => script.writes.push((selector, body.to_vec())),
                3 => script.answers.push(Answer {
                    selector,
                    query,
                    written: script.writes.last()?.1.clone(),
                    bytes: body.to_vec(),
                }),
                4 => script.end = End::Unplug,
                _ => return None,
            }
            bytes = rest;
        }
        bytes.is_empty().then_some(script)
    }
}
