//! The inner loop of a step test, for several gains at once.
//!
//! Each lane is a loop of its own: the lanes share the plant and the clock, their operations are the same in the same
//! order, so that a lane has the same bits whatever its neighbours. Lanes are plain arrays whose loops vectorise.

use crate::plant::state_space::Discrete;
use crate::plant::{
    ActuatorLimits,
    actuator::{at_least, at_most, limit},
};

/// Gain sets that are simulated at once.
pub(super) const LANES: usize = 8;

/// Greatest dead time of a test, in samples: the inputs under way are kept on the stack.
pub(super) const MAX_DELAY: usize = 1000;

/// A step test, ready to run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Test {
    pub(super) plant: Discrete,
    pub(super) actuator: ActuatorLimits,
    pub(super) set_point: f64,
    pub(super) filter_time: f64,
    pub(super) steps: u32,
}

/// ITAE of `L` loops under the gains Kp, Ki, Kd. `N` is the order of the plant; a `PLAIN` one has no dead time, no
/// limit on the rate of its input and no direct feed-through.
#[inline(always)]
pub(super) fn itae<const N: usize, const L: usize, const PLAIN: bool>(
    test: &Test,
    [kp, ki, kd]: &[[f64; L]; 3],
) -> [f64; L] {
    let plant = &test.plant;
    let (dt, r) = (plant.dt, test.set_point);
    let ActuatorLimits { min, max, rate } = test.actuator;
    // Backward Euler of the filter Tf d' + d = e': d = a d + (e - e_last) / (Tf + dt).
    let decay = test.filter_time / (test.filter_time + dt);
    let slope = 1.0 / (test.filter_time + dt);
    // All that the newest error is multiplied with is one gain, so that the way from error to input is short:
    // u = direct e + held, where the part that is known beforehand is computed beside the plant.
    let mut direct = [0.0; L];
    let mut kd_slope = [0.0; L];
    let mut ki_dt = [0.0; L];
    for l in 0..L {
        kd_slope[l] = kd[l] * slope;
        ki_dt[l] = ki[l] * dt;
        direct[l] = kp[l] + ki_dt[l] + kd_slope[l];
    }
    let mut error = [r; L];
    let mut last_error = [r; L];
    let mut integral = [0.0; L];
    let mut derivative = [0.0; L];
    let mut x = [[0.0; L]; N];
    let mut cost = [0.0; L];
    let mut u = [0.0; L];
    let mut line = [[0.0; L]; MAX_DELAY + 1];
    let mut head = 0;
    for k in 1..=test.steps {
        let t = f64::from(k) * dt;
        let last_u = u;
        for l in 0..L {
            let held_derivative = decay * derivative[l] - kd_slope[l] * last_error[l];
            u[l] = direct[l] * error[l] + (integral[l] + held_derivative);
            integral[l] += ki_dt[l] * error[l];
            derivative[l] = held_derivative + kd_slope[l] * error[l];
            last_error[l] = error[l];
            u[l] = if PLAIN { at_most(at_least(u[l], min), max) } else { limit(u[l], last_u[l], min, max, rate * dt) };
        }
        let (mut due, mut late) = (u, [0.0; L]);
        if !PLAIN {
            late = std::mem::replace(&mut line[head], u);
            head = if head == plant.delay { 0 } else { head + 1 };
            due = line[head];
            if plant.delay == 0 {
                due = u;
            }
        }
        let mut next = [[0.0; L]; N];
        let mut y = [0.0; L];
        for i in 0..N {
            for l in 0..L {
                let mut sum = plant.a[i][0] * x[0][l];
                for j in 1..N {
                    sum += plant.a[i][j] * x[j][l];
                }
                sum += plant.b[i] * due[l];
                if !PLAIN {
                    sum += plant.b_late[i] * late[l];
                }
                next[i][l] = sum;
                y[l] += plant.c[i] * sum;
            }
        }
        x = next;
        for l in 0..L {
            if !PLAIN {
                y[l] += plant.d * due[l];
            }
            error[l] = r - y[l];
            cost[l] += t * error[l].abs();
        }
    }
    cost.map(|cost| cost * dt)
}
