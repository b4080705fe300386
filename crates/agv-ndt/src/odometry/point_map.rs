//! A map of points for odometry: one running mean per small cube, cubes by the block of 4 x 4 x 4, blocks in a hash table.
//!
//! The means sharpen what many clouds saw of one surface, and keep the map as dense as it is meant to be. A query looks at the eight
//! blocks around it, which hold everything within half a block, so that the nearest points are exact up to that reach. Places are kept
//! from the block's corner, in `f32`: far from the origin nothing is lost.

use crate::Error;
use crate::cells::{CellTable, floor, pack, pack_within};
use agv_core::check;
use nalgebra::Vector3;

/// Cubes along an edge of a block.
const EDGE: i32 = 4;

/// Most points of a block. A surface meets 16 to 40 of the 64 cubes; what finds no place is left out.
const CAPACITY: usize = 40;

/// Points of a cube after which its mean moves as if there were no more of them: a world that changes is followed.
const MEMORY: u16 = 64;

/// No point of this cube.
const NONE: u8 = u8::MAX;

/// Points thinned out to one per cube, which are added to, queried and forgotten around a place.
///
/// ```
/// use agv_core::nalgebra::Vector3;
/// use agv_ndt::odometry::PointMap;
///
/// let mut map = PointMap::new(0.25)?;
/// map.insert(&Vector3::new(1.1, 2.1, 0.1));
/// map.insert(&Vector3::new(1.2, 2.2, 0.1));
/// assert_eq!(map.len(), 1);
/// let [nearest] = map.nearest::<1>(&Vector3::new(1.0, 2.0, 0.1), 0.5).ok_or("none")?;
/// assert!((nearest - Vector3::new(0.15, 0.15, 0.0)).norm() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct PointMap {
    spacing: f64,
    table: CellTable,
    blocks: Vec<Block>,
    points: usize,
}

#[derive(Debug, Clone, Copy)]
struct Block {
    cell: [i32; 3],
    len: u8,
    /// Place in the lists of each cube's point.
    place: [u8; 64],
    count: [u16; CAPACITY],
    x: [f32; CAPACITY],
    y: [f32; CAPACITY],
    z: [f32; CAPACITY],
}

impl PointMap {
    /// A map with a point per cube of `spacing` metres.
    ///
    /// # Errors
    /// A spacing that is not from 1 cm to 100 m.
    pub fn new(spacing: f64) -> Result<Self, Error> {
        check::in_range("spacing", spacing, 0.01, 100.0)?;
        Ok(Self { spacing, table: CellTable::default(), blocks: Vec::new(), points: 0 })
    }

    /// Edge of the cubes, in metres.
    pub const fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Greatest distance up to which [`nearest`](Self::nearest) misses nothing: two cubes, in metres.
    pub fn reach(&self) -> f64 {
        0.5 * self.edge()
    }

    /// Points.
    pub const fn len(&self) -> usize {
        self.points
    }

    /// Whether there are no points.
    pub const fn is_empty(&self) -> bool {
        self.points == 0
    }

    /// Forgets all points; the memory stays.
    pub fn clear(&mut self) {
        self.table.clear();
        self.blocks.clear();
        self.points = 0;
    }

    /// Adds a point; one that is not finite, or 2²⁰ blocks away, is left out.
    pub fn insert(&mut self, point: &Vector3<f64>) {
        let scaled = point / self.spacing;
        if !scaled.iter().all(|v| v.is_finite()) {
            return;
        }
        let cube = [floor(scaled.x), floor(scaled.y), floor(scaled.z)];
        let cell = cube.map(|index| index.div_euclid(EDGE));
        let Some(key) = pack(cell) else { return };
        let next = self.blocks.len() as u32;
        let index = self.table.get_or_insert(key, next);
        if index == next {
            let empty = [0.0; CAPACITY];
            let count = [0; CAPACITY];
            self.blocks.push(Block { cell, len: 0, place: [NONE; 64], count, x: empty, y: empty, z: empty });
        }
        let local = point - self.corner(cell);
        let [i, j, k] = cube.map(|index| index.rem_euclid(EDGE) as usize);
        self.points += usize::from(self.blocks[index as usize].add((i * 4 + j) * 4 + k, &local.cast()));
    }

