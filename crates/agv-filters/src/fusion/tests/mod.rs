//! The filter against vehicles that move as it believes.

mod consistency;
mod limits;
mod order;
mod roles;
mod sources;

use super::*;
use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    odometry::OdometryIncrement,
    roles::PoseBelief,
    sensors::{ImuSample, PoseObservation, PositionObservation, VelocityObservation},
    time::Stamp,
};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}

fn at(seconds: f64) -> Stamp {
    Stamp::from_seconds(seconds)
}

fn squares(sigmas: [f64; 3]) -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::from(sigmas).map(|sigma| sigma * sigma))
}

/// A belief of 5 cm and 0.02 rad.
fn belief(pose: Se2) -> PoseBelief<Se2> {
    PoseBelief::around(pose, squares([0.05, 0.05, 0.02])).unwrap()
}

/// No noise beside what measurements state.
fn bare(source: SourceParams) -> SourceParams {
    SourceParams { floor: NoiseFloor::default(), motion: MotionNoise::NONE, scaled: false, gate: 1.0, ..source }
}

fn motion(start: f64, from: &Se2, end: f64, to: &Se2, spread: Matrix3<f64>) -> OdometryIncrement {
    OdometryIncrement { covariance: spread, ..OdometryIncrement::between(at(start), from, at(end), to).unwrap() }
}

fn seen(time: f64, pose: Se2, spread: Matrix3<f64>) -> PoseObservation<Se2> {
    PoseObservation::new(at(time), UncertainPose::new(pose, spread).unwrap())
}

fn rates(time: f64, rate: f64, sigma: f64) -> ImuSample {
    let rates = UncertainVector::from_sigmas(Vector3::new(0.0, 0.0, rate), &Vector3::repeat(sigma)).unwrap();
    ImuSample::new(at(time)).with_angular_velocity(rates)
}

/// A vehicle that wanders as the parameters say, in steps of 10 ms.
struct Wanderer {
    params: FusionParams,
    pose: Se2,
    twist: Twist2,
    bias: f64,
    steps: u32,
    stream: Stream,
}

impl Wanderer {
    const STEP: f64 = 0.01;

    /// One whose start is drawn from the belief of the filter.
    fn new(params: FusionParams, seed: u64) -> Self {
        let mut stream = Seed(seed).stream(0, 0);
        let mut draw = |sigma: f64| sigma * normal(&mut stream);
        let start = Vector3::new(draw(0.05), draw(0.05), draw(0.02));
        let m = params.motion;
        let twist = Twist2::new(draw(m.vx.sigma), draw(m.vy.sigma), draw(m.yaw_rate.sigma));
        let bias = draw(params.gyro_bias_sigma);
        Self { params, pose: Se2::exp(&start), twist, bias, steps: 0, stream }
    }

    fn time(&self) -> f64 {
        f64::from(self.steps) * Self::STEP
    }

    /// Drives one step, finer than measurements are, so that path and velocity wander together.
    fn step(&mut self) {
        let fine = Self::STEP / 10.0;
        for _ in 0..10 {
            let m = self.params.motion;
            let mut wandered = |value: f64, wander: Wander| {
                let keep = (-fine / wander.time).exp();
                keep * value + wander.sigma * (1.0 - keep * keep).sqrt() * normal(&mut self.stream)
            };
            let (vx, vy) = (wandered(self.twist.vx, m.vx), wandered(self.twist.vy, m.vy));
            let next = Twist2::new(vx, vy, wandered(self.twist.yaw_rate, m.yaw_rate));
            let mean = (Vector3::from(self.twist) + Vector3::from(next)) * 0.5;
            self.pose = self.pose * Se2::exp(&(mean * fine));
            self.twist = next;
        }
        self.bias += self.params.gyro_bias_walk * Self::STEP.sqrt() * normal(&mut self.stream);
        self.steps += 1;
    }

    fn noisy(&mut self, sigmas: [f64; 3]) -> Vector3<f64> {
        Vector3::from(sigmas).map(|sigma| sigma * normal(&mut self.stream))
    }
}
