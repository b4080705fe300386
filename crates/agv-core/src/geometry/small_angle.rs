//! Angles that are nearly always small: the errors of a vehicle that keeps its path, by their series instead of by the library's
//! functions, which are slower. The results agree to the last digits.

/// Angle below which the series are summed, in radians.
const SMALL: f64 = 0.1;

/// Angle of the direction `(x, y)`, in radians.
#[inline]
pub fn angle(x: f64, y: f64) -> f64 {
    if y.abs() < SMALL * x {
        let tan = y / x;
        let square = tan * tan;
        // The next term is below 1e-14 of the first.
        let rest = 1.0 / 9.0 - square * (1.0 / 11.0 - square * (1.0 / 13.0));
        tan * (1.0 - square * (1.0 / 3.0 - square * (0.2 - square * (1.0 / 7.0 - square * rest))))
    } else {
        y.atan2(x)
    }
}

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos(angle: f64) -> (f64, f64) {
    if angle.abs() < SMALL {
        // Written without divisions, which would wait for each other.
        let square = angle * angle;
        let sin = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square * (1.0 / 362_880.0)));
        let cos = 1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40_320.0 - square * (1.0 / 3_628_800.0)));
        (angle - angle * square * sin, 1.0 - square * (0.5 - square * cos))
    } else {
        angle.sin_cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_series_are_the_functions(a in -0.2..0.2_f64, far in -4.0..4.0_f64, scale in 0.1..2.0_f64) {
            for a in [a, far, 0.1 * far, 0.0] {
                let (sin, cos) = sin_cos(a);
                prop_assert!((sin - a.sin()).abs() <= 4e-16 && (cos - a.cos()).abs() <= 4e-16);
                let (x, y) = (scale * a.cos(), scale * a.sin());
                prop_assert!((angle(x, y) - y.atan2(x)).abs() <= 1e-14 * a.abs());
            }
        }
    }
}
