//! Gates: straight lanes through the narrow places on the way.
//!
//! Motions of whole steps and headings seldom meet a gap that leaves a hand's breadth: a vehicle of length `l` needs `l sin δ`
//! more room than its width at a heading that is off by `δ`. So where the potential's way from start to goal is that narrow, a
//! lane is laid along the ridge of the distance field, and its near end is a place to which the search tries curves, as it tries
//! them to the goal. A narrow goal has lanes along its own heading.

use super::{
    guide::Potential,
    lattice::Lattice,
    motion::{Leg, Motion},
    params::HybridAStarParams,
    site::Site,
};
use agv_core::{
    geometry::{LieGroup, Se2, So2, Twist2},
    grid::Footprint,
};
use nalgebra::Vector2;

/// A lane that touches nothing, and its ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gate {
    pub(super) entry: Se2,
    pub(super) exit: Se2,
    pub(super) lane: Motion,
}

impl Gate {
    pub(super) const fn leg(&self) -> Leg {
        Leg { start: self.entry, twist: self.lane.twist, length: self.lane.length }
    }
}

/// What the vehicle covers beside its base, in metres.
#[derive(Debug, Clone, Copy)]
struct Extent {
    ahead: f64,
    behind: f64,
    half_width: f64,
}

impl Extent {
    fn of(footprint: &Footprint) -> Self {
        let corners = footprint.vertices().unwrap_or_default().iter().map(|v| (v.x, v.x, v.y.abs()));
        let circles = footprint.circles().map(|(x, radius)| (x - radius, x + radius, radius));
        corners.chain(circles).fold(Self { ahead: 0.0, behind: 0.0, half_width: 0.0 }, |all, (from, to, half)| Self {
            ahead: all.ahead.max(to),
            behind: all.behind.max(-from),
            half_width: all.half_width.max(half),
        })
    }
}

/// Finds gates; keeps the memory that it needs for it.
#[derive(Debug, Clone)]
pub(super) struct GateFinder {
    extent: Extent,
    may_reverse: bool,
    /// By how much more than half the vehicle's width makes a place narrow, in metres.
    more: f64,
    way: Vec<u32>,
    /// Points of the ridge along the way, and their distance from the nearest obstacle.
    ridge: Vec<(Vector2<f64>, f64)>,
    gates: Vec<Gate>,
}

/// By how much a lane may be turned against the ridge, in degrees, and moved to its side, in cells: what is tried, in turn.
const TURNS: [f64; 13] = [0.0, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0, 4.0, -4.0, 7.0, -7.0, 11.0, -11.0];
const SHIFTS: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];

/// How much of the vehicle is out of the narrow place at the lane's ends, as shares of what should be.
const SHARES: [(f64, f64); 5] = [(1.0, 1.0), (1.0, 0.5), (0.5, 1.0), (0.5, 0.5), (0.5, 0.0)];

/// Lengths of the lanes to a narrow goal, in lengths of the vehicle.
const TO_GOAL: [f64; 3] = [0.75, 1.5, 3.0];

impl GateFinder {
    /// Most gates of a query.
    pub(super) const MOST: usize = 64;

    pub(super) fn new(params: &HybridAStarParams, footprint: &Footprint) -> Self {
        let extent = Extent::of(footprint);
        // Motions turn by whole steps: the heading is off by half a turn at the most.
        let off = 0.5 * params.step / (params.turning_radius * f64::from(params.curvatures));
        let more = footprint.circumscribed_radius() * off.min(0.5).sin();
        let (way, ridge, gates) = Default::default();
        Self { extent, may_reverse: params.may_reverse, more, way, ridge, gates }
    }

    pub(super) fn gates(&self) -> &[Gate] {
        &self.gates
    }

    /// Finds the gates on the potential's way from a coarse cell to the goal.
    pub(super) fn find(&mut self, site: &Site, lattice: &Lattice<'_>, potential: &Potential, start: u32, goal: &Se2) {
        self.gates.clear();
        // The outline of a point is nowhere narrow.
        if self.extent.half_width == 0.0 {
            return;
        }
        potential.way_into(site, start, &mut self.way);
        self.trace_ridge(site, lattice);
        let narrow = self.extent.half_width + self.more + site.layout().resolution();
        let mut begin = 0;
        let mut tried = 0;
        while begin < self.ridge.len() && self.gates.len() < Self::MOST && tried < Self::MOST {
            let len = self.ridge[begin..].iter().take_while(|(_, room)| *room < narrow).count();
            // Places that hold the start or the goal are left to the motions and to the goal's own lanes.
            if len > 0 && begin > 0 && begin + len < self.ridge.len() {
                self.add_lane(site, begin, len);
                tried += 1;
            }
            begin += len.max(1);
        }
        if site.room_at(&goal.translation()) < narrow {
            self.add_goal_lanes(site, goal);
        }
    }

