//! How the belief goes on without measurements.
//!
//! Each velocity wanders around zero with a deviation `σ` and holds its value for a time `T` (an Ornstein–Uhlenbeck process:
//! `v' = -v/T + w` with `w` white of density `2σ²/T`). Unlike a velocity that is pushed about by white noise it knows how fast the
//! vehicle can go: however long nothing is measured, the velocity is not less certain than `σ`, and the variance of the place
//! grows with the time, not with its cube. Over a step `dt`, with `φ = exp(-dt/T)` and `x = dt/T`:
//!
//! ```text
//! v ← φ v                            Var v  += σ² (1 - φ²)
//! path = T (1 - φ) v                 Var    += σ² T² (2x - 3 + 4φ - φ²)       Cov(path, v) += σ² T (1 - φ)²
//! X ← X exp(path)                    F = [ Ad(exp(path))⁻¹   Jr(path) T (1 - φ) ]
//! ```
//!
//! Where accelerations are estimated they wander likewise and drive the velocities, `v' = -v/T + a + w`. The gyro's bias walks with the time, the
//! scales with the way.

use super::{
    FusionParams, Wander,
    state::{ACCELERATION, Covariance, DIMENSION, DISTANCE_SCALE, GYRO_BIAS, POSE, State, VELOCITY, YAW_SCALE},
};
use agv_core::geometry::{LieGroup, Se2, Twist2};
use nalgebra::{Matrix3, Vector3};

/// Errors that a step mixes: pose, velocity and acceleration; they come first.
const MOVING: usize = GYRO_BIAS;

/// What a step does to the way along one axis, the velocity and the acceleration there, in this order.
#[derive(Debug, Clone, Copy)]
struct AxisStep {
    transition: Matrix3<f64>,
    noise: Matrix3<f64>,
}

impl AxisStep {
    /// Of a velocity that wanders by itself.
    fn wandering(wander: &Wander, dt: f64) -> Self {
        let Wander { sigma, time } = *wander;
        let (x, variance) = (dt / time, sigma * sigma);
        let keep = (-x).exp();
        let lost = -(-x).exp_m1();
        // 2x - 3 + 4φ - φ², whose terms cancel down to the third order where the step is short.
        let integral = if x < 0.03 {
            x * x * x * (2.0 / 3.0 - x * (0.5 - x * (7.0 / 30.0 - x * (1.0 / 12.0 - x * (31.0 / 1260.0)))))
        } else {
            2.0 * x - 3.0 + 4.0 * keep - keep * keep
        };
        let cross = variance * time * lost * lost;
        Self {
            transition: Matrix3::new(1.0, time * lost, 0.0, 0.0, keep, 0.0, 0.0, 0.0, 0.0),
            noise: Matrix3::new(
                variance * time * time * integral,
                cross,
                0.0,
                cross,
                variance * lost * (1.0 + keep),
                0.0,
                0.0,
                0.0,
                0.0,
            ),
        }
    }

    /// Of a velocity that wanders and is driven by an acceleration that wanders too.
    ///
    /// By the power series of `F' = A F` and `Q' = A Q + Q Aᵀ + W` over a part of the step that is short against both times, and
    /// from there by doubling: `F ← F²`, `Q ← F Q Fᵀ + Q`.
    fn driven(velocity: &Wander, acceleration: &Wander, dt: f64) -> Self {
        const TERMS: i32 = 12;
        let density = |wander: &Wander| 2.0 * wander.sigma * wander.sigma / wander.time;
        let slope = Matrix3::new(0.0, 1.0, 0.0, 0.0, -1.0 / velocity.time, 1.0, 0.0, 0.0, -1.0 / acceleration.time);
        let mut term = Matrix3::from_diagonal(&Vector3::new(0.0, density(velocity), density(acceleration)));
        let doublings = (10.0 * dt / velocity.time.min(acceleration.time)).log2().ceil().max(0.0);
        let part = dt * (-doublings).exp2();

        let (mut transition, mut noise) = (Matrix3::identity(), Matrix3::zeros());
        let mut power = Matrix3::identity();
        for n in 1..=TERMS {
            let share = part / f64::from(n);
            power = slope * power * share;
            transition += power;
            term *= share;
            noise += term;
            term = slope * term + term * slope.transpose();
        }
        for _ in 0..doublings as u32 {
            noise += transition * noise * transition.transpose();
            transition *= transition;
        }
        Self { transition, noise }
    }
}

