//! A spinning lidar with many lines in a spatial world.
//!
//! All lines of a column fire together; columns follow one another counter-clockwise from the sensor's x axis, evenly
//! over the period. Each column leaves from where the sensor is at its own time, and its points are given in the
//! sensor frame of that time: a moving sensor bends its cloud as a real one does, and the time of each point lets it be
//! mended.

use crate::noise::{Part, happens, normal, own_seed};
use crate::{Error, World3d};
use agv_core::{
    check,
    compute::{Par, Seed},
    geometry::{LieGroup, Se3, Twist3},
    sensors::{BodyMotion, ConstantTwist, LidarReturn, PointCloud, SensorId},
    time::Stamp,
};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Columns per parallel chunk and random stream.
const CHUNK: usize = 16;

/// What a spinning lidar is like.
#[derive(Debug, Clone, PartialEq)]
pub struct LidarParams {
    /// Which lidar of the vehicle it is.
    pub sensor: SensorId,
    /// Pose of the sensor on the vehicle.
    pub base_from_sensor: Se3,
    /// Elevation of each line in radians, upwards positive, from the lowest: the place in the list is the ring.
    pub elevations: Vec<f64>,
    /// Columns per revolution.
    pub columns: usize,
    /// Duration of a revolution, in seconds.
    pub period: f64,
    /// Least range that gives a return, in metres.
    pub range_min: f64,
    /// Greatest range that gives a return, in metres.
    pub range_max: f64,
    /// Standard deviation of a range, in metres.
    pub range_sigma: f64,
    /// Probability that a return is lost.
    pub dropout: f64,
}

impl Default for LidarParams {
    /// [`vlp16`](Self::vlp16).
    fn default() -> Self {
        Self::vlp16()
    }
}

/// `lines` elevations evenly from `lowest` to `highest` degrees.
fn fan(lines: u32, lowest: f64, highest: f64) -> Vec<f64> {
    let step = (highest - lowest) / f64::from(lines - 1);
    (0..lines).map(|i| (lowest + f64::from(i) * step).to_radians()).collect()
}

impl LidarParams {
    /// 16 lines from -15° to 15° every 2°, 1800 columns at 10 Hz, 100 m, 3 cm (Velodyne VLP-16 data sheet).
    pub fn vlp16() -> Self {
        Self {
            sensor: SensorId::default(),
            base_from_sensor: Se3::default(),
            elevations: fan(16, -15.0, 15.0),
            columns: 1800,
            period: 0.1,
            range_min: 0.5,
            range_max: 100.0,
            range_sigma: 0.03,
            dropout: 0.001,
        }
    }

    /// 32 lines from -30.67° to 10.67° every 1.33°, 70 m, 2 cm (Velodyne HDL-32E data sheet), 1800 columns at 10 Hz.
    pub fn hdl32() -> Self {
        Self { elevations: fan(32, -30.67, 10.67), range_max: 70.0, range_sigma: 0.02, ..Self::vlp16() }
    }

    /// 64 lines evenly over 45° about the horizon and 1800 columns at 10 Hz, 120 m, 2 cm, like the Ouster OS1-64.
    pub fn uniform64() -> Self {
        Self { elevations: fan(64, -22.5, 22.5), range_max: 120.0, range_sigma: 0.02, ..Self::vlp16() }
    }

    /// The same sensor without noise and dropouts: it reads the truth, to the precision of `f32`.
    #[must_use]
    pub fn ideal(self) -> Self {
        Self { range_sigma: 0.0, dropout: 0.0, ..self }
    }

    /// The same sensor at this pose on the vehicle.
    #[must_use]
    pub fn with_mount(self, base_from_sensor: Se3) -> Self {
        Self { base_from_sensor, ..self }
    }

    fn validate(&self) -> Result<(), Error> {
        if !self.base_from_sensor.is_finite() {
            return Err(agv_core::Error::NotFinite { name: "base_from_sensor", value: f64::NAN }.into());
        }
        let lines = check::at_least("elevations", self.elevations.len(), 1)?;
        check::in_range("lines", lines as f64, 1.0, 1024.0)?;
        let mut previous = f64::NEG_INFINITY;
        for (index, &value) in self.elevations.iter().enumerate() {
            check::in_range("elevation", value, -0.25 * TAU, 0.25 * TAU)?;
            if value <= previous {
                return Err(Error::NotIncreasing { name: "elevations", index, value });
            }
            previous = value;
        }
        check::in_range("columns", self.columns as f64, 1.0, 65_536.0)?;
        check::positive("period", self.period)?;
        check::positive("range_max", self.range_max)?;
        check::in_range("range_min", self.range_min, 0.0, self.range_max.next_down())?;
        check::non_negative("range_sigma", self.range_sigma)?;
        check::in_range("dropout", self.dropout, 0.0, 1.0)?;
        Ok(())
    }
}

