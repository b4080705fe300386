//! One loop or several side by side: numbers that the kernel of a step test computes with.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use pulp::Simd;
use std::ops::{Add, Mul, Sub};

/// A number, or as many as fit side by side: every operation is the same for each, and rounds as `f64` does.
pub(super) trait Lane: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// `value` in every lane.
    fn like(self, value: f64) -> Self;
    fn abs(self) -> Self;
    /// The greater one of two numbers.
    fn at_least(self, min: Self) -> Self;
    /// The lesser one of two numbers.
    fn at_most(self, max: Self) -> Self;
}

impl Lane for f64 {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn at_least(self, min: Self) -> Self {
        if self > min { self } else { min }
    }

    #[inline(always)]
    fn at_most(self, max: Self) -> Self {
        if self < max { self } else { max }
    }
}

/// Lanes of two of the widest registers.
pub(super) const MOST_LANES: usize = 16;

/// Two registers: one loop's operations wait for each other, so that a second one costs little.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd> {
    simd: S,
    registers: [S::f64s; 2],
}

impl<S: Simd> Wide<S> {
    /// Numbers side by side.
    pub(super) const LANES: usize = 2 * S::F64_LANES;

    /// The first values; zero where there are fewer.
    #[inline(always)]
    pub(super) fn load(simd: S, values: &[f64]) -> Self {
        let (low, high) = values.split_at(values.len().min(S::F64_LANES));
        Self { simd, registers: [simd.partial_load_f64s(low), simd.partial_load_f64s(high)] }
    }

    /// The number in a lane.
    pub(super) fn lane(&self, lane: usize) -> f64 {
        let mut values = [0.0; MOST_LANES];
        let (low, high) = values.split_at_mut(S::F64_LANES);
        self.simd.partial_store_f64s(low, self.registers[0]);
        self.simd.partial_store_f64s(high, self.registers[1]);
        values[lane]
    }
}

impl<S: Simd> Add for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let (simd, [a, b], [c, d]) = (self.simd, self.registers, other.registers);
        Self { simd, registers: [simd.add_f64s(a, c), simd.add_f64s(b, d)] }
    }
}

impl<S: Simd> Sub for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let (simd, [a, b], [c, d]) = (self.simd, self.registers, other.registers);
        Self { simd, registers: [simd.sub_f64s(a, c), simd.sub_f64s(b, d)] }
    }
}

impl<S: Simd> Mul for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (simd, [a, b], [c, d]) = (self.simd, self.registers, other.registers);
        Self { simd, registers: [simd.mul_f64s(a, c), simd.mul_f64s(b, d)] }
    }
}

impl<S: Simd> Lane for Wide<S> {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self { simd: self.simd, registers: [self.simd.splat_f64s(value); 2] }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        let (simd, [a, b]) = (self.simd, self.registers);
        // `abs_f64s` is a call where it is not one instruction.
        let all_but_sign = simd.splat_f64s(f64::from_bits(!(1 << 63)));
        Self { simd, registers: [simd.and_f64s(a, all_but_sign), simd.and_f64s(b, all_but_sign)] }
    }

    #[inline(always)]
    fn at_least(self, min: Self) -> Self {
        let (simd, [a, b], [c, d]) = (self.simd, self.registers, min.registers);
        Self { simd, registers: [simd.max_f64s(a, c), simd.max_f64s(b, d)] }
    }

    #[inline(always)]
    fn at_most(self, max: Self) -> Self {
        let (simd, [a, b], [c, d]) = (self.simd, self.registers, max.registers);
        Self { simd, registers: [simd.min_f64s(a, c), simd.min_f64s(b, d)] }
    }
}
