//! The loops over a batch that vectorise: plain ones, compiled for each instruction set by `pulp`, with the same bits for all.
//!
//! Sixteen trajectories at a time go from their first step to their last, so that their state stays in registers and first cache:
//! a step moves them, looks up how clear they are, and counts whether they are free. Where all sixteen are stuck for good, they are left.
#![expect(
    clippy::inline_always,
    reason = "what is dispatched has to be inlined to be compiled for the instruction set"
)]
#![expect(clippy::needless_bitwise_bool, reason = "lazy operators are branches, which do not vectorise")]

use agv_core::kinematics::MotionLimits;
use nalgebra::Vector2;
use pulp::{Simd, WithSimd};

/// How velocities change along a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ramps {
    acceleration: f32,
    deceleration: f32,
    /// Change of the turn per second: of the yaw rate, or of the curvature of a vehicle that steers.
    turn: f32,
    steers: bool,
    lateral_acceleration: f32,
    yaw_rate: f32,
}

impl Ramps {
    pub(super) fn new(limits: &MotionLimits) -> Self {
        let twist = &limits.twist;
        Self {
            acceleration: twist.acceleration as f32,
            deceleration: twist.deceleration as f32,
            // Straight ahead a steering rate changes the curvature least.
            turn: limits.steering.map_or(twist.yaw_acceleration, |s| s.max_rate / s.wheelbase) as f32,
            steers: limits.steering.is_some(),
            lateral_acceleration: limits.lateral_acceleration.map_or(f32::MAX, |a| a as f32),
            yaw_rate: twist.yaw_rate as f32,
        }
    }
}

/// Trajectories that are rolled out together; batches are padded to whole ones.
pub(super) const LANES: usize = 16;

/// A number of each.
pub(super) type Lanes = [f32; LANES];

/// What is the same for all trajectories of a batch.
pub(super) struct Scene<'a> {
    pub(super) ramps: Ramps,
    pub(super) dt: f32,
    pub(super) steps: usize,
    /// Cosine and sine of the heading at the beginning.
    pub(super) heading: (f32, f32),
    /// Forward and sideways speed and turn at the beginning.
    pub(super) now: [f32; 3],
    /// Circles of the footprint: place ahead and to the left, and from how far obstacles touch it.
    pub(super) circles: &'a [[f32; 3]],
    pub(super) grid: GridFrame,
    /// Distances to the nearest obstacle, by cell, and of what lies off the map.
    pub(super) field: &'a [f32],
    pub(super) beyond: f32,
    /// Clearance below which a trajectory is not free.
    pub(super) limit: f32,
    /// Clearance below which it will not be.
    pub(super) hopeless: f32,
}

/// The map's grid as the roll-out sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct GridFrame {
    pub(super) origin: Vector2<f32>,
    pub(super) per_metre: f32,
    pub(super) width: f32,
    pub(super) height: f32,
    pub(super) columns: u32,
    pub(super) outside: u32,
}

/// Where sixteen trajectories are, and how they move.
#[derive(Clone, Copy)]
struct Group {
    x: Lanes,
    y: Lanes,
    cos: Lanes,
    sin: Lanes,
    vx: Lanes,
    vy: Lanes,
    turn: Lanes,
}

/// Arrays of a batch, in rows of groups; what is aimed at is either one row, or one for each step, which then becomes what is done.
pub(super) struct Rows<'a> {
    pub(super) targets: [&'a mut [Lanes]; 3],
    pub(super) per_step: bool,
    pub(super) x: &'a mut [Lanes],
    pub(super) y: &'a mut [Lanes],
    pub(super) cos: &'a mut [Lanes],
    pub(super) sin: &'a mut [Lanes],
    pub(super) clearance: &'a mut [Lanes],
    pub(super) free: &'a mut [[u32; LANES]],
}

/// All trajectories of a batch, to be rolled out.
pub(super) struct RollOut<'a> {
    pub(super) rows: Rows<'a>,
    pub(super) scene: Scene<'a>,
}

// A closure would do, but for the compiler, which does not always inline those.
impl WithSimd for RollOut<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        roll_out(&mut self.rows, &self.scene);
    }
}

#[inline(always)]
fn roll_out(rows: &mut Rows<'_>, scene: &Scene<'_>) {
    let groups = rows.free.len();
    let (cos, sin) = scene.heading;
    let [vx, vy, turn] = scene.now.map(|value| [value; LANES]);
    for column in 0..groups {
        let mut group = Group { x: [0.0; LANES], y: [0.0; LANES], cos: [cos; LANES], sin: [sin; LANES], vx, vy, turn };
        let (mut free, mut best) = ([0_u32; LANES], [f32::MAX; LANES]);
        let mut stuck = false;
        let mut targets = [0, 1, 2].map(|k| rows.targets[k][column]);
        for step in 0..scene.steps {
            let at = step * groups + column;
            let mut clearance = [f32::NEG_INFINITY; LANES];
            if !stuck {
                if rows.per_step {
                    targets = [0, 1, 2].map(|k| rows.targets[k][at]);
                }
                advance(&mut group, &targets, &scene.ramps, scene.dt);
                look_up(&mut clearance, &group, scene);
                let mut hope = 0;
                for i in 0..LANES {
                    free[i] += u32::from((free[i] == step as u32) & (clearance[i] >= scene.limit));
                    best[i] = less(best[i], clearance[i]);
                    hope |= u32::from(best[i] >= scene.hopeless);
                }
                stuck = hope == 0;
            }
            (rows.x[at], rows.y[at], rows.cos[at], rows.sin[at]) = (group.x, group.y, group.cos, group.sin);
            rows.clearance[at] = clearance;
            if rows.per_step {
                (rows.targets[0][at], rows.targets[1][at], rows.targets[2][at]) = (group.vx, group.vy, group.turn);
            }
        }
        rows.free[column] = free;
    }
}

