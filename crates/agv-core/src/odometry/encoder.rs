//! From the counts of an incremental encoder to wheel angles.
//!
//! A counter of `b` bits wraps around; the difference of two counts modulo `2^b`, read as a signed number, is right as
//! long as less than half the counter's range passes between them.

use crate::{Error, check};
use std::f64::consts::TAU;

/// An encoder and its counter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EncoderParams {
    /// Counts per revolution of the wheel (after the gear); negative for an encoder that counts backwards.
    pub ticks_per_revolution: f64,
    /// Width of the counter, in bits: 1 to 64.
    pub counter_bits: u32,
    /// Greatest wheel speed that is believed, in radians per second; anything faster is a broken reading.
    pub max_wheel_speed: f64,
}

impl Default for EncoderParams {
    /// 1024 lines in quadrature, a 16-bit counter, and 50 rad/s: 5 m/s on 20 cm wheels.
    fn default() -> Self {
        Self { ticks_per_revolution: 4096.0, counter_bits: 16, max_wheel_speed: 50.0 }
    }
}

/// Turns differences of counts into wheel angles.
///
/// ```
/// use agv_core::odometry::{EncoderParams, TickCounter};
///
/// let counter = TickCounter::new(EncoderParams::default())?;
/// assert_eq!(counter.difference(65_530, 6), 12); // through the wrap of 16 bits
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickCounter {
    params: EncoderParams,
    radians_per_tick: f64,
}

impl TickCounter {
    /// A counter with these parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: EncoderParams) -> Result<Self, Error> {
        check::finite("ticks_per_revolution", params.ticks_per_revolution)?;
        check::positive("ticks_per_revolution (magnitude)", params.ticks_per_revolution.abs())?;
        check::in_range("counter_bits", f64::from(params.counter_bits), 1.0, 64.0)?;
        check::positive("max_wheel_speed", params.max_wheel_speed)?;
        Ok(Self { params, radians_per_tick: TAU / params.ticks_per_revolution })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &EncoderParams {
        &self.params
    }

    /// Signed counts from `before` to `now`; only the counter's own bits are looked at.
    #[inline]
    pub const fn difference(&self, before: i64, now: i64) -> i64 {
        let unused = 64 - self.params.counter_bits;
        // The shift to the top drops the bits above the counter, the one back extends the sign.
        (now.wrapping_sub(before) << unused) >> unused
    }

    /// Wheel angle from `before` to `now`, in radians, if it is plausible for `dt` seconds.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if the wheel would have been faster than `max_wheel_speed` (two counts of jitter allowed).
    pub fn angle(&self, before: i64, now: i64, dt: f64) -> Result<f64, Error> {
        let angle = self.difference(before, now) as f64 * self.radians_per_tick;
        let limit = self.params.max_wheel_speed * dt + 2.0 * self.radians_per_tick.abs();
        check::in_range("wheel angle step", angle, -limit, limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The counter's wrap does not show: the true difference comes back from any width that can hold it.
        #[test]
        fn wrapping_does_not_show(start in any::<i64>(), step in -30_000_i64..30_000, bits in 16_u32..=64) {
            let counter = TickCounter::new(EncoderParams { counter_bits: bits, ..Default::default() }).unwrap();
            let mask = if bits == 64 { u64::MAX } else { (1 << bits) - 1 };
            let seen = |count: i64| (count as u64 & mask) as i64;
            prop_assert_eq!(counter.difference(seen(start), seen(start.wrapping_add(step))), step);
        }
    }

    #[test]
    fn impossible_steps_are_refused() {
        let counter = TickCounter::new(EncoderParams::default()).unwrap();
        assert!(counter.angle(0, 4096, 0.2).is_ok());
        assert!(matches!(counter.angle(0, 4096, 0.01), Err(Error::OutOfRange { name: "wheel angle step", .. })));
        assert!(counter.angle(0, 4096, f64::NAN).is_err());
    }

    #[test]
    fn bad_parameters_are_refused() {
        let good = EncoderParams::default();
        for bad in [0.0, f64::NAN, f64::INFINITY] {
            assert!(TickCounter::new(EncoderParams { ticks_per_revolution: bad, ..good }).is_err());
            assert!(TickCounter::new(EncoderParams { max_wheel_speed: bad, ..good }).is_err());
        }
        for counter_bits in [0, 65] {
            assert!(TickCounter::new(EncoderParams { counter_bits, ..good }).is_err());
        }
    }
}
