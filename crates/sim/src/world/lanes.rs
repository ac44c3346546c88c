//! Eight numbers at a time: in one register where the processor has such, else in two, and the same numbers in both.
//!
//! No product is fused with a sum. What is written against [`Eight`] has to be inlined where it is used, all of it: outside the one function
//! that is compiled for such a processor its instructions cannot be.

use wide::f32x8;

use super::ray::LANES;

/// What can be done with eight numbers.
pub(super) trait Eight: Copy {
    type Numbers: Copy;
    /// One yes or no for each lane.
    type Mask: Copy;
    /// Eight indices.
    type Indices: Copy;

    fn splat(self, value: f32) -> Self::Numbers;
    fn load(self, values: f32x8) -> Self::Numbers;
    fn store(self, values: Self::Numbers) -> f32x8;
    fn splat_index(self, value: u32) -> Self::Indices;
    fn store_indices(self, values: Self::Indices) -> [u32; LANES];

    fn add(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    fn sub(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    fn mul(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    fn div(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// Of numbers; where one of two is none, which comes back is the processor's choice.
    fn min(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// Likewise.
    fn max(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// The smallest of eight, all of them numbers.
    fn smallest(self, values: Self::Numbers) -> f32;
    /// The largest of eight, all of them numbers.
    fn largest(self, values: Self::Numbers) -> f32;

    fn is_less(self, a: Self::Numbers, b: Self::Numbers) -> Self::Mask;
    fn is_at_most(self, a: Self::Numbers, b: Self::Numbers) -> Self::Mask;
    fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// A bit for each lane, from the lowest.
    fn bits(self, mask: Self::Mask) -> u32;
    /// `a` where the mask says so, else `b`.
    fn select(self, mask: Self::Mask, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    fn select_indices(self, mask: Self::Mask, a: Self::Indices, b: Self::Indices) -> Self::Indices;

    #[inline(always)]
    fn dot(self, a: &[f32; 3], b: &[Self::Numbers; 3]) -> Self::Numbers {
        let x = self.mul(self.splat(a[0]), b[0]);
        let y = self.mul(self.splat(a[1]), b[1]);
        let z = self.mul(self.splat(a[2]), b[2]);
        self.add(self.add(x, y), z)
    }
}

/// Something to be done with eight numbers at a time.
pub(super) trait Job {
    type Output;

    /// To be inlined, with all that it calls.
    fn run_on<E: Eight>(self, eight: E) -> Self::Output;
}

/// What the processor has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Processor {
    #[cfg(target_arch = "x86_64")]
    v3: Option<pulp::x86::V3>,
}

impl Processor {
    /// The one that this runs on.
    pub(super) fn here() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            v3: pulp::x86::V3::try_new(),
        }
    }

    /// One of which nothing is known.
    #[cfg(test)]
    fn any() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            v3: None,
        }
    }

    #[inline]
    pub(super) fn run<J: Job>(self, job: J) -> J::Output {
        #[cfg(target_arch = "x86_64")]
        if let Some(v3) = self.v3 {
            return v3.vectorize(x86::OnV3(v3, job));
        }
        job.run_on(Portable)
    }
}

/// On any processor.
#[derive(Clone, Copy)]
struct Portable;

impl Eight for Portable {
    type Numbers = f32x8;
    type Mask = f32x8;
    type Indices = [u32; LANES];

    #[inline(always)]
    fn splat(self, value: f32) -> f32x8 {
        f32x8::splat(value)
    }

    #[inline(always)]
    fn load(self, values: f32x8) -> f32x8 {
        values
    }

    #[inline(always)]
    fn store(self, values: f32x8) -> f32x8 {
        values
    }

    #[inline(always)]
    fn splat_index(self, value: u32) -> [u32; LANES] {
        [value; LANES]
    }

    #[inline(always)]
    fn store_indices(self, values: [u32; LANES]) -> [u32; LANES] {
        values
    }

    #[inline(always)]
    fn add(self, a: f32x8, b: f32x8) -> f32x8 {
        a + b
    }

    #[inline(always)]
    fn sub(self, a: f32x8, b: f32x8) -> f32x8 {
        a - b
    }

    #[inline(always)]
    fn mul(self, a: f32x8, b: f32x8) -> f32x8 {
        a * b
    }

    #[inline(always)]
    fn div(self, a: f32x8, b: f32x8) -> f32x8 {
        a / b
    }

    #[inline(always)]
    fn min(self, a: f32x8, b: f32x8) -> f32x8 {
        a.fast_min(b)
    }

    #[inline(always)]
    fn max(self, a: f32x8, b: f32x8) -> f32x8 {
        a.fast_max(b)
    }

    #[inline(always)]
    fn smallest(self, values: f32x8) -> f32 {
        let v = values.to_array();
        let lesser = |a: f32, b: f32| if a < b { a } else { b };
        let four: [f32; 4] = std::array::from_fn(|i| lesser(v[i], v[i + 4]));
        lesser(lesser(four[0], four[2]), lesser(four[1], four[3]))
    }

    #[inline(always)]
    fn largest(self, values: f32x8) -> f32 {
        let v = values.to_array();
        let greater = |a: f32, b: f32| if a > b { a } else { b };
        let four: [f32; 4] = std::array::from_fn(|i| greater(v[i], v[i + 4]));
        greater(greater(four[0], four[2]), greater(four[1], four[3]))
    }

    #[inline(always)]
    fn is_less(self, a: f32x8, b: f32x8) -> f32x8 {
        a.simd_lt(b)
    }

    #[inline(always)]
    fn is_at_most(self, a: f32x8, b: f32x8) -> f32x8 {
        a.simd_le(b)
    }

    #[inline(always)]
    fn both(self, a: f32x8, b: f32x8) -> f32x8 {
        a & b
    }

    #[inline(always)]
    fn bits(self, mask: f32x8) -> u32 {
        mask.to_bitmask()
    }

    #[inline(always)]
    fn select(self, mask: f32x8, a: f32x8, b: f32x8) -> f32x8 {
        mask.bitselect(a, b)
    }

    #[inline(always)]
    fn select_indices(self, mask: f32x8, a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] {
        let bits = mask.to_bitmask();
        std::array::from_fn(|lane| match bits >> lane & 1 {
            1 => a[lane],
            _ => b[lane],
        })
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use pulp::x86::V3;
    use pulp::{NullaryFnOnce, Simd, cast, f32x8 as Eight32, m32x8, u32x8};
    use wide::f32x8;

    use super::super::ray::LANES;
    use super::{Eight, Job};

    /// A job, as the function wants it that is compiled for AVX2.
    pub(super) struct OnV3<J>(pub V3, pub J);

    impl<J: Job> NullaryFnOnce for OnV3<J> {
        type Output = J::Output;

        #[inline(always)]
        fn call(self) -> J::Output {
            self.1.run_on(self.0)
        }
    }

    /// On a processor with AVX2.
    impl Eight for V3 {
        type Numbers = Eight32;
        type Mask = m32x8;
        type Indices = u32x8;

        #[inline(always)]
        fn splat(self, value: f32) -> Eight32 {
            self.splat_f32s(value)
        }

        #[inline(always)]
        fn load(self, values: f32x8) -> Eight32 {
            cast(values.to_array())
        }

        #[inline(always)]
        fn store(self, values: Eight32) -> f32x8 {
            let lanes: [f32; LANES] = cast(values);
            f32x8::new(lanes)
        }

        #[inline(always)]
        fn splat_index(self, value: u32) -> u32x8 {
            self.splat_u32s(value)
        }

        #[inline(always)]
        fn store_indices(self, values: u32x8) -> [u32; LANES] {
            cast(values)
        }

        #[inline(always)]
        fn add(self, a: Eight32, b: Eight32) -> Eight32 {
            self.add_f32s(a, b)
        }

        #[inline(always)]
        fn sub(self, a: Eight32, b: Eight32) -> Eight32 {
            self.sub_f32s(a, b)
        }

        #[inline(always)]
        fn mul(self, a: Eight32, b: Eight32) -> Eight32 {
            self.mul_f32s(a, b)
        }

        #[inline(always)]
        fn div(self, a: Eight32, b: Eight32) -> Eight32 {
            self.div_f32s(a, b)
        }

        #[inline(always)]
        fn min(self, a: Eight32, b: Eight32) -> Eight32 {
            self.min_f32s(a, b)
        }

        #[inline(always)]
        fn max(self, a: Eight32, b: Eight32) -> Eight32 {
            self.max_f32s(a, b)
        }

        #[inline(always)]
        fn smallest(self, values: Eight32) -> f32 {
            self.reduce_min_f32s(values)
        }

        #[inline(always)]
        fn largest(self, values: Eight32) -> f32 {
            self.reduce_max_f32s(values)
        }

        #[inline(always)]
        fn is_less(self, a: Eight32, b: Eight32) -> m32x8 {
            self.less_than_f32s(a, b)
        }

        #[inline(always)]
        fn is_at_most(self, a: Eight32, b: Eight32) -> m32x8 {
            self.less_than_or_equal_f32s(a, b)
        }

        #[inline(always)]
        fn both(self, a: m32x8, b: m32x8) -> m32x8 {
            self.and_m32s(a, b)
        }

        #[inline(always)]
        fn bits(self, mask: m32x8) -> u32 {
            self.avx._mm256_movemask_ps(cast(mask)) as u32
        }

        #[inline(always)]
        fn select(self, mask: m32x8, a: Eight32, b: Eight32) -> Eight32 {
            cast(self.select_u32s(mask, cast(a), cast(b)))
        }

        #[inline(always)]
        fn select_indices(self, mask: m32x8, a: u32x8, b: u32x8) -> u32x8 {
            self.select_u32s(mask, a, b)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything that can be done, by one pair of packets.
    struct All(f32x8, f32x8);

    impl Job for All {
        type Output = Vec<u32>;

        #[inline(always)]
        fn run_on<E: Eight>(self, eight: E) -> Vec<u32> {
            let (a, b) = (eight.load(self.0), eight.load(self.1));
            let (less, at_most) = (eight.is_less(a, b), eight.is_at_most(a, b));
            let numbers = [
                eight.add(a, b),
                eight.sub(a, b),
                eight.mul(a, b),
                eight.div(a, b),
                eight.min(a, b),
                eight.max(a, b),
                eight.select(less, a, b),
                eight.dot(&[0.1, -3.7, 1e-3], &[a, b, a]),
                eight.splat(0.3),
            ];
            let indices = eight.select_indices(at_most, eight.splat_index(7), eight.splat_index(9));
            let mut bits: Vec<u32> = numbers
                .into_iter()
                .flat_map(|n| eight.store(n).to_array().map(f32::to_bits))
                .collect();
            bits.extend(eight.store_indices(indices));
            bits.extend([eight.bits(less), eight.bits(at_most)]);
            bits.push(eight.bits(eight.both(less, at_most)));
            bits.extend([eight.smallest(a), eight.largest(a)].map(f32::to_bits));
            bits
        }
    }

    #[test]
    fn all_processors_find_the_same_numbers() {
        let mut state = 1_u32;
        let mut any = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for round in 0..200 {
            let scale = 10_f32.powi(round % 13 - 6);
            let mut packet = || f32x8::new(std::array::from_fn(|_| scale * any()));
            let (a, b) = (packet(), packet());
            let here = Processor::here().run(All(a, b));
            assert_eq!(here, Processor::any().run(All(a, b)), "{a} {b}");
            assert_eq!(here[..8], (a + b).to_array().map(f32::to_bits));
            let smallest = a.to_array().into_iter().fold(f32::INFINITY, f32::min);
            assert_eq!(here[here.len() - 2], smallest.to_bits());
        }
    }
}
