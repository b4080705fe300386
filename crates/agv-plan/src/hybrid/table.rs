//! What a curve costs without obstacles, looked up: the non-holonomic half of the heuristic.
//!
//! Costs of curves to the origin from a box of positions around it and all headings, computed once per vehicle. A mirror
//! changes no cost, so positions on one side of the goal's axis are enough.

use super::{UNIT, dubins::Relative, dubins::Word, params::HybridAStarParams, reeds_shepp::ReedsShepp};
use crate::Error;
use agv_core::geometry::{LieGroup, Se2};
use std::f64::consts::TAU;

/// Half the edge of the box, in turning radii: beyond it curves are little longer than lines.
const REACH: f64 = 4.0;

/// Most entries of a table.
const MAX_ENTRIES: f64 = 4e6;

#[derive(Debug, Clone)]
pub(super) struct CurveTable {
    /// Rows of x, from the goal's axis outwards, per heading.
    costs: Vec<u32>,
    per_metre: f64,
    /// Places from the centre to the edge.
    half: i32,
    headings: i32,
}

impl CurveTable {
    pub(super) fn new(params: &HybridAStarParams) -> Result<Self, Error> {
        let radius = params.turning_radius;
        let headings = i32::from(params.headings);
        // A vehicle that moves aslant is bound by no curve.
        if params.crab_angle > 0.0 {
            return Ok(Self { costs: Vec::new(), per_metre: 1.0, half: 0, headings });
        }
        // As fine as the lattice, unless that is absurd.
        let finest = (2.0 * (REACH * radius).powi(2) * f64::from(headings) / MAX_ENTRIES).sqrt();
        let spacing = params.cell.max(finest);
        let half = (REACH * radius / spacing).ceil() as i32;
        let curves = ReedsShepp::new(radius)?.with_weights(params.weights())?;
        let mut costs = Vec::with_capacity((headings * (half + 1) * (2 * half + 1)) as usize);
        for heading in 0..headings {
            let yaw = TAU * f64::from(heading) / f64::from(headings);
            for y in 0..=half {
                for x in -half..=half {
                    let pose = Se2::new(f64::from(x) * spacing, f64::from(y) * spacing, yaw);
                    costs.push((curve_cost(&curves, params, &pose) * UNIT) as u32);
                }
            }
        }
        Ok(Self { costs, per_metre: 1.0 / spacing, half, headings })
    }

    /// Cost from a pose, seen from the goal: position in metres, and number of the heading. Zero outside of the box.
    #[inline]
    pub(super) fn cost(&self, x: f64, y: f64, heading: i32) -> u32 {
        let mirrored = y < 0.0;
        let heading = if mirrored && heading != 0 { self.headings - heading } else { heading };
        let column = (x * self.per_metre).round() as i32 + self.half;
        let row = (y.abs() * self.per_metre).round() as i32;
        let width = 2 * self.half + 1;
        if column < 0 || column >= width || row > self.half {
            return 0;
        }
        let index = (heading * (self.half + 1) + row) * width + column;
        self.costs.get(index as usize).copied().unwrap_or(0)
    }
}

/// Cost of the cheapest curve from a pose to the origin.
fn curve_cost(curves: &ReedsShepp, params: &HybridAStarParams, goal_from_pose: &Se2) -> f64 {
    let relative = Relative::of(&goal_from_pose.inverse(), params.turning_radius);
    if params.may_reverse {
        curves.least_cost(&relative)
    } else {
        Word::best(relative).length() * params.turning_radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_the_costs_of_curves_on_either_side() {
        let params = HybridAStarParams::default();
        let table = CurveTable::new(&params).unwrap();
        let curves = ReedsShepp::new(params.turning_radius).unwrap().with_weights(params.weights()).unwrap();
        for (i, j, heading) in [(0, 0, 0), (3, 5, 7), (3, -5, 65), (-9, 2, 36), (-9, -2, 36), (12, -12, 71)] {
            let (x, y) = (f64::from(i) * params.cell, f64::from(j) * params.cell);
            let pose = Se2::new(x, y, TAU * f64::from(heading) / 72.0);
            let direct = curves.cost(&pose, &Se2::default()).unwrap();
            assert!((f64::from(table.cost(x, y, heading)) / UNIT - direct).abs() < 2.0 / UNIT, "{x} {y} {heading}");
        }
        assert_eq!(table.cost(100.0, 0.0, 0), 0);
    }
}
