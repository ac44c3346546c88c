//! Values as bytes and back, bit for bit: little-endian numbers, lists behind their length.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Trajectory, UnitQuaternion, Vector2, Vector3};
use lsfb_types::Timestamp;
use nalgebra::Quaternion;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A value that can be kept.
pub(crate) trait Keep: Sized {
    /// Appends the value.
    fn put(&self, out: &mut Vec<u8>);
    /// The next value; `None` where the bytes are none.
    fn take(from: &mut ByteReader<'_>) -> Option<Self>;
}

/// Bytes that are read from front to back.
pub(crate) struct ByteReader<'a>(&'a [u8]);

impl<'a> ByteReader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }
}

macro_rules! keep_numbers {
    ($($number:ty),*) => {$(
        impl Keep for $number {
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
            fn take(from: &mut ByteReader<'_>) -> Option<Self> {
                from.array().map(Self::from_le_bytes)
            }
        }
    )*};
}

keep_numbers!(u8, u32, u64, i64, f32, f64);

/// Types whose fields are kept one after the other.
macro_rules! keep_fields {
    ($($kept:ident { $($field:ident),* })*) => {$(
        impl $crate::kept_stages::Keep for $kept {
            fn put(&self, out: &mut Vec<u8>) {
                $($crate::kept_stages::Keep::put(&self.$field, out);)*
            }
            fn take(from: &mut $crate::kept_stages::ByteReader<'_>) -> Option<Self> {
                Some(Self { $($field: $crate::kept_stages::Keep::take(from)?),* })
            }
        }
    )*};
}
pub(crate) use keep_fields;

#[derive(Serialize, Deserialize)]
struct Told<R> {
    report: R,
}

/// Appends what has names for its numbers as TOML, from which they come back bit for bit, those that are none as well.
pub(crate) fn put_told(report: &impl Serialize, out: &mut Vec<u8>) {
    // What is no TOML is not read back, and computed again.
    let text = toml::to_string(&Told { report });
    text.unwrap_or_default().put(out);
}

/// What [`put_told`] appended.
pub(crate) fn take_told<R: DeserializeOwned>(from: &mut ByteReader<'_>) -> Option<R> {
    let Told { report } = toml::from_str(&String::take(from)?).ok()?;
    Some(report)
}

impl Keep for usize {
    fn put(&self, out: &mut Vec<u8>) {
        (*self as u64).put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        u64::take(from)?.try_into().ok()
    }
}

impl<T: Keep> Keep for Vec<T> {
    fn put(&self, out: &mut Vec<u8>) {
        self.len().put(out);
        self.iter().for_each(|value| value.put(out));
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        // Grows with what is really there: a length that is none asks for no memory.
        (0..usize::take(from)?).map(|_| T::take(from)).collect()
    }
}

impl<T: Keep> Keep for Option<T> {
    fn put(&self, out: &mut Vec<u8>) {
        u8::from(self.is_some()).put(out);
        self.iter().for_each(|value| value.put(out));
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        match u8::take(from)? {
            0 => Some(None),
            1 => T::take(from).map(Some),
            _ => None,
        }
    }
}

impl<A: Keep, B: Keep> Keep for (A, B) {
    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
        self.1.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Some((A::take(from)?, B::take(from)?))
    }
}

impl<A: Keep, B: Keep, C: Keep> Keep for (A, B, C) {
    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
        self.1.put(out);
        self.2.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Some((A::take(from)?, B::take(from)?, C::take(from)?))
    }
}

impl<A: Keep, B: Keep> Keep for Result<A, B> {
    fn put(&self, out: &mut Vec<u8>) {
        u8::from(self.is_ok()).put(out);
        match self {
            Ok(value) => value.put(out),
            Err(value) => value.put(out),
        }
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        match u8::take(from)? {
            0 => B::take(from).map(Err),
            1 => A::take(from).map(Ok),
            _ => None,
        }
    }
}

impl<T: Keep> Keep for Box<T> {
    fn put(&self, out: &mut Vec<u8>) {
        T::put(self, out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        T::take(from).map(Self::new)
    }
}

impl<T: Keep + Copy + Default, const N: usize> Keep for [T; N] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = T::take(from)?;
        }
        Some(values)
    }
}

