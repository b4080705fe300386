//! Which sighting is of which landmark.
//!
//! A pair is a candidate if its innovation passes the gate. [`nearest`](Associator::nearest) takes candidates one by one, the likeliest
//! first. [`joint`](Associator::joint) searches the tree of all assignments, depth first, branch and bound: pairs must pass the
//! gate together, with the correlations between their innovations, and the assignment with the most pairs wins, of equal
//! ones that with the smaller distance (Neira and Tardós 2001, section IV). The factor of the joint innovation's covariance
//! is carried along, a row or two a pair.
//!
//! A second search looks for rivals, assignments with as many pairs that are not much farther. Where one takes a sighting for
//! another landmark, or its landmark for that of another sighting, the pair tells nothing.

use super::{
    correction::cholesky,
    state::{Constraint, SlamState},
};
use agv_core::{Error, metrics::chi_square_quantile};
use nalgebra::{Matrix2, Vector2};

/// Sightings that are assigned together at most; more are taken in groups.
pub(super) const MOST_JOINT: usize = 32;

/// A pair that is compatible by itself.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) sighting: usize,
    /// Index of the point.
    pub(super) index: usize,
    pub(super) constraint: Constraint,
    /// Of the innovation: its square, and the logarithm of the determinant of its covariance beside.
    pub(super) cost: f64,
}

/// Candidates, and memory of the search.
#[derive(Debug, Clone, Default)]
pub(super) struct Associator {
    /// By sighting; those of one sighting by cost.
    pub(super) candidates: Vec<Candidate>,
    order: Vec<usize>,
    /// Greatest joint distance for each number of rows.
    limits: Vec<f64>,
    /// Rows of the factor so far, and the whitened innovations.
    factor: Vec<f64>,
    whitened: Vec<f64>,
    chosen: Vec<usize>,
    best: Vec<usize>,
    best_square: f64,
    work: usize,
    /// Whether this group's first assignment stands.
    dived: bool,
    /// By how much a rival may be farther than the best, while rivals are sought; and which pairs of the best they contradict.
    lead: Option<f64>,
    doubtful: Vec<bool>,
}

/// Square of an innovation and its cost; none if its covariance is not positive definite.
pub(super) fn distance(residual: &Vector2<f64>, covariance: &Matrix2<f64>, rows: usize) -> Option<(f64, f64)> {
    if rows == 1 {
        let variance = covariance[(0, 0)];
        let square = residual.x * residual.x / variance;
        return (variance > 0.0 && square.is_finite()).then(|| (square, square + variance.ln()));
    }
    let determinant = covariance.determinant();
    let square = residual.dot(&(covariance.try_inverse()? * residual));
    (determinant > 0.0 && square.is_finite() && square >= 0.0).then(|| (square, square + determinant.ln()))
}

impl Associator {
    pub(super) fn new(probability: f64) -> Result<Self, Error> {
        let limits: Result<_, _> =
            (1..=2 * MOST_JOINT).map(|rows| chi_square_quantile(rows as f64, probability)).collect();
        Ok(Self { limits: limits?, doubtful: Vec::with_capacity(MOST_JOINT), ..Self::default() })
    }

    /// Greatest square of an innovation of so many rows.
    pub(super) fn limit(&self, rows: usize) -> f64 {
        self.limits[rows.clamp(1, self.limits.len()) - 1]
    }

    /// Writes indices of candidates, the surest pair first, each sighting and each point once.
    pub(super) fn nearest(&mut self, pairs: &mut Vec<usize>) {
        pairs.clear();
        self.order.clear();
        self.order.extend(0..self.candidates.len());
        let candidates = &self.candidates;
        self.order.sort_unstable_by(|&a, &b| candidates[a].cost.total_cmp(&candidates[b].cost).then(a.cmp(&b)));
        for &c in &self.order {
            let one = &candidates[c];
            let free = |&p: &usize| candidates[p].sighting != one.sighting && candidates[p].index != one.index;
            if pairs.iter().all(free) {
                pairs.push(c);
            }
        }
    }

    /// Writes indices of the candidates that are compatible together. Beside a first assignment, each sighting's cheapest that goes with those
    /// before, it looks at `work` pairs at most, shared by the groups, and at as many again for rivals that are within `lead`, if there is
    /// one group only: in one of several, rivals are not held against what the others see.
    pub(super) fn joint(&mut self, state: &SlamState, work: usize, lead: f64, pairs: &mut Vec<usize>) {
        pairs.clear();
        self.lead = None;
        let sightings = self.sightings_left(0, self.candidates.len());
        let share = work / sightings.div_ceil(MOST_JOINT).max(1);
        let mut first = 0;
        while first < self.candidates.len() {
            let end = self.group(first);
            (self.work, self.dived) = (share, false);
            self.chosen.clear();
            self.best.clear();
            self.best_square = f64::INFINITY;
            self.descend(state, pairs, first, end, 0.0);
            pairs.extend_from_slice(&self.best);
            first = end;
        }
        if lead > 0.0 && sightings <= MOST_JOINT && self.candidates.len() > self.best.len() {
            (self.work, self.lead) = (work, Some(lead));
            self.doubtful.clear();
            self.doubtful.resize(self.best.len(), false);
            self.descend(state, &[], 0, self.candidates.len(), 0.0);
            let mut doubtful = self.doubtful.iter();
            pairs.retain(|_| doubtful.next() == Some(&false));
        }
    }

