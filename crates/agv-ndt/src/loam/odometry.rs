//! LOAM-style odometry.

use super::aligner::{Aligned, Aligner};
use super::features::{FeatureExtractor, Features};
use super::mapping::{LocalMap, PlacedFeatures};
use super::params::{LoamParams, LoamSolve, LoamTarget};
use crate::Error;
use crate::odometry::MotionPrior;
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3},
    roles::{AlignmentError, LidarOdometry, LidarOdometryStep},
    sensors::PointCloud,
    time::Stamp,
};

/// Least deviation from the prediction that is reckoned with, in metres.
const LEAST_SIGMA: f64 = 0.1;

/// How far a motion may differ from what a cloud was deskewed with, in metres at its points, before that is done again.
const SKEW: f64 = 0.02;

/// Clouds in a row that fit nowhere, after which the map is begun anew where the prediction is.
const GIVE_UP: usize = 5;

/// Follows a lidar by edges and surfaces: feature extraction, deskewing by the motion, alignment with the local map or the last cloud,
/// in one call per cloud (Zhang and Singh, *LOAM*, 2014; Shan and Englot, *LeGO-LOAM*, 2018; paper 003).
///
/// How far from the prediction matches are looked for follows from how good predictions have been. Directions that the features do not
/// fix keep the prediction and are reported. A cloud that fits nowhere moves the pose by the prediction and leaves the map as it is.
///
/// Nothing is allocated once buffers and map have met clouds of that size and places of that extent.
///
/// ```
/// use agv_core::{nalgebra::Vector3, roles::LidarOdometry, sensors::PointCloud};
/// use agv_ndt::loam::{LoamOdometry, LoamParams};
///
/// // Floor and walls of a hall, seen from a vehicle that drives 20 cm between two clouds.
/// let sheet = |f: fn(f32, f32) -> [f32; 3]| (0..10_000).map(move |i| f((i % 100) as f32 * 0.1 - 5.0, (i / 100) as f32 * 0.1 - 5.0));
/// let hall: Vec<_> = sheet(|a, b| [a, b, -1.0]).chain(sheet(|a, b| [a, -5.0, b + 4.0])).chain(sheet(|a, b| [5.0, a, b + 4.0])).collect();
/// let seen_from = |x: f32| PointCloud::from_points(hall.iter().map(|p| Vector3::from(*p) - Vector3::new(x, 0.0, 0.0)));
///
/// let mut odometry = LoamOdometry::new(LoamParams::default())?;
/// odometry.process(&seen_from(0.0), None)?;
/// let step = odometry.process(&seen_from(0.2), None)?;
/// assert!((step.odom_from_base.translation() - Vector3::new(0.2, 0.0, 0.0)).norm() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct LoamOdometry {
    params: LoamParams,
    extractor: FeatureExtractor,
    features: Features,
    placed: PlacedFeatures,
    aligner: Aligner,
    map: LocalMap,
    /// The features of the last cloud that fitted, in the base frame of that time; empty unless they are asked for.
    last: LocalMap,
    /// Pose of the base at that time.
    last_pose: Se3,
    prior: Option<MotionPrior>,
    /// Clouds in a row that fitted nowhere.
    lost: usize,
    par: Par,
}

