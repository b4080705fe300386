//! Relative pose error: how far does the estimate drift over a stretch of given length?
//!
//! `Eᵢ = (Qᵢ⁻¹ Qⱼ)⁻¹ (Pᵢ⁻¹ Pⱼ)` for reference poses `Q` and estimated ones `P` (Sturm et al. 2012, Eq. 1), over every
//! start `i` that has an end `j` a delta later. Needs no alignment.

use super::{PosePair, Statistics, TrajectoryPose};
use crate::{Error, check};

/// How far apart start and end of a stretch are.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Delta {
    /// So many poses later.
    Frames(usize),
    /// The first pose at least so many seconds later.
    Seconds(f64),
    /// The first pose at least so many metres later, along the reference's path.
    Metres(f64),
}

/// What [`relative_error`] gives, one entry for each stretch.
#[derive(Debug, Clone, PartialEq)]
pub struct RelativeError {
    /// Length of the error's translation, in metres.
    pub translation: Statistics,
    /// Angle of the error's rotation, in radians.
    pub rotation: Statistics,
}

/// Relative pose error of paired poses, which are taken in the order given; for [`Delta::Seconds`] their stamps should
/// ascend. O(n).
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::metrics::{Delta, PosePair, relative_error};
/// use agv_core::time::Stamp;
///
/// // An odometer that reads 1 % too much.
/// let pairs: Vec<_> = (0..101)
///     .map(|i| PosePair {
///         stamp: Stamp::from_seconds(f64::from(i)),
///         reference: Se2::new(0.5 * f64::from(i), 0.0, 0.0),
///         estimate: Se2::new(0.505 * f64::from(i), 0.0, 0.0),
///     })
///     .collect();
/// let drift = relative_error(&pairs, Delta::Metres(10.0))?;
/// assert!((drift.translation.mean() - 0.1).abs() < 1e-9);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::NotPositive`] for the delta, [`Error::Empty`] if the trajectory is shorter than one stretch,
/// [`Error::NotFinite`].
pub fn relative_error<G: TrajectoryPose>(pairs: &[PosePair<G>], delta: Delta) -> Result<RelativeError, Error> {
    let travelled = match delta {
        Delta::Frames(count) => {
            check::positive("delta", count as f64)?;
            (0..pairs.len()).map(|i| i as f64).collect::<Vec<_>>()
        }
        Delta::Seconds(_) => pairs.iter().map(|p| p.stamp - pairs[0].stamp).collect(),
        Delta::Metres(_) => {
            let steps = pairs.windows(2).map(|w| w[0].reference.between(&w[1].reference).distance());
            std::iter::once(0.0)
                .chain(steps)
                .scan(0.0, |sum, step| {
                    *sum += step;
                    Some(*sum)
                })
                .collect()
        }
    };
    let delta = match delta {
        Delta::Frames(count) => count as f64,
        Delta::Seconds(length) | Delta::Metres(length) => check::positive("delta", length)?,
    };
    // Sums of steps round: a stretch that is short by a few units in the last place is long enough.
    let enough = delta * (1.0 - 1e-9);
    let (mut translation, mut rotation, mut end) = (Vec::new(), Vec::new(), 0);
    for (start, from) in pairs.iter().enumerate() {
        end = end.max(start + 1);
        while end < pairs.len() && travelled[end] - travelled[start] < enough {
            end += 1;
        }
        let Some(to) = pairs.get(end) else { break };
        let error = from.reference.between(&to.reference).between(&from.estimate.between(&to.estimate));
        translation.push(error.distance());
        rotation.push(error.angle());
    }
    Ok(RelativeError { translation: Statistics::new(translation)?, rotation: Statistics::new(rotation)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::{LieGroup, Se2},
        time::Stamp,
    };
    use nalgebra::Vector3;

    /// A drive on arcs of 0.2 m each, a second apart, whose estimate turns 0.01 rad too far per step.
    fn drive(count: usize) -> Vec<PosePair<Se2>> {
        let (mut reference, mut estimate) = (Se2::default(), Se2::new(5.0, 5.0, 1.0));
        (0..count)
            .map(|i| {
                let pair = PosePair { stamp: Stamp::from_seconds(i as f64), reference, estimate };
                reference = reference.plus(&Vector3::new(0.2, 0.0, 0.05));
                estimate = estimate.plus(&Vector3::new(0.2, 0.0, 0.06));
                pair
            })
            .collect()
    }

    #[test]
    fn drift_grows_with_the_delta_whatever_its_unit() {
        let pairs = drive(60);
        for frames in [1, 5, 20] {
            let by_frames = relative_error(&pairs, Delta::Frames(frames)).unwrap();
            assert_eq!(by_frames.rotation.count(), 60 - frames);
            assert!((by_frames.rotation.mean() - 0.01 * frames as f64).abs() < 1e-12);
            assert_eq!(relative_error(&pairs, Delta::Seconds(frames as f64)).unwrap(), by_frames);
            // Chords are a little shorter than arcs.
            let metres = pairs[0].reference.between(&pairs[1].reference).distance() * frames as f64;
            assert_eq!(relative_error(&pairs, Delta::Metres(metres)).unwrap(), by_frames);
        }
    }

    #[test]
    fn bad_input_is_named() {
        let pairs = drive(5);
        for delta in [Delta::Frames(0), Delta::Seconds(0.0), Delta::Seconds(f64::NAN), Delta::Metres(-1.0)] {
            assert!(matches!(relative_error(&pairs, delta), Err(Error::NotPositive { .. })), "{delta:?}");
        }
        assert!(matches!(relative_error(&pairs, Delta::Frames(5)), Err(Error::Empty { .. })));
        assert!(matches!(relative_error::<Se2>(&[], Delta::Seconds(1.0)), Err(Error::Empty { .. })));
    }
}