    /// End of the candidates of the sightings that are assigned together from one on.
    fn group(&self, first: usize) -> usize {
        let (mut sightings, mut last) = (0, usize::MAX);
        for (c, candidate) in self.candidates.iter().enumerate().skip(first) {
            if candidate.sighting != last {
                (sightings, last) = (sightings + 1, candidate.sighting);
                if sightings > MOST_JOINT {
                    return c;
                }
            }
        }
        self.candidates.len()
    }

    /// End of the candidates of the sighting that the one at `first` is of.
    fn span(&self, first: usize, end: usize) -> usize {
        let sighting = self.candidates[first].sighting;
        (first..end).find(|&c| self.candidates[c].sighting != sighting).unwrap_or(end)
    }

    fn sightings_left(&self, mut first: usize, end: usize) -> usize {
        let mut left = 0;
        while first < end {
            first = self.span(first, end);
            left += 1;
        }
        left
    }

    /// Keeps what is chosen if it is better than the best so far, or says where it contradicts it; whether more choices may do so too.
    fn goes_on(&mut self, first: usize, end: usize, square: f64) -> bool {
        let (long, best) = (self.chosen.len(), self.best.len());
        let most = long + self.sightings_left(first, end);
        let Some(lead) = self.lead else {
            // What is chosen is an assignment already, with the rest left out.
            if long > best || (long == best && square < self.best_square) {
                self.best.clone_from(&self.chosen);
                self.best_square = square;
            }
            self.dived |= first == end;
            let pruned = most < self.best.len() || (most == self.best.len() && square >= self.best_square);
            return first < end && !pruned;
        };
        if most < best || square > self.best_square + lead {
            return false;
        }
        if first == end {
            let candidates = &self.candidates;
            for (&pair, doubtful) in self.best.iter().zip(&mut self.doubtful) {
                let Candidate { sighting, index, .. } = candidates[pair];
                let denies = |&c: &usize| (candidates[c].sighting == sighting) != (candidates[c].index == index);
                *doubtful |= self.chosen.iter().any(denies);
            }
        }
        first < end
    }

    /// Tries all that can become of the sighting whose candidates begin at `first`, and of those after it.
    fn descend(&mut self, state: &SlamState, taken: &[usize], first: usize, end: usize, square: f64) {
        if !self.goes_on(first, end, square) {
            return;
        }
        let next = self.span(first, end);
        for c in first..next {
            let index = self.candidates[c].index;
            let is_other = |&p: &usize| self.candidates[p].index != index;
            if !(self.chosen.iter().all(is_other) && taken.iter().all(is_other)) {
                continue;
            }
            if self.work == 0 && self.dived {
                return;
            }
            self.work = self.work.saturating_sub(1);
            let (rows, stored) = (self.whitened.len(), self.factor.len());
            if let Some(more) = self.extend(state, c)
                && square + more <= self.limit(self.whitened.len())
            {
                self.chosen.push(c);
                self.descend(state, taken, next, end, square + more);
                self.chosen.pop();
            }
            self.whitened.truncate(rows);
            self.factor.truncate(stored);
        }
        self.descend(state, taken, next, end, square);
    }

    /// Adds the rows of a candidate to the factor; by how much the joint distance grows.
    fn extend(&mut self, state: &SlamState, c: usize) -> Option<f64> {
        let own = self.candidates[c].constraint;
        let mut block = [0.0; 4];
        let covariance = state.innovation(&own);
        let before = self.whitened.len();
        let (mut more, mut row_starts) = (0.0, [0; 2]);
        for (r, row_start) in row_starts.iter_mut().enumerate().take(own.rows) {
            *row_start = self.factor.len();
            for &p in &self.chosen {
                let other = self.candidates[p].constraint;
                let cross = state.cross(&own, &other);
                self.factor.extend((0..other.rows).map(|q| cross[(r, q)]));
            }
            // Rows of the factor so far have 1, 2, ... entries.
            let mut whitened = own.residual[r];
            for j in 0..before {
                let above = j * (j + 1) / 2;
                let mut sum = self.factor[*row_start + j];
                for l in 0..j {
                    sum -= self.factor[*row_start + l] * self.factor[above + l];
                }
                sum /= self.factor[above + j];
                self.factor[*row_start + j] = sum;
                whitened -= sum * self.whitened[j];
            }
            self.whitened.push(whitened);
            // The entry beside the first row, if this is the second, and the diagonal.
            self.factor.extend(std::iter::repeat_n(0.0, r + 1));
        }
        let reduced = |i: usize, j: usize, factor: &[f64]| {
            let (a, b) =
                (&factor[row_starts[i]..row_starts[i] + before], &factor[row_starts[j]..row_starts[j] + before]);
            covariance[(i, j)] - a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()
        };
        let k = own.rows;
        for i in 0..k {
            for j in 0..=i {
                block[i * k + j] = reduced(i, j, &self.factor);
            }
        }
        if !cholesky(&mut block[..k * k], k) {
            return None;
        }
        for i in 0..k {
            for j in 0..=i {
                self.factor[row_starts[i] + before + j] = block[i * k + j];
            }
            let mut whitened = self.whitened[before + i];
            for j in 0..i {
                whitened -= block[i * k + j] * self.whitened[before + j];
            }
            whitened /= block[i * k + i];
            self.whitened[before + i] = whitened;
            more += whitened * whitened;
        }
        Some(more)
    }
}
