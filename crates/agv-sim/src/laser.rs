//! A planar laser scanner in a planar world.
//!
//! Each beam leaves from where the scanner is at its own time, so that a moving scanner bends its scan as a real one
//! does. A reading is `r + N(0, σ² + (κ r)²)`; a beam that meets nothing, or is lost, reads as the driver writes it.

use crate::noise::{Part, happens, normal, own_seed};
use crate::{Error, PlanarWorld};
use agv_core::{
    check,
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, So2, Twist2},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use nalgebra::Vector2;

/// Beams per parallel chunk and random stream.
const CHUNK: usize = 64;

/// How a driver writes a beam without a return.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum NoReturnReading {
    /// +∞, as REP-117 asks.
    #[default]
    Infinity,
    /// `range_max` plus this many metres, as SICK drivers and the CARMEN logs do.
    BeyondMax(f64),
    /// Zero, as many low-cost scanners do: indistinguishable from a lost beam.
    Zero,
    /// NaN.
    NaN,
}

/// What a laser scanner is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaserParams {
    /// Mount, directions, range limits (metres) and timing (seconds).
    pub geometry: ScanGeometry,
    /// Number of beams, from 1 to [`LaserScan::MAX_BEAMS`].
    pub beams: usize,
    /// Standard deviation of a range, in metres.
    pub range_sigma: f64,
    /// Standard deviation that grows with the range, in metres per metre; added in quadrature.
    pub relative_sigma: f64,
    /// Probability that a beam is lost and reads NaN.
    pub dropout: f64,
    /// What a beam that meets nothing up to `range_max` reads.
    pub no_return: NoReturnReading,
}

impl Default for LaserParams {
    /// A 270° safety scanner of 1081 beams with 1 cm of noise, typical of the data sheets, one beam in a thousand lost.
    fn default() -> Self {
        Self {
            geometry: ScanGeometry::default(),
            beams: 1081,
            range_sigma: 0.01,
            relative_sigma: 0.0,
            dropout: 0.001,
            no_return: NoReturnReading::Infinity,
        }
    }
}

impl LaserParams {
    /// The same scanner without noise and dropouts: it reads the truth, to the precision of `f32`.
    #[must_use]
    pub const fn ideal(self) -> Self {
        Self { range_sigma: 0.0, relative_sigma: 0.0, dropout: 0.0, ..self }
    }

    /// `beams` beams spread evenly over `field_of_view` radians, symmetric to the scanner's x axis; one beam looks
    /// straight ahead.
    #[must_use]
    pub fn with_beams(mut self, beams: usize, field_of_view: f64) -> Self {
        self.beams = beams;
        let gaps = beams.saturating_sub(1).max(1) as f64;
        self.geometry.angle_min = if beams > 1 { -0.5 * field_of_view } else { 0.0 };
        self.geometry.angle_increment = field_of_view / gaps;
        self
    }

    fn validate(&self) -> Result<(), Error> {
        self.geometry.validate()?;
        check::at_least("beams", self.beams, 1)?;
        if self.beams > LaserScan::MAX_BEAMS {
            let (len, max) = (self.beams, LaserScan::MAX_BEAMS);
            return Err(agv_core::Error::TooMany { name: "beams", len, max }.into());
        }
        check::non_negative("range_sigma", self.range_sigma)?;
        check::non_negative("relative_sigma", self.relative_sigma)?;
        check::in_range("dropout", self.dropout, 0.0, 1.0)?;
        if let NoReturnReading::BeyondMax(margin) = self.no_return {
            check::positive("no_return margin", margin)?;
        }
        Ok(())
    }

    /// What the driver writes for a beam without return.
    fn no_return_reading(&self) -> f32 {
        match self.no_return {
            NoReturnReading::Infinity => f32::INFINITY,
            NoReturnReading::BeyondMax(margin) => (self.geometry.range_max + margin) as f32,
            NoReturnReading::Zero => 0.0,
            NoReturnReading::NaN => f32::NAN,
        }
    }
}

/// A laser scanner that looks at a [`PlanarWorld`].
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::time::Stamp;
/// use agv_sim::{Laser, LaserParams, Shape, World2d};
///
/// let world = World2d::new(Shape::room(Vector2::new(-5.0, -5.0), Vector2::new(5.0, 5.0)).to_vec())?;
/// let mut laser = Laser::new(LaserParams::default().ideal().with_beams(181, std::f64::consts::PI), Seed(1))?;
/// let scan = laser.scan(&world, &Se2::new(1.0, 0.0, 0.0), &Twist2::ZERO, Stamp::default())?;
/// assert_eq!(scan.len(), 181);
/// assert_eq!(scan.ranges()[90], 4.0);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Laser {
    params: LaserParams,
    seed: Seed,
    par: Par,
    /// Number of the next scan: the key of its random streams.
    step: u64,
    /// Unit directions in the base frame.
    directions: Vec<Vector2<f64>>,
    readings: Vec<f32>,
    scan: LaserScan,
}

