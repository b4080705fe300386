//! Parameters of graph SLAM.

use crate::matching::{CorrelativeParams, SearchWindow};
use agv_core::{
    Error, check,
    geometry::{LieGroup, PoseSigma, Se2},
    grid::{InverseModel, InverseModelParams},
};
use nalgebra::{Matrix3, Vector3};

/// How far odometry is believed: standard deviations of the motion between two key scans.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OdometryTrust {
    /// Standard deviation of the position, per metre travelled.
    pub per_metre: f64,
    /// Standard deviation of the heading, in radians per radian turned.
    pub per_radian: f64,
    /// Standard deviation of the heading, in radians per metre travelled.
    pub turn_per_metre: f64,
    /// Standard deviations of a motion between two scans that is none.
    pub floor: PoseSigma,
    /// A motion between two scans that is longer than this, in metres, is a jump of the odometry's frame and not one of the vehicle.
    pub jump: f64,
}

impl Default for OdometryTrust {
    /// A tenth of each, as for the wheels of indoor robots of the Radish logs, and jumps from 5 m on.
    fn default() -> Self {
        Self {
            per_metre: 0.1,
            per_radian: 0.1,
            turn_per_metre: 0.03,
            floor: PoseSigma { translation: 0.01, rotation: 0.01 },
            jump: 5.0,
        }
    }
}

impl OdometryTrust {
    fn validate(&self) -> Result<(), Error> {
        check::non_negative("per_metre", self.per_metre)?;
        check::non_negative("per_radian", self.per_radian)?;
        check::non_negative("turn_per_metre", self.turn_per_metre)?;
        self.floor.checked()?;
        check::positive("jump", self.jump)?;
        Ok(())
    }

    /// Whether a motion may be one of the vehicle.
    pub(super) fn believes(&self, motion: &Se2) -> bool {
        motion.translation().norm() <= self.jump
    }

    /// Information of a motion.
    pub(super) fn information(&self, driven: &Driven) -> Matrix3<f64> {
        let Driven { path, turn, .. } = *driven;
        let steps = f64::from(driven.steps.max(1)).sqrt();
        let translation = (steps * self.floor.translation).hypot(self.per_metre * path);
        let rotation = (steps * self.floor.rotation).hypot(self.per_radian * turn).hypot(self.turn_per_metre * path);
        information(PoseSigma { translation, rotation })
    }
}

/// A motion by odometry, and how it came about.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Driven {
    pub(super) motion: Se2,
    /// Way, in metres, and turn, in radians, both without sign.
    pub(super) path: f64,
    pub(super) turn: f64,
    pub(super) steps: u32,
}

impl Driven {
    pub(super) fn and(&self, motion: &Se2) -> Self {
        Self {
            motion: self.motion.compose(motion),
            path: self.path + motion.translation().norm(),
            turn: self.turn + motion.yaw().abs(),
            steps: self.steps.saturating_add(1),
        }
    }
}

/// Information of independent standard deviations.
pub(super) fn information(sigma: PoseSigma) -> Matrix3<f64> {
    let weights = [sigma.translation, sigma.translation, sigma.rotation].map(|sigma| 1.0 / (sigma * sigma));
    Matrix3::from_diagonal(&Vector3::from(weights))
}

/// How loops are sought, and what makes one.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ClosureParams {
    /// Least way between two key scans that may close a loop, in metres.
    pub min_path: f64,
    /// Poses around the expected one that are searched after a long way without a closure.
    pub window: SearchWindow,
    /// The window right after a closure; it grows with the way until it is [`window`](Self::window).
    pub least_window: SearchWindow,
    /// By how much the window grows, in metres per metre travelled (and radians per metre, a tenth of it).
    pub drift: f64,
    /// Key scans to either side of the nearest one that make the target.
    pub neighbours: usize,
    /// Groups of key scans that are tried for each new key scan.
    pub candidates: usize,
    /// Least share of the scan's points that must meet the target.
    pub min_inlier_ratio: f64,
    /// Least score of the match.
    pub min_score: f64,
    /// How many closures must agree before one counts that the graph did not expect.
    pub confirmations: usize,
    /// How far closures may differ that agree, and how far a closure may be from where the graph expects it to count at once.
    pub agreement: PoseSigma,
}

