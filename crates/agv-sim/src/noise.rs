//! Draws that every sensor needs.

use agv_core::compute::{Seed, Stream};
use agv_core::sensors::SensorId;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// A draw from a normal distribution of mean zero and standard deviation `sigma`.
#[inline]
pub(crate) fn normal(sigma: f64, stream: &mut Stream) -> f64 {
    let standard: f64 = StandardNormal.sample(stream);
    sigma * standard
}

/// Whether an event of this `probability` happens.
#[inline]
pub(crate) fn happens(probability: f64, stream: &mut Stream) -> bool {
    stream.random::<f64>() < probability
}

/// The parts that draw, so that no two of them draw the same numbers.
#[derive(Clone, Copy)]
pub(crate) enum Part {
    Vehicle = 1,
    Laser,
    Lidar,
    Imu,
    FloorCamera,
    FrontCamera,
    Encoders,
    PoseSensor,
    CodeCamera,
}

/// The seed of one part: two parts, or two sensors of one kind, may be given one seed and draw on their own.
pub(crate) fn own_seed(seed: Seed, part: Part, sensor: SensorId) -> Seed {
    seed.derive(part as u64).derive(u64::from(sensor.0))
}
