//! The line through points around a place: what a piece of wall is.

use nalgebra::Vector2;

/// Variance across a line, beside that along it, from which on points are no line.
const THICKNESS: f64 = 0.1;

/// Sums over points, from which the line through them follows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct LineSums {
    count: f64,
    sum: Vector2<f64>,
    xx: f64,
    xy: f64,
    yy: f64,
}

/// A line through points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    /// Mean of the points.
    pub(crate) mean: Vector2<f64>,
    /// Unit vector across it.
    pub(crate) normal: Vector2<f64>,
    /// Variances of the points across and along it.
    pub(crate) across: f64,
    pub(crate) along: f64,
    /// How many points there are.
    pub(crate) count: f64,
}

impl LineSums {
    /// One more point; near the origin, so that nothing cancels.
    #[inline]
    pub(crate) fn add(&mut self, point: &Vector2<f64>) {
        self.count += 1.0;
        self.sum += point;
        self.xx += point.x * point.x;
        self.xy += point.x * point.y;
        self.yy += point.y * point.y;
    }

    /// As [`add`](Self::add) if `counts`, with the same bits, and nothing else; without a branch, for neighbours of which any may be too far.
    #[inline]
    pub(crate) fn add_if(&mut self, counts: bool, point: &Vector2<f64>) {
        let share = f64::from(u8::from(counts));
        let counted = point * share;
        self.count += share;
        self.sum += counted;
        self.xx += counted.x * counted.x;
        self.xy += counted.x * counted.y;
        self.yy += counted.y * counted.y;
    }

    /// The line of least squares; none through less than three points, or where they spread about as far across as along.
    ///
    /// The closed form of the eigenvectors: half of the angle of `(xx - yy, 2 xy)` is the direction of the line.
    pub(crate) fn line(&self) -> Option<Line> {
        if self.count < 3.0 {
            return None;
        }
        let mean = self.sum / self.count;
        let xx = self.xx / self.count - mean.x * mean.x;
        let xy = self.xy / self.count - mean.x * mean.y;
        let yy = self.yy / self.count - mean.y * mean.y;
        let (difference, twice) = (xx - yy, 2.0 * xy);
        let (trace, spread) = (xx + yy, (difference * difference + twice * twice).sqrt());
        if trace + spread <= 0.0 || trace - spread > THICKNESS * (trace + spread) {
            return None;
        }
        let direction = 0.5 * twice.atan2(difference);
        let normal = Vector2::new(-direction.sin(), direction.cos());
        Some(Line { mean, normal, across: 0.5 * (trace - spread), along: 0.5 * (trace + spread), count: self.count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;
    use proptest::prelude::*;

    fn sums(points: &[Vector2<f64>]) -> LineSums {
        let mut sums = LineSums::default();
        for point in points {
            sums.add(point);
        }
        sums
    }

    proptest! {
        #[test]
        fn what_does_not_count_is_as_if_it_were_not_there(
            places in prop::collection::vec((any::<bool>(), -1.0..1.0_f64, -1.0..1.0_f64), 0..20)
        ) {
            let mut some = LineSums::default();
            for &(counts, x, y) in &places {
                some.add_if(counts, &Vector2::new(x, y));
            }
            let counted: Vec<_> = places.iter().filter(|p| p.0).map(|&(_, x, y)| Vector2::new(x, y)).collect();
            let bits = |sums: &LineSums| [sums.count, sums.sum.x, sums.sum.y, sums.xx, sums.xy, sums.yy].map(f64::to_bits);
            prop_assert_eq!(bits(&some), bits(&sums(&counted)));
        }

        /// Against the eigenvectors of the points' covariance.
        #[test]
        fn the_normal_is_the_direction_of_least_variance(
            places in prop::collection::vec((-1.0..1.0_f64, -0.2..0.2_f64), 3..20), turn in -3.0..3.0_f64
        ) {
            let (sin, cos) = turn.sin_cos();
            let points: Vec<_> =
                places.iter().map(|&(x, y)| Vector2::new(cos * x - sin * y + 0.3, sin * x + cos * y - 0.1)).collect();
            let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
            let square = |point: &Vector2<f64>| (point - mean) * (point - mean).transpose();
            let covariance = points.iter().map(square).sum::<Matrix2<f64>>() / points.len() as f64;
            let eigen = covariance.symmetric_eigen();
            let (least, most) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
            prop_assume!((least / most - THICKNESS).abs() > 1e-6);
            let line = sums(&points).line();
            prop_assert_eq!(line.is_some(), least < THICKNESS * most);
            if let Some(line) = line {
                prop_assert!((covariance * line.normal - line.normal * least).norm() < 1e-9);
                prop_assert!((line.across - least).abs() < 1e-9 && (line.along - most).abs() < 1e-9);
                prop_assert!((line.mean - mean).norm() < 1e-9 && line.count == points.len() as f64);
            }
        }
    }

    #[test]
    fn few_points_and_heaps_are_no_line() {
        let corner = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(x, y)| Vector2::new(x, y));
        assert_eq!(sums(&corner[..2]).line(), None);
        assert_eq!(sums(&corner).line(), None);
        assert_eq!(sums(&corner[..1].repeat(3)).line(), None);
    }
}
