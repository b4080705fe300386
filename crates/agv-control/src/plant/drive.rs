//! The drive of a vehicle: motor, gear, wheel and the mass that it moves.

use super::expm::{Square, expm};
use super::{ActuatorLimits, LinearPlant, Plant, TransferFunction};
use crate::Error;
use agv_core::{check, sensors::GRAVITY};

/// Parameters of a [`DrivePlant`], with the gear's ratio in them: torques and speeds are those of the wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DriveParams {
    /// Mass of the empty vehicle, in kg.
    pub mass: f64,
    /// Driven wheels, which share the mass.
    pub wheels: u32,
    /// Radius of a wheel, in metres.
    pub wheel_radius: f64,
    /// Moment of inertia of wheel, gear and rotor, in kg m².
    pub wheel_inertia: f64,
    /// Torque per current, in N m/A, which is also the voltage per speed, in V s/rad.
    pub motor_constant: f64,
    /// Resistance of the winding, in ohms.
    pub resistance: f64,
    /// Inductance of the winding, in henries.
    pub inductance: f64,
    /// Viscous friction of a wheel, in N m s/rad.
    pub viscous_friction: f64,
    /// Dry friction of a wheel's bearings and gear, in N m.
    pub dry_friction: f64,
    /// Rolling resistance, as a share of the weight.
    pub rolling_resistance: f64,
    /// Greatest voltage either way.
    pub supply: f64,
}

impl Default for DriveParams {
    /// A 48 V vehicle of 200 kg with two driven wheels of 0.1 m, at most 2 m/s.
    fn default() -> Self {
        Self {
            mass: 200.0,
            wheels: 2,
            wheel_radius: 0.1,
            wheel_inertia: 0.05,
            motor_constant: 2.4,
            resistance: 0.5,
            inductance: 0.001,
            viscous_friction: 0.2,
            dry_friction: 1.0,
            rolling_resistance: 0.01,
            supply: 48.0,
        }
    }
}

impl DriveParams {
    fn validate(&self) -> Result<(), Error> {
        for (name, value) in [
            ("mass", self.mass),
            ("wheel_radius", self.wheel_radius),
            ("motor_constant", self.motor_constant),
            ("resistance", self.resistance),
            ("inductance", self.inductance),
            ("supply", self.supply),
        ] {
            check::positive(name, value)?;
        }
        check::positive("wheels", f64::from(self.wheels))?;
        for (name, value) in [
            ("wheel_inertia", self.wheel_inertia),
            ("viscous_friction", self.viscous_friction),
            ("dry_friction", self.dry_friction),
            ("rolling_resistance", self.rolling_resistance),
        ] {
            check::non_negative(name, value)?;
        }
        Ok(())
    }

    /// Moment of inertia that a wheel sees under a load, in kg m².
    fn inertia(&self, load: f64) -> f64 {
        self.wheel_inertia + (self.mass + load) * self.wheel_radius * self.wheel_radius / f64::from(self.wheels)
    }

    /// Voltage to speed without dry friction and rolling resistance, under a load in kg, behind the supply's limits:
    ///
    /// ```text
    /// G(s) = r k / ((L s + R) (J s + b) + k²)
    /// ```
    ///
    /// # Errors
    /// A parameter out of its range, or a negative load.
    pub fn linear(&self, load: f64) -> Result<LinearPlant, Error> {
        self.validate()?;
        let (j, k) = (self.inertia(check::non_negative("load", load)?), self.motor_constant);
        let (l, r, b) = (self.inductance, self.resistance, self.viscous_friction);
        let g = TransferFunction::new(&[self.wheel_radius * k], &[l * j, r * j + l * b, r * b + k * k])?;
        LinearPlant::new(g)?.with_actuator(ActuatorLimits::symmetric(self.supply))
    }
}

