//! New particles where codes put the vehicle.

use super::{LikelihoodSearch, ObservedPose, PoseProposal, ProposalContext, ResumableProposal, SearchState};
use crate::marker::MarkerLocalizer;
use agv_core::{
    geometry::{Se2, UncertainPose},
    sensors::{LaserScan, MarkerObservation, PoseObservation},
};

/// Proposes poses by codes whose places are known, as [`ObservedPose`] does by poses, and by another proposal for scans.
///
/// What goes with a [`MarkerModel`](crate::particle::MarkerModel): that weighs particles by the codes, this draws those that
/// were missing, since few old ones are as near as a code is exact. Codes that contradict each other, or that the map does
/// not know, propose nothing.
///
/// ```
/// use agv_core::compute::{Par, Seed};
/// use agv_core::geometry::{LieGroup, Se2, UncertainPose};
/// use agv_core::grid::{CellState, Grid, GridLayout};
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::sensors::MarkerObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::marker::{MarkerLocalizer, MarkerLocalizerParams, MarkerMap};
/// use agv_filters::particle::{FreeSpace, MarkerProposal, PoseProposal, ProposalContext, UniformProposal};
///
/// let codes = MarkerMap::from_exact([(23, Se2::new(1.0, 2.0, 0.0))])?;
/// let codes = MarkerLocalizer::new(codes, MarkerLocalizerParams::default())?;
/// let mut proposal = MarkerProposal::new(codes, UniformProposal);
///
/// let space = FreeSpace::new(&Grid::filled(GridLayout::new(60, 60, 0.05, Se2::default())?, CellState::Free), 0.0)?;
/// let context = ProposalContext::new(&space, Se2::default(), Par::Seq, Seed(1), 0);
/// let seen = UncertainPose::new(Se2::new(0.1, 0.0, 0.2), Matrix3::identity() * 1e-4)?;
/// let seen = MarkerObservation::new(Stamp::default(), 23, seen);
/// let mut poses = [Se2::default(); 100];
/// assert_eq!(proposal.propose(&seen, &mut (), &context, &mut poses), 100);
/// let there = Se2::new(1.0, 2.0, 0.0) * Se2::new(0.1, 0.0, 0.2).inverse();
/// assert!(poses.iter().all(|pose| pose.minus(&there).norm() < 0.1));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MarkerProposal<G = LikelihoodSearch> {
    codes: MarkerLocalizer,
    observed: ObservedPose,
    others: G,
}

impl<G> MarkerProposal<G> {
    /// Draws from codes as [`ObservedPose::default`], and by `others` from everything else.
    pub fn new(codes: MarkerLocalizer, others: G) -> Self {
        Self { codes, observed: ObservedPose::default(), others }
    }

    /// The same with other shares of particles that are drawn from codes.
    #[must_use]
    pub fn with_shares(self, observed: ObservedPose) -> Self {
        Self { observed, ..self }
    }

    /// The proposal for everything else.
    pub const fn others(&self) -> &G {
        &self.others
    }

    /// The pose that the codes of an image say together.
    fn located(&self, seen: &[MarkerObservation<Se2>]) -> Option<PoseObservation<Se2>> {
        self.codes.locate(seen).ok()?.observation().copied()
    }
}

impl<G: ResumableProposal> ResumableProposal for MarkerProposal<G> {
    fn state(&self) -> Option<SearchState> {
        self.others.state()
    }

    fn resume(&mut self, state: Option<&SearchState>) {
        self.others.resume(state);
    }
}

impl<S: ?Sized, G> PoseProposal<[MarkerObservation<Se2>], S> for MarkerProposal<G> {
    fn propose(
        &mut self,
        seen: &[MarkerObservation<Se2>],
        sensor: &mut S,
        context: &ProposalContext<'_>,
        poses: &mut [Se2],
    ) -> usize {
        self.located(seen).map_or(0, |pose| self.observed.propose(&pose, sensor, context, poses))
    }

