//! Ways around obstacles: the free stretches across the path, how they follow each other, and the shortest ways through them.
//!
//! At each sample of the path the line across it is cut by what the vehicle cannot stand on into free stretches. A stretch leads to
//! those of the next sample that it overlaps. Between two stretches of one sample there is an obstacle, so that two ways through
//! different stretches pass it on different sides: every way through this graph is a homotopy class of its own among those that go
//! ahead with the path, left and right of each obstacle in turn, and the least detours are found by dynamic programming that
//! keeps the best few ways to each stretch.
//!
//! Look-ups on the field of distances go as far as the distance says that nothing changes, so that few are needed.

use super::{line::Ground, sample::Sample};
use agv_core::obstacle::MovingObstacle;
use nalgebra::Vector2;

/// Least step to the side, in metres.
const STEP: f64 = 0.1;
/// How fast a way leaves the path: metres to the side per metre ahead.
const SLOPE: f64 = 1.0;
/// What it costs to be beside the path, per metre of either.
const ASIDE: f64 = 0.3;

/// Some metres to the left (positive) or to the right of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stretch {
    low: f64,
    high: f64,
}

impl Stretch {
    fn overlaps(&self, other: &Self) -> bool {
        self.low <= other.high && other.low <= self.high
    }

    /// Places around a free one, and those of another stretch.
    fn around(offset: f64, within: f64, other: Option<Self>) -> Self {
        let (low, high) = (offset - within, offset + within);
        other.map_or(Self { low, high }, |other| Self { low: low.min(other.low), high: high.max(other.high) })
    }

    /// Whether this is met on the way from a place to another stretch.
    fn is_between(&self, from: f64, to: &Self) -> bool {
        if from < to.low { self.low < to.low && self.high >= from } else { self.high > to.high && self.low <= from }
    }

    /// The place nearest to the path, off the ends by `margin` where there is room.
    fn near_path(&self, margin: f64) -> f64 {
        let margin = margin.min(0.5 * (self.high - self.low));
        if self.low <= 0.0 && self.high >= 0.0 { 0.0 } else { 0.0_f64.clamp(self.low + margin, self.high - margin) }
    }
}

/// A way as far as a stretch.
#[derive(Debug, Clone, Copy)]
struct Partial {
    cost: f64,
    stretch: usize,
    offset: f64,
    /// The partial way that it goes on from.
    before: Option<usize>,
}

/// The graph of free stretches; keeps its memory.
#[derive(Debug, Clone, Default)]
pub(super) struct Lanes {
    free: Vec<Stretch>,
    /// Blocked stretches of the present sample and of the one before, with the obstacle that each belongs to.
    blocked: [Vec<(Stretch, usize)>; 2],
    /// Where the partial ways of each sample begin.
    begins: Vec<usize>,
    partials: Vec<Partial>,
    /// Cheapest ways to the end.
    found: Vec<usize>,
    /// Stretches of one way.
    through: Vec<Stretch>,
    /// A point of each obstacle beside the path.
    obstacles: Vec<Vector2<f64>>,
    along_path: bool,
}

