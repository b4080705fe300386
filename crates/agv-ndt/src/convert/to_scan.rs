//! A multi-line cloud as the single-line scan of its obstacles.
//!
//! Paper 003, section on perception: two returns A and B of one direction, from neighbouring laser lines, lie on the
//! ground if the line through them is level,
//!
//! ```text
//! alpha = atan2(|z_B - z_A|, |(x_B, y_B) - (x_A, y_A)|) < 10°
//! ```
//!
//! (LeGO-LOAM, Shan and Englot 2018, has the same test). What is left in a height band is pressed flat, and in every
//! direction the nearest obstacle counts. Heights are those above the base frame, so a tilted sensor is no harm.
//! The test alone would call the top of a table ground as well: a greatest height of the ground forbids that.

use agv_core::{
    Error, check,
    geometry::LieGroup,
    nalgebra::Vector2,
    sensors::{LaserScan, PointCloud, RangeImage, RangeImageParams, ScanBins},
};

/// What counts as an obstacle.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CloudToScanParams {
    /// How the cloud is laid out in laser lines.
    pub image: RangeImageParams,
    /// Slope below which two neighbouring returns are ground, in radians.
    pub ground_angle: f64,
    /// Greatest height of ground above the base frame, in metres: ramps, but no table tops.
    pub ground_height: f64,
    /// Lines without a return that may lie between two neighbours.
    pub max_line_gap: usize,
    /// Lower end of the obstacles' height band above the base frame, in metres.
    pub min_height: f64,
    /// Upper end of the band, in metres; what is higher, the vehicle passes under.
    pub max_height: f64,
    /// Whether a direction without obstacle reads *no return* (free) or NaN (no statement). A lidar leaves returns from
    /// open space out, so that an empty direction and a free one look alike.
    pub empty_is_free: bool,
}

impl Default for CloudToScanParams {
    /// A 16-line lidar and 10° (paper 003); a band from 5 cm, which wheels climb, to 2 m, which vehicles with a mast
    /// need.
    fn default() -> Self {
        Self {
            image: RangeImageParams::default(),
            ground_angle: 10_f64.to_radians(),
            ground_height: 0.3,
            max_line_gap: 1,
            min_height: 0.05,
            max_height: 2.0,
            empty_is_free: true,
        }
    }
}

/// Where the points went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CloudToScanReport {
    /// Points of the range image: the nearest of each line and direction.
    pub points: usize,
    /// Of these, ground.
    pub ground: usize,
    /// Of these, obstacles in the band.
    pub obstacles: usize,
}

/// Converts clouds to scans. Buffers are reused: nothing is allocated after the first cloud.
///
/// The scan that is filled says by its geometry what is wanted: field of view, number of beams, ranges, and by
/// `base_from_sensor` where the imagined planar scanner sits (the base frame itself is a good place). Its beams should be
/// no denser than the directions of the lidar: a beam between two of them meets nothing.
///
/// ```
/// use agv_core::sensors::{LaserScan, PointCloud, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_ndt::convert::{CloudToScan, CloudToScanParams};
///
/// // Two returns from a wall straight ahead, 0.5 m and 1 m up.
/// let cloud = PointCloud::new(vec![4.0, 4.0], vec![0.0, 0.0], vec![0.5, 1.0])?.with_ring(vec![4, 5])?;
/// let geometry = ScanGeometry { angle_min: -3.1, angle_increment: 0.01, ..Default::default() };
/// let mut scan = LaserScan::new(Stamp::default(), geometry, vec![0.0; 621])?;
/// let report = CloudToScan::new(CloudToScanParams::default())?.convert_into(&cloud, &mut scan)?;
/// assert_eq!((report.obstacles, scan.ranges()[310]), (2, 4.0));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CloudToScan {
    params: CloudToScanParams,
    ground_slope: f32,
    image: RangeImage,
    /// The cloud in the base frame.
    in_base: PointCloud,
    /// Per column, the last line with a return: its row and point, and whether the point is ground by the pair below.
    below: Vec<Option<Below>>,
    bins: ScanBins,
}

#[derive(Debug, Clone, Copy)]
struct Below {
    row: usize,
    point: usize,
    ground: bool,
}

