//! What an optimiser minimises: a cost of a point, one by one or in batches.

use agv_core::compute::{Par, Split};

/// A function to be minimised over points of `f64` coordinates.
///
/// Every `Fn(&[f64]) -> f64` is one. A cost of NaN says that the point has none: it loses against every number, and
/// never wins.
///
/// ```
/// use agv_control::Objective;
///
/// let sphere = |point: &[f64]| point.iter().map(|x| x * x).sum::<f64>();
/// let mut costs = [0.0; 2];
/// sphere.evaluate_batch(&[1.0, 2.0, 3.0, 4.0], &mut costs);
/// assert_eq!(costs, [5.0, 25.0]);
/// ```
pub trait Objective: Sync {
    /// The cost of a point: less is better.
    fn evaluate(&self, point: &[f64]) -> f64;

    /// The costs of several points, whose coordinates come one point after another: what wide arithmetic needs.
    ///
    /// Each cost must have the bits that [`evaluate`](Self::evaluate) gives, since how points are cut into batches is
    /// not part of a result. Batches hold at most [`BATCH`] points.
    fn evaluate_batch(&self, points: &[f64], costs: &mut [f64]) {
        let dimension = points.len() / costs.len().max(1);
        for (point, cost) in points.chunks_exact(dimension.max(1)).zip(costs) {
            *cost = self.evaluate(point);
        }
    }
}

impl<F: Fn(&[f64]) -> f64 + Sync> Objective for F {
    fn evaluate(&self, point: &[f64]) -> f64 {
        self(point)
    }
}

/// Most points in a batch: three registers of the widest kind of today (AVX-512, eight `f64` each), and all of a swarm of
/// twenty.
pub const BATCH: usize = 24;

/// Costs of points that lie one after another, in batches spread over threads. A NaN comes out as infinity.
///
/// The bits do not depend on the number of threads. Allocates nothing; the length of `points` is that of `costs` times
/// the number of coordinates, a rest is ignored.
pub(crate) fn evaluate_all<O: Objective + ?Sized>(objective: &O, points: &[f64], costs: &mut [f64], par: Par) {
    let dimension = points.len() / costs.len().max(1);
    let rows = Rows { dimension, points: &points[..dimension * costs.len()], costs };
    // Points do not meet, so how they are cut may follow the threads.
    let share = costs_per_chunk(rows.costs.len(), par);
    par.for_each_chunk(rows, share, |_, rows| {
        objective.evaluate_batch(rows.points, rows.costs);
        for cost in rows.costs.iter_mut().filter(|cost| cost.is_nan()) {
            *cost = f64::INFINITY;
        }
    });
}

/// Batches as large as they may be while each thread gets one.
fn costs_per_chunk(count: usize, par: Par) -> usize {
    count.div_ceil(par.count()).clamp(1, BATCH)
}

/// Points and their costs, cut between points.
struct Rows<'a> {
    dimension: usize,
    points: &'a [f64],
    costs: &'a mut [f64],
}

impl Split for Rows<'_> {
    fn len(&self) -> usize {
        self.costs.len()
    }

    fn split_at(self, mid: usize) -> (Self, Self) {
        let (points_a, points_b) = self.points.split_at(mid * self.dimension);
        let (costs_a, costs_b) = self.costs.split_at_mut(mid);
        (Self { points: points_a, costs: costs_a, ..self }, Self { points: points_b, costs: costs_b, ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Remembers the greatest batch that it saw.
    struct Batched(AtomicUsize);

    impl Objective for Batched {
        fn evaluate(&self, point: &[f64]) -> f64 {
            if point[0] < 3.0 { f64::NAN } else { point[0] - point[1] }
        }

        fn evaluate_batch(&self, points: &[f64], costs: &mut [f64]) {
            self.0.fetch_max(costs.len(), Ordering::Relaxed);
            for (point, cost) in points.chunks_exact(2).zip(costs) {
                *cost = self.evaluate(point);
            }
        }
    }

    #[test]
    fn every_point_gets_its_cost_whatever_the_threads() {
        let points: Vec<f64> = (0..100).map(f64::from).collect();
        for (threads, batch) in [(1, 24), (2, 24), (3, 17), (8, 7)] {
            let (objective, mut costs) = (Batched(AtomicUsize::new(0)), vec![0.0; 50]);
            evaluate_all(&objective, &points, &mut costs, Par::threads(threads));
            assert_eq!(costs[..2], [f64::INFINITY; 2]);
            assert!(costs[2..].iter().all(|&cost| cost == -1.0));
            assert_eq!(objective.0.into_inner(), batch);
        }
    }

    #[test]
    fn nothing_is_evaluated_where_there_is_nothing() {
        evaluate_all(&|_: &[f64]| 1.0, &[], &mut [], Par::Seq);
        (|_: &[f64]| 1.0).evaluate_batch(&[], &mut []);
    }
}