    /// The way's points, from start to goal, each moved across the way to where there is most room.
    fn trace_ridge(&mut self, site: &Site, lattice: &Lattice<'_>) {
        let Self { way, ridge, .. } = self;
        ridge.clear();
        let step = 0.5 * site.layout().resolution();
        let sideways = ((self.more + 4.0 * step) / step).ceil() as i32;
        let center = |i: usize| way.get(i).map_or_else(Vector2::zeros, |&cell| lattice.center(cell));
        // It leads from the goal to the start.
        for i in (0..way.len()).rev() {
            let (here, ahead, behind) = (center(i), center(i.saturating_sub(2)), center((i + 2).min(way.len() - 1)));
            let along = (ahead - behind).try_normalize(0.0).unwrap_or_else(Vector2::x);
            let across = Vector2::new(-along.y, along.x) * step;
            let mut best = (here, site.room_at(&here));
            for k in (1..=sideways).flat_map(|k| [k, -k]) {
                let point = here + across * f64::from(k);
                let room = site.room_at(&point);
                if room > best.1 {
                    best = (point, room);
                }
            }
            ridge.push(best);
        }
    }

    /// Lanes through a narrow stretch of the ridge; through its narrowest part if there is none through all of it.
    fn add_lane(&mut self, site: &Site, begin: usize, len: usize) {
        let known = self.gates.len();
        self.add_lane_through(site, begin, len);
        if self.gates.len() > known {
            return;
        }
        let stretch = self.ridge.get(begin..begin + len).unwrap_or_default();
        let narrowest = stretch.iter().enumerate().min_by(|a, b| a.1.1.total_cmp(&b.1.1)).map_or(0, |(i, _)| i);
        let Some(&(middle, _)) = stretch.get(narrowest) else { return };
        let half = 0.5 * (self.extent.ahead + self.extent.behind);
        let is_near = |(point, _): &&(Vector2<f64>, f64)| (point - middle).norm() <= half;
        let before = stretch.iter().take(narrowest).rev().take_while(is_near).count();
        let after = stretch.iter().skip(narrowest).take_while(is_near).count();
        if before + after < len {
            self.add_lane_through(site, begin + narrowest - before, before + after);
        }
    }

    fn add_lane_through(&mut self, site: &Site, begin: usize, len: usize) {
        let points = || self.ridge.iter().skip(begin).take(len).map(|(point, _)| *point);
        let center = points().sum::<Vector2<f64>>() / len as f64;
        let Some(along) = self.direction(begin, len, &center) else { return };
        let onward = |point: Vector2<f64>| (point - center).dot(&along);
        let (from, to) = points().map(onward).fold((0.0_f64, 0.0_f64), |(low, high), s| (low.min(s), high.max(s)));
        let resolution = site.layout().resolution();
        let facing = So2::from_direction(along.x, along.y);
        for reverse in [false, true].into_iter().take(1 + usize::from(self.may_reverse)) {
            let (lead, trail) =
                if reverse { (self.extent.behind, self.extent.ahead) } else { (self.extent.ahead, self.extent.behind) };
            let gate = TURNS.iter().flat_map(|turn| SHIFTS.iter().map(move |shift| (turn, shift))).find_map(
                |(turn, shift)| {
                    let heading = facing.compose(&So2::from_angle(turn.to_radians()));
                    let base = Se2::from_parts(center, heading);
                    SHARES.iter().find_map(|(before, behind)| {
                        let (first, last) = (from - before * lead, to + behind * trail);
                        let entry = base
                            * Se2::new(first, shift * resolution, if reverse { std::f64::consts::PI } else { 0.0 });
                        lane(site, entry, reverse, last - first)
                    })
                },
            );
            self.push(gate);
        }
    }

    /// Where a stretch of the ridge leads: along its principal axis, or the way's if it is but a few points.
    fn direction(&self, begin: usize, len: usize, center: &Vector2<f64>) -> Option<Vector2<f64>> {
        let point = |i: usize| self.ridge.get(i).map(|(point, _)| *point);
        let ends = point(begin.saturating_sub(2)).zip(point((begin + len + 1).min(self.ridge.len() - 1)));
        let onward = ends.and_then(|(a, b)| (b - a).try_normalize(0.0))?;
        if len < 4 {
            return Some(onward);
        }
        let offsets = self.ridge.iter().skip(begin).take(len).map(|(point, _)| point - center);
        let (xx, xy, yy) =
            offsets.fold((0.0, 0.0, 0.0), |(xx, xy, yy), d| (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y));
        let (sin, cos) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
        let axis = Vector2::new(cos, sin);
        Some(if axis.dot(&onward) < 0.0 { -axis } else { axis })
    }

    fn add_goal_lanes(&mut self, site: &Site, goal: &Se2) {
        let length = self.extent.ahead + self.extent.behind;
        for reverse in [false, true].into_iter().take(1 + usize::from(self.may_reverse)) {
            for share in TO_GOAL {
                let away = if reverse { share * length } else { -share * length };
                let gate = lane(site, *goal * Se2::new(away, 0.0, 0.0), reverse, away.abs());
                // A longer one is blocked as well.
                let Some(gate) = gate else { break };
                self.push(Some(Gate { exit: *goal, ..gate }));
            }
        }
    }

    fn push(&mut self, gate: Option<Gate>) {
        if self.gates.len() < Self::MOST {
            self.gates.extend(gate);
        }
    }
}

/// The lane from a pose straight on, if it touches nothing.
fn lane(site: &Site, entry: Se2, reverse: bool, length: f64) -> Option<Gate> {
    let twist = Twist2::new(if reverse { -1.0 } else { 1.0 }, 0.0, 0.0);
    let lane = Motion::new(twist, length);
    site.is_free_along(&entry, &twist, length).then(|| Gate { entry, exit: entry * lane.end, lane })
}