/// The speed of a vehicle under its motors' voltage: winding, inertia of wheel and load, viscous and dry friction, rolling
/// resistance (Krishnan, *Electric Motor Drives*, section 2.3),
///
/// ```text
/// L i' = V - R i - k ω,      J ω' = k i - b ω - T sign ω,      J = J_w + (m + load) r² / wheels
/// ```
///
/// Input is the voltage, output the vehicle's speed `r ω` in m/s. Between changes of the sign of `ω` the step is exact;
/// where the sign changes within a step, the wheel stands at its end, and it stands still until the motor's torque exceeds
/// the friction. The load may change while it drives: current and speed stay.
///
/// ```
/// use agv_control::plant::{DriveParams, DrivePlant, Plant};
///
/// let mut drive = DrivePlant::new(DriveParams::default())?;
/// let after_half_a_second = |drive: &mut DrivePlant| {
///     drive.reset();
///     (0..50).try_for_each(|_| drive.step(24.0, 0.01).map(|_| ())).map(|()| drive.output())
/// };
/// let empty = after_half_a_second(&mut drive)?;
/// drive.set_load(600.0)?;
/// assert!(after_half_a_second(&mut drive)? < 0.9 * empty);
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivePlant {
    params: DriveParams,
    load: f64,
    current: f64,
    wheel_speed: f64,
    rolling: Option<Rolling>,
}

/// One step of a rolling wheel: `next = a [i, ω] + b V + friction T`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rolling {
    dt: f64,
    a: [[f64; 2]; 2],
    voltage: [f64; 2],
    torque: [f64; 2],
    /// The current's own decay, while the wheel stands.
    standing: f64,
}

impl DrivePlant {
    /// A drive at rest, without load.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(params: DriveParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, load: 0.0, current: 0.0, wheel_speed: 0.0, rolling: None })
    }

    /// Load, in kg.
    pub const fn load(&self) -> f64 {
        self.load
    }

    /// Takes another load, in kg.
    ///
    /// # Errors
    /// A negative load, or one that is not finite.
    pub fn set_load(&mut self, load: f64) -> Result<(), Error> {
        self.load = check::non_negative("load", load)?;
        self.rolling = None;
        Ok(())
    }

    /// Dry friction and rolling resistance that a wheel has to overcome, in N m.
    pub fn friction_torque(&self) -> f64 {
        let DriveParams { mass, wheels, wheel_radius, dry_friction, rolling_resistance, .. } = self.params;
        dry_friction + rolling_resistance * (mass + self.load) * GRAVITY * wheel_radius / f64::from(wheels)
    }

    fn rolling(&self, dt: f64) -> Result<Rolling, Error> {
        let DriveParams { motor_constant: k, resistance: r, inductance: l, viscous_friction: b, .. } = self.params;
        let j = self.params.inertia(self.load);
        let mut block = Square::zeros();
        for (at, value) in [
            ((0, 0), -r / l),
            ((0, 1), -k / l),
            ((1, 0), k / j),
            ((1, 1), -b / j),
            ((0, 2), 1.0 / l),
            ((1, 3), 1.0 / j),
        ] {
            block[at] = value * dt;
        }
        let phi = expm(&block).ok_or(Error::Overflow { name: "matrix exponential of the drive" })?;
        Ok(Rolling {
            dt,
            a: [[phi[(0, 0)], phi[(0, 1)]], [phi[(1, 0)], phi[(1, 1)]]],
            voltage: [phi[(0, 2)], phi[(1, 2)]],
            torque: [phi[(0, 3)], phi[(1, 3)]],
            standing: (-r / l * dt).exp(),
        })
    }
}

impl Plant for DrivePlant {
    fn output(&self) -> f64 {
        self.params.wheel_radius * self.wheel_speed
    }

    fn step(&mut self, input: f64, dt: f64) -> Result<f64, Error> {
        check::finite("input", input)?;
        check::positive("dt", dt)?;
        let rolling = match self.rolling {
            Some(rolling) if rolling.dt == dt => rolling,
            _ => self.rolling(dt)?,
        };
        self.rolling = Some(rolling);
        let DriveParams { motor_constant: k, resistance, supply, .. } = self.params;
        let (voltage, friction) = (input.clamp(-supply, supply), self.friction_torque());
        // A wheel that stands rolls off in the direction of the torque that the motor comes to, if that is enough.
        let standing = voltage / resistance + (self.current - voltage / resistance) * rolling.standing;
        let direction = if self.wheel_speed != 0.0 {
            self.wheel_speed.signum()
        } else if (k * standing).abs() > friction {
            standing.signum()
        } else {
            self.current = standing;
            return Ok(0.0);
        };
        let torque = -friction * direction;
        let next = |row: usize| {
            rolling.a[row][0] * self.current
                + rolling.a[row][1] * self.wheel_speed
                + rolling.voltage[row] * voltage
                + rolling.torque[row] * torque
        };
        let (current, wheel_speed) = (next(0), next(1));
        self.current = current;
        self.wheel_speed = if wheel_speed * direction > 0.0 { wheel_speed } else { 0.0 };
        Ok(self.output())
    }

