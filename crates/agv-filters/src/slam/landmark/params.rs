//! What landmark SLAM must be told.

use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
};
use nalgebra::{Matrix3, Vector3};

/// How odometry errs that does not state its own covariance: a random walk.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WayNoise {
    /// Deviation of the way ahead, in metres per square root of a metre driven.
    pub forward: f64,
    /// Deviation to the side, in metres per square root of a metre driven.
    pub sideways: f64,
    /// Deviation of the heading, in radians per square root of a metre driven.
    pub yaw_by_way: f64,
    /// Deviation of the heading, in radians per square root of a radian turned.
    pub yaw_by_turn: f64,
}

impl Default for WayNoise {
    /// A wheeled vehicle on an even floor: after 100 m, half a metre along the way and some ten degrees.
    fn default() -> Self {
        Self { forward: 0.05, sideways: 0.02, yaw_by_way: 0.02, yaw_by_turn: 0.05 }
    }
}

impl WayNoise {
    fn validate(&self) -> Result<(), Error> {
        check::non_negative("forward", self.forward)?;
        check::non_negative("sideways", self.sideways)?;
        check::non_negative("yaw_by_way", self.yaw_by_way)?;
        check::non_negative("yaw_by_turn", self.yaw_by_turn).map(|_| ())
    }

    /// Covariance of the right increment of a motion.
    pub fn covariance(&self, start_from_end: &Se2) -> Matrix3<f64> {
        let (way, turn) = (start_from_end.translation().norm(), start_from_end.log().z.abs());
        let square = |v: f64| v * v;
        Matrix3::from_diagonal(&Vector3::new(
            square(self.forward) * way,
            square(self.sideways) * way,
            square(self.yaw_by_way) * way + square(self.yaw_by_turn) * turn,
        ))
    }
}

/// How sightings of unknown landmarks find theirs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Association {
    /// Each the nearest that is left, the surest pair first (individual compatibility).
    Nearest,
    /// The most pairs that are compatible together, and of these the best (joint compatibility: Neira and Tardós, *Data association
    /// in stochastic mapping using the joint compatibility test*, 2001).
    #[default]
    Joint,
}

/// Where errors are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SlamErrors {
    /// In the group of the pose and all points, on the side of the map: what cannot be observed, place and turn of the whole map, does
    /// not depend on the estimate, so that nothing is learnt of it by mistake (Barrau and Bonnabel, *An EKF-SLAM algorithm with
    /// consistency properties*, 2015; Zhang et al., 2017).
    #[default]
    Invariant,
    /// In each coordinate by itself, as in textbooks: grows too sure of the heading (Huang et al., 2008). For comparison.
    Additive,
}

/// What the sensor sees, for landmarks that ought to be seen and are not.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SensorView {
    /// How far, in metres, it is sure to see.
    pub range: f64,
    /// How far to either side of ahead, in radians.
    pub half_angle: f64,
}

/// How the place of a landmark is found of which only ranges are measured.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeStart {
    /// Way between two ranges that are kept, in metres.
    pub spacing: f64,
    /// Least number of ranges.
    pub least: usize,
    /// Most ranges that are kept; then every other one goes, and the spacing doubles.
    pub most: usize,
    /// By how much more likely the place is to be than the best one elsewhere, as twice a logarithm: a difference of squared residuals.
    pub lead: f64,
    /// Largest deviation of the place, as a share of its distance.
    pub certainty: f64,
}

impl Default for RangeStart {
    /// A metre apart, eight ranges or more; a mirrored place is a thousand times less likely (13.8), and the place is known to a
    /// tenth of its distance, within which a range is linear.
    fn default() -> Self {
        Self { spacing: 1.0, least: 8, most: 32, lead: 13.8, certainty: 0.1 }
    }
}

/// Parameters of [`LandmarkSlam`](super::LandmarkSlam).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LandmarkSlamParams {
    /// Noise of odometry whose increments state none.
    pub way_noise: WayNoise,
    /// Deviation of the share by which ranges are too long; zero: they are not.
    pub range_scale_sigma: f64,
    /// How sightings of unknown landmarks find theirs.
    pub association: Association,
    /// Probability with which a sighting of a landmark passes for one.
    pub gate_probability: f64,
    /// Probability beyond which a sighting cannot be of a known landmark, and is of a new one; between the gates it is left out.
    pub novelty_probability: f64,
    /// By how much farther, as a difference of squared distances, another joint assignment with as many pairs must be; sightings that a nearer one takes
    /// for another landmark are left out. Zero: the nearest is taken. Counts for 32 unnamed sightings at a time or less.
    pub lead: f64,
    /// Sightings of a landmark until it is believed.
    pub confirmations: u32,
    /// How often a landmark that is not believed yet may be missed where it ought to be seen; then it is forgotten.
    pub patience: u32,
    /// Where landmarks ought to be seen; none: not known, and no landmark is forgotten.
    pub view: Option<SensorView>,
    /// Start of landmarks of which only ranges are measured.
    pub range_start: RangeStart,
    /// Most pairs that a joint association looks at for one update beside its first try, at least 32; the best found by then is taken.
    pub joint_work: usize,
    /// Most landmarks; further ones are not added.
    pub most_landmarks: usize,
    /// Where errors are held.
    pub errors: SlamErrors,
}

impl Default for LandmarkSlamParams {
    /// Joint compatibility with gates of 99 % and of one in a million, and rivals that are farther by 9.21 = 2 ln 100, a
    /// hundred times less likely if they are as uncertain;
    /// three sightings make a landmark.
    fn default() -> Self {
        Self {
            way_noise: WayNoise::default(),
            range_scale_sigma: 0.0,
            association: Association::default(),
            gate_probability: 0.99,
            novelty_probability: 0.999_999,
            lead: 9.21,
            confirmations: 3,
            patience: 10,
            view: None,
            range_start: RangeStart::default(),
            joint_work: 2000,
            most_landmarks: 5000,
            errors: SlamErrors::default(),
        }
    }
}

impl LandmarkSlamParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        self.way_noise.validate()?;
        check::in_range("range_scale_sigma", self.range_scale_sigma, 0.0, 1.0)?;
        check::open_probability("gate_probability", self.gate_probability)?;
        check::open_probability("novelty_probability", self.novelty_probability)?;
        check::in_range("novelty_probability", self.novelty_probability, self.gate_probability, 1.0)?;
        check::non_negative("lead", self.lead)?;
        if let Some(view) = self.view {
            check::positive("range of the view", view.range)?;
            check::in_range("half_angle", view.half_angle, 0.0, std::f64::consts::PI)?;
        }
        let start = &self.range_start;
        check::positive("spacing", start.spacing)?;
        check::at_least("least ranges", start.least, 3)?;
        check::at_least("most ranges", start.most, start.least.saturating_mul(2))?;
        check::in_range("most ranges", start.most as f64, 1.0, 1000.0)?;
        check::non_negative("lead", start.lead)?;
        check::positive("certainty", start.certainty)?;
        check::at_least("joint_work", self.joint_work, super::association::MOST_JOINT)?;
        check::in_range("most_landmarks", self.most_landmarks as f64, 0.0, 20_000.0).map(|_| ())
    }
}