impl Keep for String {
    fn put(&self, out: &mut Vec<u8>) {
        self.len().put(out);
        out.extend_from_slice(self.as_bytes());
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let count = usize::take(from)?;
        String::from_utf8(from.bytes(count)?.to_vec()).ok()
    }
}

impl Keep for Timestamp {
    fn put(&self, out: &mut Vec<u8>) {
        self.nanos().put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        i64::take(from).map(Timestamp::from_nanos)
    }
}

impl Keep for Vector2<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Some(Self::new(f64::take(from)?, f64::take(from)?))
    }
}

impl Keep for Vector3<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Some(Self::new(
            f64::take(from)?,
            f64::take(from)?,
            f64::take(from)?,
        ))
    }
}

impl Keep for Matrix6<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let mut matrix = Self::zeros();
        for value in matrix.iter_mut() {
            *value = f64::take(from)?;
        }
        Some(matrix)
    }
}

impl Keep for Se3 {
    fn put(&self, out: &mut Vec<u8>) {
        self.rotation.coords.iter().for_each(|value| value.put(out));
        self.translation.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        let mut rotation = Quaternion::identity();
        for value in rotation.coords.iter_mut() {
            *value = f64::take(from)?;
        }
        // Not normalized: it is unit up to rounding, and stays the same to the last bit.
        Some(Self {
            rotation: UnitQuaternion::new_unchecked(rotation),
            translation: Vector3::take(from)?,
        })
    }
}

impl Keep for StampedPose {
    fn put(&self, out: &mut Vec<u8>) {
        self.time.put(out);
        self.world_from_rig.put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Some(Self {
            time: Timestamp::take(from)?,
            world_from_rig: Se3::take(from)?,
        })
    }
}

impl Keep for Trajectory {
    fn put(&self, out: &mut Vec<u8>) {
        self.poses().to_vec().put(out);
    }

    fn take(from: &mut ByteReader<'_>) -> Option<Self> {
        Vec::take(from).map(Self::new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn back<T: Keep>(value: &T) -> Option<T> {
        let mut bytes = Vec::new();
        value.put(&mut bytes);
        for cut in 0..bytes.len() {
            assert!(T::take(&mut ByteReader::new(&bytes[..cut])).is_none());
        }
        T::take(&mut ByteReader::new(&bytes))
    }

    #[test]
    fn values_come_back_bit_for_bit_and_never_from_fewer_bytes() {
        let pose = StampedPose {
            time: Timestamp::from_nanos(-5),
            world_from_rig: Se3 {
                rotation: UnitQuaternion::from_euler_angles(0.1, -0.7, 2.9),
                translation: Vector3::new(f64::INFINITY, -0.0, 1e-310),
            },
        };
        assert_eq!(
            back(&vec![(pose, Some(3_u32))]),
            Some(vec![(pose, Some(3))])
        );
        assert_eq!(
            back(&Trajectory::new(vec![pose])),
            Some(Trajectory::new(vec![pose]))
        );
        let words = vec!["".to_owned(), "8 × 8".to_owned()];
        assert_eq!(back(&words), Some(words));
        assert_eq!(
            back(&([1.5_f32, -2.0], [7_u8; 128], 9_usize)),
            Some(([1.5, -2.0], [7; 128], 9))
        );
        let found: Vec<Result<Box<u32>, Vector2<f64>>> =
            vec![Ok(Box::new(7)), Err(Vector2::new(-0.0, 3.0))];
        assert_eq!(back(&found), Some(found));
        let nan = back(&f64::NAN.copysign(-1.0)).expect("a number");
        assert_eq!(nan.to_bits(), f64::NAN.copysign(-1.0).to_bits());
    }

    #[test]
    fn lengths_that_are_none_ask_for_no_memory() {
        let mut bytes = Vec::new();
        u64::MAX.put(&mut bytes);
        assert_eq!(Vec::<f64>::take(&mut ByteReader::new(&bytes)), None);
        assert_eq!(String::take(&mut ByteReader::new(&bytes)), None);
        assert_eq!(
            <Option<u8> as Keep>::take(&mut ByteReader::new(&[2, 0])),
            None
        );
    }
}
