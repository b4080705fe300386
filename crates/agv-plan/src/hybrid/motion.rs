//! The motions that a lattice path is made of: constant twists, exact arcs and lines.

use super::params::HybridAStarParams;
use agv_core::{
    geometry::{Se2, Twist2},
    path::Gear,
};

/// A stretch of constant motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Leg {
    pub(super) start: Se2,
    /// At a speed of 1 m/s.
    pub(super) twist: Twist2,
    /// In metres, not negative.
    pub(super) length: f64,
}

impl Leg {
    pub(super) fn at(&self, distance: f64) -> Se2 {
        self.start * self.twist.integrate(distance)
    }

    pub(super) fn end(&self) -> Se2 {
        self.at(self.length)
    }

    pub(super) fn gear(&self) -> Gear {
        gear_of(&self.twist)
    }
}

fn gear_of(twist: &Twist2) -> Gear {
    if twist.vx < 0.0 { Gear::Reverse } else { Gear::Forward }
}

/// Where the wheels point: the curvature, and for a vehicle that moves aslant the ratio of its velocities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wheels {
    curvature: f64,
    slant: f64,
}

impl Wheels {
    pub(super) fn of(twist: &Twist2) -> Self {
        Self { curvature: twist.yaw_rate / twist.vx, slant: twist.vy / twist.vx }
    }

    /// Share of the way from straight ahead to the stop by which the wheels turn.
    pub(super) fn change(&self, other: &Self, turning_radius: f64) -> f64 {
        (self.curvature - other.curvature).abs() * turning_radius + (self.slant - other.slant).abs()
    }
}

/// One step of the search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    pub(super) twist: Twist2,
    /// In metres.
    pub(super) length: f64,
    pub(super) gear: Gear,
    pub(super) wheels: Wheels,
    /// The end and the middle, seen from the start.
    pub(super) end: Se2,
    pub(super) middle: Se2,
}

impl Motion {
    pub(super) fn new(twist: Twist2, length: f64) -> Self {
        let (end, middle) = (twist.integrate(length), twist.integrate(0.5 * length));
        Self { twist, length, gear: gear_of(&twist), wheels: Wheels::of(&twist), end, middle }
    }
}

/// Lengths of a motion, as shares of the step: the shorter ones are for places where the longer are blocked.
pub(super) const LENGTHS: [f64; 3] = [1.0, 0.5, 0.25];

/// All curvatures of the motions, as shares of the tightest: none, then to the left and right by turns.
fn curvatures(params: &HybridAStarParams) -> impl Iterator<Item = f64> + Clone {
    let n = u32::from(params.curvatures);
    let both = (1..=n).map(move |i| f64::from(i) / f64::from(n)).flat_map(|share| [share, -share]);
    std::iter::once(0.0).chain(both)
}

/// All motions of a vehicle, forwards first and the straight one before the turns; each in all [`LENGTHS`].
pub(super) fn motions(params: &HybridAStarParams) -> Vec<Motion> {
    let mut motions = Vec::new();
    let curvatures = curvatures(params);
    let directions = if params.may_reverse { &[1.0, -1.0][..] } else { &[1.0][..] };
    for &direction in directions {
        let mut add = |twist: Twist2| motions.extend(LENGTHS.map(|share| Motion::new(twist, share * params.step)));
        for curvature in curvatures.clone() {
            add(Twist2::new(direction, 0.0, direction * curvature / params.turning_radius));
        }
        if params.crab_angle > 0.0 {
            let (sin, cos) = params.crab_angle.sin_cos();
            add(Twist2::new(direction * cos, direction * sin, 0.0));
            add(Twist2::new(direction * cos, -direction * sin, 0.0));
        }
    }
    motions
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn turns_are_by_whole_headings_and_reach_all_where_they_may() {
        for radius in [0.1, 0.86, 1.0, 1.2 / 35_f64.to_radians().tan(), 4.0, 15.0] {
            let mut params = HybridAStarParams::for_turning_radius(radius).unwrap();
            let per_heading = TAU / f64::from(params.headings);
            params.curvatures = (params.step / radius / per_heading).round() as u8;
            assert!(params.curvatures == 4 || !(0.5..=2.0).contains(&radius));
            params.curvatures = params.curvatures.min(8);
            let whole = |params: &HybridAStarParams| -> Vec<f64> {
                motions(params)
                    .into_iter()
                    .step_by(LENGTHS.len())
                    .map(|motion| motion.end.yaw() / per_heading)
                    .collect()
            };
            let tightest = whole(&HybridAStarParams { curvatures: 1, ..params });
            assert!(tightest.iter().all(|turn| (turn - turn.round()).abs() < 1e-9), "{radius}: {tightest:?}");
            let all = whole(&params);
            assert!(radius < 0.5 || all.iter().any(|turn| (turn - 1.0).abs() < 1e-9), "{radius}: {all:?}");
        }
    }
}
