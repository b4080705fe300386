//! The inner loop of a step test, for one set of gains or several side by side.
//!
//! Lanes share the plant and the clock and nothing else; their operations are the same in the same order, so that a lane
//! has the bits of a run on its own.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::lane::Lane;
use crate::plant::{
    ActuatorLimits,
    state_space::{Discrete, Vector},
};

/// A step test, ready to run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Test {
    pub(super) plant: Discrete,
    pub(super) actuator: ActuatorLimits,
    pub(super) set_point: f64,
    pub(super) filter_time: f64,
    pub(super) steps: u32,
}

/// What a run sums up; a plain one leaves all but the ITAE at zero. See [`StepFigures`](super::StepFigures).
#[derive(Clone, Copy)]
pub(super) struct Sums<T> {
    pub(super) itae: T,
    pub(super) iae: T,
    pub(super) ise: T,
    pub(super) itse: T,
    pub(super) overshoot: T,
    pub(super) energy: T,
    pub(super) travel: T,
    pub(super) last_error: T,
}

impl<T> Sums<T> {
    #[inline(always)]
    pub(super) fn map<U>(&self, f: impl Fn(&T) -> U) -> Sums<U> {
        Sums {
            itae: f(&self.itae),
            iae: f(&self.iae),
            ise: f(&self.ise),
            itse: f(&self.itse),
            overshoot: f(&self.overshoot),
            energy: f(&self.energy),
            travel: f(&self.travel),
            last_error: f(&self.last_error),
        }
    }
}

/// Runs the loops under the gains Kp, Ki, Kd. `N` is at least the order of the plant. A `PLAIN` run is for plants without
/// dead time, rate limit or direct feed-through, and gives the ITAE only. `line` has more entries than the plant's delay,
/// all zero.
#[inline(always)]
pub(super) fn run<T: Lane, const N: usize, const PLAIN: bool>(
    test: &Test,
    [kp, ki, kd]: [T; 3],
    line: &mut [T],
) -> Sums<T> {
    let plant = &test.plant;
    let (zero, dt, r) = (kp.like(0.0), plant.dt, kp.like(test.set_point));
    let (min, max) = (kp.like(test.actuator.min), kp.like(test.actuator.max));
    let step = kp.like(test.actuator.rate * dt);
    // Loops rather than closures, which would not be compiled for the vector unit.
    let (mut a, mut b, mut late_b, mut c) = ([[zero; N]; N], [zero; N], [zero; N], [zero; N]);
    for i in 0..N {
        (b[i], late_b[i], c[i]) = (kp.like(plant.b[i]), kp.like(plant.b_late[i]), kp.like(plant.c[i]));
        for (entry, value) in a[i].iter_mut().zip(&plant.a[i]) {
            *entry = kp.like(*value);
        }
    }
    let product = |b: &Vector| plant.c.iter().zip(b).map(|(c, b)| c * b).sum::<f64>();
    let (cb, late_cb) = (kp.like(product(&plant.b) + plant.d), kp.like(product(&plant.b_late)));
    // Backward Euler of the filter Tf d' + d = e': d = decay d + slope (e - e_last).
    let decay = kp.like(test.filter_time / (test.filter_time + dt));
    let slope = kp.like(1.0 / (test.filter_time + dt));
    // All that the newest error is multiplied with is one gain, so that the way from error to input is short:
    // u = direct e + held, where the part that is known beforehand is computed beside the plant.
    let (kd_slope, ki_dt) = (kd * slope, ki * kp.like(dt));
    let direct = kp + ki_dt + kd_slope;

    let mut sums = Sums {
        itae: zero,
        iae: zero,
        ise: zero,
        itse: zero,
        overshoot: zero,
        energy: zero,
        travel: zero,
        last_error: zero,
    };
    let (mut error, mut integral, mut derivative, mut slope_error, mut u) = (r, zero, zero, kd_slope * r, zero);
    let (mut x, mut head) = ([zero; N], 0);
    for k in 1..=test.steps {
        let t = kp.like(f64::from(k) * dt);
        let held = decay * derivative - slope_error;
        let last_u = u;
        u = (direct * error + (integral + held)).at_least(min).at_most(max);
        if !PLAIN {
            u = u.at_least(last_u - step).at_most(last_u + step);
        }
        integral = integral + ki_dt * error;
        slope_error = kd_slope * error;
        derivative = held + slope_error;

        let (mut due, mut late) = (u, zero);
        if !PLAIN {
            late = std::mem::replace(&mut line[head], u);
            head = if head == plant.delay { 0 } else { head + 1 };
            due = if plant.delay == 0 { u } else { line[head] };
        }
        let mut next = [zero; N];
        for i in 0..N {
            // What the old state gives comes first: it does not wait for the input.
            next[i] = a[i][0] * x[0];
            for j in 1..N {
                next[i] = next[i] + a[i][j] * x[j];
            }
        }
        // r - C x, of which the part without the input is known before.
        let mut free = r;
        for i in 0..N {
            free = free - c[i] * next[i];
            x[i] = next[i] + b[i] * due;
            if !PLAIN {
                x[i] = x[i] + late_b[i] * late;
            }
        }
        if !PLAIN {
            free = free - late_cb * late;
        }
        error = free - cb * due;
        sums.itae = sums.itae + t * error.abs();
        if !PLAIN {
            sums.iae = sums.iae + error.abs();
            sums.ise = sums.ise + error * error;
            sums.itse = sums.itse + t * (error * error);
            sums.overshoot = sums.overshoot.at_least(if test.set_point < 0.0 { error } else { zero - error });
            sums.energy = sums.energy + u * u;
            sums.travel = sums.travel + (u - last_u).abs();
        }
    }
    let dt = kp.like(dt);
    Sums {
        itae: sums.itae * dt,
        iae: sums.iae * dt,
        ise: sums.ise * dt,
        itse: sums.itse * dt,
        energy: sums.energy * dt,
        last_error: error.abs(),
        ..sums
    }
}