impl Lanes {
    /// Looks beside the path for at most `most` ways to its end or to the map's, the least detours first. What moves is where it will be when a
    /// vehicle at the usual speed comes there.
    pub(super) fn search(&mut self, samples: &[Sample], ground: &Ground<'_>, movers: &[MovingObstacle], most: usize) {
        for list in &mut self.blocked {
            list.clear();
        }
        self.obstacles.clear();
        self.begins.clear();
        self.partials.clear();
        self.found.clear();
        self.free.clear();
        self.along_path = true;
        // Past the last place on the map nothing is known.
        let on_map = |s: &Sample| ground.clearance([s.position.x, s.position.y, s.yaw]).is_some();
        let samples = &samples[..samples.iter().rposition(on_map).map_or(0, |i| i + 1)];
        let (Some(start), Some(second)) = (samples.first(), samples.get(1)) else { return };
        let offset = second.across().dot(&(start.position - second.position));
        self.free.push(Stretch { low: offset, high: offset });
        self.begins.push(0);
        self.partials.push(Partial { cost: 0.0, stretch: 0, offset, before: None });
        let mut time = 0.0;
        for (before, sample) in samples.iter().zip(samples.iter().skip(1)) {
            time += (sample.position - before.position).norm() / ground.usual_speed();
            let begin = self.free.len();
            self.scan(sample, ground, (movers, time));
            self.link(begin, ground, most);
        }
        // The end is where the path has it, if the vehicle can stand there.
        let last = self.begins.last().copied().unwrap_or(0);
        let partials = self.partials.iter().enumerate().skip(last);
        let at_path = partials.clone().any(|(_, partial)| partial.offset == 0.0);
        self.found.extend(partials.filter(|(_, partial)| !at_path || partial.offset == 0.0).map(|(i, _)| i));
        self.found.sort_unstable_by(|&a, &b| self.partials[a].cost.total_cmp(&self.partials[b].cost).then(a.cmp(&b)));
        self.found.truncate(most);
    }

    /// Whether nothing blocks the path itself.
    pub(super) const fn is_path_free(&self) -> bool {
        self.along_path
    }

    /// Number of ways that were found.
    pub(super) const fn count(&self) -> usize {
        self.found.len()
    }

    /// A point of each obstacle that was met.
    pub(super) fn obstacles(&self) -> &[Vector2<f64>] {
        &self.obstacles
    }

    /// By how much a way is to the left of each sample.
    pub(super) fn offsets(&mut self, way: usize, spacing: f64, offsets: &mut Vec<f64>) {
        offsets.clear();
        self.through.clear();
        let mut at = self.found.get(way).copied();
        while let Some(partial) = at.and_then(|at| self.partials.get(at)) {
            offsets.push(partial.offset);
            self.through.push(self.free[partial.stretch]);
            at = partial.before;
        }
        offsets.reverse();
        self.through.reverse();
        // Not all at once: forward and backward, so that the greatest has its ramps.
        if let Some(first) = offsets.first_mut() {
            *first = 0.0;
        }
        let ramp = SLOPE * spacing;
        let through = &self.through;
        let mut ease = |i: usize, other: f64| {
            let least = (other.abs() - ramp).max(0.0).copysign(other);
            let now = offsets[i];
            if now.abs() < least.abs() && now * least >= 0.0 {
                offsets[i] = least.clamp(through[i].low, through[i].high);
            }
            offsets[i]
        };
        let (mut before, mut after) = (0.0, 0.0);
        for i in 1..through.len() {
            before = ease(i, before);
        }
        for i in (1..through.len()).rev() {
            after = ease(i, after);
        }
    }

