//! A search that is spread over updates.
//!
//! As long as a vehicle is tracked, and the estimate explains the scan, there is time: each update tries part of the candidates,
//! spread over all free space, and refines the best ones by a round. What was found so far moves along with the odometry and
//! competes with what is new, all of them weighed by the scan of the day. So an update that searches costs about twice what one does that does not search.

use super::{LikelihoodSearch, Place, ProposalContext, search::Found};
use crate::particle::WeighParticles;
use agv_core::geometry::{LieGroup, Se2};

impl LikelihoodSearch {
    /// Poses that an update may spend: in proportion to its particles, if the belief is narrow and the estimate explains the
    /// observation; none if not, and the search is to be done at once.
    pub(super) fn budget<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> Option<usize> {
        if !context.is_narrow {
            return None;
        }
        let explained = sensor.explained(observation, &context.estimate)?;
        let poses = (self.params.effort * context.particles as f64) as usize;
        let all = self.count(context) + self.params.refined * self.params.trials * self.params.rounds as usize;
        (explained >= self.params.explained && poses < all).then_some(poses)
    }

    /// Goes on with the search by so many poses; returns how many places are known.
    pub(super) fn advance<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
        poses: usize,
    ) -> usize {
        self.carry(context);
        let trials = self.params.trials.max(1);
        let kept = (poses / 4 / trials).clamp(1, self.params.refined);
        let known = self.found.len();
        let fresh = poses.saturating_sub(known + kept * trials).clamp(1, self.params.max_candidates);
        self.try_next(context, fresh);
        let is_weighed = self.weigh(observation, sensor, context);
        self.rounds.clear();
        self.rounds.extend(self.found.iter().map(|found| found.rounds));
        self.found.clear();
        if is_weighed {
            self.keep_best(kept);
            self.refine(observation, sensor, context);
            self.sort_found();
        }
        self.remember();
        self.found.len()
    }

    /// The whole search, from which later updates may go on.
    pub(super) fn search_at_once<Z: ?Sized, S: WeighParticles<Z> + ?Sized>(
        &mut self,
        observation: &Z,
        sensor: &mut S,
        context: &ProposalContext<'_>,
    ) -> usize {
        let found = self.search(observation, sensor, context);
        let state = &mut self.state;
        state.tried = 0;
        state.goes_on_after(context);
        self.remember();
        found
    }

    /// The known places where the vehicle would be now if it had been there, or none if the search begins.
    fn carry(&mut self, context: &ProposalContext<'_>) {
        let state = &mut self.state;
        if !state.goes_on_with(context) {
            state.places.clear();
            state.tried = 0;
        }
        let motion = state.odom_from_base.between(&context.odom_from_base);
        self.found.clear();
        self.found.extend(state.places.iter().map(|place| Found {
            pose: place.pose * motion,
            log_likelihood: f64::NEG_INFINITY,
            rounds: place.rounds,
        }));
        state.goes_on_after(context);
    }

    /// Lines up the known places and the next candidates.
    fn try_next(&mut self, context: &ProposalContext<'_>, fresh: usize) {
        let (space, count) = (context.free_space, self.count(context));
        let (tried, stride) = (self.state.tried, stride(count as u64));
        self.candidates.clear();
        self.candidates.extend(self.found.iter().map(|found| found.pose));
        let known = self.candidates.len();
        self.candidates.resize(known + fresh, Se2::identity());
        context.fill(1, &mut self.candidates[known..], |index, stream| {
            // Neighbours in number lie far apart: each update sees all of the space.
            let stratum = tried.wrapping_add(index as u64).wrapping_mul(stride) % count as u64;
            space.sample_stratum(stratum as usize, count, stream)
        });
        self.state.tried = tried.wrapping_add(fresh as u64) % count as u64;
    }

    fn remember(&mut self) {
        self.state.places.clear();
        self.state.places.extend(self.found.iter().map(|found| Place { pose: found.pose, rounds: found.rounds }));
    }
}

