//! A histogram over pose space that only stores the bins that something fell in.
//!
//! Open addressing over packed bin coordinates; slots carry the number of the filling they belong to, so that emptying
//! the histogram costs nothing. Bins are kept in the order in which they were first hit, so that walking over them does
//! not depend on the hash. What heading a pose has is read from its cosine and sine by a polynomial, to 2e-5 rad, which is
//! exact enough to choose a bin and much faster than the library's arc tangent.

use agv_core::{Error, check, geometry::Se2};
use std::f64::consts::{FRAC_PI_2, PI};

/// Size of the bins of a [`PoseHistogram`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseBins {
    /// Side of a bin in the plane, in metres.
    pub position: f64,
    /// Heading that a bin spans, in radians; the nearest whole part of a full turn is taken.
    pub heading: f64,
}

impl Default for PoseBins {
    /// 0.5 m and 10°, as `nav2_amcl` and Beluga.
    fn default() -> Self {
        Self { position: 0.5, heading: 10_f64.to_radians() }
    }
}

impl PoseBins {
    /// Checks both sizes.
    ///
    /// # Errors
    /// A size that is not finite and positive, or a heading of below 1e-4 rad.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("position bin", self.position)?;
        check::in_range("heading bin", self.heading, 1e-4, f64::MAX)?;
        Ok(())
    }
}

/// Coordinates of a bin; that of the heading lies in `0..headings`.
type Key = [i32; 3];

/// A bin that something fell in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bin {
    key: Key,
    /// Weight that fell in.
    pub(super) weight: f64,
}

/// An entry of the hash table.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    /// The filling that it belongs to; zero for none.
    filling: u32,
    bin: u32,
}

/// Counts poses by place and heading.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_filters::particle::{PoseBins, PoseHistogram};
///
/// let mut histogram = PoseHistogram::new(PoseBins::default())?;
/// let poses = [Se2::new(0.1, 0.1, 0.05), Se2::new(0.4, 0.2, 0.1), Se2::new(0.6, 0.2, 0.1)];
/// let bins = poses.map(|pose| histogram.insert(&pose, 1.0));
/// assert_eq!((bins, histogram.len()), ([0, 0, 1], 2));
/// assert_eq!(histogram.weight(0), Some(2.0));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct PoseHistogram {
    per_metre: f64,
    per_radian: f64,
    headings: i32,
    table: Vec<Slot>,
    filling: u32,
    bins: Vec<Bin>,
}

impl PoseHistogram {
    /// An empty histogram.
    ///
    /// # Errors
    /// Sizes that [`validate`](PoseBins::validate) refuses.
    pub fn new(bins: PoseBins) -> Result<Self, Error> {
        bins.validate()?;
        let headings = (2.0 * PI / bins.heading).round().max(1.0);
        Ok(Self {
            per_metre: bins.position.recip(),
            per_radian: headings / (2.0 * PI),
            headings: headings as i32,
            table: vec![Slot::default(); 16],
            filling: 1,
            bins: Vec::with_capacity(8),
        })
    }

    /// The same with room for so many bins: no more is allocated until there are more of them.
    #[must_use]
    pub fn with_capacity(mut self, bins: usize) -> Self {
        self.bins.reserve(bins.saturating_sub(self.bins.len()));
        self.grow_table((2 * bins.max(8)).next_power_of_two());
        self
    }

    /// Number of bins that something fell in.
    pub const fn len(&self) -> usize {
        self.bins.len()
    }

    /// Whether nothing fell in any.
    pub const fn is_empty(&self) -> bool {
        self.bins.is_empty()
    }

    /// Weight that fell in a bin.
    pub fn weight(&self, bin: usize) -> Option<f64> {
        self.bins.get(bin).map(|bin| bin.weight)
    }

    /// Empties it, in constant time but for once in 2³² times.
    pub fn clear(&mut self) {
        self.bins.clear();
        self.filling = self.filling.wrapping_add(1);
        if self.filling == 0 {
            self.table.fill(Slot::default());
            self.filling = 1;
        }
    }