impl CloudToScan {
    /// A converter with these parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: CloudToScanParams) -> Result<Self, Error> {
        check::in_range("ground_angle", params.ground_angle, 0.0, std::f64::consts::FRAC_PI_2.next_down())?;
        check::finite("ground_height", params.ground_height)?;
        check::finite("max_height", params.max_height)?;
        check::in_range("min_height", params.min_height, f64::MIN, params.max_height)?;
        let image = RangeImage::new(params.image.clone())?;
        Ok(Self {
            ground_slope: params.ground_angle.tan() as f32,
            below: vec![None; image.columns()],
            image,
            in_base: PointCloud::default(),
            bins: ScanBins::default(),
            params,
        })
    }

    /// Fills `scan` with the obstacles of `cloud`, and stamps it as the cloud; linear in points and cells of the image.
    ///
    /// Deskew the cloud before, if the vehicle moves. Points that are not finite are left out.
    ///
    /// # Errors
    /// As [`RangeImage::fill`]; the scan is then as it was.
    pub fn convert_into(&mut self, cloud: &PointCloud, scan: &mut LaserScan) -> Result<CloudToScanReport, Error> {
        self.image.fill(cloud)?;
        cloud.transform_into(&cloud.base_from_sensor(), &mut self.in_base);
        self.bins.begin(scan, if self.params.empty_is_free { f32::INFINITY } else { f32::NAN });
        let scanner = Flattener {
            sensor_from_base: scan.geometry().base_from_sensor.inverse(),
            band: self.params.min_height as f32..=self.params.max_height as f32,
        };
        let mut report = CloudToScanReport::default();
        self.below.fill(None);
        // Row by row, so that the image is read as it lies in memory. A point is decided on when the next return above
        // it is known: either pair may say that it is ground.
        for row in 0..self.image.rows() {
            for column in 0..self.image.columns() {
                let Some(point) = self.image.point_index(row, column) else { continue };
                // `below` has one entry per column.
                let mut ground = false;
                if let Some(below) = self.below[column] {
                    let level = row - below.row <= self.params.max_line_gap + 1 && self.is_level(below.point, point);
                    ground = level;
                    scanner.add(&self.in_base, below.point, below.ground || level, &mut self.bins, &mut report);
                }
                self.below[column] = Some(Below { row, point, ground });
            }
        }
        for below in self.below.iter().flatten() {
            scanner.add(&self.in_base, below.point, below.ground, &mut self.bins, &mut report);
        }
        self.bins.finish(cloud.stamp(), scan)?;
        Ok(report)
    }

    /// Whether two points of the base frame are level with each other, and low enough to be ground.
    fn is_level(&self, a: usize, b: usize) -> bool {
        let (x, y, z) = (self.in_base.x(), self.in_base.y(), self.in_base.z());
        // The image holds indices of the cloud that `in_base` is a copy of.
        let flat = (x[b] - x[a]).hypot(y[b] - y[a]);
        (z[b] - z[a]).abs() < self.ground_slope * flat && z[a].max(z[b]) <= self.params.ground_height as f32
    }
}

/// The imagined planar scanner.
struct Flattener {
    sensor_from_base: agv_core::geometry::Se2,
    band: std::ops::RangeInclusive<f32>,
}

