//! LOAM-style odometry.

use super::aligner::{Aligner, FEWEST};
use super::features::{FeatureExtractor, Features};
use super::mapping::{LocalMap, PlacedFeatures};
use super::params::{LoamParams, LoamSolve, LoamTarget};
use crate::Error;
use crate::odometry::{LEAST_SIGMA, Matcher, Tracked, Tracker};
use agv_core::{
    compute::Par,
    geometry::{LieGroup, Se3},
    roles::{AlignmentError, LidarOdometry, LidarOdometryStep},
    sensors::PointCloud,
};
use nalgebra::Vector6;

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
    tracker: Tracker,
    matcher: FeatureMatcher,
    par: Par,
}

/// The maps, and the features that are matched with them.
#[derive(Debug, Clone)]
struct FeatureMatcher {
    target: LoamTarget,
    solve: LoamSolve,
    features: Features,
    placed: PlacedFeatures,
    aligner: Aligner,
    map: LocalMap,
    /// The features of the last cloud that fitted, in the base frame of that time; empty unless they are asked for.
    last: LocalMap,
    /// Pose of the base at that time.
    last_pose: Se3,
}

impl LoamOdometry {
    /// An odometry that has not seen anything.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(params: LoamParams) -> Result<Self, Error> {
        params.validate()?;
        let matcher = FeatureMatcher {
            target: params.target,
            solve: params.solve,
            features: Features::default(),
            placed: PlacedFeatures::default(),
            aligner: Aligner::new(params),
            map: LocalMap::new(params.map)?,
            last: LocalMap::new(params.map)?,
            last_pose: Se3::identity(),
        };
        Ok(Self {
            extractor: FeatureExtractor::new(params.features)?,
            tracker: Tracker::new(params.initial_sigma),
            matcher,
            par: Par::Seq,
            params,
        })
    }

    /// The same, with its loops spread over threads.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self.matcher.aligner.spread_over(par);
        self
    }

    /// The parameters.
    pub const fn params(&self) -> &LoamParams {
        &self.params
    }

    /// The local map, in the frame of the first cloud.
    pub const fn map(&self) -> &LocalMap {
        &self.matcher.map
    }

    /// The features of the last cloud, in its sensor frame and as they were seen: not deskewed.
    pub const fn features(&self) -> &Features {
        &self.matcher.features
    }

    /// Forgets the drive; the next cloud is the first one.
    pub fn reset(&mut self) {
        self.matcher.forget();
        self.tracker = Tracker::new(self.params.initial_sigma);
    }
}

impl Matcher for FeatureMatcher {
    fn place(&mut self, cloud: &PointCloud, velocity: Option<&Vector6<f64>>) -> Result<(), AlignmentError> {
        self.placed.rebuild(&self.features, &cloud.base_from_sensor(), velocity);
        Ok(())
    }

    fn placed(&self) -> (usize, f64) {
        self.placed.count_and_range()
    }

    fn has_map(&self) -> bool {
        self.map.len().max(self.last.len()) >= FEWEST
    }

    fn track(&mut self, guess: &Se3, sigma: f64) -> Result<Tracked, AlignmentError> {
        let Self { target, solve, placed, aligner, map, last, last_pose, .. } = self;
        let (mut guess, mut sigma) = (*guess, sigma);
        if *target != LoamTarget::LocalMap {
            let mut found = aligner.align(placed, last, &last_pose.between(&guess), sigma, &[*solve]);
            let pose = last_pose.compose(&found.alignment.target_from_source);
            found.alignment.target_from_source = pose;
            if *target == LoamTarget::LastCloud {
                return Ok(found);
            }
            if found.is_usable {
                (guess, sigma) = (pose, LEAST_SIGMA);
            }
        }
        let with_map: &[_] = match (*target, *solve) {
            (LoamTarget::LocalMap, LoamSolve::TwoStep) => &[LoamSolve::TwoStep, LoamSolve::Joint],
            _ => &[LoamSolve::Joint],
        };
        Ok(aligner.align(placed, map, &guess, sigma, with_map))
    }

    fn remember(&mut self, pose: &Se3) {
        if self.target != LoamTarget::LastCloud {
            self.map.insert(&self.placed, pose);
        }
        if self.target != LoamTarget::LocalMap {
            self.last.clear();
            self.last.insert(&self.placed, &Se3::identity());
            self.last_pose = *pose;
        }
    }

    fn forget(&mut self) {
        self.map.clear();
        self.last.clear();
    }
}

impl LidarOdometry for LoamOdometry {
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, AlignmentError> {
        self.extractor.extract_into(cloud, self.par, &mut self.matcher.features)?;
        self.tracker.step(&mut self.matcher, cloud, prior)
    }
}
