//! Laser lines of a cloud that does not name them: by elevation, where that tells them apart.
//!
//! The elevations of an unmoved spinning lidar gather at those of its lasers. A histogram with bins of 0.1° shows them as short runs
//! with empty bins between; if nearly all points are in such runs, each run is a line. Clouds that were deskewed, merged or moved by
//! their publisher have no such runs, and lasers with calibrated offsets none at short range.

use agv_core::sensors::PointCloud;
use std::f32::consts::PI;

/// Bins over half a turn.
const BINS: usize = 1800;

/// Widest run that is one line, in bins.
const WIDEST: usize = 4;

/// Lines that a lidar may have.
const LINES: std::ops::RangeInclusive<usize> = 4..=256;

/// Share of the points that must lie in lines.
const SHARE: f64 = 0.95;

/// Not a line.
pub(crate) const NO_LINE: u16 = u16::MAX;

/// Finds the laser lines of clouds; buffers are used again.
#[derive(Debug, Clone, Default)]
pub struct LineFinder {
    bins: Vec<u16>,
    counts: Vec<u32>,
    /// Line of each bin.
    lines: Vec<u16>,
}

impl LineFinder {
    /// Writes the line of each point to `rings`, from the lowest, and says how many there are; zero, and nothing written, if the
    /// elevations show none. Points off all lines, or not finite, have the ring [`u16::MAX`]. Linear in the points.
    ///
    /// ```
    /// use agv_core::{nalgebra::Vector3, sensors::PointCloud};
    /// use agv_ndt::preprocess::LineFinder;
    ///
    /// // Four lasers, 5° apart, in a round room.
    /// let beam = |i: u16| (f32::from(i / 4) * 0.01, f32::from(i % 4) * 5.0_f32.to_radians());
    /// let points = (0..2000).map(beam).map(|(a, e)| Vector3::new(a.cos(), a.sin(), e.tan()) * 7.0);
    /// let mut rings = Vec::new();
    /// assert_eq!(LineFinder::default().find_into(&PointCloud::from_points(points), &mut rings), 4);
    /// assert_eq!(rings[..6], [0, 1, 2, 3, 0, 1]);
    /// ```
    pub fn find_into(&mut self, cloud: &PointCloud, rings: &mut Vec<u16>) -> usize {
        rings.clear();
        self.counts.clear();
        self.counts.resize(BINS, 0);
        self.bins.clear();
        let bin = |(x, y, z): (f32, f32, f32)| {
            let elevation = z.atan2((x * x + y * y).sqrt());
            let known = elevation.is_finite() && (x != 0.0 || y != 0.0 || z != 0.0);
            if known { (((elevation / PI + 0.5) * BINS as f32) as u16).min(BINS as u16 - 1) } else { NO_LINE }
        };
        let points = cloud.x().iter().zip(cloud.y()).zip(cloud.z()).map(|((&x, &y), &z)| (x, y, z));
        self.bins.extend(points.map(bin));
        for &bin in self.bins.iter().filter(|bin| **bin != NO_LINE) {
            self.counts[usize::from(bin)] += 1;
        }
        let usable: u32 = self.counts.iter().sum();
        // A few stray points do not bridge two lines.
        let least = 1 + usable / 5000;
        let (mut count, mut width, mut gathered) = (0_usize, 0, 0);
        self.lines.clear();
        for &points in &self.counts {
            let inside = points >= least;
            if inside {
                count += usize::from(width == 0);
                width += 1;
                gathered += points;
                if width > WIDEST || count > *LINES.end() {
                    return 0;
                }
            } else {
                width = 0;
            }
            self.lines.push(if inside { count as u16 - 1 } else { NO_LINE });
        }
        if !LINES.contains(&count) || f64::from(gathered) < SHARE * f64::from(usable) {
            return 0;
        }
        rings.extend(self.bins.iter().map(|bin| self.lines.get(usize::from(*bin)).copied().unwrap_or(NO_LINE)));
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn find(points: impl IntoIterator<Item = Vector3<f32>>) -> (usize, Vec<u16>) {
        let mut rings = vec![7];
        let count = LineFinder::default().find_into(&PointCloud::from_points(points), &mut rings);
        (count, rings)
    }

    #[test]
    fn points_without_lines_have_none() {
        let scattered =
            (0..5000_u16).map(|i| Vector3::new(5.0, f32::from(i % 71) * 0.1, f32::from(i % 997) * 0.004 - 2.0));
        assert_eq!(find(scattered), (0, vec![]));
        assert_eq!(find([]), (0, vec![]));
        assert_eq!(find([Vector3::repeat(f32::NAN), Vector3::zeros()]), (0, vec![]));
        assert_eq!(find((0..100_u8).map(|i| Vector3::new(3.0, f32::from(i), 0.0))), (0, vec![]));
    }

    #[test]
    fn stray_points_are_off_the_lines() {
        let beam = |i: u16| (f32::from(i / 8) * 0.01, (f32::from(i % 8) * 2.0_f32 - 7.0).to_radians());
        let beams = (0..8000).map(beam).map(|(a, e): (f32, f32)| Vector3::new(a.cos(), a.sin(), e.tan()) * 9.0);
        let (count, rings) = find(beams.chain([Vector3::new(4.0, 0.0, 3.0), Vector3::repeat(f32::INFINITY)]));
        assert_eq!((count, &rings[..9]), (8, &[0, 1, 2, 3, 4, 5, 6, 7, 0][..]));
        assert_eq!(rings[8000..], [NO_LINE, NO_LINE]);
    }
}