/// A spinning lidar that looks at a [`World3d`].
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se3, So3, Twist3};
/// use agv_core::nalgebra::Vector3;
/// use agv_core::time::Stamp;
/// use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};
///
/// let factory = Factory::generate(FactoryParams::default(), Seed(7))?;
/// let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::default());
/// let mut lidar = Lidar::new(LidarParams::vlp16().with_mount(mount), Seed(1))?;
/// let map_from_base = Se3::from_parts(Vector3::new(20.0, 1.5, 0.0), So3::default());
/// let cloud = lidar.scan(factory.world(), &map_from_base, &Twist3::default(), Stamp::default())?;
/// assert!(cloud.len() > 27_000); // nearly all of 16 x 1800 rays end indoors
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Lidar {
    params: LidarParams,
    seed: Seed,
    par: Par,
    /// Number of the next revolution: the key of its random streams.
    step: u64,
    /// Cosine and sine of each column's azimuth and each line's elevation.
    azimuths: Vec<(f64, f64)>,
    elevations: Vec<(f64, f64)>,
    /// Column by column, lines from the lowest; the coordinates of a lost return are NaN.
    returns: Vec<LidarReturn>,
    cloud: PointCloud,
}

impl Lidar {
    /// A lidar with its own source of randomness.
    ///
    /// # Errors
    /// The first parameter that is out of its range, or elevations that do not increase.
    pub fn new(params: LidarParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let unit = |angle: f64| (angle.cos(), angle.sin());
        let azimuths = (0..params.columns).map(|i| unit(TAU * i as f64 / params.columns as f64)).collect();
        let elevations: Vec<_> = params.elevations.iter().map(|&e| unit(e)).collect();
        let returns = vec![LidarReturn::default(); params.columns * elevations.len()];
        let mut cloud = PointCloud::default().with_sensor(params.sensor).with_mount(params.base_from_sensor)?;
        // Makes room for every return, so that no later scan allocates.
        cloud.refill(Stamp::default(), returns.iter().copied());
        cloud.clear();
        let seed = own_seed(seed, Part::Lidar, params.sensor);
        Ok(Self { params, seed, par: Par::Seq, step: 0, azimuths, elevations, returns, cloud })
    }

    /// The same lidar with its columns spread over threads; the clouds have the same bits.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// What the lidar is like.
    pub const fn params(&self) -> &LidarParams {
        &self.params
    }

    /// The cloud taken last; empty before the first.
    pub const fn last(&self) -> &PointCloud {
        &self.cloud
    }

    /// The revolution that begins at `stamp` with the base at `map_from_base`, moving at `twist` (base frame).
    ///
    /// Only returns are in the cloud, column by column and in each from the lowest line, with ring, time after `stamp`
    /// in seconds, and intensity: reflectivity times the cosine of the incidence, from 0 to 1. O(lines columns) rays;
    /// no allocation. Clone what is returned to keep it.
    ///
    /// # Errors
    /// A pose or twist that is not finite; the sensor's random state is then as it was.
    pub fn scan(
        &mut self,
        world: &World3d,
        map_from_base: &Se3,
        twist: &Twist3,
        stamp: Stamp,
    ) -> Result<&PointCloud, Error> {
        self.scan_along(world, map_from_base, &ConstantTwist::spatial(stamp, twist)?)
    }

