//! Figures of merit of a planned path.

use crate::{
    Error, check,
    geometry::wrap_angle,
    path::{Gear, Path},
};
use nalgebra::Vector2;

/// How a path is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PathQualityParams {
    /// Least change of direction that counts as a turn, in radians.
    pub turn_threshold: f64,
    /// Distance between the places where the clearance is asked for, in metres.
    pub clearance_step: f64,
}

impl Default for PathQualityParams {
    /// Any change beyond rounding is a turn, as paper 002 counts corners on grids; the clearance is sampled at half a
    /// usual cell of 5 cm.
    fn default() -> Self {
        Self { turn_threshold: 1e-6, clearance_step: 0.025 }
    }
}

/// Length, turns, smoothness and clearance of a path.
///
/// ```
/// use agv_core::metrics::{PathQuality, PathQualityParams};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
///
/// let corner = Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(2.0, 0.0), Vector2::new(2.0, 2.0)])?;
/// let pillar = Vector2::new(1.0, 1.0);
/// let quality = PathQuality::of(&corner, PathQualityParams::default(), |p| (p - pillar).norm() - 0.2)?;
/// assert_eq!((quality.length, quality.turns), (4.0, 1));
/// assert!((quality.min_clearance - 0.8).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathQuality {
    /// Length along the straight lines, in metres.
    pub length: f64,
    /// Points where the direction changes by more than the threshold.
    pub turns: usize,
    /// Sum of all changes of direction, in radians.
    pub total_turning: f64,
    /// Bending energy `∫ κ² ds`, in 1/m: at a corner of angle `θ` between lines `a` and `b` long the curvature is
    /// taken as `2θ / (a + b)`. Zero for a straight path; the smoother, the less.
    pub bending_energy: f64,
    /// Changes between forward and reverse.
    pub cusps: usize,
    /// Least distance to an obstacle, in metres.
    pub min_clearance: f64,
    /// Mean distance to obstacles over the length of the path, in metres.
    pub mean_clearance: f64,
}