/// One step: velocities towards their targets, then the exact arc of the new ones. Where a vehicle that steers would slow down for a bend,
/// its yaw rate is cut instead, its curvature stays.
#[inline(always)]
fn advance(group: &mut Group, [target_vx, target_vy, target_turn]: &[Lanes; 3], ramps: &Ramps, dt: f32) {
    let (up, down) = (ramps.acceleration * dt, ramps.deceleration * dt);
    let (turn_up, ratio) = (ramps.turn * dt, ramps.acceleration / ramps.deceleration);
    let Group { x, y, cos, sin, vx, vy, turn } = group;
    for i in 0..LANES {
        vx[i] = ramp(vx[i], target_vx[i], up, down, ratio);
        vy[i] = ramp(vy[i], target_vy[i], up, down, ratio);
        turn[i] = ramp(turn[i], target_turn[i], turn_up, turn_up, 1.0);
        let yaw_rate = if ramps.steers { turn[i] * vx[i] } else { turn[i] };
        let speed = greater(greater(vx[i].abs(), vy[i].abs()), 1e-6);
        let most = less(ramps.yaw_rate, ramps.lateral_acceleration / speed);
        let yaw_rate = less(greater(yaw_rate, -most), most);
        turn[i] = if ramps.steers { turn[i] } else { yaw_rate };
        let angle = yaw_rate * dt;
        let square = angle * angle;
        let a = 1.0 - square * (1.0 / 6.0) * (1.0 - square * (1.0 / 20.0) * (1.0 - square * (1.0 / 42.0)));
        let b = 0.5 - square * (1.0 / 24.0) * (1.0 - square * (1.0 / 30.0) * (1.0 - square * (1.0 / 56.0)));
        let (turned_sin, turned_cos) = (angle * a, 1.0 - square * b);
        let (ahead, left) = ((a * vx[i] - angle * b * vy[i]) * dt, (angle * b * vx[i] + a * vy[i]) * dt);
        x[i] += cos[i] * ahead - sin[i] * left;
        y[i] += sin[i] * ahead + cos[i] * left;
        let (c, s) = (cos[i], sin[i]);
        cos[i] = c * turned_cos - s * turned_sin;
        sin[i] = s * turned_cos + c * turned_sin;
    }
}

/// How far each vehicle is from obstacles.
#[inline(always)]
fn look_up(clearance: &mut Lanes, group: &Group, scene: &Scene<'_>) {
    let (field, grid) = (scene.field, &scene.grid);
    *clearance = [f32::MAX; LANES];
    for &[ahead, left, reach] in scene.circles {
        let index = place(group, ahead, left, grid);
        for i in 0..LANES {
            let distance = field.get(index[i] as usize).copied().unwrap_or(scene.beyond);
            clearance[i] = less(clearance[i], distance - reach);
        }
    }
}

/// Where in the field a circle of the footprint is looked up.
#[inline(always)]
fn place(group: &Group, ahead: f32, left: f32, grid: &GridFrame) -> [u32; LANES] {
    let Group { x, y, cos, sin, .. } = group;
    let mut index = [0; LANES];
    for i in 0..LANES {
        let column = (x[i] + cos[i] * ahead - sin[i] * left) * grid.per_metre + grid.origin.x;
        let row = (y[i] + sin[i] * ahead + cos[i] * left) * grid.per_metre + grid.origin.y;
        let inside = (column >= 0.0) & (row >= 0.0) & (column < grid.width) & (row < grid.height);
        let cell = whole(row).wrapping_mul(grid.columns).wrapping_add(whole(column));
        index[i] = if inside { cell } else { grid.outside };
    }
    index
}

/// The whole part of a number from 0 to below 2²³; of others, some number. Unlike a cast, which saturates, it vectorises.
#[inline(always)]
fn whole(value: f32) -> u32 {
    /// 2²³, from which on numbers are whole: adding it rounds, and leaves what is rounded in the low bits.
    const WHOLE: f32 = 8_388_608.0;
    let rounded = value + WHOLE;
    let bits = rounded.to_bits() & 0x007f_ffff;
    bits.wrapping_sub(u32::from(rounded - WHOLE > value))
}

/// Counts the steps of each trajectory before the first that is not as clear as `limit`.
pub(super) struct CountFree<'a> {
    pub(super) free: &'a mut [u32],
    pub(super) clearance: &'a [f32],
    pub(super) limit: f32,
}

impl WithSimd for CountFree<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { free, clearance, limit } = self;
        for (step, clearance) in clearance.chunks_exact(free.len().max(1)).enumerate() {
            for (free, &clearance) in free.iter_mut().zip(clearance) {
                // Only as long as no step before was blocked.
                *free += u32::from((*free == step as u32) & (clearance >= limit));
            }
        }
    }
}

/// A component after a step towards its target, its magnitude growing by at most `up` and shrinking by at most `down`; `ratio` is the one
/// by the other.
#[inline(always)]
fn ramp(now: f32, target: f32, up: f32, down: f32, ratio: f32) -> f32 {
    less(greater(target, -rise(-now, up, down, ratio)), rise(now, up, down, ratio))
}

/// As `agv_core::kinematics::rise`: a negative value brakes first, then accelerates for the time that is left.
#[inline(always)]
fn rise(now: f32, up: f32, down: f32, ratio: f32) -> f32 {
    let braked = now + down;
    let turned = if braked <= 0.0 { braked } else { braked * ratio };
    if now >= 0.0 { now + up } else { turned }
}

/// The greater of two numbers, neither of them NaN: one instruction, unlike the library's.
#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser of two numbers, neither of them NaN.
#[inline(always)]
fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