    /// Cuts the line across a sample, where the vehicle is after some time, into free stretches, and gives what blocks it to obstacles.
    fn scan(&mut self, sample: &Sample, ground: &Ground<'_>, (movers, time): (&[MovingObstacle], f64)) {
        let reach = ground.params.max_detour;
        // Nothing may stand between two samples unseen.
        let inscribed = ground.params.footprint.inscribed_radius();
        let floor = (0.5 * ground.params.spacing - inscribed).max(0.0);
        let wanted = floor + 0.5 * ground.params.clearance;
        let across = sample.across();
        let clearance = |offset: f64| {
            let at = sample.position + across * offset;
            let pose = [at.x, at.y, sample.yaw];
            let of_movers = movers.iter().map(|mover| ground.clearance_from(mover, time, pose));
            ground.clearance(pose).map(|clearance| of_movers.fold(clearance, f64::min))
        };
        self.blocked.swap(0, 1);
        self.blocked[0].clear();
        // The present stretch by where it was looked at, and by what the clearance there says is free.
        let (mut open, mut wide): (Option<Stretch>, Option<Stretch>) = (None, None);
        let mut room = f64::NEG_INFINITY;
        let mut gap = Gap::new(-reach);
        let mut offset = -reach;
        // Where at the lowest the present stretch may begin, by what was blocked last, and its last place that was looked at.
        let (mut begin, mut last) = (-reach, -reach);
        let within = |clearance: f64| (clearance - floor).max(0.0);
        loop {
            let here = clearance(offset);
            let is_free = here.is_some_and(|c| c > if offset == 0.0 { 0.0 } else { floor });
            self.along_path &= offset != 0.0 || is_free;
            if let (true, Some(here)) = (is_free, here) {
                (begin, last) = (begin.min(offset), offset);
                open = Some(Stretch { high: offset, ..open.unwrap_or(Stretch { low: offset, high: offset }) });
                wide = Some(Stretch::around(offset, within(here), wide));
                room = room.max(here);
            }
            let at_end = offset >= reach;
            if let (Some(mut stretch), true) = (open, !is_free || at_end) {
                let end = if is_free { reach } else { here.map_or(last, |c| last.max(offset + c - floor)) };
                // Looked at from aside, a narrow one has more room in its middle.
                let middle = 0.5 * (begin + end);
                if room <= wanted
                    && let Some(c) = clearance(middle).filter(|&c| c > floor)
                {
                    wide = Some(Stretch::around(middle, within(c), wide));
                    room = room.max(c);
                }
                // Looked at in hardly more than a place, it might overlap none of its own lane.
                if let (Some(wide), true) = (wide, stretch.high - stretch.low < STEP) {
                    stretch = Stretch { low: wide.low.max(begin), high: wide.high.min(end) };
                }
                // Too narrow to look for, but for the path itself.
                if room > wanted || (stretch.low <= 0.0 && stretch.high >= 0.0) {
                    self.block(&gap, stretch.low, sample, ground);
                    self.free.push(stretch);
                    gap = Gap::new(stretch.high);
                }
                (open, wide, room) = (None, None, f64::NEG_INFINITY);
            }
            if !is_free {
                gap.meet(offset, here);
                // Off the map nothing is known.
                begin = here.map_or(f64::INFINITY, |c| offset + floor - c);
            }
            if at_end {
                break;
            }
            let next = offset + here.map_or(0.0, |c| (c - floor).abs()).max(STEP);
            offset = if offset < 0.0 && next > 0.0 { 0.0 } else { next.min(reach) };
        }
        self.block(&gap, reach, sample, ground);
    }

    /// Gives a blocked stretch to the obstacle that it goes on from, or to a new one.
    fn block(&mut self, gap: &Gap, high: f64, sample: &Sample, ground: &Ground<'_>) {
        let Some((deepest, clearance)) = gap.deepest else { return };
        let stretch = Stretch { low: gap.low, high };
        let known = self.blocked[1].iter().find(|(before, _)| before.overlaps(&stretch)).map(|&(_, i)| i);
        let obstacle = known.unwrap_or_else(|| {
            let across = sample.across();
            let at = sample.position + across * deepest;
            // A point of the obstacle itself, which no band runs over that only comes too near; where who moves is in the way, the
            // place itself.
            let stands = ground.clearance([at.x, at.y, sample.yaw]).is_some_and(|c| c <= clearance);
            let nearest = ground.map.distance_at(&at).filter(|_| stands).and_then(|(distance, slope)| {
                let point = at - slope.try_normalize(1e-9)? * distance;
                let offset = across.dot(&(point - sample.position));
                (stretch.low <= offset && offset <= stretch.high).then_some(point)
            });
            self.obstacles.push(nearest.unwrap_or(at));
            self.obstacles.len() - 1
        });
        self.blocked[0].push((stretch, obstacle));
    }

