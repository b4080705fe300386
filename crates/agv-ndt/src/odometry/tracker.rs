//! What every lidar odometry does with a cloud, whatever it is matched by.
//!
//! ```text
//! prior, or constant velocity --> predicted pose and velocity --> the cloud without skew --> aligned near the prediction
//!   unclear:       again as far as predictions may be off at first, and from where the vehicle was; the best counts
//!   other skew:    the motion that was found is not the one the cloud was deskewed with: deskewed and aligned once more
//!   free directions keep the prediction
//!   fits:          pose, map and prediction learn
//!   fits nowhere:  the prediction is the pose, the map stays as it is; after five in a row it is begun anew
//! ```
//!
//! A cloud of a handful of points, where those of the map had many, as of a lidar that is covered, says nothing: a handful fits anywhere.
//! It is not aligned, the prediction is the pose, and it is no reason to doubt the map.

use super::{MotionPrior, is_skewed, sweep};
use crate::checks::finite_pose;
use crate::registration::MIN_POINTS;
use agv_core::{
    check,
    geometry::{LieGroup, Se3},
    roles::{Alignment, AlignmentError, LidarOdometryStep, Termination},
    sensors::PointCloud,
};
use nalgebra::Vector6;

/// Least deviation from the prediction that is reckoned with, in metres.
pub(crate) const LEAST_SIGMA: f64 = 0.1;

/// Clouds in a row that fit nowhere, after which the map is begun anew where the prediction is.
const GIVE_UP: usize = 5;

/// Points or features of a cloud, below which it says nothing of where the vehicle is, if ...
const FEWEST: usize = MIN_POINTS;

/// ... it also has less than one in so many of what the last cloud in the map had: what is few depends on the lidar and the place.
const FEW: usize = 4;

/// How a cloud met the map.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tracked {
    pub(crate) alignment: Alignment<Se3>,
    /// Whether the pose can be used; what the cloud leaves free of it is the prediction's then.
    pub(crate) is_usable: bool,
    /// Whether there is no reason to look any further.
    pub(crate) is_clear: bool,
}

impl Tracked {
    /// What a cloud amounts to that says nothing.
    pub(crate) fn nothing(predicted: &Se3) -> Self {
        let alignment = Alignment::unknown(*predicted, Termination::TooFewPoints);
        Self { alignment, is_usable: false, is_clear: false }
    }

    /// Whether this explains more of the cloud than another result.
    fn beats(&self, other: &Self) -> bool {
        let rank = |of: &Self| (of.is_usable, of.alignment.converged(), of.alignment.inlier_ratio);
        rank(self) > rank(other)
    }

    /// Takes the predicted place along what the cloud leaves free: noise has it otherwise. A pose that was found far from the prediction
    /// is moved by as much, and not aligned again.
    fn hold(&mut self, predicted: &Se3) {
        let found = &mut self.alignment;
        let pose = found.target_from_source;
        let held = pose.plus(&(found.unobserved * predicted.minus(&pose)));
        if found.unobserved.trace() > 0.5 && held.is_finite() {
            found.target_from_source = held;
        }
    }
}

/// A way of matching clouds, and its map.
pub(crate) trait Matcher {
    /// Puts the cloud where the base is at its stamp, given its velocity.
    fn place(&mut self, cloud: &PointCloud, velocity: Option<&Vector6<f64>>) -> Result<(), AlignmentError>;

    /// How many points or features were placed, and their mean distance from the base, in metres.
    fn placed(&self) -> (usize, f64);

    /// Whether there is a map to match with.
    fn has_map(&self) -> bool;

    /// The pose of what was placed near a guess, which is `sigma` metres off or so.
    fn track(&mut self, guess: &Se3, sigma: f64) -> Result<Tracked, AlignmentError>;

    /// Takes what was placed into the map.
    fn remember(&mut self, pose: &Se3);

    /// Empties the map.
    fn forget(&mut self);
}

/// Where the vehicle is between two clouds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tracker {
    /// Deviation from the prediction that is expected before any was seen, in metres.
    initial_sigma: f64,
    prior: Option<MotionPrior>,
    /// Clouds in a row that fitted nowhere.
    misses: usize,
    /// Points or features of the last cloud that was taken into the map.
    usual: usize,
}

impl Tracker {
    /// Before the first cloud.
    pub(crate) const fn new(initial_sigma: f64) -> Self {
        Self { initial_sigma, prior: None, misses: 0, usual: 0 }
    }