    /// Offsets of the `N` points nearest to `query` from it, nearest first; `None` if there are not as many within `radius` metres
    /// and [`reach`](Self::reach), as for a query that is not finite and a radius that is negative or NaN.
    pub fn nearest<const N: usize>(&self, query: &Vector3<f64>, radius: f64) -> Option<[Vector3<f32>; N]> {
        if !(radius >= 0.0 && query.iter().all(|v| v.is_finite())) {
            return None;
        }
        let radius = radius.min(self.reach()) as f32;
        let mut found = Nearest { offsets: [Vector3::zeros(); N], squares: [radius * radius; N], count: 0 };
        let scaled = query / self.edge();
        let low = [floor(scaled.x - 0.5), floor(scaled.y - 0.5), floor(scaled.z - 0.5)];
        // Beyond what a key holds there are no blocks; one more so that the block above is within, too.
        pack(low.map(|index| index.saturating_add(index.signum())))?;
        // The block that the query is in comes first; how far the others are at least tells which need no look.
        let inner = [0, 1, 2].map(|axis| scaled[axis] - f64::from(low[axis]) >= 1.0);
        let aside = [0, 1, 2].map(|axis| ((scaled[axis] - f64::from(low[axis]) - 1.0) * self.edge()) as f32);
        for others in 0..8_u8 {
            let other = [0, 1, 2].map(|axis| others >> axis & 1 == 1);
            let gap: f32 = (0..3).filter(|&axis| other[axis]).map(|axis| aside[axis] * aside[axis]).sum();
            if N == 0 || gap >= found.squares[N - 1] {
                continue;
            }
            let cell = [0, 1, 2].map(|axis| low[axis] + i32::from(inner[axis] != other[axis]));
            let Some(index) = self.table.get(pack_within(cell)) else { continue };
            let offset = (self.corner(cell) - query).cast::<f32>();
            let block = &self.blocks[index as usize];
            // All squares first, in lanes; few of them are near enough for the branches of the list.
            let (len, mut squares) = (usize::from(block.len).min(CAPACITY), [0.0; CAPACITY]);
            let points = block.x[..len].iter().zip(&block.y[..len]).zip(&block.z[..len]);
            for (square, ((x, y), z)) in squares.iter_mut().zip(points) {
                let (x, y, z) = (x + offset.x, y + offset.y, z + offset.z);
                *square = x * x + y * y + z * z;
            }
            for (i, &square) in squares[..len].iter().enumerate() {
                if square < found.squares[N - 1] {
                    found.take(Vector3::new(block.x[i], block.y[i], block.z[i]) + offset, square);
                }
            }
        }
        (found.count >= N).then_some(found.offsets)
    }

    /// Keeps the blocks whose centre is no farther than `radius` metres from `center`. Linear in the blocks.
    pub fn retain_around(&mut self, center: &Vector3<f64>, radius: f64) {
        let (edge, half) = (self.edge(), Vector3::repeat(0.5 * self.edge()));
        let corner = |cell: [i32; 3]| Vector3::from(cell.map(f64::from)) * edge;
        self.blocks.retain(|block| (corner(block.cell) + half - center).norm_squared() <= radius * radius);
        self.table.clear();
        self.points = 0;
        for (index, block) in self.blocks.iter().enumerate() {
            self.table.get_or_insert(pack_within(block.cell), index as u32);
            self.points += usize::from(block.len);
        }
    }

    /// All points, in the order in which their blocks were met.
    pub fn points(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        self.blocks.iter().flat_map(|block| {
            let corner = self.corner(block.cell);
            let local = |i: usize| Vector3::new(block.x[i], block.y[i], block.z[i]).cast::<f64>();
            (0..usize::from(block.len)).map(move |i| corner + local(i))
        })
    }

    fn edge(&self) -> f64 {
        self.spacing * f64::from(EDGE)
    }

    fn corner(&self, cell: [i32; 3]) -> Vector3<f64> {
        Vector3::from(cell.map(f64::from)) * self.edge()
    }
}