    fn reset(&mut self) {
        (self.current, self.wheel_speed) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frictionless() -> DriveParams {
        DriveParams { dry_friction: 0.0, rolling_resistance: 0.0, ..Default::default() }
    }

    fn run(drive: &mut DrivePlant, steps: usize, voltage: f64) {
        for _ in 0..steps {
            drive.step(voltage, 0.01).unwrap();
        }
    }

    #[test]
    fn without_dry_friction_it_is_its_transfer_function() {
        for load in [0.0, 600.0] {
            let mut drive = DrivePlant::new(frictionless()).unwrap();
            drive.set_load(load).unwrap();
            let mut linear = frictionless().linear(load).unwrap();
            for k in 0..300 {
                let voltage = 20.0 + 40.0 * (0.1 * f64::from(k)).sin().max(-0.4);
                let speeds = [drive.step(voltage, 0.01).unwrap(), linear.step(voltage, 0.01).unwrap()];
                assert!((speeds[0] - speeds[1]).abs() < 1e-10, "{k}: {speeds:?}");
            }
        }
    }

    /// At rest in the end: `k i = b ω + T` and `V = R i + k ω`.
    #[test]
    fn friction_slows_and_holds() {
        let params = DriveParams::default();
        let mut drive = DrivePlant::new(params).unwrap();
        drive.set_load(300.0).unwrap();
        run(&mut drive, 3000, 24.0);
        let (k, r, b) = (params.motor_constant, params.resistance, params.viscous_friction);
        let expected = (24.0 - r * drive.friction_torque() / k) / (k + r * b / k) * params.wheel_radius;
        assert!((drive.output() - expected).abs() < 1e-9);
        // Without voltage it coasts to a stop, and the torque of a small voltage does not move it.
        run(&mut drive, 1000, 0.0);
        assert_eq!(drive.output(), 0.0);
        let holding = 0.99 * r * drive.friction_torque() / k;
        assert!((0..1000).all(|_| drive.step(-holding, 0.01).unwrap() == 0.0));
        assert!((0..1000).any(|_| drive.step(-holding * 1.05, 0.01).unwrap() < 0.0));
    }

    #[test]
    fn a_load_changes_while_it_drives() {
        let mut drive = DrivePlant::new(DriveParams::default()).unwrap();
        run(&mut drive, 100, 24.0);
        let before = drive.output();
        drive.set_load(600.0).unwrap();
        assert_eq!(drive.output(), before);
        assert!(drive.set_load(-1.0).is_err() && drive.set_load(f64::NAN).is_err());
        assert_eq!(drive.load(), 600.0);
    }

    #[test]
    fn bad_input_is_refused_and_changes_nothing() {
        let good = DriveParams::default();
        for params in [
            DriveParams { mass: 0.0, ..good },
            DriveParams { wheels: 0, ..good },
            DriveParams { wheel_radius: -0.1, ..good },
            DriveParams { wheel_inertia: -0.1, ..good },
            DriveParams { motor_constant: f64::NAN, ..good },
            DriveParams { resistance: 0.0, ..good },
            DriveParams { inductance: 0.0, ..good },
            DriveParams { viscous_friction: f64::INFINITY, ..good },
            DriveParams { dry_friction: -1.0, ..good },
            DriveParams { rolling_resistance: f64::NAN, ..good },
            DriveParams { supply: 0.0, ..good },
        ] {
            assert!(DrivePlant::new(params).is_err() && params.linear(0.0).is_err(), "{params:?}");
        }
        let mut drive = DrivePlant::new(good).unwrap();
        let before = drive;
        for (input, dt) in [(f64::NAN, 0.1), (1.0, 0.0), (1.0, -1.0), (1.0, f64::NAN), (1.0, f64::INFINITY), (1.0, 1e9)]
        {
            assert!(drive.step(input, dt).is_err(), "{input} {dt}");
        }
        assert_eq!(drive, before);
    }
}