    /// As [`scan`](Self::scan), along any motion; the revolution begins at the motion's reference time, with the base at
    /// `map_from_base`.
    ///
    /// # Errors
    /// A pose that is not finite; the sensor's random state is then as it was.
    pub fn scan_along(
        &mut self,
        world: &World3d,
        map_from_base: &Se3,
        motion: &(impl BodyMotion<Se3> + Sync),
    ) -> Result<&PointCloud, Error> {
        check::all_finite("map_from_base", &map_from_base.rotation().matrix())?;
        check::all_finite("map_from_base", map_from_base.translation().iter())?;
        let (params, seed, step) = (&self.params, self.seed, self.step);
        let (azimuths, elevations) = (self.azimuths.as_slice(), self.elevations.as_slice());
        let lines = elevations.len();
        self.par.for_each_chunk(self.returns.as_mut_slice(), CHUNK * lines, |chunk, returns| {
            let mut stream = seed.stream(step, chunk as u64);
            for (offset, column) in returns.chunks_mut(lines).enumerate() {
                let index = chunk * CHUNK + offset;
                let time = params.period * index as f64 / params.columns as f64;
                let sensor = *map_from_base * motion.reference_from_base(time) * params.base_from_sensor;
                let (origin, rotation) = (sensor.translation(), sensor.rotation().matrix());
                let (cos_azimuth, sin_azimuth) = azimuths[index];
                for (ring, (point, (cos, sin))) in column.iter_mut().zip(elevations).enumerate() {
                    let direction = Vector3::new(cos * cos_azimuth, cos * sin_azimuth, *sin);
                    // Drawn for every ray, hit or not: what one ray meets does not change its neighbours' noise.
                    let noise = if params.range_sigma > 0.0 { normal(params.range_sigma, &mut stream) } else { 0.0 };
                    let lost = params.dropout > 0.0 && happens(params.dropout, &mut stream);
                    let in_map = rotation * direction;
                    let hit = world
                        .cast(&origin, &in_map, params.range_max)
                        .filter(|hit| !lost && hit.range >= params.range_min);
                    *point = match hit {
                        Some(hit) => LidarReturn {
                            position: (direction * (hit.range + noise)).map(|v| v as f32),
                            intensity: (-world.reflectivity(hit.fixture) * hit.normal.dot(&in_map)) as f32,
                            ring: ring as u16,
                            time: time as f32,
                        },
                        None => LidarReturn { position: Vector3::repeat(f32::NAN), ..LidarReturn::default() },
                    };
                }
            }
        });
        self.step += 1;
        self.cloud.refill(motion.reference(), self.returns.iter().filter(|r| r.position.x.is_finite()).copied());
        Ok(&self.cloud)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Factory, FactoryParams, Solid};
    use agv_core::geometry::So3;

    fn box_room() -> World3d {
        World3d::new(vec![Solid::block(Vector3::repeat(-5.0), Vector3::repeat(5.0)).into()]).unwrap()
    }

    fn bits(cloud: &PointCloud) -> Vec<u32> {
        cloud.x().iter().chain(cloud.y()).chain(cloud.z()).map(|v| v.to_bits()).collect()
    }

    #[test]
    fn tables_are_those_of_the_data_sheets() {
        for (params, lines, lowest, highest) in [
            (LidarParams::vlp16(), 16, -15.0, 15.0),
            (LidarParams::hdl32(), 32, -30.67, 10.67),
            (LidarParams::uniform64(), 64, -22.5, 22.5),
        ] {
            assert_eq!(params.elevations.len(), lines);
            assert!((params.elevations[0].to_degrees() - lowest).abs() < 1e-9);
            assert!((params.elevations[lines - 1].to_degrees() - highest).abs() < 1e-9);
        }
    }

    /// Every point of an ideal scan lies on the room's walls, in its ring's cone, in the order of time.
    #[test]
    fn an_ideal_scan_lies_on_the_walls() {
        let mount = Se3::from_parts(Vector3::new(0.3, -0.2, 1.0), So3::from_roll_pitch_yaw(0.1, -0.2, 0.7));
        let mut lidar = Lidar::new(LidarParams::hdl32().ideal().with_mount(mount), Seed(0)).unwrap();
        let map_from_base = Se3::from_parts(Vector3::new(1.0, 0.5, -2.0), So3::from_roll_pitch_yaw(0.0, 0.05, 2.0));
        let cloud = lidar.scan(&box_room(), &map_from_base, &Twist3::default(), Stamp::default()).unwrap();
        assert_eq!(cloud.len(), 32 * 1800);
        let elevations = LidarParams::hdl32().elevations;
        let (rings, times) = (cloud.ring().unwrap(), cloud.time().unwrap());
        for (i, p) in cloud.points().map(|p| p.map(f64::from)).enumerate() {
            let in_map = map_from_base * mount * p;
            assert!((in_map.amax() - 5.0).abs() < 2e-6, "{in_map}");
            assert!((p.z / p.norm() - elevations[usize::from(rings[i])].sin()).abs() < 1e-6);
        }
        assert!(times.windows(2).all(|w| w[0] <= w[1]) && times[times.len() - 1] < 0.1);
        assert!(cloud.intensity().unwrap().iter().all(|v| (0.0..=0.5).contains(v)));
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let factory = Factory::generate(FactoryParams::default(), Seed(7)).unwrap();
        let pose = Se3::from_parts(Vector3::new(20.0, 1.5, 1.8), So3::default());
        let twist = Twist3 { linear: Vector3::new(1.0, 0.0, 0.0), angular: Vector3::new(0.0, 0.0, 0.5) };
        let run = |par| {
            let mut lidar = Lidar::new(LidarParams::vlp16(), Seed(1)).unwrap().with_parallelism(par);
            (0..2)
                .map(|_| bits(lidar.scan(factory.world(), &pose, &twist, Stamp::default()).unwrap()))
                .collect::<Vec<_>>()
        };
        let reference = run(Par::Seq);
        assert_ne!(reference[0], reference[1]);
        assert_eq!(run(Par::threads(2)), reference);
        assert_eq!(run(Par::threads(5)), reference);
    }