/// A step through `0..count` that comes to each number once, and to neighbours late: the nearest to the golden section that has
/// no divisor in common with the count.
fn stride(count: u64) -> u64 {
    let golden = (count as f64 * 0.618_033_988_749_894_9) as u64;
    (golden.max(1)..=count).find(|&step| gcd(step, count) == 1).unwrap_or(1)
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::{FreeSpace, LikelihoodSearchParams, ResumableProposal};
    use agv_core::{
        compute::{Par, Seed},
        grid::{CellState, Grid, GridLayout},
        roles::SkipReason,
    };
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn all_candidates_have_their_turn(count in 1_u64..3000) {
            let step = stride(count);
            let mut seen: Vec<u64> = (0..count).map(|i| i * step % count).collect();
            seen.sort_unstable();
            prop_assert!(seen.iter().copied().eq(0..count));
        }
    }

    /// A vehicle that drives along x, and an observation that says where it is.
    struct Peak(Se2);

    impl WeighParticles<()> for Peak {
        fn weigh(&mut self, (): &(), poses: &[Se2], out: &mut [f64], _: Par) -> Result<(), SkipReason> {
            for (value, pose) in out.iter_mut().zip(poses) {
                *value = -pose.minus(&self.0).norm_squared() * 5.0;
            }
            Ok(())
        }
    }

    fn space() -> FreeSpace {
        let layout = GridLayout::new(100, 80, 0.1, Se2::identity()).unwrap();
        FreeSpace::new(&Grid::filled(layout, CellState::Free), 0.0).unwrap()
    }

    /// The error of the best place after so many updates of 400 poses, 0.2 m of way between them.
    fn follow(search: &mut LikelihoodSearch, updates: std::ops::Range<u64>) -> f64 {
        let space = space();
        let mut error = f64::NAN;
        for update in updates {
            let odometry = Se2::new(0.2 * update as f64, 0.0, 0.0);
            let truth = Se2::new(1.0, 4.0, 0.3) * odometry;
            let context = ProposalContext::new(&space, Se2::identity(), Par::Seq, Seed(1), update);
            search.advance(&(), &mut Peak(truth), &context.after(update, odometry), 400);
            error = search.found().next().unwrap().0.minus(&truth).norm();
        }
        error
    }

    #[test]
    fn places_move_along_and_get_better() {
        let mut search = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
        let first = follow(&mut search, 0..1);
        let later = follow(&mut search, 1..12);
        assert!(later < 0.2 && later < 0.5 * first, "{first} {later}");
        assert!(search.state.tried > 0 && search.state.tried < 400 * 12);
        // An update that did not search comes between: it begins anew.
        follow(&mut search, 13..14);
        assert!(search.state.tried < 400);
    }

    #[test]
    fn what_was_found_in_another_belief_is_forgotten() {
        let (space, mut search) = (space(), LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap());
        follow(&mut search, 0..5);
        // Put elsewhere and initialised anew; by chance the search begins at the update that the old one would go on with.
        let context = ProposalContext::new(&space, Se2::identity(), Par::Seq, Seed(1), 0).after(5, Se2::identity());
        let mut same = search.clone();
        same.carry(&context);
        assert!(!same.found.is_empty() && same.state.tried > 0);
        search.carry(&context.in_belief(7));
        assert!(search.found.is_empty() && search.state.tried == 0);
    }

    #[test]
    fn a_stored_search_goes_on_with_the_same_bits() {
        let mut search = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
        follow(&mut search, 0..5);
        let mut resumed = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
        resumed.resume(search.state().as_ref());
        assert_eq!(follow(&mut search, 5..8).to_bits(), follow(&mut resumed, 5..8).to_bits());
        assert_eq!(search.state(), resumed.state());
        resumed.resume(None);
        assert_eq!(resumed.state(), Some(crate::particle::SearchState::default()));
    }
}