    /// The best ways on to the free stretches from `begin` on.
    fn link(&mut self, begin: usize, ground: &Ground<'_>, most: usize) {
        let (spacing, margin) = (ground.params.spacing, 0.5 * ground.params.clearance);
        let (before, now) = (self.begins.last().copied().unwrap_or(0), self.partials.len());
        self.begins.push(now);
        let is_first = self.begins.len() == 2;
        for index in begin..self.free.len() {
            let stretch = self.free[index];
            let offset = stretch.near_path(margin);
            let here = self.partials.len();
            for i in before..now {
                let from = self.partials[i];
                // The vehicle itself may stand anywhere, also between the stretches before it.
                let leads_here = self.free[from.stretch].overlaps(&stretch)
                    || is_first && !self.free[begin..].iter().any(|other| other.is_between(from.offset, &stretch));
                if !leads_here {
                    continue;
                }
                let length = spacing.hypot(offset - from.offset) + ASIDE * offset.abs() * spacing;
                let partial = Partial { cost: from.cost + length, stretch: index, offset, before: Some(i) };
                // In order, the first of equals first.
                let place = self.partials[here..].partition_point(|other| other.cost <= partial.cost);
                if place < most {
                    self.partials.insert(here + place, partial);
                    self.partials.truncate(here + most);
                }
            }
        }
    }
}

/// What is blocked since the last free stretch.
struct Gap {
    low: f64,
    /// Where it is blocked most, and by how much.
    deepest: Option<(f64, f64)>,
}

impl Gap {
    const fn new(low: f64) -> Self {
        Self { low, deepest: None }
    }

