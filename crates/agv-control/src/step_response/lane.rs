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

/// Most registers that are worked on at a time.
pub(super) const MOST_REGISTERS: usize = 3;

/// Lanes of so many of the widest registers.
pub(super) const MOST_LANES: usize = 8 * MOST_REGISTERS;

/// `R` registers: one loop's operations wait for each other, so that a second one costs little.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd, const R: usize> {
    simd: S,
    registers: [S::f64s; R],
}

impl<S: Simd, const R: usize> Wide<S, R> {
    /// Numbers side by side.
    pub(super) const LANES: usize = R * S::F64_LANES;

    /// The first values; zero where there are fewer.
    #[inline(always)]
    pub(super) fn load(simd: S, values: &[f64]) -> Self {
        let mut registers = [simd.splat_f64s(0.0); R];
        for (register, values) in registers.iter_mut().zip(values.chunks(S::F64_LANES)) {
            *register = simd.partial_load_f64s(values);
        }
        Self { simd, registers }
    }

    /// The number in a lane.
    pub(super) fn lane(&self, lane: usize) -> f64 {
        let mut values = [0.0; MOST_LANES];
        for (values, &register) in values.chunks_mut(S::F64_LANES).zip(&self.registers) {
            self.simd.partial_store_f64s(values, register);
        }
        values[lane]
    }
}

impl<S: Simd, const R: usize> Add for Wide<S, R> {
    type Output = Self;

    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for (own, other) in self.registers.iter_mut().zip(other.registers) {
            *own = self.simd.add_f64s(*own, other);
        }
        self
    }
}

impl<S: Simd, const R: usize> Sub for Wide<S, R> {
    type Output = Self;

    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        for (own, other) in self.registers.iter_mut().zip(other.registers) {
            *own = self.simd.sub_f64s(*own, other);
        }
        self
    }
}

impl<S: Simd, const R: usize> Mul for Wide<S, R> {
    type Output = Self;

    #[inline(always)]
    fn mul(mut self, other: Self) -> Self {
        for (own, other) in self.registers.iter_mut().zip(other.registers) {
            *own = self.simd.mul_f64s(*own, other);
        }
        self
    }
}

impl<S: Simd, const R: usize> Lane for Wide<S, R> {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self { simd: self.simd, registers: [self.simd.splat_f64s(value); R] }
    }

    #[inline(always)]
    fn abs(mut self) -> Self {
        // `abs_f64s` is a call where it is not one instruction.
        let all_but_sign = self.simd.splat_f64s(f64::from_bits(!(1 << 63)));
        for own in &mut self.registers {
            *own = self.simd.and_f64s(*own, all_but_sign);
        }
        self
    }

    #[inline(always)]
    fn at_least(mut self, min: Self) -> Self {
        for (own, min) in self.registers.iter_mut().zip(min.registers) {
            *own = self.simd.max_f64s(*own, min);
        }
        self
    }

    #[inline(always)]
    fn at_most(mut self, max: Self) -> Self {
        for (own, max) in self.registers.iter_mut().zip(max.registers) {
            *own = self.simd.min_f64s(*own, max);
        }
        self
    }
}
