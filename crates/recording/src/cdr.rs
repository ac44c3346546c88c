//! Little-endian CDR (XCDR1) as ROS 2 writes it: a four-byte encapsulation header, then primitives aligned to their own
//! size, counted from the byte after that header.

use lsfb_types::Timestamp;

const ENCAPSULATION_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
const NANOS_PER_SEC: i64 = 1_000_000_000;

/// Why bytes are not the message they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CdrError {
    /// The bytes end inside a field.
    #[error(
        "message ends inside `{field}`: {needed} bytes needed at byte {offset}, {available} there"
    )]
    TooShort {
        /// The field that was being read.
        field: &'static str,
        /// Where it starts.
        offset: usize,
        /// Its size.
        needed: usize,
        /// What is left.
        available: usize,
    },
    /// The first bytes do not announce little-endian CDR.
    #[error("encapsulation is {found:02x?}, but only little-endian CDR (00 01) is supported")]
    Encapsulation {
        /// The first two bytes.
        found: [u8; 2],
    },
    /// A field holds something that no such message holds.
    #[error("field `{field}` has an invalid or unsupported value")]
    Value {
        /// The field.
        field: &'static str,
    },
}

/// Appends fields to a message.
pub(crate) struct CdrWriter {
    bytes: Vec<u8>,
}

impl CdrWriter {
    pub fn with_capacity(bytes: usize) -> Self {
        let mut buffer = Vec::with_capacity(bytes + ENCAPSULATION_LITTLE_ENDIAN.len());
        buffer.extend_from_slice(&ENCAPSULATION_LITTLE_ENDIAN);
        Self { bytes: buffer }
    }

    fn align(&mut self, size: usize) {
        let written = self.bytes.len() - ENCAPSULATION_LITTLE_ENDIAN.len();
        let padding = written.wrapping_neg() % size;
        self.bytes.resize(self.bytes.len() + padding, 0);
    }

    fn put<const N: usize>(&mut self, value: [u8; N]) {
        self.align(N);
        self.bytes.extend_from_slice(&value);
    }

    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub fn u16(&mut self, value: u16) {
        self.put(value.to_le_bytes());
    }

    pub fn u32(&mut self, value: u32) {
        self.put(value.to_le_bytes());
    }

    pub fn u64(&mut self, value: u64) {
        self.put(value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.put(value.to_le_bytes());
    }

    pub fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|v| self.f64(*v));
    }

    /// Seconds and nanoseconds; times before 1970 or after 2038 wrap, the writer refuses them beforehand.
    pub fn time(&mut self, time: Timestamp) {
        self.u32(time.nanos().div_euclid(NANOS_PER_SEC) as u32);
        self.u32(time.nanos().rem_euclid(NANOS_PER_SEC) as u32);
    }

    pub fn string(&mut self, value: &str) {
        self.u32(value.len() as u32 + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
    }

    /// A `uint8[N]`: no count, no alignment.
    pub fn raw(&mut self, value: &[u8]) {
        self.bytes.extend_from_slice(value);
    }

    /// A `uint8[]`.
    pub fn byte_sequence(&mut self, value: &[u8]) {
        self.u32(value.len() as u32);
        self.raw(value);
    }

    /// A `std_msgs/Header`.
    pub fn header(&mut self, stamp: Timestamp, frame_id: &str) {
        self.time(stamp);
        self.string(frame_id);
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// A `std_msgs/Header`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header<'a> {
    /// When it was measured.
    pub stamp: Timestamp,
    /// Its frame of reference.
    pub frame_id: &'a str,
}

/// How fields lie in a message of ROS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Of ROS 1: without gaps; headers begin with a counter.
    Ros1,
    /// Of ROS 2: each number at a multiple of its size behind an encapsulation of four bytes.
    Cdr,
}

/// Takes fields off a message; every length is checked against what is there.
pub struct CdrReader<'a> {
    layout: Layout,
    payload: &'a [u8],
    position: usize,
}

