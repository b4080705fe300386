//! What a cloud says of a belief: by one alignment from it, or by a search.

use super::fusion::{fuse, tempered};
use super::{NdtLocalizer, NdtLocalizerParams, SearchParams, State};
use agv_core::{
    geometry::{Se3, UncertainPose},
    roles::{Alignment, AlignmentError, Doubt, LocalizationError, LocalizationStatus, Registration},
};
use nalgebra::Matrix6;

/// Deviations of a belief beyond which it is looked for from many starts: in metres, and in radians.
const WIDE: (f64, f64) = (1.0, 0.35);

/// Standard deviations of a wide belief within which it is looked for.
const WIDTHS: f64 = 3.0;

/// What a cloud says of a belief.
pub(super) enum Match {
    /// Nothing: it fits nowhere, or in several places.
    Unexplained,
    /// Where the vehicle is, whatever was believed.
    Found { pose: UncertainPose<Se3>, share: f64 },
    /// The belief, corrected.
    Fused { pose: UncertainPose<Se3>, nis: f64, share: f64 },
}

impl NdtLocalizer {
    /// What the thinned cloud makes of a belief; nothing is changed but the last alignment.
    pub(super) fn match_cloud(&mut self, state: &State) -> Result<Match, LocalizationError> {
        // A belief that was never confirmed has nothing to lose: there the clouds count.
        let patience = u32::try_from(self.params.status.confirmations).unwrap_or(u32::MAX).max(1);
        let is_lost = matches!(self.monitor.status(), LocalizationStatus::Lost { doubt: Doubt::Unexplained { .. } });
        let contradicted = is_lost || state.misses >= patience;
        let Some(search) = self.params.search else { return self.follow(&state.belief.pose) };
        if state.anywhere || contradicted {
            let reach = search.radius * f64::from(state.misses.saturating_sub(patience).min(20)).exp2();
            let reach = reach.max(WIDTHS * state.belief.pose.position_deviation());
            return self.find(&state.belief.pose, if state.anywhere { f64::INFINITY } else { reach }, &search);
        }
        let followed = self.follow(&state.belief.pose)?;
        let unobserved = self.alignment.map_or_else(Matrix6::zeros, |found| found.unobserved);
        let is_believed = matches!(followed, Match::Fused { nis, .. } if nis <= self.params.gate);
        let (prior, all) = (&state.belief.pose, Matrix6::zeros());
        if !is_wide(prior, &all) || (is_believed && !is_wide(prior, &unobserved)) {
            return Ok(followed);
        }
        self.narrow(&state.belief.pose, &search)
    }

    /// The match from the predicted pose.
    fn follow(&mut self, belief: &UncertainPose<Se3>) -> Result<Match, LocalizationError> {
        let found = self.ndt.align(&self.thinned, belief.mean()).map_err(|error| refused(&error))?;
        self.alignment = Some(found);
        if !found.converged() {
            return Ok(Match::Unexplained);
        }
        fused(&self.params, belief, &found)
    }

    /// The match among those that a wide belief allows.
    fn narrow(&mut self, belief: &UncertainPose<Se3>, search: &SearchParams) -> Result<Match, LocalizationError> {
        let (radius, params) = (WIDTHS * belief.position_deviation(), &self.params);
        let allowed = |found: &Alignment<Se3>| matches!(fused(params, belief, found), Ok(Match::Fused { nis, .. }) if nis <= params.gate);
        let (places, around) = (&self.places, belief.mean());
        self.search
            .run(&mut self.ndt, &self.thinned, places, (around, radius), search, allowed)
            .map_err(|e| refused(&e))?;
        // Two that differ along what they do not observe are one: the belief says where along it.
        self.alignment = self.search.verdict(search.lead, true);
        self.alignment.map_or(Ok(Match::Unexplained), |found| fused(&self.params, belief, &found))
    }

    /// The match among all within `radius` metres, whatever was believed.
    fn find(
        &mut self,
        belief: &UncertainPose<Se3>,
        radius: f64,
        search: &SearchParams,
    ) -> Result<Match, LocalizationError> {
        let (places, around) = (&self.places, belief.mean());
        self.search
            .run(&mut self.ndt, &self.thinned, places, (around, radius), search, |_| true)
            .map_err(|e| refused(&e))?;
        self.alignment = self.search.verdict(search.lead, false);
        let Some(found) = self.alignment else { return Ok(Match::Unexplained) };
        let tempered = tempered(&found.information, self.params.independent, self.params.floor);
        // Along what the cloud does not fix, any of the places tried may be meant.
        let to = |place: &Se3, from: &Se3| (place.translation() - from.translation()).norm();
        let tried = places.iter().filter(|place| to(place, around) <= radius);
        let farthest = tried.map(|place| to(place, &found.target_from_source)).fold(search.radius, f64::max);
        let unknown = Matrix6::identity() * farthest.powi(-2);
        let singular = agv_core::Error::Singular { name: "covariance", row: 0, pivot: 0.0 };
        let covariance = (tempered + unknown).try_inverse().ok_or(singular)?;
        let pose = UncertainPose::new(found.target_from_source, (covariance + covariance.transpose()) * 0.5)?;
        Ok(Match::Found { pose, share: found.inlier_ratio })
    }
}

/// A belief corrected by a match.
fn fused(
    params: &NdtLocalizerParams,
    belief: &UncertainPose<Se3>,
    found: &Alignment<Se3>,
) -> Result<Match, LocalizationError> {
    let information = tempered(&found.information, params.independent, params.floor);
    let fused = fuse(belief, &found.target_from_source, &information)?;
    Ok(Match::Fused { pose: fused.pose, nis: fused.nis, share: found.inlier_ratio })
}

/// Whether a belief is wide along other directions than those of the projector `unobserved`.
fn is_wide(belief: &UncertainPose<Se3>, unobserved: &Matrix6<f64>) -> bool {
    let observed = Matrix6::identity() - unobserved;
    let variances = (observed * belief.covariance() * observed).diagonal();
    variances.fixed_rows::<3>(0).sum() > WIDE.0.powi(2) || variances.fixed_rows::<3>(3).sum() > WIDE.1.powi(2)
}

fn refused(error: &AlignmentError) -> LocalizationError {
    match error {
        AlignmentError::Invalid(error) => LocalizationError::Invalid(*error),
        // There is a target from the construction on.
        _ => LocalizationError::NotInitialized,
    }
}
