//! Points by the squares of the plane that they lie in: sorted, and thinned out to one in each.

use agv_core::sensors::LaserScan;
use nalgebra::Vector2;

/// Column and row of a square of a plane that is divided into squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Square(pub(super) i32, pub(super) i32);

impl Square {
    /// The square of this edge that holds a point; places farther off than an `i32` counts squares share the outermost ones.
    #[inline]
    pub(super) fn holding(point: &Vector2<f64>, edge: f64) -> Self {
        Self(whole(point.x / edge), whole(point.y / edge))
    }

    /// One number for both, in the order of columns, then of rows.
    #[inline]
    pub(super) fn key(self) -> u64 {
        let unsigned = |v: i32| u64::from(v.cast_unsigned() ^ (1 << 31));
        (unsigned(self.0) << 32) | unsigned(self.1)
    }
}

/// The greatest whole number that is not above `v`, as far as an `i32` goes: without a call of the system's.
#[inline]
pub(super) fn whole(v: f64) -> i32 {
    let towards_zero = v as i32;
    towards_zero.saturating_sub(i32::from(v < f64::from(towards_zero)))
}

/// Memory for sorting points by squares: the key of a square, and the index of a point in it.
pub(crate) type Squares = Vec<(u64, u32)>;

/// Bytes that a list has room for.
pub(crate) const fn room_of<T>(list: &Vec<T>) -> usize {
    list.capacity() * size_of::<T>()
}

/// The end points of a scan, a point per square, in memory that is used again.
#[derive(Debug, Clone, Default)]
pub(super) struct ThinnedScan {
    pub(super) points: Vec<Vector2<f64>>,
    squares: Squares,
}

impl ThinnedScan {
    /// Takes another scan, thinned out to squares of this edge.
    pub(super) fn refill(&mut self, scan: &LaserScan, edge: f64) {
        thin_into(scan.points_in_base(), edge, &mut self.squares, &mut self.points);
    }
}

/// The first point of each square of this edge, in the order in which they came.
pub(super) fn thinned(points: &[Vector2<f64>], edge: f64) -> Vec<Vector2<f64>> {
    let (mut squares, mut kept) = (Squares::new(), Vec::new());
    thin_into(points.iter().copied(), edge, &mut squares, &mut kept);
    kept
}

/// As [`thinned`], in memory that is there.
pub(crate) fn thin_into(
    points: impl Iterator<Item = Vector2<f64>>,
    edge: f64,
    squares: &mut Squares,
    kept: &mut Vec<Vector2<f64>>,
) {
    kept.clear();
    kept.extend(points);
    squares.clear();
    squares.extend((0..).zip(&*kept).map(|(i, point)| (Square::holding(point, edge).key(), i)));
    squares.sort_unstable();
    let mut last = None;
    for &(square, i) in &*squares {
        if last.replace(square) == Some(square) {
            // Points are finite: this one is marked as one to be left out.
            kept[i as usize].x = f64::NAN;
        }
    }
    kept.retain(|point| !point.x.is_nan());
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn whole_numbers_and_keys_are_those_of_the_squares(v in -1e5..1e5_f64, columns in any::<[i32; 2]>(), rows in any::<[i32; 2]>()) {
            prop_assert_eq!(f64::from(whole(v)), v.floor());
            let [a, b] = [0, 1].map(|i| (columns[i], rows[i]));
            prop_assert_eq!(a.cmp(&b), Square(a.0, a.1).key().cmp(&Square(b.0, b.1).key()));
        }

        /// Against a set of the squares that were met.
        #[test]
        fn the_first_point_of_each_square_stays(
            places in prop::collection::vec((-0.4..0.4_f64, -0.4..0.4_f64), 0..80), edge in 0.02..0.5_f64
        ) {
            let points: Vec<_> = places.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
            let mut met = std::collections::HashSet::new();
            let first = |point: &&Vector2<f64>| met.insert([point.x, point.y].map(|v| (v / edge).floor() as i64));
            let expected: Vec<_> = points.iter().filter(first).copied().collect();
            prop_assert_eq!(thinned(&points, edge), expected);
        }
    }

    #[test]
    fn far_places_share_the_outermost_squares() {
        assert_eq!(whole(1e300), i32::MAX);
        assert_eq!(whole(-1e300), i32::MIN);
        assert_eq!(whole(-0.0), 0);
        assert_eq!((whole(-1.0), whole(-1.0 - 1e-9), whole(2.999)), (-1, -2, 2));
    }
}