    /// Adds a pose, and returns the number of its bin; new bins are numbered on. Expected O(1).
    ///
    /// What lies beyond 2³¹ bins from the origin falls in the outermost ones.
    #[inline]
    pub fn insert(&mut self, pose: &Se2, weight: f64) -> usize {
        let key = self.key(pose);
        let slot = self.slot(key);
        let entry = self.table[slot];
        if entry.filling == self.filling {
            self.bins[entry.bin as usize].weight += weight;
            return entry.bin as usize;
        }
        let bin = self.bins.len();
        self.table[slot] = Slot { filling: self.filling, bin: bin as u32 };
        self.bins.push(Bin { key, weight });
        if 2 * self.bins.len() > self.table.len() {
            self.grow_table(2 * self.table.len());
        }
        bin
    }

    /// The bin that a pose would fall in, if something did already.
    pub fn find(&self, pose: &Se2) -> Option<usize> {
        self.find_key(self.key(pose))
    }

    /// Calls `visit` with each neighbour of a bin that something fell in: those that touch it at a side, an edge or a
    /// corner, across the seam of the headings too.
    pub(super) fn neighbours(&self, bin: usize, mut visit: impl FnMut(usize)) {
        let [x, y, heading] = self.bins[bin].key;
        // With one or two headings, the one before and the one after are the same.
        let turns = -i32::from(self.headings > 2)..=i32::from(self.headings > 1);
        for turn in turns {
            let heading = (heading + turn).rem_euclid(self.headings);
            for dy in -1..=1 {
                for dx in -1..=1 {
                    let key = [x.saturating_add(dx), y.saturating_add(dy), heading];
                    if let Some(found) = self.find_key(key).filter(|&found| found != bin) {
                        visit(found);
                    }
                }
            }
        }
    }

    fn find_key(&self, key: Key) -> Option<usize> {
        let entry = self.table[self.slot(key)];
        (entry.filling == self.filling).then_some(entry.bin as usize)
    }

    #[inline]
    fn key(&self, pose: &Se2) -> Key {
        let turn = heading(pose.rotation().cos(), pose.rotation().sin());
        // Casts saturate, and the heading's rounding must not leave its range.
        let heading = ((turn * self.per_radian) as i32).clamp(0, self.headings - 1);
        [(pose.x() * self.per_metre).floor() as i32, (pose.y() * self.per_metre).floor() as i32, heading]
    }

    /// The slot that holds the key, or the free one that it belongs into: at most half of the slots are in use.
    #[inline]
    fn slot(&self, key: Key) -> usize {
        let mask = self.table.len() - 1;
        let mut slot = hash(key) as usize & mask;
        loop {
            let entry = self.table[slot];
            if entry.filling != self.filling || self.bins[entry.bin as usize].key == key {
                return slot;
            }
            slot = (slot + 1) & mask;
        }
    }

    fn grow_table(&mut self, slots: usize) {
        if slots > self.table.len() {
            self.table.clear();
            self.table.resize(slots, Slot::default());
            for bin in 0..self.bins.len() {
                let slot = self.slot(self.bins[bin].key);
                self.table[slot] = Slot { filling: self.filling, bin: bin as u32 };
            }
        }
    }
}

/// Multiplication by odd constants, the high bits folded onto the low ones, which choose the slot.
#[inline]
fn hash([x, y, heading]: Key) -> u64 {
    let packed = (u64::from(x as u32) | u64::from(y as u32) << 32).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ u64::from(heading as u32).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (packed ^ packed >> 32).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 32
}

