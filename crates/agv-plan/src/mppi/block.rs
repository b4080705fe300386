//! A part of the samples, with all that a thread needs to try them.

use super::proposal::{Control, Proposal};
use crate::local::{
    Trajectories,
    critics::{Critic, Scene, Spread, assess},
};
use agv_core::{compute::Stream, roles::LocalPlanRequest};

/// Samples of a block: enough to fill registers, few enough for their states to stay in a core's cache.
pub(super) const BLOCK: usize = 128;

/// Some of the samples.
#[derive(Debug)]
pub(super) struct Block {
    pub(super) batch: Trajectories,
    /// Number of its first sample, and how many there are.
    first: usize,
    len: usize,
    critics: Vec<Critic>,
    /// What each critic says, a row for each.
    rows: Vec<f32>,
    /// What all say together; infinite for what is ruled out.
    pub(super) costs: Vec<f32>,
    /// Whether any was free of what stands, and of what moves too.
    pub(super) is_free: (bool, bool),
    noise: Vec<f32>,
}

impl Block {
    pub(super) fn new(first: usize, len: usize, critics: Vec<Critic>) -> Self {
        let (rows, costs, noise) = (Vec::new(), Vec::new(), Vec::new());
        Self { batch: Trajectories::default(), first, len, critics, rows, costs, is_free: (false, false), noise }
    }

    /// Draws samples and rolls them out.
    pub(super) fn sample(&mut self, request: &LocalPlanRequest<'_>, proposal: &Proposal<'_>, stream: &mut Stream) {
        self.begin(request, proposal);
        proposal.write(&mut self.batch, self.first, stream, &mut self.noise);
        self.roll_out(request, proposal);
    }

    /// Rolls one sequence out.
    pub(super) fn follow(&mut self, request: &LocalPlanRequest<'_>, proposal: &Proposal<'_>, sequence: &[Control]) {
        self.begin(request, proposal);
        for (step, control) in sequence.iter().enumerate() {
            for (row, &value) in self.batch.controls_mut(step).into_iter().zip(control) {
                row.fill(value);
            }
        }
        self.roll_out(request, proposal);
    }

    fn begin(&mut self, request: &LocalPlanRequest<'_>, proposal: &Proposal<'_>) {
        let params = proposal.params;
        let dt = params.horizon / params.steps as f64;
        self.batch.begin_sequences(&request.state, request.map, (self.len, params.steps), dt);
    }

    fn roll_out(&mut self, request: &LocalPlanRequest<'_>, proposal: &Proposal<'_>) {
        self.batch.roll_out(&request.state, request.limits, request.map, &proposal.params.footprint);
        let is_free = |batch: &Trajectories| batch.free().iter().any(|&free| free > 0);
        self.is_free.0 = is_free(&self.batch);
        self.batch.meet(request.obstacles);
        self.is_free.1 = is_free(&self.batch);
    }

    /// Asks the critics.
    pub(super) fn assess(&mut self, scene: &Scene<'_>) {
        assess(&mut self.critics, &self.batch, scene, &mut self.rows, &mut self.costs);
    }

    /// Takes the spread of what each critic said.
    pub(super) fn spread(&self, spreads: &mut [Spread]) {
        for (spread, costs) in spreads.iter_mut().zip(self.rows.chunks_exact(self.len)) {
            spread.take(costs);
        }
    }

    /// Puts together what the critics said, for what is not ruled out.
    pub(super) fn sum_up(&mut self, spreads: &[Spread]) {
        for ((critic, &spread), costs) in self.critics.iter().zip(spreads).zip(self.rows.chunks_exact(self.len)) {
            critic.add_to(costs, spread, &mut self.costs);
        }
    }

    /// The best sample and its cost, if any is possible.
    pub(super) fn best(&self) -> Option<(f32, usize)> {
        let finite = self.costs.iter().enumerate().filter(|(_, cost)| cost.is_finite());
        finite.min_by(|a, b| a.1.total_cmp(b.1)).map(|(i, &cost)| (cost, i))
    }

    /// Adds the sequences of all samples, weighed by `exp(-(cost - least) / temperature)`, to `sums`; the sum of the weights.
    pub(super) fn add_weighted(&mut self, least: f32, temperature: f64, sums: &mut [[f64; 3]]) -> f64 {
        // What is ruled out weighs nothing.
        let weigh = |cost: f32| (f64::from(least - cost) / temperature).exp() as f32;
        let weights = &mut self.noise;
        weights.clear();
        weights.extend(self.costs.iter().map(|&cost| weigh(cost)));
        for (step, sums) in sums.iter_mut().enumerate() {
            for (sum, row) in sums.iter_mut().zip(self.batch.controls(step)) {
                *sum += f64::from(dot(weights, row));
            }
        }
        weights.iter().map(|&weight| f64::from(weight)).sum()
    }
}

/// Sum of products in sixteen parts, so that it vectorises; the second may be longer.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    const LANES: usize = 16;
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let next = b.get(a.len()).map_or(b_rest, |chunk| chunk.as_slice());
    a_rest.iter().zip(next).for_each(|(a, b)| sums[0] += a * b);
    sums.iter().sum()
}
