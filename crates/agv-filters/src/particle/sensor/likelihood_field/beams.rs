//! The beams of a scan that are used, and where they end.
//!
//! Directions are those of the scanner, the same from scan to scan; and an update asks several times for the end points of one scan.
//! Both are computed once.

use super::{super::beams::evenly_spread, LikelihoodFieldModelParams, kernel::EndPoints};
use agv_core::{
    geometry::{LieGroup, Se2},
    sensors::{Beam, LaserScan, ScanGeometry},
};

/// End points of the last scan, with what they were computed of.
#[derive(Debug, Clone)]
pub(super) struct Beams {
    /// Scanner that the rays belong to, and number of its beams; none before the first scan.
    scanner: Option<(ScanGeometry, usize)>,
    rays: Vec<Ray>,
    /// Raw readings of the rays.
    readings: Vec<f32>,
    /// In the base frame, in cells.
    ends: EndPoints,
}

/// A beam that is used.
#[derive(Debug, Clone, Copy)]
struct Ray {
    index: usize,
    cos: f64,
    sin: f64,
}

impl Beams {
    /// None, with room for as many.
    pub(super) fn with_capacity(beams: usize) -> Self {
        let (rays, readings) = (Vec::with_capacity(beams), Vec::with_capacity(beams));
        Self { scanner: None, rays, readings, ends: EndPoints::with_capacity(beams) }
    }

    /// The end points of the last scan.
    pub(super) const fn known(&self) -> &EndPoints {
        &self.ends
    }

    /// The end points of a scan.
    pub(super) fn ends(
        &mut self,
        scan: &LaserScan,
        params: &LikelihoodFieldModelParams,
        cells_per_metre: f64,
    ) -> &EndPoints {
        let scanner = (*scan.geometry(), scan.len());
        let is_known = self.scanner == Some(scanner);
        let ranges = scan.ranges();
        if is_known
            && self.rays.iter().zip(&self.readings).all(|(ray, read)| ranges[ray.index].to_bits() == read.to_bits())
        {
            return &self.ends;
        }
        if !is_known {
            self.aim(scan, params.max_beams);
            self.scanner = Some(scanner);
        }
        let mount: &Se2 = &scan.geometry().base_from_sensor;
        self.readings.clear();
        self.ends.clear();
        for ray in &self.rays {
            let reading = ranges[ray.index];
            self.readings.push(reading);
            let Beam::Hit(range) = scan.interpret(reading) else { continue };
            if range > params.max_range {
                continue;
            }
            let end = mount.act(&[range * ray.cos, range * ray.sin].into()) * cells_per_metre;
            self.ends.push(end.x as f32, end.y as f32);
        }
        &self.ends
    }

    fn aim(&mut self, scan: &LaserScan, most: usize) {
        self.rays.clear();
        self.rays.extend(evenly_spread(scan.len(), most).map(|index| {
            let (sin, cos) = scan.geometry().angle(index).sin_cos();
            Ray { index, cos, sin }
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::time::Stamp;

    fn scan(first: f32, increment: f64, beams: usize) -> LaserScan {
        let geometry = ScanGeometry { angle_min: 0.0, angle_increment: increment, ..Default::default() };
        let ranges = (0..beams).map(|i| if i == 0 { first } else { 2.0 }).collect();
        LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
    }

    /// Whatever came before, the end points are those of the scan.
    #[test]
    fn what_is_remembered_is_of_the_same_scan() {
        let params = LikelihoodFieldModelParams { max_beams: 8, ..Default::default() };
        let mut beams = Beams::with_capacity(8);
        let scans = [
            scan(1.0, 0.1, 8),
            scan(1.0, 0.1, 8),
            scan(1.5, 0.1, 8),
            scan(f32::NAN, 0.1, 8),
            scan(f32::NAN, 0.2, 8),
            scan(1.0, 0.2, 5),
        ];
        for scan in &scans {
            let seen: Vec<_> = beams.ends(scan, &params, 20.0).iter().collect();
            let fresh: Vec<_> = Beams::with_capacity(8).ends(scan, &params, 20.0).iter().collect();
            assert_eq!(seen, fresh);
            assert_eq!(seen.len(), scan.ranges().iter().filter(|range| !range.is_nan()).count());
        }
    }
}