/// Moves a state on by `dt` seconds, which must not be negative.
pub(super) fn predict(state: &mut State, params: &FusionParams, dt: f64) {
    if dt <= 0.0 {
        return;
    }
    let motion = &params.motion;
    let linear = |wander: &Wander| match &motion.acceleration {
        Some(acceleration) => AxisStep::driven(wander, acceleration, dt),
        None => AxisStep::wandering(wander, dt),
    };
    let steps = [linear(&motion.vx), linear(&motion.vy), AxisStep::wandering(&motion.yaw_rate, dt)];

    // Means, and by how much each error moves the errors that follow.
    let (velocity, acceleration) = (state.twist, state.acceleration);
    let rates = [[velocity.vx, acceleration.x], [velocity.vy, acceleration.y], [velocity.yaw_rate, 0.0]];
    let ahead = |row: usize| {
        Vector3::from_fn(|k, _| {
            let [v, a] = rates[k];
            steps[k].transition[(row, 1)] * v + steps[k].transition[(row, 2)] * a
        })
    };
    let (path, twist) = (ahead(0), ahead(1));
    state.acceleration = ahead(2).xy();
    let moved = Se2::exp(&path);
    let (back, bend) = (moved.inverse().adjoint(), Se2::right_jacobian(&path));
    let mut transition = [[0.0; MOVING]; MOVING];
    for i in 0..3 {
        for j in 0..3 {
            transition[POSE + i][POSE + j] = back[(i, j)];
            transition[POSE + i][VELOCITY + j] = bend[(i, j)] * steps[j].transition[(0, 1)];
        }
        transition[VELOCITY + i][VELOCITY + i] = steps[i].transition[(1, 1)];
        for j in 0..2 {
            transition[POSE + i][ACCELERATION + j] = bend[(i, j)] * steps[j].transition[(0, 2)];
        }
    }
    for j in 0..2 {
        transition[VELOCITY + j][ACCELERATION + j] = steps[j].transition[(1, 2)];
        transition[ACCELERATION + j][ACCELERATION + j] = steps[j].transition[(2, 2)];
    }
    let used = state.used();
    carry(&mut state.covariance, &transition, used);

    let noise = &mut state.covariance;
    for (k, AxisStep { noise: gained, .. }) in steps.iter().enumerate() {
        let rates = [VELOCITY + k, ACCELERATION + k];
        // Turns have no acceleration.
        let rates = &rates[..if k < 2 { 2 } else { 1 }];
        for i in 0..3 {
            for j in 0..3 {
                noise[POSE + j][POSE + i] += bend[(i, k)] * gained[(0, 0)] * bend[(j, k)];
            }
            for (n, &rate) in rates.iter().enumerate() {
                noise[POSE + i][rate] += bend[(i, k)] * gained[(0, n + 1)];
                noise[rate][POSE + i] += bend[(i, k)] * gained[(0, n + 1)];
            }
        }
        for (m, &column) in rates.iter().enumerate() {
            for (n, &row) in rates.iter().enumerate() {
                noise[column][row] += gained[(n + 1, m + 1)];
            }
        }
    }
    noise[GYRO_BIAS][GYRO_BIAS] += params.gyro_bias_walk * params.gyro_bias_walk * dt;
    noise[DISTANCE_SCALE][DISTANCE_SCALE] += params.distance_scale_walk * path.x.hypot(path.y);
    noise[YAW_SCALE][YAW_SCALE] += params.yaw_scale_walk * path.z.abs();

    state.map_from_base = state.map_from_base * moved;
    state.twist = Twist2::from(twist);
    state.stamp = state.stamp + dt;
}

