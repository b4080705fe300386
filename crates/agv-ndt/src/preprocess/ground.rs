//! Which points are ground: by the slope between neighbouring laser lines, or by a plane.
//!
//! Paper 003, section on perception, and LeGO-LOAM (Shan and Englot 2018): two returns A and B of one direction, from neighbouring
//! laser lines, lie on the ground if the line through them is level,
//!
//! ```text
//! alpha = atan2(|z_B - z_A|, |(x_B, y_B) - (x_A, y_A)|) < 10°
//! ```
//!
//! Clouds without lines have a plane fitted to them: three points at a time are tried (Fischler and Bolles, *RANSAC*, 1981), those
//! alone that lie level, and the plane with the most points near it is refined by them.

use super::one_of_every;
use crate::Error;
use crate::eigen::SymmetricEigen;
use agv_core::{
    check,
    compute::Seed,
    sensors::{PointCloud, PointSource, RangeImage},
};
use nalgebra::{Matrix3, Vector3};

/// What counts as ground. Heights are above the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GroundParams {
    /// Slope below which the ground lies level, in radians.
    pub max_slope: f64,
    /// Greatest height of ground, in metres: ramps, but no table tops.
    pub max_height: f64,
    /// Distance from a fitted plane up to which points belong to it, in metres.
    pub plane_distance: f64,
    /// Planes that are tried.
    pub trials: u32,
    /// Where the choice of points comes from.
    pub seed: Seed,
}

impl Default for GroundParams {
    /// 10° as both sources; 0.3 m as [`CloudToScan`](crate::convert::CloudToScan); 10 cm holds five standard deviations of a lidar. Where
    /// one point in five is ground, 400 trials miss it four times in a hundred.
    fn default() -> Self {
        Self { max_slope: 10_f64.to_radians(), max_height: 0.3, plane_distance: 0.1, trials: 400, seed: Seed(0) }
    }
}

/// A plane `normal · p = offset` of the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPlane {
    /// Unit normal, upwards.
    pub normal: Vector3<f64>,
    /// Distance from the origin along the normal, in metres.
    pub offset: f64,
}

/// Marks the ground of clouds; buffers are used again.
///
/// ```
/// use agv_core::{nalgebra::Vector3, sensors::PointCloud};
/// use agv_ndt::preprocess::{GroundFilter, GroundParams};
///
/// // A floor and a wall.
/// let at = |i: u16| (f32::from(i % 40) * 0.1, f32::from(i / 40) * 0.1);
/// let floor = (0..1600).map(at).map(|(a, b)| Vector3::new(a, b, 0.02));
/// let wall = (0..800).map(at).map(|(a, b)| Vector3::new(a, 4.0, b + 0.3));
/// let cloud = PointCloud::from_points(floor.chain(wall));
/// let mut is_ground = Vec::new();
/// let plane = GroundFilter::new(GroundParams::default())?.by_plane_into(&cloud, &mut is_ground).ok_or("no ground")?;
/// assert!((plane.offset - 0.02).abs() < 1e-3 && plane.normal.z > 0.999);
/// assert_eq!(is_ground.iter().filter(|ground| **ground).count(), 1600);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct GroundFilter {
    params: GroundParams,
    in_base: PointCloud,
    /// Finite points that are low enough.
    low: Vec<u32>,
}

/// Lines without a return that may lie between two neighbours.
const MAX_GAP: usize = 1;

/// Fewest points of a plane.
const FEWEST: usize = 10;

/// Points that planes are judged by while they are tried.
const JUDGES: usize = 2000;

