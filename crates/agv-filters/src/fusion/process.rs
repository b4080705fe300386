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
//! Where accelerations are estimated they wander likewise and drive the velocities. The gyro's bias walks with the time, the
//! scales with the way.

use super::{
    FusionParams, Wander,
    state::{ACCELERATION, Covariance, DIMENSION, DISTANCE_SCALE, GYRO_BIAS, POSE, State, VELOCITY, YAW_SCALE},
};
use agv_core::geometry::{LieGroup, Se2, Twist2};
use nalgebra::Vector3;

/// Errors that a step mixes: pose, velocity and acceleration; they come first.
const MOVING: usize = GYRO_BIAS;

/// What a step of a wandering quantity does.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Share of the value that is left.
    keep: f64,
    /// Seconds of the present value that the integral has.
    gain: f64,
    /// Variance that the value gains.
    value: f64,
    /// Variance that the integral gains.
    integral: f64,
    /// Covariance of the two.
    cross: f64,
}

impl Step {
    fn new(wander: &Wander, dt: f64) -> Self {
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
        Self {
            keep,
            gain: time * lost,
            value: variance * lost * (1.0 + keep),
            integral: variance * time * time * integral,
            cross: variance * time * lost * lost,
        }
    }
}

/// Moves a state on by `dt` seconds, which must not be negative.
pub(super) fn predict(state: &mut State, params: &FusionParams, dt: f64) {
    if dt <= 0.0 {
        return;
    }
    let motion = &params.motion;
    let steps = [&motion.vx, &motion.vy, &motion.yaw_rate].map(|wander| Step::new(wander, dt));
    let pushed = motion.acceleration.map(|wander| Step::new(&wander, dt));

    // Means, and by how much each error moves the errors that follow.
    let velocity = Vector3::from(state.twist);
    let mut path = Vector3::from_fn(|i, _| steps[i].gain * velocity[i]);
    let mut twist = Vector3::from_fn(|i, _| steps[i].keep * velocity[i]);
    if let Some(push) = &pushed {
        for i in 0..2 {
            twist[i] += push.gain * state.acceleration[i];
            path[i] += 0.5 * dt * push.gain * state.acceleration[i];
        }
        state.acceleration *= push.keep;
    }
    let moved = Se2::exp(&path);
    let (back, bend) = (moved.inverse().adjoint(), Se2::right_jacobian(&path));
    let mut transition = [[0.0; MOVING]; MOVING];
    for i in 0..3 {
        for j in 0..3 {
            transition[POSE + i][POSE + j] = back[(i, j)];
            transition[POSE + i][VELOCITY + j] = bend[(i, j)] * steps[j].gain;
        }
        transition[VELOCITY + i][VELOCITY + i] = steps[i].keep;
    }
    if let Some(push) = &pushed {
        for j in 0..2 {
            for i in 0..3 {
                transition[POSE + i][ACCELERATION + j] = bend[(i, j)] * 0.5 * dt * push.gain;
            }
            transition[VELOCITY + j][ACCELERATION + j] = push.gain;
            transition[ACCELERATION + j][ACCELERATION + j] = push.keep;
        }
    }
    let used = state.used();
    carry(&mut state.covariance, &transition, used);

    let noise = &mut state.covariance;
    for (k, step) in steps.iter().enumerate() {
        for i in 0..3 {
            for j in 0..3 {
                noise[POSE + j][POSE + i] += bend[(i, k)] * step.integral * bend[(j, k)];
            }
            noise[POSE + i][VELOCITY + k] += bend[(i, k)] * step.cross;
            noise[VELOCITY + k][POSE + i] += bend[(i, k)] * step.cross;
        }
        noise[VELOCITY + k][VELOCITY + k] += step.value;
    }
    if let Some(push) = &pushed {
        for k in 0..2 {
            let (a, v) = (ACCELERATION + k, VELOCITY + k);
            noise[a][a] += push.value;
            noise[v][v] += push.integral;
            noise[a][v] += push.cross;
            noise[v][a] += push.cross;
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

    /// Noise adds up to the same whether a time is taken in one step or in a thousand.
    #[test]
    fn noise_does_not_depend_on_the_steps() {
        let motion = MotionParams { acceleration: None, ..MotionParams::omnidirectional() };
        let params = FusionParams { motion, ..FusionParams::default() };
        let run = |steps: u32| {
            let mut state = State::new(Stamp::default(), Se2::default(), &Matrix3::zeros(), &[0.0; ANCHORS]);
            (0..steps).for_each(|_| predict(&mut state, &params, 2.0 / f64::from(steps)));
            state.covariance
        };
        let (coarse, fine) = (run(1), run(1000));
        for i in 0..GYRO_BIAS {
            for j in 0..GYRO_BIAS {
                let scale = (coarse[i][i] * coarse[j][j]).sqrt();
                assert!((coarse[i][j] - fine[i][j]).abs() <= 1e-9 * scale, "{i} {j}: {} {}", coarse[i][j], fine[i][j]);
            }
        }
    }

    /// The series of short steps and the closed form of long ones meet.
    #[test]
    fn short_and_long_steps_agree() {
        let at = |x: f64| Step::new(&Wander::new(1.0, 1.0), x).integral / (x * x * x);
        assert!((at(0.03 - 1e-9) / at(0.03 + 1e-9) - 1.0).abs() < 1e-8);
        assert!((at(1e-6) * 1.5 - 1.0).abs() < 1e-5);
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
    }
}
