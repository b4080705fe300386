//! How much odometry and sensor err, by the log itself: the factors of their deviations under which the filter is least surprised.
//!
//! The likelihood of all innovations tells it without any truth (Bar-Shalom, Li and Kirubarajan 2001, section 11.6). What was left out and what
//! was taken for a new landmark counts as a sighting at the edge of the gate, so that nothing is gained by refusing to look. Logs state
//! deviations that are off by factors: Victoria Park's trees are placed to a decimetre, not to the 0.6 m that the file has.

use super::{
    Result,
    replay::{self, Run},
    settings::Settings,
};
use agv_support::landmark_log::LandmarkLog;

/// What a sighting at the edge of the gate counts: half the square there, and as much again for the density's breadth.
const SURPRISE: f64 = 18.0;

/// Factors by which deviations are changed, the boldest first.
const STEPS: [f64; 3] = [4.0, 2.0, std::f64::consts::SQRT_2];

/// Deviations are changed by this factor at most.
const MOST: f64 = 64.0;

/// Settings with the factors that fit best.
pub(crate) fn calibrate(log: &LandmarkLog, settings: &Settings) -> Result<Settings> {
    let mut best = *settings;
    let mut score = judge(&replay::run(log, &best)?);
    for factor in STEPS {
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
                    let found = judge(&replay::run(log, &trial)?);
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

/// The logarithm of the likelihood.
fn judge(run: &Run) -> f64 {
    run.counts.log_likelihood - SURPRISE * (run.counts.left_out + run.landmarks.len()) as f64
}
