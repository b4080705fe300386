//! Angles on the circle.

use std::f64::consts::{PI, TAU};

/// The same direction in (-π, π].
///
/// ```
/// use agv_core::geometry::wrap_angle;
/// use std::f64::consts::PI;
///
/// assert_eq!(wrap_angle(-PI), PI);
/// assert!((wrap_angle(7.0 * PI / 2.0) + PI / 2.0).abs() < 1e-12);
/// assert!(wrap_angle(f64::NAN).is_nan());
/// ```
#[inline]
pub fn wrap_angle(angle: f64) -> f64 {
    // Nearly every angle met in practice is in range already; the remainder costs ten times as much.
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// The shortest turn from `from` to `to`, in (-π, π].
#[inline]
pub fn angle_difference(to: f64, from: f64) -> f64 {
    wrap_angle(to - from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wrapping_keeps_the_direction(angle in -1e4..1e4_f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9 && (wrapped.cos() - angle.cos()).abs() < 1e-9);
        }

        #[test]
        fn differences_undo_turns(from in -10.0..10.0_f64, turn in -3.1..3.1_f64) {
            prop_assert!((angle_difference(from + turn, from) - turn).abs() < 1e-9);
        }
    }

    #[test]
    fn the_branch_cut_belongs_to_plus_pi() {
        for angle in [PI, -PI, 3.0 * PI, -3.0 * PI] {
            assert!((wrap_angle(angle) - PI).abs() < 1e-12, "{angle}");
        }
        // Just below -π, where the remainder rounds to the full turn.
        assert!(wrap_angle(f64::from_bits((-PI).to_bits() + 1)) <= PI);
    }
}
