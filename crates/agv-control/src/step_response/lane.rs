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

/// Registers side by side: one loop's operations wait for each other, so that more loops cost little until the
/// registers run out. Three are what AVX2 has room for, and make two runs of a swarm of twenty.
const REGISTERS: usize = 3;

/// Lanes of that many of the widest registers.
pub(super) const MOST_LANES: usize = 8 * REGISTERS;

/// A number in each lane of all registers.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd> {
    simd: S,
    registers: [S::f64s; REGISTERS],
}

impl<S: Simd> Wide<S> {
    /// Numbers side by side.
    pub(super) const LANES: usize = REGISTERS * S::F64_LANES;

    /// The first values; zero where there are fewer.
    #[inline(always)]
    pub(super) fn load(simd: S, values: &[f64]) -> Self {
        let mut registers = [simd.splat_f64s(0.0); REGISTERS];
        for (register, values) in registers.iter_mut().zip(values.chunks(S::F64_LANES)) {
            *register = simd.partial_load_f64s(values);
        }
        Self { simd, registers }
    }

    /// The number in a lane.
    pub(super) fn lane(&self, lane: usize) -> f64 {
        let mut values = [0.0; MOST_LANES];
        for (values, register) in values.chunks_mut(S::F64_LANES).zip(self.registers) {
            self.simd.partial_store_f64s(values, register);
        }
        values[lane]
    }

    #[inline(always)]
    fn each(mut self, operation: impl Fn(S, S::f64s) -> S::f64s) -> Self {
        for register in &mut self.registers {
            *register = operation(self.simd, *register);
        }
        self
    }

    #[inline(always)]
    fn pairs(mut self, other: Self, operation: impl Fn(S, S::f64s, S::f64s) -> S::f64s) -> Self {
        for (register, other) in self.registers.iter_mut().zip(other.registers) {
            *register = operation(self.simd, *register, other);
        }
        self
    }
}

impl<S: Simd> Add for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.pairs(other, S::add_f64s)
    }
}

impl<S: Simd> Sub for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.pairs(other, S::sub_f64s)
    }
}

impl<S: Simd> Mul for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.pairs(other, S::mul_f64s)
    }
}

impl<S: Simd> Lane for Wide<S> {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self { simd: self.simd, registers: [self.simd.splat_f64s(value); REGISTERS] }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        // `abs_f64s` is a call where it is not one instruction.
        let all_but_sign = self.simd.splat_f64s(f64::from_bits(!(1 << 63)));
        self.each(
            #[inline(always)]
            |simd, a| simd.and_f64s(a, all_but_sign),
        )
    }

    #[inline(always)]
    fn at_least(self, min: Self) -> Self {
        self.pairs(min, S::max_f64s)
    }

    #[inline(always)]
    fn at_most(self, max: Self) -> Self {
        self.pairs(max, S::min_f64s)
    }
}
