//! A vehicle beside a straight path.

use super::{ActuatorLimits, Plant};
use crate::Error;
use agv_core::check;

/// Parameters of a [`CrossTrackPlant`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CrossTrackParams {
    /// Speed along the vehicle, in m/s; negative backwards.
    pub speed: f64,
    /// Time constant with which the yaw rate follows its command, in seconds; zero for none.
    pub yaw_lag: f64,
    /// Curvature of the path, in 1/m, positive to the left.
    pub curvature: f64,
    /// Limits of the yaw rate, in rad/s and rad/s².
    pub yaw_rate: ActuatorLimits,
}

impl Default for CrossTrackParams {
    /// The vehicle of the stand-in [`P2`](super::StandIn::P2): 0.5 m/s, a lag of 0.15 s, at most 0.3 rad/s.
    fn default() -> Self {
        Self { speed: 0.5, yaw_lag: 0.15, curvature: 0.0, yaw_rate: ActuatorLimits::symmetric(0.3) }
    }
}

/// Error dynamics of a vehicle on a path (Rajamani, *Vehicle Dynamics and Control*, chapter 3; kinematic, for a
/// differential drive): with the distance `y` to the left of the path and the heading `θ` relative to it,
///
/// ```text
/// y' = v sin θ,      θ' = ω - κ v cos θ / (1 - κ y),      Tω ω' = ω_commanded - ω
/// ```
///
/// Input is the commanded yaw rate, output the distance `y`. The actuator is exact at the samples, and on a straight
/// path the heading too; the distance is a Gauss quadrature of degree five. For small angles it is the transfer function
/// `v / (s² (Tω s + 1))`.
///
/// ```
/// use agv_control::plant::{CrossTrackParams, CrossTrackPlant, Plant};
///
/// let mut vehicle = CrossTrackPlant::new(CrossTrackParams { yaw_lag: 0.0, ..CrossTrackParams::default() })?;
/// vehicle.step(0.2, 1.0)?; // an arc of radius 2.5 m
/// assert!((vehicle.output() - 2.5 * (1.0 - 0.2_f64.cos())).abs() < 1e-9);
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossTrackPlant {
    params: CrossTrackParams,
    command: f64,
    yaw_rate: f64,
    heading: f64,
    distance: f64,
}

impl CrossTrackPlant {
    /// A vehicle on the path.
    ///
    /// # Errors
    /// A parameter that is not finite, a negative lag, or limits as [`ActuatorLimits::validate`] refuses them.
    pub fn new(params: CrossTrackParams) -> Result<Self, Error> {
        check::finite("speed", params.speed)?;
        check::non_negative("yaw_lag", params.yaw_lag)?;
        check::finite("curvature", params.curvature)?;
        params.yaw_rate.validate()?;
        Ok(Self { params, command: 0.0, yaw_rate: 0.0, heading: 0.0, distance: 0.0 })
    }

    /// Heading relative to the path, in radians; it is not wrapped.
    pub const fn heading(&self) -> f64 {
        self.heading
    }

    /// Yaw rate, in rad/s.
    pub const fn yaw_rate(&self) -> f64 {
        self.yaw_rate
    }

    /// Puts the vehicle beside the path, in metres and radians; its yaw rate stays.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn place(&mut self, distance: f64, heading: f64) -> Result<(), Error> {
        check::finite("distance", distance)?;
        check::finite("heading", heading)?;
        (self.distance, self.heading) = (distance, heading);
        Ok(())
    }

    /// Takes a new speed, in m/s.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_speed(&mut self, speed: f64) -> Result<(), Error> {
        self.params.speed = check::finite("speed", speed)?;
        Ok(())
    }

    /// The turn of the path's direction below the vehicle, per second.
    fn path_rate(&self, distance: f64, heading: f64) -> f64 {
        let CrossTrackParams { speed, curvature, .. } = self.params;
        curvature * speed * heading.cos() / (1.0 - curvature * distance)
    }
}

impl Plant for CrossTrackPlant {
    fn output(&self) -> f64 {
        self.distance
    }

