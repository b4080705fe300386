//! Drives between racks, with clouds and an odometry that drifts.
#![allow(dead_code, reason = "each test binary uses its part")]

use agv_nav::core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Se3, So3, Twist3},
    nalgebra::{Vector2, Vector3},
    roles::LidarOdometryStep,
    sensors::PointCloud,
    time::Stamp,
};
use agv_nav::pipeline::mapping::KeyFrameMap;
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};
use rand::RngExt;

/// A drive with a cloud for every metre; the stamp of a cloud is its number, in seconds. Each is taken while the
/// vehicle goes on as it came, from the place before: at corners in an arc.
pub(crate) struct Laps {
    pub(crate) clouds: Vec<PointCloud>,
    pub(crate) truth: Vec<Se3>,
    pub(crate) odometry: Vec<Se3>,
}

/// How odometry errs at most: share of the way that it takes too much for, and heading per metre, in radians. Each
/// drive draws its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drift {
    pub(crate) scale: f64,
    pub(crate) heading: f64,
}

/// A hall of so many metres, whose racks are filled to that share.
pub(crate) fn hall(length: f64, width: f64, fill: f64, seed: Seed) -> Factory {
    Factory::generate(FactoryParams { length, width, fill, ..Default::default() }, seed).unwrap()
}

/// Ends of an aisle, 2 m into the cross aisles.
fn ends(factory: &Factory, aisle: usize) -> [Vector2<f64>; 2] {
    let entrance = factory.aisles()[aisle].translation();
    [entrance - Vector2::new(2.0, 0.0), entrance + Vector2::new(factory.aisle_length() + 2.0, 0.0)]
}

impl Laps {
    /// Twice around the first rack, and some metres on.
    pub(crate) fn around(factory: &Factory, columns: usize, drift: Drift, seed: Seed) -> Self {
        let ([a, b], [d, c]) = (ends(factory, 0), ends(factory, 1));
        let on = a + (b - a).normalize() * 6.0;
        Self::through(factory, &[a, b, c, d, a, b, c, d, a, on], columns, drift, seed)
    }

    /// To and fro through all aisles, none of them twice.
    pub(crate) fn once_each(factory: &Factory, columns: usize, drift: Drift, seed: Seed) -> Self {
        let order = |aisle: usize| {
            let [west, east] = ends(factory, aisle);
            if aisle.is_multiple_of(2) { [west, east] } else { [east, west] }
        };
        let way: Vec<_> = (0..factory.aisles().len()).flat_map(order).collect();
        Self::through(factory, &way, columns, drift, seed)
    }

    fn through(factory: &Factory, way: &[Vector2<f64>], columns: usize, drift: Drift, seed: Seed) -> Self {
        let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::default());
        let params = LidarParams { columns, ..LidarParams::vlp16().with_mount(mount) };
        let mut lidar = Lidar::new(params, seed).unwrap();
        let mut stream = seed.stream(77, 0);
        let [scale, heading] = [drift.scale, drift.heading].map(|most| most * (2.0 * stream.random::<f64>() - 1.0));
        let mut laps = Self { clouds: vec![], truth: vec![], odometry: vec![] };
        for pair in way.windows(2) {
            let stretch = pair[1] - pair[0];
            let steps = stretch.norm().round();
            for step in 0..steps as u32 {
                let at = pair[0] + stretch * (f64::from(step) / steps);
                let truth = Se2::new(at.x, at.y, stretch.y.atan2(stretch.x));
                let (mut odometry, mut twist) = (Se3::identity(), Twist3::default());
                if let (Some(last), Some(before)) = (laps.truth.last(), laps.odometry.last()) {
                    let tangent = last.between(&truth.into()).log();
                    twist = Twist3 {
                        linear: tangent.fixed_rows::<3>(0).into(),
                        angular: tangent.fixed_rows::<3>(3).into(),
                    };
                    let motion = last.to_planar().between(&truth);
                    let (length, noise) = (motion.translation().norm(), 0.002 * (2.0 * stream.random::<f64>() - 1.0));
                    let yaw = motion.yaw() + heading * length + noise;
                    odometry =
                        before.compose(&Se2::new(motion.x() * (1.0 + scale), motion.y() * (1.0 + scale), yaw).into());
                }
                let stamp = Stamp::from_seconds(laps.truth.len() as f64);
                let cloud = lidar.scan(factory.world(), &truth.into(), &twist, stamp).unwrap();
                laps.clouds.push(cloud.clone());
                laps.truth.push(truth.into());
                laps.odometry.push(odometry);
            }
        }
        laps
    }

    pub(crate) fn step(&self, index: usize) -> LidarOdometryStep {
        LidarOdometryStep { odom_from_base: self.odometry[index], alignment: None }
    }

    /// Error of a pose of that cloud, in metres, where the first is at the truth.
    pub(crate) fn error(&self, index: usize, pose: &Se3) -> f64 {
        self.truth[0].between(&self.truth[index]).between(pose).translation().norm()
    }

    /// Greatest error of a trajectory that begins at the truth, in metres, and that of its end.
    pub(crate) fn errors(&self, poses: impl Iterator<Item = Se3>) -> (f64, f64) {
        let errors: Vec<f64> = poses.enumerate().map(|(index, pose)| self.error(index, &pose)).collect();
        (errors.iter().copied().fold(0.0, f64::max), errors[errors.len() - 1])
    }

    /// Closures whose two key frames are elsewhere, by more than half a metre or five degrees.
    pub(crate) fn false_closures(&self, map: &KeyFrameMap) -> usize {
        let keys: Vec<usize> =
            map.key_frames().map(|(key, _)| key.cloud().stamp().seconds().round() as usize).collect();
        let closures = map.relations().iter().filter(|relation| relation.to.0 > relation.from.0 + 1);
        let is_false = |relation: &&agv_nav::filters::graph::Relation<Se3>| {
            let between = self.truth[keys[relation.from.index()]].between(&self.truth[keys[relation.to.index()]]);
            let off = between.between(&relation.from_from_to);
            off.translation().norm() > 0.5 || off.rotation().log().norm() > 5_f64.to_radians()
        };
        closures.filter(is_false).count()
    }
}
