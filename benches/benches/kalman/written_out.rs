//! The same filters as one writes them for a single vehicle: closed forms, and nalgebra's operators.

use crate::drive::{DT, SIGMAS};
use agv_core::{
    geometry::wrap_angle,
    nalgebra::{Matrix3, SMatrix, SVector, Vector3},
};
use agv_filters::kalman::PlanarPose;

/// A state with the Jacobian and the noise of the step to it.
pub(crate) type Step<const N: usize> = (SVector<f64, N>, SMatrix<f64, N, N>, SMatrix<f64, N, N>);

/// The arc of a vehicle that turns, by the difference of sines, with its derivatives by heading, speed and turn rate.
fn arc(yaw: f64, speed: f64, rate: f64) -> [[f64; 2]; 4] {
    let (s0, c0) = yaw.sin_cos();
    let (s1, c1) = (yaw + rate * DT).sin_cos();
    let radius = speed / rate;
    let moved = [radius * (s1 - s0), radius * (c0 - c1)];
    let by_speed = [(s1 - s0) / rate, (c0 - c1) / rate];
    let by_rate = [radius * DT * c1 - moved[0] / rate, radius * DT * s1 - moved[1] / rate];
    [moved, [-moved[1], moved[0]], by_speed, by_rate]
}

/// The unicycle at the speed and turn rate of the drive.
pub(crate) fn unicycle(x: &SVector<f64, 3>, speed: f64, rate: f64) -> Step<3> {
    let [moved, by_yaw, by_speed, by_rate] = arc(x[2], speed, rate);
    let end = Vector3::new(x[0] + moved[0], x[1] + moved[1], wrap_angle(x[2] + rate * DT));
    let f = Matrix3::new(1.0, 0.0, by_yaw[0], 0.0, 1.0, by_yaw[1], 0.0, 0.0, 1.0);
    let (forward, left) = (0.02 * 0.02 + 1e-5 * speed, 0.01 * 0.01);
    let turn = 0.02 * 0.02 + 1e-5 * rate;
    let g = Matrix3::new(by_speed[0], -by_speed[1], by_rate[0], by_speed[1], by_speed[0], by_rate[1], 0.0, 0.0, DT);
    let q = g * Matrix3::from_diagonal(&(Vector3::new(forward, left, turn) / DT)) * g.transpose();
    (end, f, q)
}

/// The vehicle that keeps its speed and turn rate.
pub(crate) fn constant_turn(x: &SVector<f64, 5>) -> Step<5> {
    let (speed, rate) = (x[2], x[4]);
    let [moved, by_yaw, by_speed, by_rate] = arc(x[3], speed, rate);
    let end = SVector::<f64, 5>::new(x[0] + moved[0], x[1] + moved[1], speed, wrap_angle(x[3] + rate * DT), rate);
    let mut f = SMatrix::<f64, 5, 5>::identity();
    for row in 0..2 {
        (f[(row, 2)], f[(row, 3)], f[(row, 4)]) = (by_speed[row], by_yaw[row], by_rate[row]);
    }
    f[(3, 4)] = DT;
    let mut g = SMatrix::<f64, 5, 2>::zeros();
    (g[(0, 0)], g[(1, 0)], g[(2, 0)]) = (0.5 * DT * by_speed[0], 0.5 * DT * by_speed[1], DT);
    (g[(3, 1)], g[(4, 1)]) = (0.5 * DT * DT, DT);
    let variance = 0.158 * 0.158 / DT;
    (end, f, g * g.transpose() * variance)
}

/// `H`: the pose among the states, whose heading stands at `yaw`.
pub(crate) fn reads_pose<const N: usize>(yaw: usize) -> SMatrix<f64, 3, N> {
    let mut h = SMatrix::<f64, 3, N>::zeros();
    (h[(0, 0)], h[(1, 1)], h[(2, yaw)]) = (1.0, 1.0, 1.0);
    h
}

/// `R`.
pub(crate) fn noise() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::from(SIGMAS).map(|sigma| sigma * sigma))
}

/// An extended filter in nalgebra's operators, with Joseph's form, a gate and a wrapped heading.
pub(crate) struct Filter<const N: usize> {
    pub(crate) x: SVector<f64, N>,
    pub(crate) p: SMatrix<f64, N, N>,
}

impl<const N: usize> Filter<N> {
    #[inline]
    pub(crate) fn cycle(&mut self, step: Step<N>, seen: &PlanarPose, h: &SMatrix<f64, 3, N>, yaw: usize) {
        let (x, f, q) = step;
        let p = f * self.p * f.transpose() + q;
        let r = noise();
        let innovation = Vector3::new(seen[0] - x[0], seen[1] - x[1], wrap_angle(seen[2] - x[yaw]));
        let s = h * p * h.transpose() + r;
        let inverse = s.try_inverse().expect("a covariance");
        let nis = innovation.dot(&(inverse * innovation));
        (self.x, self.p) = (x, p);
        if nis < 16.266 {
            let k = p * h.transpose() * inverse;
            self.x += k * innovation;
            self.x[yaw] = wrap_angle(self.x[yaw]);
            let keep = SMatrix::<f64, N, N>::identity() - k * h;
            let joseph = keep * p * keep.transpose() + k * r * k.transpose();
            self.p = (joseph + joseph.transpose()) * 0.5;
        }
    }
}