impl Block {
    /// Moves the mean of a cube (0 to 63), or begins it; whether there is one point more.
    fn add(&mut self, cube: usize, point: &Vector3<f32>) -> bool {
        let mut at = usize::from(self.place[cube]);
        let new = self.place[cube] == NONE;
        if new {
            at = usize::from(self.len);
            if at >= CAPACITY {
                return false;
            }
            self.place[cube] = self.len;
            self.len += 1;
        }
        self.count[at] = (self.count[at] + 1).min(MEMORY);
        let share = 1.0 / f32::from(self.count[at]);
        self.x[at] += (point.x - self.x[at]) * share;
        self.y[at] += (point.y - self.y[at]) * share;
        self.z[at] += (point.z - self.z[at]) * share;
        new
    }
}

/// The nearest offsets so far, in order; of equal distances the first counts.
struct Nearest<const N: usize> {
    offsets: [Vector3<f32>; N],
    squares: [f32; N],
    count: usize,
}

impl<const N: usize> Nearest<N> {
    /// Takes an offset whose square is less than the last one's, of which there is one.
    #[inline]
    fn take(&mut self, offset: Vector3<f32>, square: f32) {
        let mut place = N - 1;
        while place > 0 && square < self.squares[place - 1] {
            self.squares[place] = self.squares[place - 1];
            self.offsets[place] = self.offsets[place - 1];
            place -= 1;
        }
        self.squares[place] = square;
        self.offsets[place] = offset;
        self.count += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The nearest are those of a look at all points.
        #[test]
        fn the_nearest_are_those_of_brute_force(
            points in prop::collection::vec(prop::array::uniform3(-3.0..3.0_f64), 0..120),
            query in prop::array::uniform3(-3.0..3.0_f64), radius in 0.1..1.0_f64, shift in -9e5..9e5_f64,
        ) {
            let shift = Vector3::repeat(shift);
            let mut map = PointMap::new(0.25).unwrap();
            for point in &points {
                map.insert(&(Vector3::from(*point) + shift));
            }
            let query = Vector3::from(query) + shift;
            let mut all: Vec<f64> = map.points().map(|p| (p - query).norm()).collect();
            all.sort_by(f64::total_cmp);
            let expected: Vec<f64> = all.into_iter().filter(|d| *d < radius.min(0.5) - 1e-6).take(3).collect();
            prop_assert_eq!(map.points().count(), map.len());
            if let Some(found) = map.nearest::<3>(&query, radius) {
                for (distance, offset) in expected.iter().zip(&found) {
                    prop_assert!((distance - f64::from(offset.norm())).abs() < 1e-6);
                }
            } else {
                prop_assert!(expected.len() < 3);
            }
        }
    }

    #[test]
    fn the_map_slides_and_points_of_a_cube_are_averaged() {
        let mut map = PointMap::new(0.5).unwrap();
        for i in 0..100 {
            map.insert(&Vector3::new(f64::from(i), 0.1, 0.1));
            map.insert(&Vector3::new(f64::from(i), 0.3, 0.1));
        }
        assert_eq!(map.len(), 100);
        map.retain_around(&Vector3::new(50.0, 0.0, 0.0), 20.0);
        assert!((38..=42).contains(&map.len()));
        let [nearest] = map.nearest(&Vector3::new(50.0, 0.2, 0.1), 0.4).unwrap();
        assert!(nearest.norm() < 1e-6);
        assert!(map.nearest::<1>(&Vector3::new(80.0, 0.2, 0.1), 0.4).is_none());
    }

    #[test]
    fn what_is_not_finite_or_out_of_reach_is_left_out() {
        for spacing in [0.0, -1.0, f64::NAN, 1e9] {
            assert!(PointMap::new(spacing).is_err(), "{spacing}");
        }
        let mut map = PointMap::new(0.25).unwrap();
        for value in [f64::NAN, f64::INFINITY, 1e12] {
            let point = Vector3::new(0.0, value, 0.0);
            map.insert(&point);
            assert!(map.nearest::<1>(&point, 1.0).is_none());
        }
        assert!(map.is_empty());
        let near = Vector3::repeat(0.05);
        map.insert(&near);
        assert!(map.nearest::<1>(&Vector3::zeros(), 1.0).is_some());
        assert!(map.nearest::<1>(&Vector3::new(0.0, f64::NAN, 0.0), 1.0).is_none());
        for radius in [f64::NAN, -1.0, 0.0] {
            assert!(map.nearest::<1>(&Vector3::zeros(), radius).is_none(), "{radius}");
        }
    }
}
