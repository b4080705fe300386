//! Many trajectories at once, as structure of arrays: what a sampling planner rolls out and its critics score.
//!
//! All are in a local frame, metres from the vehicle along the axes of the map's grid, in `f32`: small numbers, eight to a register.
//! A step is the exact arc of its twist, `θ = ω dt` entering by the series of `sin θ / θ` and `(1 - cos θ) / θ`, good for `|θ| <= 1`. The velocities follow
//! ramps: each component goes from what it is to its target as fast as the limits allow, so that what is rolled out is what the
//! vehicle would do; a target within one step of the present velocity gives a plain arc.
//!
//! The way of each is looked up in the distance field, under every circle that covers the footprint: the coordinates and indices
//! are computed in loops that vectorise, the look-up is scalar. The price does not depend on how many obstacles there are. A group of
//! trajectories that are all deep in obstacles is not followed any further: it stays where it is, and its clearance is minus infinity.

mod kernel;

use agv_core::{
    geometry::{LieGroup, Se2, Twist2},
    grid::{Cell, Footprint, LocalMap},
    kinematics::MotionLimits,
    obstacle::{Hull, MovingObstacle},
    roles::VehicleState,
};
use kernel::{CountFree, GridFrame, LANES, Lanes, Ramps, RollOut, Rows};
use nalgebra::Vector2;
use pulp::Arch;

/// A batch of trajectories of equal duration; entry `step * stride + i` of an array belongs to trajectory `i` after `step + 1` steps.
#[derive(Debug, Clone, Default)]
pub struct Trajectories {
    len: usize,
    stride: usize,
    steps: usize,
    dt: f64,
    map_from_local: Se2,
    /// What is aimed at: forward and sideways speed, and yaw rate, or curvature for a vehicle that steers. One row, or one for each
    /// step, which then becomes what is done.
    targets: [Vec<f32>; 3],
    per_step: bool,
    /// Means over the steps of what is done, of sequences.
    means: [Vec<f32>; 3],
    pub(crate) x: Vec<f32>,
    pub(crate) y: Vec<f32>,
    pub(crate) cos: Vec<f32>,
    pub(crate) sin: Vec<f32>,
    pub(crate) clearance: Vec<f32>,
    free: Vec<u32>,
    circles: Vec<[f32; 3]>,
    /// The same, with the reach of a cell in their radius.
    reaches: Vec<[f32; 3]>,
    /// Cosine and sine of the heading at the beginning.
    heading: (f32, f32),
    /// What the processor can do; the bits do not depend on it.
    arch: Arch,
    /// Clearance below which a trajectory is not free: none, or that of where the vehicle stands if the circles and cells claim that it
    /// touches something already. The guard is exact.
    limit: f32,
}

/// How much deeper in what looks like an obstacle a trajectory may lead than where the vehicle stands, in cells: the circles and cells of the
/// look-up claim more than the vehicle and the obstacles have.
const SLACK: f32 = 0.25;

/// Depth below that, in cells, from which on a trajectory is not followed any further.
const HOPELESS: f32 = 2.0;

impl Trajectories {
    /// Number of trajectories.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Number of steps of each.
    pub const fn steps(&self) -> usize {
        self.steps
    }

    /// Duration of a step, in seconds.
    pub const fn dt(&self) -> f64 {
        self.dt
    }

    /// Distance between the entries of two steps in the arrays.
    pub const fn stride(&self) -> usize {
        self.stride
    }

    /// The frame of all positions: origin at the vehicle, axes of the map's grid.
    pub const fn map_from_local(&self) -> &Se2 {
        &self.map_from_local
    }

    /// A point of the map in the local frame.
    pub fn to_local(&self, point: &Vector2<f64>) -> Vector2<f32> {
        self.map_from_local.inverse().act(point).cast()
    }

