//! Where the path ends: at the goal, or where the vehicle can stand near it.

use super::{params::HybridAStarParams, site::Site};
use agv_core::geometry::{LieGroup, Se2};
use std::f64::consts::TAU;

/// The goal if the vehicle can stand there, or the nearest pose within the tolerances where it can; of those in one place
/// the one that is turned least. Looks at no more poses than a query may expand states.
pub(super) fn free_near(site: &Site, params: &HybridAStarParams, goal: &Se2) -> Option<Se2> {
    if site.is_free(goal) {
        return Some(*goal);
    }
    let step = site.layout().resolution();
    let reach = params.goal_tolerance / step;
    let per_heading = TAU / f64::from(params.headings);
    let turns = (params.goal_heading_tolerance / per_heading).floor() as i32;
    let headings = || std::iter::once(0).chain((1..=turns).flat_map(|i| [i, -i])).map(|i| f64::from(i) * per_heading);
    let mut left = params.max_expansions;
    let mut found: Option<(i64, Se2)> = None;
    // Square rings around the goal, outwards: no place of a ring is nearer than its number.
    for ring in 0..=reach.floor() as i64 {
        if found.is_some_and(|(least, _)| ring * ring >= least) {
            break;
        }
        for (x, y) in places_of(ring) {
            let squared = x * x + y * y;
            if squared as f64 > reach * reach || found.is_some_and(|(least, _)| squared >= least) {
                continue;
            }
            for yaw in headings() {
                let Some(fewer) = left.checked_sub(1) else { return found.map(|(_, pose)| pose) };
                left = fewer;
                let pose = goal.compose(&Se2::new(x as f64 * step, y as f64 * step, yaw));
                if site.is_free(&pose) {
                    found = Some((squared, pose));
                    break;
                }
            }
        }
    }
    found.map(|(_, pose)| pose)
}

/// The places of a square ring around the origin, each once.
fn places_of(ring: i64) -> impl Iterator<Item = (i64, i64)> {
    (-ring..=ring).flat_map(move |y| {
        let whole_row = y.abs() == ring;
        let stride = if whole_row { 1 } else { (2 * ring).max(1) };
        (-ring..=ring).step_by(stride as usize).map(move |x| (x, y))
    })
}
