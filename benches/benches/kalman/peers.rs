//! The same drives by hand and by the crates `kfilter` and `adskalman`, whose nalgebra is another version.
//!
//! Neither wraps headings: readings are given to them near their predicted heading.

use crate::drive::{FiveStates, Problem, ThreeStates};
use crate::written_out::{self, Filter, Step};
use adskalman::{CovarianceUpdateMethod, ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use agv_core::{geometry::wrap_angle, nalgebra::SVector};
use agv_filters::kalman::PlanarPose;
use kfilter::{
    kalman::{EKF, KalmanFilter, KalmanPredictInput, KalmanUpdate},
    measurement::{LinearMeasurement, Measurement},
    system::StepReturn,
};
use nalgebra_034 as old;

/// Ends of a drive by other filters.
pub(crate) trait Peers<const N: usize> {
    fn by_hand(&self) -> [f64; N];
    fn by_kfilter(&self) -> [f64; N];
    fn by_adskalman(&self) -> [f64; N];
}

/// A matrix of the other version.
fn matrix<const R: usize, const C: usize>(m: &agv_core::nalgebra::SMatrix<f64, R, C>) -> old::SMatrix<f64, R, C> {
    old::SMatrix::<f64, R, C>::from_column_slice(m.as_slice())
}

/// A reading with the heading nearest to the one expected, as `(x, y, yaw)`.
fn reading(seen: &PlanarPose, yaw: f64) -> old::Vector3<f64> {
    old::Vector3::new(seen[0], seen[1], yaw + wrap_angle(seen[2] - yaw))
}

fn wrapped<const N: usize>(mut state: [f64; N], yaw: usize) -> [f64; N] {
    state[yaw] = wrap_angle(state[yaw]);
    state
}

/// Heading in the middle of the state, the other components of a step from `step`.
fn returned<const N: usize>((x, f, q): Step<N>) -> StepReturn<f64, N> {
    StepReturn { state: matrix(&x), jacobian: matrix(&f), covariance: matrix(&q) }
}

fn by_kfilter<const N: usize, const U: usize>(
    step: fn(old::SVector<f64, N>, old::SVector<f64, U>) -> StepReturn<f64, N>,
    start: [f64; N],
    yaw: usize,
    cycles: impl Iterator<Item = (old::SVector<f64, U>, PlanarPose)>,
) -> [f64; N] {
    let mut filter: EKF<f64, N, U> =
        EKF::new_ekf_with_input(step, start.into(), old::SMatrix::<f64, N, N>::identity() * 0.01);
    let mut sensor = LinearMeasurement::new(
        matrix(&written_out::reads_pose::<N>(yaw)),
        matrix(&written_out::noise()),
        old::Vector3::zeros(),
    );
    for (control, seen) in cycles {
        let expected = filter.predict(control).expect("a step")[yaw];
        sensor.set_measurement(reading(&seen, expected));
        filter.update(&sensor).expect("a reading");
    }
    wrapped((*filter.state()).into(), yaw)
}

/// A step as `adskalman` takes one: the state at its end is given, not linear.
struct OneStep<const N: usize> {
    end: old::SVector<f64, N>,
    f: old::SMatrix<f64, N, N>,
    ft: old::SMatrix<f64, N, N>,
    q: old::SMatrix<f64, N, N>,
}

impl<const N: usize> TransitionModelLinearNoControl<f64, old::Const<N>> for OneStep<N> {
    fn F(&self) -> &old::SMatrix<f64, N, N> {
        &self.f
    }
    fn FT(&self) -> &old::SMatrix<f64, N, N> {
        &self.ft
    }
    fn Q(&self) -> &old::SMatrix<f64, N, N> {
        &self.q
    }
    fn predict(&self, before: &StateAndCovariance<f64, old::Const<N>>) -> StateAndCovariance<f64, old::Const<N>> {
        StateAndCovariance::new(self.end, self.f * before.covariance() * self.ft + self.q)
    }
}

struct PoseSensor<const N: usize> {
    h: old::SMatrix<f64, 3, N>,
    ht: old::SMatrix<f64, N, 3>,
    r: old::Matrix3<f64>,
}

impl<const N: usize> ObservationModel<f64, old::Const<N>, old::Const<3>> for PoseSensor<N> {
    fn H(&self) -> &old::SMatrix<f64, 3, N> {
        &self.h
    }
    fn HT(&self) -> &old::SMatrix<f64, N, 3> {
        &self.ht
    }
    fn R(&self) -> &old::Matrix3<f64> {
        &self.r
    }
}

fn by_adskalman<const N: usize>(
    start: [f64; N],
    yaw: usize,
    seen: impl Iterator<Item = PlanarPose>,
    step: impl Fn(&SVector<f64, N>) -> Step<N>,
) -> [f64; N] {
    let h = matrix(&written_out::reads_pose::<N>(yaw));
    let sensor = PoseSensor { h, ht: h.transpose(), r: matrix(&written_out::noise()) };
    let mut belief = StateAndCovariance::new(start.into(), old::SMatrix::<f64, N, N>::identity() * 0.01);
    for seen in seen {
        let state: [f64; N] = (*belief.state()).into();
        let (end, f, q) = step(&state.into());
        let f = matrix(&f);
        let model = OneStep { end: matrix(&end), f, ft: f.transpose(), q: matrix(&q) };
        let predicted = model.predict(&belief);
        let reading = reading(&seen, predicted.state()[yaw]);
        belief = sensor.update(&predicted, &reading, CovarianceUpdateMethod::JosephForm).expect("a covariance");
    }
    wrapped((*belief.state()).into(), yaw)
}

impl Peers<3> for ThreeStates {
    fn by_hand(&self) -> [f64; 3] {
        let mut filter = Filter { x: *self.start().vector(), p: Self::spread() };
        let h = written_out::reads_pose::<3>(2);
        for (twist, seen) in self.cycles() {
            let step = written_out::unicycle(&filter.x, twist.vx, twist.yaw_rate);
            filter.cycle(step, seen, &h, 2);
        }
        filter.x.into()
    }

    fn by_kfilter(&self) -> [f64; 3] {
        let step = |x: old::Vector3<f64>, u: old::Vector2<f64>| {
            returned(written_out::unicycle(&<[f64; 3]>::from(x).into(), u[0], u[1]))
        };
        let cycles = self.cycles().iter().map(|(twist, seen)| (old::Vector2::new(twist.vx, twist.yaw_rate), *seen));
        by_kfilter(step, [0.0; 3], 2, cycles)
    }

    fn by_adskalman(&self) -> [f64; 3] {
        let (twist, _) = self.cycles()[0];
        let seen = self.cycles().iter().map(|(_, seen)| *seen);
        by_adskalman([0.0; 3], 2, seen, |x| written_out::unicycle(x, twist.vx, twist.yaw_rate))
    }
}

impl Peers<5> for FiveStates {
    fn by_hand(&self) -> [f64; 5] {
        let mut filter = Filter { x: *self.start().vector(), p: Self::spread() };
        let h = written_out::reads_pose::<5>(3);
        for ((), seen) in self.cycles() {
            let step = written_out::constant_turn(&filter.x);
            filter.cycle(step, seen, &h, 3);
        }
        filter.x.into()
    }

    fn by_kfilter(&self) -> [f64; 5] {
        let step = |x: old::SVector<f64, 5>, _: old::Vector1<f64>| {
            returned(written_out::constant_turn(&<[f64; 5]>::from(x).into()))
        };
        by_kfilter(
            step,
            (*self.start().vector()).into(),
            3,
            self.cycles().iter().map(|((), seen)| (old::Vector1::zeros(), *seen)),
        )
    }

    fn by_adskalman(&self) -> [f64; 5] {
        let seen = self.cycles().iter().map(|((), seen)| *seen);
        by_adskalman((*self.start().vector()).into(), 3, seen, written_out::constant_turn)
    }
}