    /// Turning and driving during the revolution: each point, put back by the motion up to its time, is on a wall.
    #[test]
    fn motion_bends_the_cloud_and_time_mends_it() {
        let mut lidar = Lidar::new(LidarParams::vlp16().ideal(), Seed(0)).unwrap();
        let twist = Twist3 { linear: Vector3::new(3.0, 0.5, 0.0), angular: Vector3::new(0.0, 0.1, 1.5) };
        let cloud = lidar.scan(&box_room(), &Se3::default(), &twist, Stamp::default()).unwrap();
        let off_wall = |p: Vector3<f64>| (p.amax() - 5.0).abs();
        let mut bent: f64 = 0.0;
        for (p, &time) in cloud.points().zip(cloud.time().unwrap()) {
            let p = p.map(f64::from);
            assert!(off_wall(twist.integrate(f64::from(time)) * p) < 1e-5);
            bent = bent.max(off_wall(p));
        }
        assert!(bent > 0.2, "{bent}");
    }

    /// Sum of squared standard scores is chi-square(n), lost returns binomial: within 4.5 sigma.
    #[test]
    fn noise_and_dropouts_have_the_stated_size() {
        let ball = World3d::new(vec![
            Solid::Cylinder { base: Vector3::new(0.0, 0.0, -9.0), radius: 4.0, height: 18.0 }.into(),
        ])
        .unwrap();
        let params = LidarParams {
            elevations: vec![0.0],
            columns: 20_000,
            range_sigma: 0.02,
            dropout: 0.1,
            ..LidarParams::vlp16()
        };
        let mut lidar = Lidar::new(params, Seed(4)).unwrap();
        let cloud = lidar.scan(&ball, &Se3::default(), &Twist3::default(), Stamp::default()).unwrap();
        let n = cloud.len() as f64;
        assert!((n - 18_000.0).abs() < 4.5 * 1800_f64.sqrt(), "{n}");
        let squares: f64 = cloud.points().map(|p| ((f64::from(p.norm()) - 4.0) / 0.02).powi(2)).sum();
        assert!((squares - n).abs() < 4.5 * (2.0 * n).sqrt(), "{squares} of {n}");
    }

    #[test]
    fn bad_sensors_and_poses_are_refused() {
        let good = LidarParams::vlp16;
        for bad in [
            LidarParams { elevations: vec![], ..good() },
            LidarParams { elevations: vec![0.1, 0.1], ..good() },
            LidarParams { elevations: vec![f64::NAN], ..good() },
            LidarParams { elevations: vec![2.0], ..good() },
            LidarParams { columns: 0, ..good() },
            LidarParams { columns: usize::MAX, ..good() },
            LidarParams { period: 0.0, ..good() },
            LidarParams { range_min: 200.0, ..good() },
            LidarParams { range_max: f64::NAN, ..good() },
            LidarParams { range_sigma: -1.0, ..good() },
            LidarParams { dropout: 2.0, ..good() },
            good().with_mount(Se3::from_parts(Vector3::repeat(f64::NAN), So3::default())),
        ] {
            assert!(Lidar::new(bad.clone(), Seed(0)).is_err(), "{bad:?}");
        }
        let mut lidar = Lidar::new(good(), Seed(0)).unwrap();
        let nan = Se3::from_parts(Vector3::repeat(f64::NAN), So3::default());
        assert!(lidar.scan(&box_room(), &nan, &Twist3::default(), Stamp::default()).is_err());
        let spin = Twist3 { angular: Vector3::repeat(f64::INFINITY), ..Twist3::default() };
        assert!(lidar.scan(&box_room(), &Se3::default(), &spin, Stamp::default()).is_err());
        let first = bits(lidar.scan(&box_room(), &Se3::default(), &Twist3::default(), Stamp::default()).unwrap());
        let mut fresh = Lidar::new(good(), Seed(0)).unwrap();
        assert_eq!(
            bits(fresh.scan(&box_room(), &Se3::default(), &Twist3::default(), Stamp::default()).unwrap()),
            first
        );
    }
}