    /// # Errors
    /// Also a vehicle that comes to the centre of the path's curvature, where the nearest point is not one.
    fn step(&mut self, input: f64, dt: f64) -> Result<f64, Error> {
        check::finite("input", input)?;
        check::positive("dt", dt)?;
        let CrossTrackParams { speed, yaw_lag, curvature, yaw_rate: limits } = self.params;
        let command = limits.apply(input, self.command, dt);
        // What the actuator has turned after t seconds: command t + (ω - command) Tω (1 - exp(-t / Tω)).
        let lead = self.yaw_rate - command;
        let turned = |t: f64| command * t - if yaw_lag > 0.0 { lead * yaw_lag * (-t / yaw_lag).exp_m1() } else { 0.0 };
        // A midpoint step for the path's own turn, which is slow.
        let halfway = self.heading + turned(0.5 * dt) - 0.5 * dt * self.path_rate(self.distance, self.heading);
        let path_rate = self.path_rate(self.distance + 0.5 * dt * speed * self.heading.sin(), halfway);
        let heading = |t: f64| self.heading + turned(t) - path_rate * t;
        // Gauss-Legendre with three nodes.
        let offset = 0.5 * 0.6_f64.sqrt();
        let mean = (5.0 * (heading((0.5 - offset) * dt).sin() + heading((0.5 + offset) * dt).sin())
            + 8.0 * heading(0.5 * dt).sin())
            / 18.0;
        let (distance, heading) = (self.distance + speed * dt * mean, heading(dt));
        check::in_range("curvature * distance", curvature * distance, -f64::MAX, 1.0 - f64::EPSILON)?;
        if !distance.is_finite() || !heading.is_finite() {
            return Err(Error::Overflow { name: "distance beside the path" });
        }
        self.yaw_rate = command + if yaw_lag > 0.0 { lead * (-dt / yaw_lag).exp() } else { 0.0 };
        (self.command, self.distance, self.heading) = (command, distance, heading);
        Ok(distance)
    }

    fn reset(&mut self) {
        (self.command, self.yaw_rate, self.heading, self.distance) = (0.0, 0.0, 0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::StandIn;

    #[test]
    fn for_small_angles_it_is_the_stand_in() {
        let (mut vehicle, mut linear) =
            (CrossTrackPlant::new(CrossTrackParams::default()).unwrap(), StandIn::P2.plant().unwrap());
        for k in 0..200 {
            let command = 0.01 * (0.05 * f64::from(k)).sin();
            let outputs = [vehicle.step(command, 0.02).unwrap(), linear.step(command, 0.02).unwrap()];
            assert!((outputs[0] - outputs[1]).abs() <= 1e-3 * outputs[1].abs(), "{k}: {outputs:?}");
        }
        assert!(vehicle.output() > 1e-3);
    }

    /// One long step against many short ones, on a bend, with everything moving.
    #[test]
    fn long_steps_end_where_short_ones_do() {
        let params = CrossTrackParams { speed: 1.0, curvature: 0.2, ..Default::default() };
        let run = |steps: u32| {
            let mut vehicle = CrossTrackPlant::new(params).unwrap();
            vehicle.place(0.3, -0.4).unwrap();
            for _ in 0..steps {
                vehicle.step(0.25, 2.0 / f64::from(steps)).unwrap();
            }
            vehicle
        };
        let (long, short) = (run(40), run(4000));
        assert!((long.output() - short.output()).abs() < 1e-4, "{long:?} {short:?}");
        assert!((long.heading() - short.heading()).abs() < 1e-4);
        assert!((long.yaw_rate() - 0.25 * (1.0 - (-2.0_f64 / 0.15).exp())).abs() < 1e-12);
    }

    #[test]
    fn a_vehicle_that_turns_with_the_path_stays_on_it() {
        let params = CrossTrackParams { yaw_lag: 0.0, curvature: 0.5, ..Default::default() };
        let mut vehicle = CrossTrackPlant::new(params).unwrap();
        for _ in 0..100 {
            assert!(vehicle.step(0.25, 0.02).unwrap().abs() < 1e-12);
        }
    }

    #[test]
    fn bad_input_is_refused_and_changes_nothing() {
        let good = CrossTrackParams::default();
        for params in [
            CrossTrackParams { speed: f64::NAN, ..good },
            CrossTrackParams { yaw_lag: -0.1, ..good },
            CrossTrackParams { curvature: f64::INFINITY, ..good },
            CrossTrackParams { yaw_rate: ActuatorLimits { min: 0.1, max: 1.0, rate: 1.0 }, ..good },
        ] {
            assert!(CrossTrackPlant::new(params).is_err(), "{params:?}");
        }
        let mut vehicle = CrossTrackPlant::new(CrossTrackParams { curvature: 1.0, ..good }).unwrap();
        let before = vehicle;
        for (input, dt) in [(f64::NAN, 0.1), (0.0, 0.0), (0.0, -1.0), (0.0, f64::NAN), (0.0, f64::INFINITY)] {
            assert!(vehicle.step(input, dt).is_err(), "{input} {dt}");
        }
        assert!(vehicle.place(f64::NAN, 0.0).is_err() && vehicle.set_speed(f64::NAN).is_err());
        assert_eq!(vehicle, before);
        vehicle.place(0.99, 1.5).unwrap();
        assert!(vehicle.step(0.3, 1.0).is_err(), "beyond the centre of the bend");
    }
}