impl PathQuality {
    /// Judges a path; `clearance` gives the distance from a point to the nearest obstacle, in metres.
    ///
    /// Directions are those of the straight lines, turned about where the vehicle reverses, so that a cusp is not a
    /// turn. Repeated points are skipped.
    ///
    /// # Errors
    /// [`Error::Empty`] for a path without points, [`Error::Negative`] or [`Error::NotPositive`] for a parameter,
    /// [`Error::NotFinite`] for a clearance.
    pub fn of(
        path: &Path,
        params: PathQualityParams,
        mut clearance: impl FnMut(&Vector2<f64>) -> f64,
    ) -> Result<Self, Error> {
        check::non_negative("turn_threshold", params.turn_threshold)?;
        check::positive("clearance_step", params.clearance_step)?;
        let mut points = path.points().iter();
        let mut here = points.next().ok_or(Error::Empty { name: "path" })?.pose.translation();
        let mut ask = |at: &Vector2<f64>| check::finite("clearance", clearance(at));
        let first = ask(&here)?;
        let mut quality = Self {
            length: 0.0,
            turns: 0,
            total_turning: 0.0,
            bending_energy: 0.0,
            cusps: 0,
            min_clearance: first,
            mean_clearance: first,
        };
        let (mut clearance_integral, mut before) = (0.0, None::<(f64, f64, Gear)>);
        let mut known = first;
        for point in points {
            let ahead = point.pose.translation() - here;
            let length = ahead.norm();
            if length == 0.0 {
                continue;
            }
            let driven = if point.gear == Gear::Reverse { -ahead } else { ahead };
            let direction = driven.y.atan2(driven.x);
            if let Some((last_direction, last_length, gear)) = before {
                let turn = wrap_angle(direction - last_direction).abs();
                quality.turns += usize::from(turn > params.turn_threshold);
                quality.total_turning += turn;
                quality.bending_energy += 2.0 * turn * turn / (last_length + length);
                quality.cusps += usize::from(gear != point.gear);
            }
            before = Some((direction, length, point.gear));
            // Trapezoids between samples; a step that is absurdly small is cut to a million samples a line.
            let samples = (length / params.clearance_step).ceil().clamp(1.0, 1e6) as usize;
            for i in 1..=samples {
                let next = ask(&(here + ahead * (i as f64 / samples as f64)))?;
                clearance_integral += 0.5 * (known + next) * length / samples as f64;
                quality.min_clearance = quality.min_clearance.min(next);
                known = next;
            }
            quality.length += length;
            here += ahead;
        }
        if quality.length > 0.0 {
            quality.mean_clearance = clearance_integral / quality.length;
        }
        Ok(quality)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{geometry::Se2, path::PathPoint};

    fn path(positions: &[(f64, f64)]) -> Path {
        Path::from_positions(&positions.iter().map(|(x, y)| Vector2::new(*x, *y)).collect::<Vec<_>>()).unwrap()
    }

    fn judge(path: &Path) -> PathQuality {
        PathQuality::of(path, PathQualityParams::default(), |p| p.y + 1.0).unwrap()
    }

    #[test]
    fn a_grid_path_has_the_turns_that_one_counts() {
        // Along a row, a diagonal in two steps, and along the row again: two turns, whatever the number of cells.
        let quality =
            judge(&path(&[(0.5, 0.5), (1.5, 0.5), (2.5, 0.5), (2.5, 0.5), (3.5, 1.5), (4.5, 2.5), (5.5, 2.5)]));
        assert_eq!((quality.turns, quality.cusps), (2, 0));
        assert!((quality.length - 3.0 - 8_f64.sqrt()).abs() < 1e-12);
        assert!((quality.total_turning - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn the_bending_energy_of_a_circle_is_its_length_over_the_radius_squared() {
        let radius = 2.0;
        let circle: Vec<_> = (0..=1000).map(|i| 0.002 * std::f64::consts::PI * f64::from(i)).collect();
        let circle = path(&circle.iter().map(|a| (radius * a.cos(), radius * a.sin())).collect::<Vec<_>>());
        let quality = judge(&circle);
        // One corner of a thousand is missing where the circle closes.
        assert!((quality.bending_energy / (quality.length / radius.powi(2)) - 0.999).abs() < 1e-4, "{quality:?}");
        assert!((quality.mean_clearance - 1.0).abs() < 1e-3 && (quality.min_clearance + 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_cusp_is_no_turn() {
        let mut path = Path::new();
        for (x, gear) in [(0.0, Gear::Forward), (1.0, Gear::Forward), (0.5, Gear::Reverse)] {
            path.push(PathPoint { pose: Se2::new(x, 0.0, 0.0), gear }).unwrap();
        }
        let quality = judge(&path);
        assert_eq!((quality.turns, quality.cusps, quality.length), (0, 1, 1.5));
    }

    #[test]
    fn bad_input_is_named() {
        let (good, defaults) = (path(&[(0.0, 0.0), (1.0, 0.0)]), PathQualityParams::default());
        assert!(matches!(PathQuality::of(&Path::new(), defaults, |_| 0.0), Err(Error::Empty { .. })));
        assert!(matches!(PathQuality::of(&good, defaults, |_| f64::NAN), Err(Error::NotFinite { .. })));
        for step in [0.0, f64::NAN] {
            let params = PathQualityParams { clearance_step: step, ..defaults };
            assert!(matches!(PathQuality::of(&good, params, |_| 0.0), Err(Error::NotPositive { .. })), "{step}");
        }
        let params = PathQualityParams { turn_threshold: f64::NAN, ..defaults };
        assert!(matches!(PathQuality::of(&good, params, |_| 0.0), Err(Error::Negative { .. })));
        let point = judge(&path(&[(0.0, 0.5)]));
        assert_eq!((point.length, point.mean_clearance), (0.0, 1.5));
    }
}
