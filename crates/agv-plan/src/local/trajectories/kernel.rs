//! The loops over a batch that vectorise: plain ones, compiled for each instruction set by `pulp`, with the same bits for all.
#![expect(
    clippy::inline_always,
    reason = "what is dispatched has to be inlined to be compiled for the instruction set"
)]
#![expect(clippy::needless_bitwise_bool, reason = "lazy operators are branches, which do not vectorise")]

use agv_core::kinematics::MotionLimits;
use nalgebra::Vector2;

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

/// One step of all trajectories: velocities towards their targets, then the exact arc of the new ones.
///
/// A function of its own, so that the compiler knows that its slices do not overlap.
#[inline(always)]
pub(super) fn advance(
    (vx, vy, turn): (&mut [f32], &mut [f32], &mut [f32]),
    (target_vx, target_vy, target_turn): (&[f32], &[f32], &[f32]),
    (x, y): (&mut [f32], &mut [f32]),
    (cos, sin): (&mut [f32], &mut [f32]),
    ramps: &Ramps,
    dt: f32,
) {
    let (up, down) = (ramps.acceleration * dt, ramps.deceleration * dt);
    let (turn_up, ratio) = (ramps.turn * dt, ramps.acceleration / ramps.deceleration);
    let len = vx.len();
    let (vy, turn, x, y) = (&mut vy[..len], &mut turn[..len], &mut x[..len], &mut y[..len]);
    let (cos, sin) = (&mut cos[..len], &mut sin[..len]);
    let (target_vx, target_vy, target_turn) = (&target_vx[..len], &target_vy[..len], &target_turn[..len]);
    for i in 0..len {
        vx[i] = ramp(vx[i], target_vx[i], up, down, ratio);
        vy[i] = ramp(vy[i], target_vy[i], up, down, ratio);
        turn[i] = ramp(turn[i], target_turn[i], turn_up, turn_up, 1.0);
        let yaw_rate = if ramps.steers { turn[i] * vx[i] } else { turn[i] };
        let speed = greater(greater(vx[i].abs(), vy[i].abs()), 1e-6);
        let most = less(ramps.yaw_rate, ramps.lateral_acceleration / speed);
        let angle = less(greater(yaw_rate, -most), most) * dt;
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

/// Where in the field a circle of the footprint is looked up, for all trajectories.
#[inline(always)]
pub(super) fn place(
    index: &mut [u32],
    (x, y): (&[f32], &[f32]),
    (cos, sin): (&[f32], &[f32]),
    (ahead, left): (f32, f32),
    grid: &GridFrame,
) {
    let len = index.len();
    let (x, y, cos, sin) = (&x[..len], &y[..len], &cos[..len], &sin[..len]);
    for i in 0..len {
        let column = (x[i] + cos[i] * ahead - sin[i] * left) * grid.per_metre + grid.origin.x;
        let row = (y[i] + sin[i] * ahead + cos[i] * left) * grid.per_metre + grid.origin.y;
        let inside = (column >= 0.0) & (row >= 0.0) & (column < grid.width) & (row < grid.height);
        let cell = (row as i32).wrapping_mul(grid.columns).wrapping_add(column as i32);
        index[i] = if inside { cell as u32 } else { grid.outside };
    }
}

/// The map's grid as the roll-out sees it.
pub(super) struct GridFrame {
    pub(super) origin: Vector2<f32>,
    pub(super) per_metre: f32,
    pub(super) width: f32,
    pub(super) height: f32,
    pub(super) columns: i32,
    pub(super) outside: u32,
}

/// Counts the steps of each trajectory before the first that is not as clear as `limit`.
#[inline(always)]
pub(super) fn count_free(free: &mut [u32], clearance: &[f32], limit: f32) {
    for (step, clearance) in clearance.chunks_exact(free.len().max(1)).enumerate() {
        for (free, &clearance) in free.iter_mut().zip(clearance) {
            // Only as long as no step before was blocked.
            *free += u32::from((*free == step as u32) & (clearance >= limit));
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