/// `F P Fᵀ` for a transition that mixes the leading errors only; most of its entries are zero.
fn carry(covariance: &mut Covariance, transition: &[[f64; MOVING]; MOVING], used: usize) {
    let mut right = [[0.0; DIMENSION]; MOVING];
    for (column, weights) in right.iter_mut().zip(transition) {
        for (weight, source) in weights.iter().zip(covariance.iter()) {
            if *weight != 0.0 {
                for (entry, value) in column.iter_mut().zip(source).take(used) {
                    *entry += weight * value;
                }
            }
        }
    }
    for (c, column) in right.iter().enumerate() {
        for r in c..MOVING {
            let sum = transition[r].iter().zip(column).map(|(weight, value)| weight * value).sum();
            covariance[c][r] = sum;
            covariance[r][c] = sum;
        }
        for r in MOVING..used {
            covariance[c][r] = column[r];
            covariance[r][c] = column[r];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::{
        MotionParams,
        state::{ANCHORS, Row},
    };
    use agv_core::time::Stamp;
    use nalgebra::{Matrix3, Vector2};

    fn moving() -> State {
        let mut state = State::new(Stamp::default(), Se2::new(1.0, 2.0, 0.7), &Matrix3::zeros(), &[0.0; ANCHORS]);
        (state.twist, state.acceleration) = (Twist2::new(1.2, -0.3, 0.9), Vector2::new(0.4, 0.1));
        state
    }

    /// What a difference of two states is as an error, of those entries that move.
    fn difference(to: &State, from: &State) -> [f64; MOVING] {
        let pose = to.map_from_base.minus(&from.map_from_base);
        let twist = Vector3::from(to.twist) - Vector3::from(from.twist);
        let acceleration = to.acceleration - from.acceleration;
        [pose.x, pose.y, pose.z, twist.x, twist.y, twist.z, acceleration.x, acceleration.y]
    }

    /// Without noise the covariance is carried by the derivative of the mean: compare with central differences.
    #[test]
    fn covariances_go_where_states_go() {
        let still = |time| Wander::new(0.0, time);
        let motion =
            MotionParams { vx: still(8.0), vy: still(1.0), yaw_rate: still(0.5), acceleration: Some(still(0.7)) };
        let params = FusionParams { motion, ..FusionParams::default() };
        let (dt, h) = (0.3, 1e-6);
        for k in 0..MOVING {
            let mut error: Row = [0.0; DIMENSION];
            let ends = [h, -h].map(|step| {
                let mut state = moving();
                error[k] = step;
                state.shift(&error);
                predict(&mut state, &params, dt);
                state
            });
            let slope = difference(&ends[0], &ends[1]).map(|value| value / (2.0 * h));
            let mut state = moving();
            state.covariance[k][k] = 1.0;
            predict(&mut state, &params, dt);
            for (i, column) in state.covariance.iter().enumerate().take(MOVING) {
                for (j, entry) in column.iter().enumerate().take(MOVING) {
                    assert!((entry - slope[i] * slope[j]).abs() < 1e-8, "{k} {i} {j}");
                }
            }
        }
    }

    /// The mean goes, and noise adds up, to the same whether a time is taken in one step or in a thousand.
    #[test]
    fn nothing_depends_on_the_steps() {
        // As slow as the velocity, slower and faster, where a formula with a difference of the two would fail.
        for acceleration in
            [None, Some(Wander::new(0.5, 8.0)), Some(Wander::new(1.0, 0.5)), Some(Wander::new(1.0, 30.0))]
        {
            for duration in [0.01, 2.0, 40.0] {
                let motion = MotionParams { acceleration, ..MotionParams::omnidirectional() };
                let params = FusionParams { motion, ..FusionParams::default() };
                let run = |push: f64, steps: u32| {
                    let mut state = State::new(Stamp::default(), Se2::default(), &Matrix3::zeros(), &[0.0; ANCHORS]);
                    state.acceleration.x = push;
                    (0..steps).for_each(|_| predict(&mut state, &params, duration / f64::from(steps)));
                    state
                };
                let push = acceleration.map_or(0.0, |_| 0.3);
                let [coarse, fine] = [1, 1000].map(|steps| run(push, steps).map_from_base.x());
                assert!((coarse - fine).abs() <= 1e-9 * fine, "{acceleration:?} {duration}: {coarse} {fine}");
                // At rest: along a way that is driven the covariance is that of its linear part.
                let [coarse, fine] = [1, 1000].map(|steps| run(0.0, steps).covariance);
                for i in 0..GYRO_BIAS {
                    for j in 0..GYRO_BIAS {
                        let (scale, [a, b]) = ((coarse[i][i] * coarse[j][j]).sqrt(), [coarse[i][j], fine[i][j]]);
                        assert!((a - b).abs() <= 1e-8 * scale, "{acceleration:?} {duration} {i} {j}: {a} {b}");
                    }
                }
            }
        }
    }

    /// The series of short steps and the closed form of long ones meet.
    #[test]
    fn short_and_long_steps_agree() {
        let at = |x: f64| AxisStep::wandering(&Wander::new(1.0, 1.0), x).noise[(0, 0)] / (x * x * x);
        assert!((at(0.03 - 1e-9) / at(0.03 + 1e-9) - 1.0).abs() < 1e-8);
        assert!((at(1e-6) * 1.5 - 1.0).abs() < 1e-5);
    }

    /// Without accelerations both forms are one.
    #[test]
    fn an_acceleration_that_is_none_changes_nothing() {
        for dt in [1e-3, 0.1, 3.0, 500.0] {
            let plain = AxisStep::wandering(&Wander::new(0.7, 2.0), dt);
            let driven = AxisStep::driven(&Wander::new(0.7, 2.0), &Wander::new(0.0, 0.3), dt);
            for (row, column) in [(0, 0), (0, 1), (1, 1)] {
                let (a, b) = (plain.noise[(row, column)], driven.noise[(row, column)]);
                assert!((a - b).abs() < 1e-9 * a, "{dt} {row} {column}: {a} {b}");
                assert!((plain.transition[(row, column)] - driven.transition[(row, column)]).abs() < 1e-9);
            }
        }
    }

    /// A day without any measurement: the velocity is as uncertain as the vehicle is fast, the place grows with the time.
    #[test]
    fn nothing_explodes_when_nothing_is_measured() {
        let params = FusionParams::default();
        let mut state = moving();
        state.acceleration = Vector2::zeros();
        for _ in 0..24 {
            predict(&mut state, &params, 3600.0);
        }
        let sigma = |i: usize| state.covariance[i][i].sqrt();
        assert!((sigma(VELOCITY) - 1.0).abs() < 1e-9 && (sigma(VELOCITY + 2) - 0.6).abs() < 1e-9);
        assert!(sigma(POSE).is_finite() && sigma(POSE) > 100.0 && state.twist.speed() < 1e-12);

        let motion = MotionParams { acceleration: Some(Wander::new(1.0, 0.5)), ..MotionParams::differential() };
        predict(&mut state, &FusionParams { motion, ..params }, 3600.0);
        // 1 + 8² 0.5 / 8.5, as `MotionParams::acceleration` says.
        assert!((state.covariance[VELOCITY][VELOCITY] - (1.0 + 64.0 * 0.5 / 8.5)).abs() < 1e-9);
    }
}
