//! Two clouds of one place whose relative pose is known: what registrations are tried on.

use crate::{Error, Factory, FactoryParams, Lidar, LidarParams};
use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se3, So3, Twist3},
    sensors::PointCloud,
    time::Stamp,
};
use nalgebra::Vector3;

/// Height of the lidar above the floor, in metres.
const HEIGHT: f64 = 1.8;

/// A target, a source, and how they lie to each other.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_sim::{CloudPair, LidarParams};
///
/// let pair = CloudPair::in_factory(LidarParams { columns: 300, ..LidarParams::hdl32() }, Seed(1))?;
/// assert!((pair.target_from_source.translation().norm() - 0.506).abs() < 1e-3);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct CloudPair {
    /// Where the vehicle was first.
    pub target: PointCloud,
    /// Where it was then.
    pub source: PointCloud,
    /// Pose of the source in the target frame.
    pub target_from_source: Se3,
}

impl CloudPair {
    /// Two revolutions of a lidar, 1.8 m above a vehicle that stands in an aisle of a generated factory: half a metre and five
    /// degrees apart. The mount of `lidar` is replaced.
    ///
    /// # Errors
    /// Parameters that [`Lidar::new`] refuses.
    pub fn in_factory(lidar: LidarParams, seed: Seed) -> Result<Self, Error> {
        let factory = Factory::generate(FactoryParams::default(), seed)?;
        let mount = Se3::from_parts(Vector3::new(0.0, 0.0, HEIGHT), So3::identity());
        let mut lidar = Lidar::new(lidar.with_mount(mount), seed)?;
        let aisles = factory.aisles();
        let first = Se3::from(aisles.get(1).or(aisles.first()).copied().unwrap_or_default());
        let turn = So3::from_roll_pitch_yaw(0.0, 0.0, 5_f64.to_radians());
        let step = Se3::from_parts(Vector3::new(0.5, 0.08, 0.0), turn);
        let mut scan = |pose: Se3| -> Result<PointCloud, Error> {
            Ok(lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::default())?.clone())
        };
        let (target, source) = (scan(first)?, scan(first * step)?);
        Ok(Self { target, source, target_from_source: mount.inverse() * step * mount })
    }
}