impl LoamOdometry {
    /// An odometry that has not seen anything.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(params: LoamParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            extractor: FeatureExtractor::new(params.features)?,
            features: Features::default(),
            placed: PlacedFeatures::default(),
            aligner: Aligner::new(params),
            map: LocalMap::new(params.map)?,
            last: LocalMap::new(params.map)?,
            last_pose: Se3::identity(),
            prior: None,
            lost: 0,
            par: Par::Seq,
            params,
        })
    }

    /// The same, with its loops spread over threads.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self.aligner.spread_over(par);
        self
    }

    /// The parameters.
    pub const fn params(&self) -> &LoamParams {
        &self.params
    }

    /// The local map, in the frame of the first cloud.
    pub const fn map(&self) -> &LocalMap {
        &self.map
    }

    /// The features of the last cloud, in its sensor frame and as they were seen: not deskewed.
    pub const fn features(&self) -> &Features {
        &self.features
    }

    /// Forgets the drive; the next cloud is the first one.
    pub fn reset(&mut self) {
        self.map.clear();
        self.last.clear();
        self.prior = None;
        self.lost = 0;
    }

    /// Puts the features where the base is at the cloud's stamp, given its motion in `seconds`.
    fn place(&mut self, cloud: &PointCloud, motion: &Se3, seconds: f64) {
        let twist = (cloud.time().is_some() && seconds > 0.0).then(|| motion.log() / seconds);
        self.placed.rebuild(&self.features, &cloud.base_from_sensor(), twist.as_ref());
    }

    /// The pose of the base, which was at `origin` and moved by `motion`, give or take `sigma` metres at the features.
    fn track(&mut self, origin: &Se3, motion: &Se3, sigma: f64) -> Aligned {
        let Self { params, placed, aligner, map, last, last_pose, .. } = self;
        let mut guess = origin.compose(motion);
        let (mut sigma, mut solve) = (sigma.max(LEAST_SIGMA), params.solve);
        if params.target != LoamTarget::LocalMap {
            let mut found = aligner.align(placed, last, &last_pose.between(&guess), sigma, solve);
            let pose = last_pose.compose(&found.alignment.target_from_source);
            found.alignment.target_from_source = pose;
            if params.target == LoamTarget::LastCloud {
                return found;
            }
            if found.alignment.converged() {
                (guess, sigma) = (pose, LEAST_SIGMA);
            }
            solve = LoamSolve::Joint;
        }
        aligner.align(placed, map, &guess, sigma, solve)
    }

    /// Takes the features into the maps.
    fn remember(&mut self, pose: &Se3) {
        match self.params.target {
            LoamTarget::LastCloud => {}
            LoamTarget::LocalMap => return self.map.insert(&self.placed, pose),
            LoamTarget::LastCloudThenMap => self.map.insert(&self.placed, pose),
        }
        self.last.clear();
        self.last.insert(&self.placed, &Se3::identity());
        self.last_pose = *pose;
    }

    fn begin(&mut self, cloud: &PointCloud, stamp: Stamp) -> LidarOdometryStep {
        self.place(cloud, &Se3::identity(), 0.0);
        self.remember(&Se3::identity());
        self.prior = Some(MotionPrior::new(stamp, self.params.initial_sigma));
        LidarOdometryStep { odom_from_base: Se3::identity(), alignment: None }
    }
}

impl LidarOdometry for LoamOdometry {
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, AlignmentError> {
        if let Some(prior) = prior {
            check::all_finite("prior", prior.translation().iter())?;
            check::all_finite("prior", prior.rotation().matrix().iter())?;
        }
        self.extractor.extract_into(cloud, self.par, &mut self.features)?;
        let stamp = cloud.stamp();
        let Some(mut state) = self.prior else { return Ok(self.begin(cloud, stamp)) };
        let seconds = state.seconds_to(stamp);
        let predicted = prior.copied().unwrap_or_else(|| state.motion_until(stamp));
        let (origin, sigma) = (state.pose(), state.sigma());
        check::all_finite("predicted position", origin.compose(&predicted).translation().iter())?;
        self.place(cloud, &predicted, seconds);
        let range = self.placed.mean_range();
        let mut found = self.track(&origin, &predicted, sigma);
        // The prediction may be worse than it has been, or what is wrong.
        let wide = self.params.initial_sigma.max(sigma);
        let mut expected = predicted;
        for motion in [predicted, Se3::identity()] {
            if found.is_clear() {
                break;
            }
            self.place(cloud, &motion, seconds);
            let other = self.track(&origin, &motion, wide);
            if other.beats(&found) {
                (found, expected) = (other, motion);
            } else {
                self.place(cloud, &expected, seconds);
            }
        }
        let mut found = found.alignment;
        let motion = origin.between(&found.target_from_source);
        let turned = expected.between(&motion);
        let skew = turned.translation().norm() + range * turned.rotation().log().norm();
        if found.converged() && cloud.time().is_some() && seconds > 0.0 && skew > SKEW {
            self.place(cloud, &motion, seconds);
            found = self.track(&origin, &motion, LEAST_SIGMA).alignment;
        }
        let pose = if found.converged() { found.target_from_source } else { origin.compose(&predicted) };
        if found.converged() {
            state.learn(&origin.compose(&predicted), &pose, range);
            self.lost = 0;
        } else {
            self.place(cloud, &predicted, seconds);
            self.lost += 1;
            if self.lost >= GIVE_UP {
                self.map.clear();
            }
        }
        if found.converged() || (self.map.is_empty() && self.last.is_empty()) || self.lost >= GIVE_UP {
            self.remember(&pose);
        }
        state.advance(stamp, &pose);
        self.prior = Some(state);
        Ok(LidarOdometryStep { odom_from_base: pose, alignment: Some(found) })
    }
}