/// Direction of `(cos, sin)` in [0, 2π], to 2e-5 rad; no number in particular if they are not finite.
#[inline]
fn heading(cos: f64, sin: f64) -> f64 {
    let (a, b) = (cos.abs(), sin.abs());
    let ratio = a.min(b) / a.max(b);
    let s = ratio * ratio;
    // Abramowitz and Stegun, 4.4.47.
    let octant = ratio * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let quadrant = if b > a { FRAC_PI_2 - octant } else { octant };
    let half = if cos < 0.0 { PI - quadrant } else { quadrant };
    if sin < 0.0 { 2.0 * PI - half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashMap;

    proptest! {
        #[test]
        fn headings_agree_with_the_library(angle in -4.0..4.0_f64) {
            let difference = heading(angle.cos(), angle.sin()) - angle.rem_euclid(2.0 * PI);
            let wrapped = (difference + PI).rem_euclid(2.0 * PI) - PI;
            prop_assert!(wrapped.abs() < 2e-5, "{angle}: {wrapped}");
        }

        /// Against an ordinary map, over several fillings and through growth.
        #[test]
        fn counts_as_a_map_does(poses in prop::collection::vec((-9.0..9.0_f64, -9.0..9.0_f64, -3.1..3.1_f64), 1..400)) {
            let mut histogram = PoseHistogram::new(PoseBins { position: 1.5, heading: 1.0 }).unwrap();
            for filling in 0..2 {
                histogram.clear();
                let mut expected: HashMap<[i32; 3], f64> = HashMap::new();
                for &(x, y, yaw) in &poses[..poses.len() / (1 + filling)] {
                    let pose = Se2::new(x, y, yaw);
                    let bin = histogram.insert(&pose, 0.5);
                    prop_assert_eq!(histogram.find(&pose), Some(bin));
                    *expected.entry(histogram.key(&pose)).or_default() += 0.5;
                }
                prop_assert_eq!(histogram.len(), expected.len());
                for bin in &histogram.bins {
                    prop_assert_eq!(Some(&bin.weight), expected.get(&bin.key));
                }
            }
        }
    }

    fn neighbours(histogram: &PoseHistogram, bin: usize) -> Vec<usize> {
        let mut found = Vec::new();
        histogram.neighbours(bin, |neighbour| found.push(neighbour));
        found.sort_unstable();
        found
    }

    #[test]
    fn neighbours_touch_and_headings_wrap() {
        let mut histogram = PoseHistogram::new(PoseBins::default()).unwrap();
        for (x, y, yaw) in [(0.1, 0.1, 0.05), (-0.1, 0.6, -0.05), (0.1, 0.1, 0.5), (1.1, 0.1, 0.05), (0.6, 0.1, 0.2)] {
            histogram.insert(&Se2::new(x, y, yaw), 1.0);
        }
        assert_eq!(neighbours(&histogram, 0), [1, 4], "across the corner and the seam; the third is two bins off");
        assert_eq!(neighbours(&histogram, 4), [0, 2, 3]);
        for headings in 1..4 {
            let bins = PoseBins { position: 0.5, heading: 2.0 * PI / f64::from(headings) };
            let mut histogram = PoseHistogram::new(bins).unwrap();
            (0..headings)
                .for_each(|i| _ = histogram.insert(&Se2::new(0.0, 0.0, 0.1 + f64::from(i) * bins.heading), 1.0));
            assert_eq!(histogram.len(), headings as usize);
            assert_eq!(neighbours(&histogram, 0).len(), headings as usize - 1, "each once");
        }
    }

    #[test]
    fn poses_at_the_end_of_the_world_have_bins() {
        let mut histogram = PoseHistogram::new(PoseBins::default()).unwrap();
        for pose in [Se2::new(1e300, -1e300, 0.0), Se2::new(f64::NAN, 0.0, f64::NAN), Se2::new(0.0, 0.0, PI)] {
            let bin = histogram.insert(&pose, 1.0);
            neighbours(&histogram, bin);
        }
        assert_eq!(histogram.len(), 3);
    }

    #[test]
    fn bad_bins_are_named() {
        for bins in [
            PoseBins { position: 0.0, ..Default::default() },
            PoseBins { position: f64::NAN, ..Default::default() },
            PoseBins { heading: 0.0, ..Default::default() },
            PoseBins { heading: f64::NAN, ..Default::default() },
            PoseBins { heading: f64::INFINITY, ..Default::default() },
        ] {
            assert!(PoseHistogram::new(bins).is_err(), "{bins:?}");
        }
    }
}