    /// Positions and directions of the noses after a step (from 0), of all trajectories.
    pub fn at_step(&self, step: usize) -> StepView<'_> {
        let range = step * self.stride..step * self.stride + self.len;
        StepView {
            x: self.x.get(range.clone()).unwrap_or_default(),
            y: self.y.get(range.clone()).unwrap_or_default(),
            cos: self.cos.get(range.clone()).unwrap_or_default(),
            sin: self.sin.get(range.clone()).unwrap_or_default(),
            clearance: self.clearance.get(range).unwrap_or_default(),
        }
    }

    /// Steps of each trajectory before the vehicle would touch something; [`steps`](Self::steps) for one that is free.
    pub fn free(&self) -> &[u32] {
        self.free.get(..self.len).unwrap_or_default()
    }

    /// What trajectory `i` aims at, or what a sequence does on average: forward and sideways speed, and yaw rate (curvature for a
    /// vehicle that steers).
    pub fn target(&self, i: usize) -> [f32; 3] {
        let all = if self.per_step { &self.means } else { &self.targets };
        all.each_ref().map(|component| component.get(i).copied().unwrap_or(0.0))
    }

    /// What sequence `i` does in a step: components as those of [`target`](Self::target).
    pub(crate) fn control(&self, i: usize, step: usize) -> [f32; 3] {
        self.targets.each_ref().map(|component| component.get(step * self.stride + i).copied().unwrap_or(0.0))
    }

    /// What all sequences do in a step, component by component, padding included.
    pub(crate) fn controls(&self, step: usize) -> [&[f32]; 3] {
        let row = step * self.stride..(step + 1) * self.stride;
        self.targets.each_ref().map(|component| component.get(row.clone()).unwrap_or_default())
    }

    /// What all sequences aim at in a step, to be written before they are rolled out.
    pub(crate) fn controls_mut(&mut self, step: usize) -> [&mut [f32]; 3] {
        let row = step * self.stride..(step + 1) * self.stride;
        self.targets.each_mut().map(|component| component.get_mut(row.clone()).unwrap_or_default())
    }

    /// Begins a batch of `steps` steps of `dt` seconds.
    pub fn begin(&mut self, state: &VehicleState, map: &LocalMap, steps: usize, dt: f64) {
        let rotation = map.layout().map_from_grid().rotation();
        self.map_from_local = Se2::from_parts(state.map_from_base.translation(), rotation);
        (self.steps, self.dt, self.len, self.per_step) = (steps, dt, 0, false);
        self.targets.iter_mut().for_each(Vec::clear);
    }

    /// Begins a batch of `len` sequences, each with targets of its own in every step.
    pub(crate) fn begin_sequences(
        &mut self,
        state: &VehicleState,
        map: &LocalMap,
        (len, steps): (usize, usize),
        dt: f64,
    ) {
        self.begin(state, map, steps, dt);
        (self.len, self.per_step) = (len, true);
        self.stride = len.next_multiple_of(LANES);
        self.targets.iter_mut().for_each(|component| component.resize(self.stride * steps, 0.0));
    }

    /// Adds a trajectory by what it aims at.
    pub fn push(&mut self, target: [f32; 3]) {
        for (all, value) in self.targets.iter_mut().zip(target) {
            all.push(value);
        }
        self.len += 1;
    }

    /// Rolls all out from the vehicle's state, and looks up how clear they are.
    pub fn roll_out(&mut self, state: &VehicleState, limits: &MotionLimits, map: &LocalMap, footprint: &Footprint) {
        self.stride = self.len.next_multiple_of(LANES);
        let (stride, cells) = (self.stride, self.stride * self.steps);
        for array in [&mut self.x, &mut self.y, &mut self.cos, &mut self.sin, &mut self.clearance] {
            array.resize(cells, 0.0);
        }
        let rows = if self.per_step { self.steps } else { 1 };
        self.targets.iter_mut().for_each(|target| target.resize(stride * rows, 0.0));
        self.free.resize(stride, 0);
        let layout = map.layout();
        let resolution = layout.resolution() as f32;
        // An obstacle reaches half a cell farther than its centre.
        let half = 0.5 * resolution;
        self.circles.clear();
        let of_circle = |(center, radius): (Vector2<f64>, f64)| [center.x as f32, center.y as f32, radius as f32];
        self.circles.extend(footprint.covering_circles().map(of_circle));
        let heading = self.map_from_local.rotation().inverse().compose(&state.map_from_base.rotation());
        self.heading = (heading.cos() as f32, heading.sin() as f32);
        let origin = layout.to_grid(&self.map_from_local.translation()).cast::<f32>();
        self.limit = self.clearance_here(map, origin).min(0.0) - SLACK * resolution;
        let grid = GridFrame {
            origin,
            per_metre: (1.0 / layout.resolution()) as f32,
            width: layout.width() as f32,
            height: layout.height() as f32,
            columns: layout.width() as u32,
            outside: layout.len() as u32,
        };
        let reaches = &mut self.reaches;
        reaches.clear();
        reaches.extend(self.circles.iter().map(|&[ahead, left, radius]| [ahead, left, radius + half]));
        let scene = kernel::Scene {
            ramps: Ramps::new(limits),
            dt: self.dt as f32,
            steps: self.steps,
            heading: self.heading,
            now: now(state, limits),
            circles: reaches,
            grid,
            field: map.obstacles().distance().values(),
            beyond: beyond(map),
            limit: self.limit,
            hopeless: self.limit - HOPELESS * resolution,
        };
        let rows = Rows {
            targets: self.targets.each_mut().map(|target| lanes(target)),
            per_step: self.per_step,
            x: lanes(&mut self.x),
            y: lanes(&mut self.y),
            cos: lanes(&mut self.cos),
            sin: lanes(&mut self.sin),
            clearance: lanes(&mut self.clearance),
            free: self.free.as_chunks_mut().0,
        };
        self.arch.dispatch(RollOut { rows, scene });
        if self.per_step {
            self.average();
        }
    }

    /// What sequences do on average.
    fn average(&mut self) {
        let per_step = 1.0 / self.steps as f32;
        for (mean, component) in self.means.iter_mut().zip(&self.targets) {
            mean.clear();
            mean.resize(self.stride, 0.0);
            for row in component.chunks_exact(self.stride.max(1)) {
                mean.iter_mut().zip(row).for_each(|(mean, value)| *mean += per_step * value);
            }
        }
    }

    /// Clearance of the vehicle where it is, as it is looked up for the trajectories.
    fn clearance_here(&self, map: &LocalMap, origin: Vector2<f32>) -> f32 {
        let layout = map.layout();
        let (per_metre, half) = ((1.0 / layout.resolution()) as f32, (0.5 * layout.resolution()) as f32);
        let (cos, sin) = self.heading;
        let (field, beyond) = (map.obstacles().distance().values(), beyond(map));
        let of_circle = |&[ahead, left, radius]: &[f32; 3]| {
            let column = (cos * ahead - sin * left) * per_metre + origin.x;
            let row = (sin * ahead + cos * left) * per_metre + origin.y;
            let index = layout.index(Cell::new(column.floor() as i32, row.floor() as i32)).unwrap_or(layout.len());
            field.get(index).copied().unwrap_or(beyond) - radius - half
        };
        self.circles.iter().map(of_circle).fold(f32::MAX, f32::min)
    }

    /// Lets the trajectories come `cells` cells of the map nearer to obstacles before they count as blocked.
    pub(crate) fn relax(&mut self, map: &LocalMap, cells: f32) {
        self.limit -= cells * map.layout().resolution() as f32;
        self.count_free();
    }

    fn count_free(&mut self) {
        self.free.fill(0);
        self.arch.dispatch(CountFree { free: &mut self.free, clearance: &self.clearance, limit: self.limit });
    }

    /// Takes in the obstacles that move: each step is compared with where they are at its time.
    pub fn meet(&mut self, obstacles: &[MovingObstacle]) {
        if obstacles.is_empty() {
            return;
        }
        let stride = self.stride;
        for obstacle in obstacles {
            let velocity: Vector2<f32> = self.map_from_local.rotation().inverse().act(&obstacle.velocity).cast();
            let position = self.to_local(&obstacle.position);
            let vertices = obstacle.hull.vertices();
            if vertices.len() > 2 {
                self.meet_inside(obstacle);
            }
            let pairs = vertices.iter().zip(vertices.iter().cycle().skip(1)).take(if vertices.len() == 2 {
                1
            } else {
                usize::MAX
            });
            for (from, to) in pairs {
                let turned = |v: &Vector2<f64>| self.map_from_local.rotation().inverse().act(v).cast::<f32>();
                let (from, along) = (turned(from), turned(&(to - from)));
                let per_square = if along.norm_squared() > 0.0 { 1.0 / along.norm_squared() } else { 0.0 };
                for step in 0..self.steps {
                    let begin = position + from + velocity * ((step + 1) as f32 * self.dt as f32);
                    let at = step * stride..(step + 1) * stride;
                    let (x, y) = (&self.x[at.clone()], &self.y[at.clone()]);
                    let (cos, sin) = (&self.cos[at.clone()], &self.sin[at.clone()]);
                    let clearance = &mut self.clearance[at];
                    for &[ahead, left, radius] in &self.circles {
                        let reach = radius + obstacle.radius as f32;
                        for i in 0..stride {
                            let dx = x[i] + cos[i] * ahead - sin[i] * left - begin.x;
                            let dy = y[i] + sin[i] * ahead + cos[i] * left - begin.y;
                            let share = ((dx * along.x + dy * along.y) * per_square).clamp(0.0, 1.0);
                            let (dx, dy) = (dx - share * along.x, dy - share * along.y);
                            clearance[i] = clearance[i].min((dx * dx + dy * dy).sqrt() - reach);
                        }
                    }
                }
            }
        }
        self.count_free();
    }

    /// Takes in who is within the outline of an obstacle, left of all its edges: as deep as the nearest of them is far.
    fn meet_inside(&mut self, obstacle: &MovingObstacle) {
        let rotation = self.map_from_local.rotation().inverse();
        let velocity: Vector2<f32> = rotation.act(&obstacle.velocity).cast();
        let position = self.to_local(&obstacle.position);
        let vertices = obstacle.hull.vertices();
        // A point of each edge, and the way to its left.
        let mut edges = [(Vector2::<f32>::zeros(), Vector2::<f32>::zeros()); Hull::MAX_VERTICES];
        for (edge, (from, to)) in edges.iter_mut().zip(vertices.iter().zip(vertices.iter().cycle().skip(1))) {
            let along = (to - from) / (to - from).norm();
            *edge = (rotation.act(from).cast(), rotation.act(&Vector2::new(-along.y, along.x)).cast());
        }
        let edges = &edges[..vertices.len()];
        for step in 0..self.steps {
            let origin = position + velocity * ((step + 1) as f32 * self.dt as f32);
            for i in step * self.stride..(step + 1) * self.stride {
                for &[ahead, left, radius] in &self.circles {
                    let dx = self.x[i] + self.cos[i] * ahead - self.sin[i] * left - origin.x;
                    let dy = self.y[i] + self.sin[i] * ahead + self.cos[i] * left - origin.y;
                    let to_left = edges.iter().map(|(from, left)| (dx - from.x) * left.x + (dy - from.y) * left.y);
                    let depth = to_left.fold(f32::INFINITY, f32::min);
                    if depth > 0.0 {
                        self.clearance[i] = self.clearance[i].min(-depth - radius - obstacle.radius as f32);
                    }
                }
            }
        }
    }

    /// Twist that trajectory `i` aims at.
    pub(crate) fn target_twist(&self, i: usize, steers: bool) -> Twist2 {
        let [vx, vy, turn] = self.target(i).map(f64::from);
        Twist2::new(vx, vy, if steers { turn * vx } else { turn })
    }
}