impl Flattener {
    fn add(&self, cloud: &PointCloud, point: usize, ground: bool, bins: &mut ScanBins, report: &mut CloudToScanReport) {
        report.points += 1;
        if ground {
            report.ground += 1;
        } else if self.band.contains(&cloud.z()[point]) {
            report.obstacles += 1;
            let flat = Vector2::new(f64::from(cloud.x()[point]), f64::from(cloud.y()[point]));
            bins.add_hit(&self.sensor_from_base.act(&flat));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::{Se3, So3};
    use agv_core::nalgebra::Vector3;
    use agv_core::sensors::ScanGeometry;
    use agv_core::time::Stamp;

    /// Axis-aligned box that stops a ray.
    struct Block {
        min: [f64; 3],
        max: [f64; 3],
    }

    fn hit(origin: &Vector3<f64>, direction: &Vector3<f64>, blocks: &[Block]) -> Option<f64> {
        let entry = |block: &Block| {
            let (mut near, mut far) = (0.0_f64, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = ((block.min[k] - origin[k]) / direction[k], (block.max[k] - origin[k]) / direction[k]);
                (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
            }
            (near <= far).then_some(near)
        };
        blocks.iter().filter_map(entry).min_by(f64::total_cmp)
    }

    /// 16 lines from -15° to 15°, 360 directions, of a scene in the base frame.
    fn cloud(mount: Se3, blocks: &[Block]) -> PointCloud {
        let (mut points, mut rings) = (Vec::new(), Vec::new());
        for column in 0..360 {
            let azimuth = (f64::from(column) + 0.5).to_radians();
            for ring in 0..16_u16 {
                let elevation = (-15.0 + 2.0 * f64::from(ring)).to_radians();
                let ray =
                    Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
                if let Some(range) = hit(&mount.translation(), &mount.rotation().act(&ray), blocks)
                    && range < 60.0
                {
                    points.push((ray * range).cast::<f32>());
                    rings.push(ring);
                }
            }
        }
        PointCloud::from_points(points)
            .with_ring(rings)
            .unwrap()
            .with_mount(mount)
            .unwrap()
            .with_stamp(Stamp::from_seconds(4.0))
    }

    fn floor() -> Block {
        Block { min: [-50.0, -50.0, -1.0], max: [50.0, 50.0, 0.0] }
    }

    fn wall() -> Block {
        Block { min: [8.0, -20.0, 0.0], max: [8.5, 20.0, 4.0] }
    }

    fn mount(pitch: f64) -> Se3 {
        Se3::from_parts(Vector3::new(0.2, 0.0, 1.2), So3::from_roll_pitch_yaw(0.0, pitch, 0.0))
    }

    fn scan(base_from_sensor: agv_core::geometry::Se2) -> LaserScan {
        let degree = 1_f64.to_radians();
        let geometry = ScanGeometry {
            base_from_sensor,
            angle_min: -179.5 * degree,
            angle_increment: degree,
            ..Default::default()
        };
        LaserScan::new(Stamp::default(), geometry, vec![0.0; 360]).unwrap()
    }

    fn convert(params: CloudToScanParams, cloud: &PointCloud) -> (LaserScan, CloudToScanReport) {
        let mut scan = scan(agv_core::geometry::Se2::new(0.2, 0.0, 0.0));
        let report = CloudToScan::new(params).unwrap().convert_into(cloud, &mut scan).unwrap();
        (scan, report)
    }

    /// Floor, wall ahead: the scan shows the wall where it is and nothing elsewhere, level or tilted.
    #[test]
    fn the_wall_is_seen_and_the_floor_is_not() {
        for pitch in [0.0, 0.05, -0.03] {
            let cloud = cloud(mount(pitch), &[floor(), wall()]);
            let (scan, report) = convert(CloudToScanParams::default(), &cloud);
            assert_eq!(scan.stamp(), cloud.stamp());
            assert!(report.ground > 1000 && report.obstacles > 300, "{report:?}");
            assert_eq!(report.points, cloud.len());
            let mut seen = 0;
            for point in scan.points_in_base() {
                // Half a beam at a slant; the wall's face is at x = 8.
                assert!((point.x - 8.0).abs() < 0.35, "{point}");
                seen += 1;
            }
            assert!((100..140).contains(&seen), "{seen}");
        }
    }

    /// A ramp of 5° rises into the band, and is ground by its slope all the same.
    #[test]
    fn a_ramp_is_ground() {
        let steps = (0..60).map(|i| {
            let x = 2.0 + f64::from(i) * 0.05;
            Block { min: [x, -1.0, -1.0], max: [x + 0.05, 1.0, (x - 2.0) * 5_f64.to_radians().tan()] }
        });
        let blocks: Vec<Block> = steps.chain([floor()]).collect();
        let cloud = cloud(mount(0.0), &blocks);
        let (with_test, report) = convert(CloudToScanParams::default(), &cloud);
        let (without, _) = convert(CloudToScanParams { ground_angle: 0.0, ..Default::default() }, &cloud);
        let hits = |scan: &LaserScan| scan.points_in_base().count();
        assert!(hits(&without) > 20, "{}", hits(&without));
        assert!(hits(&with_test) * 4 < hits(&without), "{} {} {report:?}", hits(&with_test), hits(&without));
    }

    /// A shelf that hangs above the band does not block, one in the band does.
    #[test]
    fn the_band_decides_on_overhanging_shelves() {
        let shelf = |z: f64| Block { min: [3.0, -1.0, z], max: [4.0, 1.0, z + 0.2] };
        let ahead = |z: f64, max_height: f64| {
            let cloud = cloud(mount(0.0), &[floor(), wall(), shelf(z)]);
            let (scan, _) = convert(CloudToScanParams { max_height, ..Default::default() }, &cloud);
            scan.ranges()[180]
        };
        assert!((ahead(1.5, 1.4) - 7.8).abs() < 0.1); // the wall behind, seen from 0.2 m ahead of the base
        assert!((ahead(1.5, 2.0) - 2.8).abs() < 0.1);
    }

    #[test]
    fn empty_directions_read_as_asked() {
        let cloud = cloud(mount(0.0), &[wall()]);
        let (free, _) = convert(CloudToScanParams::default(), &cloud);
        let (unknown, _) = convert(CloudToScanParams { empty_is_free: false, ..Default::default() }, &cloud);
        assert_eq!(free.ranges()[0], f32::INFINITY);
        assert!(unknown.ranges()[0].is_nan());
    }

    #[test]
    fn bad_input_is_refused() {
        let good = CloudToScanParams::default();
        for bad in [f64::NAN, f64::INFINITY] {
            for params in [
                CloudToScanParams { ground_angle: bad, ..good.clone() },
                CloudToScanParams { ground_height: bad, ..good.clone() },
                CloudToScanParams { min_height: bad, ..good.clone() },
                CloudToScanParams { max_height: bad, ..good.clone() },
            ] {
                assert!(CloudToScan::new(params).is_err());
            }
        }
        assert!(CloudToScan::new(CloudToScanParams { min_height: 3.0, ..good.clone() }).is_err());
        let mut scan = scan(agv_core::geometry::Se2::default());
        let before = scan.clone();
        let no_ring = PointCloud::from_points([Vector3::x()]);
        assert!(CloudToScan::new(good.clone()).unwrap().convert_into(&no_ring, &mut scan).is_err());
        assert_eq!(scan, before);
        let nan = PointCloud::from_points([Vector3::repeat(f32::NAN)]).with_ring(vec![0]).unwrap();
        assert_eq!(CloudToScan::new(good).unwrap().convert_into(&nan, &mut scan), Ok(CloudToScanReport::default()));
    }
}