    fn meet(&mut self, offset: f64, clearance: Option<f64>) {
        let clearance = clearance.unwrap_or(0.0);
        if self.deepest.is_none_or(|(_, deepest)| clearance < deepest) {
            self.deepest = Some((offset, clearance));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::teb::{TebParams, edges::Circle, signature::Signature};
    use agv_core::{
        geometry::{Se2, Twist2},
        grid::{CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost},
        kinematics::MotionLimits,
        path::Path,
        roles::{LocalPlanRequest, VehicleState},
    };
    use proptest::prelude::*;

    /// The ways along a hall of 8 x 6 m with posts, a disc's of 0.2 m: places at each sample, and their signatures.
    fn ways(posts: &[Vector2<f64>], most: usize) -> (Vec<Vec<Vector2<f64>>>, Vec<Signature>, LocalMap) {
        ways_along(3.0, posts, &[], most)
    }

    /// The same with the path elsewhere in the hall, and with who moves.
    fn ways_along(
        y: f64,
        posts: &[Vector2<f64>],
        movers: &[MovingObstacle],
        most: usize,
    ) -> (Vec<Vec<Vector2<f64>>>, Vec<Signature>, LocalMap) {
        let layout = GridLayout::new(160, 120, 0.05, Se2::default()).unwrap();
        let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        for post in posts {
            costmap.set(layout.cell_at(post).unwrap(), cost::LETHAL);
        }
        let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
        let params = TebParams::for_footprint(Footprint::circle(0.2).unwrap());
        let (limits, path) = (MotionLimits::default(), Path::new());
        let state = VehicleState::new(Se2::new(1.0, y, 0.0), Twist2::ZERO);
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
        let circles = [Circle { center: Vector2::zeros(), radius: 0.2 }];
        let ground = Ground::new(&params, &circles, &request, 1.0);
        let at = |i: u32| Sample { position: Vector2::new(1.0 + 0.1 * f64::from(i), y), yaw: 0.0, direction: 0.0 };
        let samples: Vec<_> = (0..=60).map(at).collect();
        let mut lanes = Lanes::default();
        lanes.search(&samples, &ground, movers, most);
        let blocked = samples.iter().any(|s| ground.clearance([s.position.x, s.position.y, 0.0]).unwrap() <= 0.0);
        assert!(!movers.is_empty() || lanes.is_path_free() != blocked);
        let (mut found, mut signatures, mut offsets) = (Vec::new(), Vec::new(), Vec::new());
        for way in 0..lanes.count() {
            lanes.offsets(way, 0.1, &mut offsets);
            assert_eq!(offsets.len(), samples.len());
            let places: Vec<_> = samples.iter().zip(&offsets).map(|(s, o)| s.position + s.across() * *o).collect();
            let nodes: Vec<_> = places.iter().map(|p| [p.x, p.y, 0.0, 0.1]).collect();
            signatures.push(Signature::default());
            signatures[way].set(&nodes, &samples[60].position, lanes.obstacles());
            found.push(places);
        }
        (found, signatures, map)
    }

    #[test]
    fn each_obstacle_is_passed_on_either_side() {
        let posts: Vec<_> = (0..3).map(|i| Vector2::new(2.5 + 1.5 * f64::from(i), 3.025)).collect();
        for count in 0..=3 {
            let (found, signatures, _) = ways(&posts[..count], 20);
            assert_eq!(found.len(), 1 << count);
            for (i, one) in signatures.iter().enumerate() {
                assert!(signatures[..i].iter().all(|other| other != one), "{signatures:?}");
            }
        }
        // The least detours first: a post that is a little to the left is passed on the right.
        let (found, ..) = ways(&[Vector2::new(4.025, 3.125)], 1);
        assert!(found.len() == 1 && found[0].iter().all(|place| place.y <= 3.0 + 1e-9), "{found:?}");
        // Between two posts that leave no room no way leads, and none past a wall.
        let pair = [Vector2::new(4.025, 3.225), Vector2::new(4.025, 2.825)];
        assert_eq!(ways(&pair, 20).0.len(), 2);
        let wall: Vec<_> = (0..30).map(|i| Vector2::new(4.025, 0.1 + 0.2 * f64::from(i))).collect();
        assert_eq!(ways(&wall, 20).0.len(), 0);
    }

    /// The nearest of what stands is a wall behind who is in the way: that tells no sides.
    #[test]
    fn who_moves_is_passed_on_either_side() {
        let wall: Vec<_> = (0..40).map(|i| Vector2::new(7.975, 2.0 + 0.05 * f64::from(i))).collect();
        let mover = MovingObstacle::new(Vector2::new(5.5, 3.0), Vector2::zeros(), 0.3).unwrap();
        let (found, signatures, _) = ways_along(3.0, &wall, &[mover], 20);
        assert_eq!(found.len(), 2);
        assert_ne!(signatures[0], signatures[1]);
    }

    /// A gap in a thick wall, with 0.15 m for the vehicle's centre, wherever the places fall that are looked at.
    #[test]
    fn a_narrow_lane_is_found() {
        let cells = (0..20).flat_map(|i| (0..120).map(move |j| Vector2::new(f64::from(i), f64::from(j))));
        let wall = cells.map(|cell| Vector2::new(3.525, 0.025) + 0.05 * cell);
        let wall: Vec<_> = wall.filter(|place| (place.y - 3.725).abs() > 0.29).collect();
        for i in 0..40 {
            let y = 2.75 + 0.0125 * f64::from(i);
            assert_eq!(ways_along(y, &wall, &[], 20).0.len(), 1, "{y}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        /// Ways are of different classes, all of them, and the vehicle can stand at all of their places.
        #[test]
        fn ways_differ_and_are_free(posts in prop::collection::vec((1.8..6.4_f64, 1.0..5.0_f64), 0..12)) {
            let posts: Vec<_> = posts.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
            let (found, signatures, map) = ways(&posts, 6);
            for (i, one) in signatures.iter().enumerate() {
                prop_assert!(signatures[..i].iter().all(|other| other != one));
            }
            for place in found.iter().flat_map(|places| places.iter().skip(1)) {
                prop_assert!(map.distance_at(place).unwrap().0 > 0.2, "{place}");
            }
        }
    }
}