    /// Takes the next cloud; this is as it was if that is refused.
    pub(crate) fn step(
        &mut self,
        matcher: &mut impl Matcher,
        cloud: &PointCloud,
        prior: Option<&Se3>,
    ) -> Result<LidarOdometryStep, AlignmentError> {
        if let Some(prior) = prior {
            finite_pose("prior", prior)?;
        }
        let stamp = cloud.stamp();
        let Some(mut state) = self.prior else {
            matcher.place(cloud, None)?;
            matcher.remember(&Se3::identity());
            self.usual = matcher.placed().0;
            self.prior = Some(MotionPrior::new(stamp, self.initial_sigma));
            return Ok(LidarOdometryStep { odom_from_base: Se3::identity(), alignment: None });
        };
        let origin = state.pose();
        let predicted = origin.compose(&prior.copied().unwrap_or_else(|| state.motion_until(stamp)));
        check::all_finite("predicted position", predicted.translation().iter())?;

        let sweep = sweep(cloud);
        let velocity = |pose: &Se3| state.velocity(stamp, pose, sweep).filter(|_| cloud.time().is_some());
        let mut search = Search { matcher, cloud, skew: velocity(&predicted) };
        search.matcher.place(cloud, search.skew.as_ref())?;
        let (count, range) = search.matcher.placed();
        let tells = count >= FEWEST.min(self.usual / FEW).max(1);
        let sigma = state.sigma().max(LEAST_SIGMA);
        let mut found = if tells { search.matcher.track(&predicted, sigma)? } else { Tracked::nothing(&predicted) };
        if !found.is_clear && tells && search.matcher.has_map() {
            found = search.again(&found, (&origin, &predicted), sigma, self.initial_sigma, velocity(&origin))?;
        }
        if found.is_usable {
            found.hold(&predicted);
            let after = velocity(&found.alignment.target_from_source);
            found =
                search.straighten(&found, after, &predicted, |before, after| is_skewed(before, after, sweep, range))?;
        }
        let pose = if found.is_usable { found.alignment.target_from_source } else { predicted };
        let misses = if found.is_usable { 0 } else { self.misses + usize::from(tells) };
        let anew = misses >= GIVE_UP || !(found.is_usable || search.matcher.has_map());
        if anew {
            search.skew_by(velocity(&pose))?;
            search.matcher.forget();
        }
        if anew || found.is_usable {
            search.matcher.remember(&pose);
            self.usual = count;
        }
        if found.is_usable {
            state.learn(&predicted, &pose, range);
        }
        self.misses = if anew { 0 } else { misses };
        state.advance(stamp, &pose);
        self.prior = Some(state);
        Ok(LidarOdometryStep { odom_from_base: pose, alignment: Some(found.alignment) })
    }
}

/// A cloud that was placed, and the velocity that it was deskewed with.
struct Search<'a, M> {
    matcher: &'a mut M,
    cloud: &'a PointCloud,
    skew: Option<Vector6<f64>>,
}

impl<M: Matcher> Search<'_, M> {
    /// Deskews the cloud with another velocity.
    fn skew_by(&mut self, velocity: Option<Vector6<f64>>) -> Result<(), AlignmentError> {
        if velocity != self.skew {
            self.matcher.place(self.cloud, velocity.as_ref())?;
            self.skew = velocity;
        }
        Ok(())
    }

    /// The best of what was found and of further tries: the prediction may be worse than it has been, or what is wrong.
    fn again(
        &mut self,
        first: &Tracked,
        (origin, predicted): (&Se3, &Se3),
        sigma: f64,
        initial_sigma: f64,
        still: Option<Vector6<f64>>,
    ) -> Result<Tracked, AlignmentError> {
        let (mut found, wide) = (*first, sigma.max(initial_sigma));
        if sigma < wide {
            let other = self.matcher.track(predicted, wide)?;
            if other.beats(&found) {
                found = other;
            }
        }
        // Of a vehicle that was at rest the same has just been tried.
        if found.is_clear || origin == predicted {
            return Ok(found);
        }
        let before = self.skew;
        self.skew_by(still)?;
        let other = self.matcher.track(origin, wide)?;
        if other.beats(&found) {
            return Ok(other);
        }
        self.skew_by(before)?;
        Ok(found)
    }

    /// Deskews by the velocity that was found and aligns once more, if that differs from the one that was taken: a pose found with one
    /// velocity's skew would spoil the next velocity by half of that, to and fro.
    fn straighten(
        &mut self,
        found: &Tracked,
        velocity: Option<Vector6<f64>>,
        predicted: &Se3,
        is_skewed: impl Fn(&Vector6<f64>, &Vector6<f64>) -> bool,
    ) -> Result<Tracked, AlignmentError> {
        let (Some(before), Some(after)) = (self.skew, velocity) else { return Ok(*found) };
        if !is_skewed(&before, &after) {
            return Ok(*found);
        }
        self.skew_by(velocity)?;
        let mut again = self.matcher.track(&found.alignment.target_from_source, LEAST_SIGMA)?;
        if again.is_usable {
            again.hold(predicted);
            return Ok(again);
        }
        self.skew_by(Some(before))?;
        Ok(*found)
    }
}

#[cfg(test)]
mod tests;