impl Laser {
    /// A scanner with its own source of randomness: the seed together with the kind of sensor and its
    /// [`SensorId`](agv_core::sensors::SensorId), so that one seed may serve a whole vehicle.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: LaserParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let geometry = params.geometry;
        let mount = geometry.base_from_sensor.rotation();
        let directions = (0..params.beams)
            .map(|i| mount.compose(&So2::from_angle(geometry.angle(i))))
            .map(|rotation| Vector2::new(rotation.cos(), rotation.sin()));
        Ok(Self {
            params,
            seed: own_seed(seed, Part::Laser, geometry.sensor),
            par: Par::Seq,
            step: 0,
            directions: directions.collect(),
            readings: vec![0.0; params.beams],
            scan: LaserScan::new(Stamp::default(), geometry, Vec::with_capacity(params.beams))?,
        })
    }

    /// The same scanner with its beams spread over threads; the scans have the same bits.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// What the scanner is like.
    pub const fn params(&self) -> &LaserParams {
        &self.params
    }

    /// The scan taken last; empty before the first.
    pub const fn last(&self) -> &LaserScan {
        &self.scan
    }

    /// The scan whose first beam is taken at `stamp` with the base at `map_from_base`, moving at `twist`.
    ///
    /// O(beams) rays; no allocation. Clone what is returned to keep it.
    ///
    /// # Errors
    /// A pose or twist that is not finite; the scanner's random state is then as it was.
    pub fn scan<W: PlanarWorld + ?Sized>(
        &mut self,
        world: &W,
        map_from_base: &Se2,
        twist: &Twist2,
        stamp: Stamp,
    ) -> Result<&LaserScan, Error> {
        check::all_finite("map_from_base", &[map_from_base.x(), map_from_base.y(), map_from_base.yaw()])?;
        check::all_finite("twist", &[twist.vx, twist.vy, twist.yaw_rate])?;
        let (params, seed, step) = (&self.params, self.seed, self.step);
        let geometry = &params.geometry;
        let mount = geometry.base_from_sensor.translation();
        let moving = geometry.time_increment > 0.0 && *twist != Twist2::ZERO;
        let data = (self.readings.as_mut_slice(), self.directions.as_slice());
        self.par.for_each_chunk(data, CHUNK, |chunk, (readings, directions)| {
            let mut stream = seed.stream(step, chunk as u64);
            for (offset, (reading, direction)) in readings.iter_mut().zip(directions).enumerate() {
                let pose = if moving {
                    let elapsed = (chunk * CHUNK + offset) as f64 * geometry.time_increment;
                    *map_from_base * twist.integrate(elapsed)
                } else {
                    *map_from_base
                };
                // Drawn for every beam, hit or not: what one beam meets does not change its neighbours' noise.
                let noise = if params.range_sigma > 0.0 || params.relative_sigma > 0.0 {
                    normal(1.0, &mut stream)
                } else {
                    0.0
                };
                let lost = params.dropout > 0.0 && happens(params.dropout, &mut stream);
                let range = world.cast(&(pose * mount), &pose.rotation().act(direction), geometry.range_max);
                *reading = match range {
                    _ if lost => f32::NAN,
                    Some(range) => (range + noise * params.range_sigma.hypot(params.relative_sigma * range)) as f32,
                    None => params.no_return_reading(),
                };
            }
        });
        self.step += 1;
        self.scan.refill(stamp, self.readings.iter().copied())?;
        Ok(&self.scan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Shape, World2d};
    use agv_core::sensors::Beam;
    use std::f64::consts::TAU;

    fn round_room(radius: f64) -> World2d {
        World2d::new(vec![Shape::Circle { center: Vector2::zeros(), radius }]).unwrap()
    }

    fn scan(params: LaserParams, world: &World2d, par: Par) -> LaserScan {
        let mut laser = Laser::new(params, Seed(3)).unwrap().with_parallelism(par);
        laser.scan(world, &Se2::default(), &Twist2::ZERO, Stamp::default()).unwrap().clone()
    }

    #[test]
    fn any_number_of_beams_and_threads_gives_the_same_bits() {
        for beams in [1, 63, 64, 65, 1440, 5000] {
            let params = LaserParams::default().with_beams(beams, TAU);
            let bits =
                |par| scan(params, &round_room(5.0), par).ranges().iter().map(|r| r.to_bits()).collect::<Vec<_>>();
            let reference = bits(Par::Seq);
            assert_eq!(reference.len(), beams);
            assert_eq!(bits(Par::threads(2)), reference);
            assert_eq!(bits(Par::threads(7)), reference);
        }
    }

    /// Sum of squared standard scores over n beams is chi-square(n): within 4.5 sigma of n. The two halves of the
    /// scanner see walls at 4 m and 8 m, so both terms of the noise are seen.
    #[test]
    fn range_noise_has_the_stated_variance() {
        let params = LaserParams { range_sigma: 0.02, relative_sigma: 0.005, dropout: 0.0, ..Default::default() };
        for radius in [4.0, 8.0] {
            let noisy = scan(params.with_beams(20_000, TAU), &round_room(radius), Par::Seq);
            let sigma = 0.02_f64.hypot(0.005 * radius);
            let scores: Vec<f64> = noisy.ranges().iter().map(|&r| (f64::from(r) - radius) / sigma).collect();
            let n = scores.len() as f64;
            let squares: f64 = scores.iter().map(|z| z * z).sum();
            assert!((squares - n).abs() < 4.5 * (2.0 * n).sqrt(), "{squares}");
            assert!(scores.iter().sum::<f64>().abs() < 4.5 * n.sqrt());
        }
    }

    #[test]
    fn dropouts_are_binomial_and_read_nan() {
        let params = LaserParams { dropout: 0.1, ..Default::default() }.with_beams(20_000, TAU);
        let lost = scan(params, &round_room(3.0), Par::Seq).ranges().iter().filter(|r| r.is_nan()).count() as f64;
        assert!((lost - 2000.0).abs() < 4.5 * 1800_f64.sqrt(), "{lost}");
    }

    #[test]
    fn nothing_in_range_reads_as_the_driver_writes_it() {
        let empty = World2d::new(vec![]).unwrap();
        for (no_return, meaning) in [
            (NoReturnReading::Infinity, Beam::NoReturn),
            (NoReturnReading::BeyondMax(1.0), Beam::NoReturn),
            (NoReturnReading::Zero, Beam::Invalid),
            (NoReturnReading::NaN, Beam::Invalid),
        ] {
            let params = LaserParams { no_return, ..Default::default() }.ideal().with_beams(5, 1.0);
            assert!(scan(params, &empty, Par::Seq).beams().all(|(_, beam)| beam == meaning), "{no_return:?}");
        }
    }

    /// Driving at a wall, each beam of a narrow scan is taken `v dt` nearer to it than the one before.
    #[test]
    fn a_moving_scanner_bends_its_scan() {
        let wall = Shape::Segment { a: Vector2::new(5.0, -9.0), b: Vector2::new(5.0, 9.0) };
        let world = World2d::new(vec![wall]).unwrap();
        let mut params = LaserParams::default().ideal().with_beams(11, 1e-9);
        params.geometry.time_increment = 0.01;
        let mut laser = Laser::new(params, Seed(0)).unwrap();
        let twist = Twist2::new(2.0, 0.0, 0.0);
        let scan = laser.scan(&world, &Se2::default(), &twist, Stamp::default()).unwrap();
        for (i, range) in scan.ranges().iter().enumerate() {
            assert!((f64::from(*range) - (5.0 - 0.02 * i as f64)).abs() < 1e-6);
        }
    }

    #[test]
    fn the_mount_moves_and_turns_the_beams() {
        let world = World2d::new(Shape::room(Vector2::new(-5.0, -5.0), Vector2::new(5.0, 5.0)).to_vec()).unwrap();
        let mut params = LaserParams::default().ideal().with_beams(1, 1.0);
        params.geometry.base_from_sensor = Se2::new(1.0, 0.5, std::f64::consts::FRAC_PI_2);
        let mut laser = Laser::new(params, Seed(0)).unwrap();
        let scan = laser.scan(&world, &Se2::default(), &Twist2::ZERO, Stamp::default()).unwrap();
        assert!((scan.ranges()[0] - 4.5).abs() < 1e-6);
    }

    #[test]
    fn bad_parameters_and_poses_are_refused() {
        let good = LaserParams::default();
        for bad in [
            LaserParams { beams: 0, ..good },
            LaserParams { beams: LaserScan::MAX_BEAMS + 1, ..good },
            LaserParams { range_sigma: -1.0, ..good },
            LaserParams { relative_sigma: f64::NAN, ..good },
            LaserParams { dropout: 1.5, ..good },
            LaserParams { no_return: NoReturnReading::BeyondMax(0.0), ..good },
            LaserParams { geometry: ScanGeometry { range_max: f64::NAN, ..good.geometry }, ..good },
        ] {
            assert!(Laser::new(bad, Seed(0)).is_err(), "{bad:?}");
        }
        let (mut laser, world) = (Laser::new(good, Seed(0)).unwrap(), round_room(3.0));
        let before = laser.clone().scan(&world, &Se2::default(), &Twist2::ZERO, Stamp::default()).unwrap().clone();
        let nan_twist = Twist2::new(f64::NAN, 0.0, 0.0);
        assert!(laser.scan(&world, &Se2::new(f64::NAN, 0.0, 0.0), &Twist2::ZERO, Stamp::default()).is_err());
        assert!(laser.scan(&world, &Se2::default(), &nan_twist, Stamp::default()).is_err());
        // The refused calls drew nothing. Compared by bits, for lost beams read NaN.
        let after = laser.scan(&world, &Se2::default(), &Twist2::ZERO, Stamp::default()).unwrap();
        assert!(before.ranges().iter().zip(after.ranges()).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
}