impl<'a> CdrReader<'a> {
    /// Of a message of ROS 2.
    pub fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let Some((head, payload)) = bytes.split_first_chunk::<4>() else {
            return Err(CdrError::TooShort {
                field: "encapsulation",
                offset: 0,
                needed: 4,
                available: bytes.len(),
            });
        };
        if head[..2] != ENCAPSULATION_LITTLE_ENDIAN[..2] {
            return Err(CdrError::Encapsulation {
                found: [head[0], head[1]],
            });
        }
        Ok(Self {
            layout: Layout::Cdr,
            payload,
            position: 0,
        })
    }

    /// Of a message of either ROS.
    pub fn with_layout(layout: Layout, bytes: &'a [u8]) -> Result<Self, CdrError> {
        match layout {
            Layout::Cdr => Self::new(bytes),
            Layout::Ros1 => Ok(Self {
                layout,
                payload: bytes,
                position: 0,
            }),
        }
    }

    /// A `uint8[N]`.
    pub fn raw(&mut self, field: &'static str, length: usize) -> Result<&'a [u8], CdrError> {
        let rest = self.payload.get(self.position..).unwrap_or_default();
        let taken = rest.get(..length).ok_or(CdrError::TooShort {
            field,
            offset: self.position + 4,
            needed: length,
            available: rest.len(),
        })?;
        self.position += length;
        Ok(taken)
    }

    fn take<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], CdrError> {
        if self.layout == Layout::Cdr {
            self.position += self.position.wrapping_neg() % N;
        }
        let mut value = [0; N];
        value.copy_from_slice(self.raw(field, N)?);
        Ok(value)
    }

    /// Eight bits.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, CdrError> {
        Ok(self.take::<1>(field)?[0])
    }

    /// Sixteen bits.
    pub fn u16(&mut self, field: &'static str) -> Result<u16, CdrError> {
        Ok(u16::from_le_bytes(self.take(field)?))
    }

    /// Thirty-two bits.
    pub fn u32(&mut self, field: &'static str) -> Result<u32, CdrError> {
        Ok(u32::from_le_bytes(self.take(field)?))
    }

    /// Sixty-four bits.
    pub fn u64(&mut self, field: &'static str) -> Result<u64, CdrError> {
        Ok(u64::from_le_bytes(self.take(field)?))
    }

    /// Double precision.
    pub fn f64(&mut self, field: &'static str) -> Result<f64, CdrError> {
        Ok(f64::from_le_bytes(self.take(field)?))
    }

    /// A `float64[N]`.
    pub fn f64_array<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], CdrError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(field)?;
        }
        Ok(values)
    }

    /// Seconds and nanoseconds.
    pub fn time(&mut self, field: &'static str) -> Result<Timestamp, CdrError> {
        let secs = self.u32(field)? as i32;
        let nanos = self.u32(field)?;
        if i64::from(nanos) >= NANOS_PER_SEC {
            return Err(CdrError::Value { field });
        }
        Ok(Timestamp::from_nanos(
            i64::from(secs) * NANOS_PER_SEC + i64::from(nanos),
        ))
    }

    /// Text in UTF-8.
    pub fn string(&mut self, field: &'static str) -> Result<&'a str, CdrError> {
        let length = self.u32(field)? as usize;
        let bytes = self.raw(field, length)?;
        // Some writers send a bare zero length for the empty string.
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(text).map_err(|_| CdrError::Value { field })
    }

    /// A `uint8[]`.
    pub fn byte_sequence(&mut self, field: &'static str) -> Result<&'a [u8], CdrError> {
        let length = self.u32(field)? as usize;
        self.raw(field, length)
    }

    /// A `std_msgs/Header`.
    pub fn header(&mut self) -> Result<Header<'a>, CdrError> {
        if self.layout == Layout::Ros1 {
            self.u32("header.seq")?;
        }
        Ok(Header {
            stamp: self.time("header.stamp")?,
            frame_id: self.string("header.frame_id")?,
        })
    }
}