impl Default for ClosureParams {
    /// Windows for indoor odometry, whose matched chains drift by some per cent; three closures that agree to a quarter of a metre.
    fn default() -> Self {
        Self {
            min_path: 8.0,
            window: SearchWindow { distance: 4.0, angle: 0.7 },
            least_window: SearchWindow { distance: 0.8, angle: 0.25 },
            drift: 0.05,
            neighbours: 6,
            candidates: 3,
            min_inlier_ratio: 0.6,
            min_score: 0.45,
            confirmations: 3,
            agreement: PoseSigma { translation: 0.25, rotation: 0.06 },
        }
    }
}

impl ClosureParams {
    fn validate(&self, resolution: f64) -> Result<(), Error> {
        check::non_negative("min_path", self.min_path)?;
        self.window.checked(resolution)?;
        self.least_window.checked(resolution)?;
        check::non_negative("drift", self.drift)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        check::in_range("min_score", self.min_score, 0.0, 1.0)?;
        check::at_least("confirmations", self.confirmations, 1)?;
        self.agreement.checked()?;
        Ok(())
    }

    /// Where to search after so many metres without a closure.
    pub(super) fn window_after(&self, path: f64) -> SearchWindow {
        let grown = |least: f64, most: f64, rate: f64| (least + rate * path).clamp(least.min(most), most);
        SearchWindow {
            distance: grown(self.least_window.distance, self.window.distance, self.drift),
            angle: grown(self.least_window.angle, self.window.angle, 0.1 * self.drift),
        }
    }
}

/// Parameters of [`GraphSlam`](super::GraphSlam): the same for every building and vehicle that we know of.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GraphSlamParams {
    /// Edge of a cell of the map, in metres.
    pub resolution: f64,
    /// How beams enter the map.
    pub inverse_model: InverseModelParams,
    /// How scans are matched; its window is the front end's.
    pub matcher: CorrelativeParams,
    /// Greatest range of a reading that is matched, in metres: at most 3000 cells of the matcher.
    pub max_range: f64,
    /// A key scan is made after so many metres,
    pub key_distance: f64,
    /// or after so many radians.
    pub key_angle: f64,
    /// Key scans that make the front end's target.
    pub chain: usize,
    /// Share of the points that must meet the target for the front end to do without a search.
    pub good_fit: f64,
    /// Standard deviations of a match that the information of its points does not know of: the errors of the target.
    pub match_floor: PoseSigma,
    /// How far odometry is believed.
    pub odometry: OdometryTrust,
    /// Loop closures.
    pub closure: ClosureParams,
}

impl Default for GraphSlamParams {
    /// Maps of 0.05 m, key scans as Karto and Cartographer space them, readings up to 25 m.
    fn default() -> Self {
        Self {
            resolution: 0.05,
            inverse_model: InverseModelParams { max_range: Some(30.0), ..Default::default() },
            matcher: CorrelativeParams::default(),
            max_range: 25.0,
            key_distance: 0.3,
            key_angle: 0.3,
            chain: 16,
            good_fit: 0.75,
            match_floor: PoseSigma { translation: 0.01, rotation: 0.004 },
            odometry: OdometryTrust::default(),
            closure: ClosureParams::default(),
        }
    }
}

impl GraphSlamParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("resolution", self.resolution)?;
        InverseModel::new(self.inverse_model)?;
        self.matcher.validate()?;
        check::positive("max_range", self.max_range)?;
        // What a scan sees must be one target.
        check::in_range("max_range (cells of the matcher)", self.max_range / self.matcher.resolution, 1.0, 3000.0)?;
        check::positive("key_distance", self.key_distance)?;
        check::positive("key_angle", self.key_angle)?;
        check::at_least("chain", self.chain, 1)?;
        check::in_range("good_fit", self.good_fit, 0.0, 1.0)?;
        self.match_floor.checked()?;
        self.odometry.validate()?;
        self.closure.validate(self.matcher.resolution)
    }
}