impl GroundFilter {
    /// A filter with these parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: GroundParams) -> Result<Self, Error> {
        check::in_range("max_slope", params.max_slope, 0.0, std::f64::consts::FRAC_PI_2.next_down())?;
        check::finite("max_height", params.max_height)?;
        check::positive("plane_distance", params.plane_distance)?;
        check::in_range("trials", f64::from(params.trials), 1.0, 1e6)?;
        Ok(Self { params, in_base: PointCloud::default(), low: Vec::new() })
    }

    /// Marks the ground of a cloud by the slope between laser lines; `image` was filled with the cloud. Points that are not in the
    /// image, hidden by nearer ones of the same cell, are not marked. Linear in points and cells.
    pub fn by_slope_into(&mut self, cloud: &PointCloud, image: &RangeImage, is_ground: &mut Vec<bool>) {
        is_ground.clear();
        is_ground.resize(cloud.len(), false);
        cloud.transform_into(&cloud.base_from_sensor(), &mut self.in_base);
        let (tangent, highest) = (self.params.max_slope.tan() as f32, self.params.max_height as f32);
        let known = |row: usize, column: usize| image.point_index(row, column).filter(|&index| index < cloud.len());
        for column in 0..image.columns() {
            let mut below: Option<(usize, usize)> = None;
            for row in 0..image.rows() {
                let Some(index) = known(row, column) else { continue };
                if let Some((last, before)) = below.filter(|(last, _)| row - last <= MAX_GAP + 1) {
                    let (a, b) = (self.in_base.point(before), self.in_base.point(index));
                    let level = (b.z - a.z).abs() < tangent * (b.x - a.x).hypot(b.y - a.y);
                    if level && a.z.max(b.z) <= highest && last < row {
                        (is_ground[before], is_ground[index]) = (true, true);
                    }
                }
                below = Some((row, index));
            }
        }
    }

    /// Marks the ground of a cloud by the plane that most of its low points are near to, and gives that plane; `None`, and nothing
    /// marked, if there is none. The same for the same seed. Linear in the points, and in trials times at most 2000 of them.
    pub fn by_plane_into(&mut self, cloud: &PointCloud, is_ground: &mut Vec<bool>) -> Option<GroundPlane> {
        is_ground.clear();
        is_ground.resize(cloud.len(), false);
        cloud.transform_into(&cloud.base_from_sensor(), &mut self.in_base);
        let highest = self.params.max_height as f32;
        self.low.clear();
        let points = self.in_base.points().enumerate();
        let low = points.filter(|(_, p)| p.iter().all(|v| v.is_finite()) && p.z <= highest);
        self.low.extend(low.map(|(index, _)| index as u32));
        let mut plane = self.most_supported()?;
        // Two rounds of least squares with what is near.
        for _ in 0..2 {
            plane = self.refined(&plane)?;
        }
        let near = |&&index: &&u32| self.distance(&plane, index) <= self.params.plane_distance;
        self.low.iter().filter(near).for_each(|&index| is_ground[index as usize] = true);
        Some(plane)
    }

    fn at(&self, index: u32) -> Vector3<f64> {
        self.in_base.point(index as usize).cast()
    }

    fn distance(&self, plane: &GroundPlane, index: u32) -> f64 {
        (plane.normal.dot(&self.at(index)) - plane.offset).abs()
    }

    fn most_supported(&self) -> Option<GroundPlane> {
        use rand::RngExt;
        if self.low.len() < FEWEST {
            return None;
        }
        let (mut stream, least) = (self.params.seed.stream(0, 0), self.params.max_slope.cos());
        let step = self.low.len().div_ceil(JUDGES);
        let mut best: Option<(usize, GroundPlane)> = None;
        for _ in 0..self.params.trials {
            let [a, b, c] = [(); 3].map(|()| self.at(self.low[stream.random_range(0..self.low.len())]));
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-6) else { continue };
            let normal = if normal.z < 0.0 { -normal } else { normal };
            if normal.z < least {
                continue;
            }
            let plane = GroundPlane { normal, offset: normal.dot(&a) };
            let near = |&place: &usize| self.distance(&plane, self.low[place]) <= self.params.plane_distance;
            let support = one_of_every(step, self.low.len()).filter(near).count();
            if best.is_none_or(|(most, _)| support > most) {
                best = Some((support, plane));
            }
        }
        best.map(|(_, plane)| plane)
    }

    fn refined(&self, plane: &GroundPlane) -> Option<GroundPlane> {
        let near = || self.low.iter().filter(|&&index| self.distance(plane, index) <= self.params.plane_distance);
        let count = near().count();
        if count < FEWEST {
            return None;
        }
        let mean = near().map(|&index| self.at(index)).sum::<Vector3<f64>>() / count as f64;
        let scatter: Matrix3<f64> = near().map(|&index| self.at(index) - mean).map(|d| d * d.transpose()).sum();
        let eigen = SymmetricEigen::new(&scatter);
        let normal = eigen.vectors.column(0).into_owned();
        let normal = if normal.z < 0.0 { -normal } else { normal };
        // Points on a line are near to many planes.
        let spread = eigen.values[1] > 1e-6 * eigen.values[2];
        let level = normal.z >= self.params.max_slope.cos();
        (spread && level).then(|| GroundPlane { normal, offset: normal.dot(&mean) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        geometry::{Se3, So3, Twist3},
        sensors::RangeImageParams,
        time::Stamp,
    };
    use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};

    fn filter(params: GroundParams) -> GroundFilter {
        GroundFilter::new(params).unwrap()
    }

    /// Both ways, on a revolution in a factory whose floor is z = 0, by a sensor that is mounted askew.
    #[test]
    fn the_floor_of_a_factory_is_found_and_hardly_anything_else() {
        let factory = Factory::generate(FactoryParams::default(), Seed(5)).unwrap();
        let mount = Se3::from_parts(Vector3::new(0.2, 0.0, 1.2), So3::from_roll_pitch_yaw(0.02, 0.06, 0.3));
        let params = LidarParams { columns: 900, ..LidarParams::hdl32().with_mount(mount) };
        let mut lidar = Lidar::new(params, Seed(5)).unwrap();
        let still = Twist3::default();
        let pose = Se3::from(factory.aisles()[1]);
        let cloud = lidar.scan(factory.world(), &pose, &still, Stamp::default()).unwrap();
        let in_base = {
            let mut moved = PointCloud::default();
            cloud.transform_into(&mount, &mut moved);
            moved
        };
        let floor: Vec<bool> = in_base.z().iter().map(|z| *z < 0.05).collect();
        let mut image = RangeImage::new(RangeImageParams { rows: 32, columns: 900, ..Default::default() }).unwrap();
        image.fill(cloud).unwrap();
        let mut filter = filter(GroundParams::default());
        let mut marked = Vec::new();
        let shares = |marked: &[bool]| {
            let both = marked.iter().zip(&floor).filter(|(m, f)| **m && **f).count() as f64;
            let count = |list: &[bool]| list.iter().filter(|v| **v).count() as f64;
            (both / count(marked), both / count(&floor))
        };
        filter.by_slope_into(cloud, &image, &mut marked);
        let (right, found) = shares(&marked);
        // Floor that is seen between racks has no floor on the next line.
        assert!(right > 0.95 && found > 0.7, "{right} {found}");
        let plane = filter.by_plane_into(cloud, &mut marked).unwrap();
        let (right, found) = shares(&marked);
        assert!(right > 0.9 && found > 0.95, "{right} {found}");
        assert!(plane.normal.z > 0.9999 && plane.offset.abs() < 0.02, "{plane:?}");
    }

    /// A quarter of the points are on a lower sheet, in step with those that planes are judged by if these were every fourth.
    #[test]
    fn the_order_of_the_points_does_not_choose_the_ground() {
        let points = (0..8000_u16).map(|i| {
            let z = if i % 4 == 0 { -0.5 } else { 0.0 };
            Vector3::new(f32::from(i % 83) * 0.1, f32::from(i / 83) * 0.1, z)
        });
        let mut marked = Vec::new();
        let plane =
            filter(GroundParams::default()).by_plane_into(&PointCloud::from_points(points), &mut marked).unwrap();
        assert!(plane.offset.abs() < 1e-3, "{plane:?}");
        assert_eq!(marked.iter().filter(|ground| **ground).count(), 6000);
    }

    #[test]
    fn without_ground_nothing_is_marked() {
        let mut filter = filter(GroundParams::default());
        let mut marked = vec![true];
        let wall = (0..900_u16).map(|i| Vector3::new(3.0, f32::from(i % 30) * 0.1, f32::from(i / 30) * 0.1 - 2.0));
        let line = (0..100_u16).map(|i| Vector3::new(f32::from(i) * 0.1, 0.0, 0.0));
        let nowhere = [Vector3::repeat(f32::NAN), Vector3::repeat(f32::INFINITY)];
        for cloud in [
            PointCloud::from_points(wall),
            PointCloud::from_points(line),
            PointCloud::from_points(nowhere),
            PointCloud::default(),
        ] {
            assert_eq!(filter.by_plane_into(&cloud, &mut marked), None);
            assert_eq!(marked, vec![false; cloud.len()]);
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = GroundParams::default();
        for bad in [
            GroundParams { max_slope: -0.1, ..good },
            GroundParams { max_slope: 2.0, ..good },
            GroundParams { max_height: f64::NAN, ..good },
            GroundParams { plane_distance: 0.0, ..good },
            GroundParams { trials: 0, ..good },
        ] {
            assert!(GroundFilter::new(bad).is_err(), "{bad:?}");
        }
    }
}