/// Distance to the nearest obstacle of what lies off the map.
fn beyond(map: &LocalMap) -> f32 {
    if map.obstacles().params().outside_is_obstacle { 0.0 } else { f32::MAX }
}

/// What the vehicle does: forward and sideways speed, and yaw rate, or curvature if it steers.
pub(crate) fn now(state: &VehicleState, limits: &MotionLimits) -> [f32; 3] {
    let twist = state.twist;
    let turn = limits.steering.map_or(twist.yaw_rate, |steering| {
        let read = if twist.vx == 0.0 { 0.0 } else { twist.yaw_rate / twist.vx };
        state.steering.map_or(read, |angle| steering.curvature(angle))
    });
    [twist.vx as f32, twist.vy as f32, turn as f32]
}

/// An array of whole groups.
fn lanes(array: &mut [f32]) -> &mut [Lanes] {
    array.as_chunks_mut().0
}

/// One step of all trajectories.
#[derive(Debug, Clone, Copy)]
pub struct StepView<'a> {
    /// Position along the local x axis, in metres.
    pub x: &'a [f32],
    /// Position along the local y axis, in metres.
    pub y: &'a [f32],
    /// Cosine of the heading in the local frame.
    pub cos: &'a [f32],
    /// Sine of the heading in the local frame.
    pub sin: &'a [f32],
    /// Distance of the footprint from the nearest obstacle, in metres, about; negative where it touches one.
    pub clearance: &'a [f32],
}

#[cfg(test)]
mod tests;
