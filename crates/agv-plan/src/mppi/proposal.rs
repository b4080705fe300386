//! What is tried: the plan of the last cycle moved on, that plan with noise, plain arcs, and rest.

use super::MppiParams;
use crate::local::Trajectories;
use agv_core::compute::Stream;
use rand_distr::{Distribution, StandardNormal};

/// What a vehicle does or aims at in a step: forward and sideways speed, and yaw rate, or curvature if it steers.
pub(super) type Control = [f32; 3];

/// The sequence that was taken in the last cycle: `U`.
#[derive(Debug, Clone, Default)]
pub(super) struct Plan {
    pub(super) controls: Vec<Control>,
}

impl Plan {
    /// Moves on by a share of steps, its last control being held; a new one holds what the vehicle does.
    pub(super) fn move_on(&mut self, shift: f64, steps: usize, now: Control) {
        if self.controls.len() != steps {
            self.controls.clear();
            self.controls.resize(steps, now);
            return;
        }
        let last = steps.saturating_sub(1);
        // No farther than its end: what follows is held.
        let shift = shift.min(last as f64);
        let (whole, rest) = (shift as usize, (shift - shift.floor()) as f32);
        for k in 0..steps {
            let (a, b) = ((k + whole).min(last), (k + whole + 1).min(last));
            let (from, to) = (self.controls[a], self.controls[b]);
            self.controls[k] = [0, 1, 2].map(|i| from[i] + rest * (to[i] - from[i]));
        }
    }
}

/// What all samples of a cycle have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Proposal<'a> {
    pub(super) plan: &'a Plan,
    pub(super) params: &'a MppiParams,
    /// Least and greatest value of each component.
    pub(super) ranges: [(f32, f32); 3],
    /// Standard deviation of the noise of each; zero for one that the vehicle does not have.
    pub(super) sigmas: Control,
}

impl Proposal<'_> {
    /// Writes samples, the first of which has number `first`, to a batch that was begun; `noise` is working memory.
    pub(super) fn write(&self, batch: &mut Trajectories, first: usize, stream: &mut Stream, noise: &mut Vec<f32>) {
        let (knot, steps, stride) = (self.params.knot, self.params.steps, batch.stride());
        let knots = (steps - 1) / knot + 2;
        let is_fixed = (0..stride).take_while(|i| self.fixed(first + i, 0).is_some()).count();
        noise.clear();
        noise.resize(3 * knots * stride, 0.0);
        for (row, values) in noise.chunks_exact_mut(stride).enumerate() {
            let sigma = self.sigmas[row / knots];
            if sigma > 0.0 {
                for value in values.iter_mut().skip(is_fixed) {
                    let normal: f32 = StandardNormal.sample(stream);
                    *value = sigma * normal;
                }
            }
        }
        for step in 0..steps {
            let (at, share) = (step / knot, (step % knot) as f32 / knot as f32);
            let rows = batch.controls_mut(step);
            for (k, row) in rows.into_iter().enumerate() {
                let begin = (k * knots + at) * stride;
                let (before, after) = noise[begin..begin + 2 * stride].split_at(stride);
                let ((low, high), mean) = (self.ranges[k], self.plan.controls[step][k]);
                for ((value, &before), &after) in row.iter_mut().zip(before).zip(after) {
                    *value = (mean + before + share * (after - before)).max(low).min(high);
                }
                for (i, value) in row.iter_mut().enumerate().take(is_fixed) {
                    if let Some(control) = self.fixed(first + i, step) {
                        *value = control[k];
                    }
                }
            }
        }
    }

    /// What a sample without noise aims at: rest, the plan, or an arc.
    fn fixed(&self, sample: usize, step: usize) -> Option<Control> {
        let arc = match sample {
            0 => return Some([0.0; 3]),
            1 => return self.plan.controls.get(step).copied(),
            _ => sample - 2,
        };
        let (speeds, turns) = (self.params.arc_speeds, self.params.arc_turns);
        let of = |(low, high): (f32, f32), i: usize, count: usize| {
            low + (high - low) * (i as f32 / count.saturating_sub(1).max(1) as f32)
        };
        (arc < speeds * turns)
            .then(|| [of(self.ranges[0], arc / turns, speeds), 0.0, of(self.ranges[2], arc % turns, turns)])
    }
}
