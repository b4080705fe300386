//! End points back into beams: the nearest in every direction.

use super::{LaserScan, ScanGeometry};
use crate::{Error, time::Stamp};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// Builds a [`LaserScan`] from end points, as a scanner of that scan's geometry would have seen them: in every beam the
/// nearest. Buffers are reused from scan to scan.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::{LaserScan, ScanBins, ScanGeometry};
/// use agv_core::time::Stamp;
///
/// let mut scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![0.0; 1081])?;
/// let mut bins = ScanBins::default();
/// bins.begin(&scan, f32::INFINITY);
/// bins.add_hit(&Vector2::new(2.0, 0.0));
/// bins.add_hit(&Vector2::new(1.5, 0.0));
/// bins.finish(Stamp::default(), &mut scan)?;
/// assert_eq!(scan.ranges()[540], 1.5);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct ScanBins {
    geometry: ScanGeometry,
    ranges: Vec<f32>,
}

impl ScanBins {
    /// Begins a scan with the geometry and the number of beams of `like`. Beams that nothing is added to read `empty`:
    /// +∞ for *no return*, NaN for no statement.
    pub fn begin(&mut self, like: &LaserScan, empty: f32) {
        self.geometry = *like.geometry();
        self.ranges.clear();
        self.ranges.resize(like.len(), empty);
    }

    /// The beam that looks along `(x, y)` of the sensor frame, to the nearest; `None` outside the field of view and for
    /// a direction that is not finite.
    #[inline]
    pub fn beam_towards(&self, direction: &Vector2<f64>) -> Option<usize> {
        let offset = (direction.y.atan2(direction.x) - self.geometry.angle_min) / self.geometry.angle_increment;
        // Full turns are added until the beam is at or after the first: half a beam before it belongs to it still.
        let turn = TAU / self.geometry.angle_increment.abs();
        let index = (offset + 0.5).rem_euclid(turn);
        (index < self.ranges.len() as f64).then_some(index as usize)
    }

    /// Adds a surface at `point` of the sensor frame, in metres. Points that are not finite, outside the field of view
    /// or nearer than `range_min` are left out.
    #[inline]
    pub fn add_hit(&mut self, point: &Vector2<f64>) {
        let range = point.norm();
        if !(range >= self.geometry.range_min && range <= self.geometry.range_max) {
            return;
        }
        if let Some(slot) = self.beam_towards(point).and_then(|beam| self.ranges.get_mut(beam)) {
            let range = range as f32;
            if slot.is_nan() || range < *slot {
                *slot = range;
            }
        }
    }

    /// Adds a beam along `direction` of the sensor frame that came back empty; a surface in the same beam wins.
    #[inline]
    pub fn add_no_return(&mut self, direction: &Vector2<f64>) {
        if let Some(slot) = self.beam_towards(direction).and_then(|beam| self.ranges.get_mut(beam))
            && slot.is_nan()
        {
            *slot = f32::INFINITY;
        }
    }

    /// Writes the readings to `scan`, taken at `stamp`.
    ///
    /// # Errors
    /// None for the scan that [`begin`](Self::begin) was given; otherwise [`Error::LengthMismatch`].
    pub fn finish(&mut self, stamp: Stamp, scan: &mut LaserScan) -> Result<(), Error> {
        crate::check::length("scan", scan.len(), self.ranges.len())?;
        scan.refill(stamp, self.ranges.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bins(geometry: ScanGeometry, beams: usize) -> (ScanBins, LaserScan) {
        let scan = LaserScan::new(Stamp::default(), geometry, vec![0.0; beams]).unwrap();
        let mut bins = ScanBins::default();
        bins.begin(&scan, f32::NAN);
        (bins, scan)
    }

    proptest! {
        /// Every beam's own direction finds the beam, whichever way the scanner turns and wherever it starts.
        #[test]
        fn beams_find_themselves(beam in 0_usize..720, start in -7.0..7.0_f64, clockwise in any::<bool>(), miss in -0.49..0.49_f64) {
            let increment = 0.5_f64.to_radians() * if clockwise { -1.0 } else { 1.0 };
            let geometry = ScanGeometry { angle_min: start, angle_increment: increment, ..Default::default() };
            let (bins, _) = bins(geometry, 720);
            let (sin, cos) = (geometry.angle(beam) + miss * increment).sin_cos();
            prop_assert_eq!(bins.beam_towards(&Vector2::new(cos, sin)), Some(beam));
        }
    }

    #[test]
    fn outside_and_not_finite_is_left_out() {
        let (mut bins, mut scan) = bins(ScanGeometry::default(), 1081);
        for point in [[-1.0, 0.0], [f64::NAN, 1.0], [f64::INFINITY, 0.0], [0.001, 0.0], [31.0, 0.0]] {
            bins.add_hit(&Vector2::from(point));
        }
        bins.add_no_return(&Vector2::new(1.0, 0.0));
        bins.finish(Stamp::default(), &mut scan).unwrap();
        assert_eq!(scan.ranges().iter().filter(|r| r.is_nan()).count(), 1080);
        assert_eq!(scan.ranges()[540], f32::INFINITY);
    }
}
