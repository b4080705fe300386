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

/// Lengths of a motion, as shares of the step: the shorter ones are for places where the longer are blocked.
pub(super) const LENGTHS: [f64; 3] = [1.0, 0.5, 0.25];

/// All motions of a vehicle, forwards first and the straight one before the turns; each in all [`LENGTHS`].
pub(super) fn motions(params: &HybridAStarParams) -> Vec<Motion> {
    let mut motions = Vec::new();
    let n = i32::from(params.curvatures);
    // 0, 1, -1, 2, -2, ...
    let curvatures = (0..=2 * n).map(|i| if i % 2 == 1 { (i + 1) / 2 } else { -i / 2 });
    let directions = if params.may_reverse { &[1.0, -1.0][..] } else { &[1.0][..] };
    for &direction in directions {
        let mut add = |twist: Twist2| {
            for length in LENGTHS.map(|share| share * params.step) {
                let (end, middle) = (twist.integrate(length), twist.integrate(0.5 * length));
                motions.push(Motion { twist, length, gear: gear_of(&twist), wheels: Wheels::of(&twist), end, middle });
            }
        };
        for curvature in curvatures.clone() {
            let curvature = f64::from(curvature) / f64::from(n) / params.turning_radius;
            add(Twist2::new(direction, 0.0, direction * curvature));
        }
        if params.crab_angle > 0.0 {
            let (sin, cos) = params.crab_angle.sin_cos();
            add(Twist2::new(direction * cos, direction * sin, 0.0));
            add(Twist2::new(direction * cos, -direction * sin, 0.0));
        }
    }
    motions
}
