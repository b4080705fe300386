//! How much odometry and sensor err, by the log itself: the factors of their deviations under which the filter is least surprised.
//!
//! The likelihood of all innovations tells it without any truth (Bar-Shalom, Li and Kirubarajan 2001, section 11.6). What was left out and what
//! was taken for a new landmark counts as a sighting at the edge of its gate, so that nothing is gained by refusing to look: by a harsh guess at
//! first, and once more by the likelihood that sightings turned out to have. Logs state
//! deviations that are off by factors: Victoria Park's trees are placed to a decimetre, not to the 0.6 m that the file has.

use super::{
    Result,
    replay::{self, Run},
    settings::{Finding, Settings},
};
use agv_support::landmark_log::LandmarkLog;

/// What a sighting at the edge of the gate counts before anything is known of the log.
const SURPRISE: f64 = -18.0;

/// Factors by which deviations are changed, the boldest first.
const STEPS: [f64; 3] = [4.0, 2.0, std::f64::consts::SQRT_2];

/// Probability with which the filter lets a sighting pass whose landmark is known.
const KNOWN: f64 = 0.9999;

/// Deviations are changed by this factor at most.
const MOST: f64 = 64.0;

/// What sightings count that corrected nothing.
#[derive(Clone, Copy)]
struct Edge {
    left_out: f64,
    new: f64,
}

impl Edge {
    /// A mean sighting has a square of its rows, one at the edge that of the gate.
    fn of(run: &Run, settings: &Settings) -> Result<Self> {
        let matched = run.counts.matched.max(1) as f64;
        let (mean, rows) = (run.counts.log_likelihood / matched, (run.counts.degrees as f64 / matched).max(1.0));
        let at = |probability: f64| -> Result<f64> {
            Ok(mean - 0.5 * (agv_nav::core::metrics::chi_square_quantile(rows, probability)? - rows))
        };
        let gate = if settings.finding == Finding::Known { KNOWN } else { settings.params.gate_probability };
        Ok(Self { left_out: at(gate)?, new: at(settings.params.novelty_probability)? })
    }

    /// The logarithm of a run's likelihood.
    fn judge(&self, run: &Run) -> f64 {
        run.counts.log_likelihood + self.left_out * run.counts.left_out as f64 + self.new * run.landmarks.len() as f64
    }
}

/// Settings with the factors that fit best.
pub(crate) fn calibrate(log: &LandmarkLog, settings: &Settings) -> Result<Settings> {
    let rough = climb(log, settings, &STEPS, Edge { left_out: SURPRISE, new: SURPRISE })?;
    let edge = Edge::of(&replay::run(log, &rough)?, &rough)?;
    climb(log, &rough, &STEPS[2..], edge)
}

/// Changes one factor after the other as long as that is for the better.
fn climb(log: &LandmarkLog, settings: &Settings, steps: &[f64], edge: Edge) -> Result<Settings> {
    let mut best = *settings;
    let mut score = edge.judge(&replay::run(log, &best)?);
    for &factor in steps {
        let mut moved = true;
        while moved {
            moved = false;
            for axis in 0..best.factors.len() {
                for by in [factor, 1.0 / factor] {
                    let mut trial = best;
                    trial.factors[axis] *= by;
                    if !(1.0 / MOST..=MOST).contains(&trial.factors[axis]) {
                        continue;
                    }
                    let found = edge.judge(&replay::run(log, &trial)?);
                    if found > score {
                        (best, score, moved) = (trial, found, true);
                        break;
                    }
                }
            }
        }
    }
    Ok(best)
}