    fn share(&self, seen: &[MarkerObservation<Se2>], expected: &UncertainPose<Se2>, doubted: f64) -> f64 {
        self.located(seen).map_or(0.0, |pose| PoseProposal::<_, S>::share(&self.observed, &pose, expected, doubted))
    }
}

impl<S: ?Sized, G> PoseProposal<MarkerObservation<Se2>, S> for MarkerProposal<G> {
    fn propose(
        &mut self,
        seen: &MarkerObservation<Se2>,
        sensor: &mut S,
        context: &ProposalContext<'_>,
        poses: &mut [Se2],
    ) -> usize {
        self.propose(std::slice::from_ref(seen), sensor, context, poses)
    }

    fn share(&self, seen: &MarkerObservation<Se2>, expected: &UncertainPose<Se2>, doubted: f64) -> f64 {
        PoseProposal::<_, S>::share(self, std::slice::from_ref(seen), expected, doubted)
    }
}

macro_rules! proposed_by_others {
    ($($observation:ty),+) => {$(
        impl<S: ?Sized, G: PoseProposal<$observation, S>> PoseProposal<$observation, S> for MarkerProposal<G> {
            fn propose(
                &mut self,
                observation: &$observation,
                sensor: &mut S,
                context: &ProposalContext<'_>,
                poses: &mut [Se2],
            ) -> usize {
                self.others.propose(observation, sensor, context, poses)
            }

            fn share(&self, observation: &$observation, expected: &UncertainPose<Se2>, doubted: f64) -> f64 {
                self.others.share(observation, expected, doubted)
            }
        }
    )+};
}
proposed_by_others!(LaserScan, PoseObservation<Se2>);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        marker::{MarkerLocalizerParams, MarkerMap},
        particle::{FreeSpace, UniformProposal},
    };
    use agv_core::{
        compute::{Par, Seed},
        geometry::LieGroup,
        grid::{CellState, Grid, GridLayout},
        time::Stamp,
    };
    use nalgebra::Matrix3;

    fn seen(id: u32, x: f64) -> MarkerObservation<Se2> {
        let pose = UncertainPose::new(Se2::new(x, 0.0, 0.0), Matrix3::identity() * 1e-4).unwrap();
        MarkerObservation::new(Stamp::default(), id, pose)
    }

    #[test]
    fn codes_that_say_nothing_propose_nothing() {
        let codes = MarkerMap::from_exact([(1, Se2::new(2.0, 2.0, 0.0)), (2, Se2::new(2.2, 2.0, 0.0))]).unwrap();
        let codes = MarkerLocalizer::new(codes, MarkerLocalizerParams::default()).unwrap();
        let mut proposal = MarkerProposal::new(codes, UniformProposal);
        let layout = GridLayout::new(100, 80, 0.1, Se2::identity()).unwrap();
        let space = FreeSpace::new(&Grid::filled(layout, CellState::Free), 0.0).unwrap();
        let context = ProposalContext::new(&space, Se2::identity(), Par::Seq, Seed(1), 0);
        let expected = UncertainPose::new(Se2::new(2.0, 2.0, 0.0), Matrix3::identity() * 1e-4).unwrap();
        let mut poses = [Se2::identity(); 20];
        for (images, share) in [
            (vec![], None),
            (vec![seen(9, 0.0)], None),
            (vec![seen(1, 0.0), seen(2, 1.2)], None),
            (vec![seen(1, 0.0), seen(2, 0.2)], Some(proposal.observed.agreed)),
            (vec![seen(9, 3.0), seen(1, 0.0)], Some(proposal.observed.agreed)),
            (vec![seen(1, 1.0), seen(2, 1.2)], Some(proposal.observed.contradicted)),
        ] {
            let drawn = PoseProposal::propose(&mut proposal, images.as_slice(), &mut (), &context, &mut poses);
            assert_eq!(drawn, if share.is_some() { 20 } else { 0 }, "{images:?}");
            let stated = PoseProposal::<_, ()>::share(&proposal, images.as_slice(), &expected, 0.5);
            assert_eq!(stated, share.unwrap_or(0.0), "{images:?}");
        }
    }
}
