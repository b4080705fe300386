//! Where measurements come from, and how each source is to be taken.

use super::FusionParams;
use crate::kalman::Gate;
use agv_core::{Error, check};
use std::ops::BitOr;

/// Most sources of a filter.
pub(super) const MAX_SOURCES: usize = 12;

/// A source of a [`FusionFilter`](super::FusionFilter), as it numbered it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct SourceId(pub(super) u8);

impl SourceId {
    /// Its place among the sources, in the order in which they were added.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// The numbers of a measurement that count: a mask.
///
/// ```
/// use agv_filters::fusion::Components;
///
/// let wheels_of_a_differential_drive = Components::VX | Components::YAW_RATE;
/// assert!(wheels_of_a_differential_drive.contains(Components::VX));
/// assert!(!wheels_of_a_differential_drive.contains(Components::VY));
/// assert_eq!(Components::TWIST, Components::VX | Components::VY | Components::YAW_RATE);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Components(u8);

impl Components {
    /// Position along the x axis: of the map, or for motions of the base where they began.
    pub const X: Self = Self(1);
    /// Position along the y axis of the same.
    pub const Y: Self = Self(1 << 1);
    /// Heading, or turn.
    pub const YAW: Self = Self(1 << 2);
    /// Velocity along the x axis of the sensor.
    pub const VX: Self = Self(1 << 3);
    /// Velocity along the y axis of the sensor.
    pub const VY: Self = Self(1 << 4);
    /// Turn rate.
    pub const YAW_RATE: Self = Self(1 << 5);
    /// Acceleration along the x axis of the base.
    pub const AX: Self = Self(1 << 6);
    /// Acceleration along the y axis of the base.
    pub const AY: Self = Self(1 << 7);
    /// Both coordinates.
    pub const POSITION: Self = Self(0b11);
    /// Position and heading.
    pub const POSE: Self = Self(0b111);
    /// All velocities.
    pub const TWIST: Self = Self(0b11_1000);
    /// Both accelerations.
    pub const ACCELERATION: Self = Self(0b1100_0000);
    /// All but accelerations.
    pub const KINEMATIC: Self = Self(0b11_1111);

    /// Whether all of `others` are among these.
    pub const fn contains(self, others: Self) -> bool {
        self.0 & others.0 == others.0
    }

    /// Whether each of some numbers is among these.
    pub(super) fn among<const K: usize>(self, numbers: [Self; K]) -> [bool; K] {
        numbers.map(|number| self.contains(number))
    }
}

impl BitOr for Components {
    type Output = Self;

    fn bitor(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }
}

/// What the poses and headings of a source refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Reference {
    /// The map: AMCL, NDT, floor codes.
    #[default]
    Map,
    /// The measurement before: what counts is the motion between two of them, whose error is that of a motion
    /// ([`MotionNoise`]; of headings, what they state). For odometry, which drifts, in either form (increments, or poses in a frame of its own).
    Previous,
    /// The first measurement, in a frame of the sensor's own, whose place in the map is estimated with the rest: for a tracking
    /// system that nobody has aligned with the map, or an attitude that counts from where it was switched on.
    First,
}

/// How uncertain a measured motion is, beside what it states of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionNoise {
    /// Variance along each axis per metre driven, in m²/m.
    pub position_per_metre: f64,
    /// Variance of the heading per metre driven, in rad²/m.
    pub yaw_per_metre: f64,
    /// Variance of the heading per radian turned, in rad²/rad.
    pub yaw_per_radian: f64,
    /// Variance along each axis per radian turned, in m²/rad.
    pub position_per_radian: f64,
}

impl MotionNoise {
    /// A motion that errs as it says.
    pub const NONE: Self =
        Self { position_per_metre: 0.0, yaw_per_metre: 0.0, yaw_per_radian: 0.0, position_per_radian: 0.0 };
}

impl Default for MotionNoise {
    /// Wheels on a hard floor: 3 mm and 0.2° after a metre ([`PoseFilterParams`](crate::kalman::PoseFilterParams) has the
    /// same), and 1 mm after a radian.
    fn default() -> Self {
        Self { position_per_metre: 1e-5, yaw_per_metre: 1e-5, yaw_per_radian: 1e-5, position_per_radian: 1e-6 }
    }
}

/// Standard deviations that are added to what a measurement states of itself, in quadrature. Of a driver that states none
/// (covariances of zero) they are all that there is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NoiseFloor {
    /// Of a position along each axis, in metres.
    pub position: f64,
    /// Of a heading, in radians.
    pub yaw: f64,
    /// Of a velocity along each axis, in m/s.
    pub velocity: f64,
    /// Of a turn rate, in rad/s.
    pub yaw_rate: f64,
    /// Of an acceleration along each axis, in m/s².
    pub acceleration: f64,
}

/// How a source is to be taken.
///
/// Start from the constructor that fits, and change what differs:
///
/// ```
/// use agv_filters::fusion::{Components, Reference, SourceParams};
///
/// // A unit whose heading counts from where it was switched on, and whose rate is not to be used.
/// let attitude = SourceParams {
///     components: Components::YAW,
///     reference: Reference::First,
///     ..SourceParams::imu()
/// };
/// assert_eq!(attitude.gate, 0.9999);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SourceParams {
    /// Which numbers of its measurements count.
    pub components: Components,
    /// What its poses and headings refer to.
    pub reference: Reference,
    /// What is added to the noise that it states.
    pub floor: NoiseFloor,
    /// Noise of its motions.
    pub motion: MotionNoise,
    /// Whether its motions and velocities are those of wheels, which misread by the scales that the filter estimates.
    pub scaled: bool,
    /// Probability with which a sound measurement passes the gate; one opens it.
    pub gate: f64,
    /// So many measurements in a row are gated before one is taken in all the same, for it is the belief that must be wrong;
    /// zero for never.
    pub gate_patience: u32,
    /// How much older its measurements are than their stamps say, in seconds.
    pub latency: f64,
    /// Whether its latency is not known to the end: what its poses and places in the map are older than `latency` says is estimated
    /// ([`FusionParams::latency_sigma`]). For one source whose [`Reference`] is the map.
    pub late: bool,
    /// After so many seconds without a measurement it counts as silent.
    pub timeout: f64,
}

impl SourceParams {
    /// Poses in the map, by a localizer or a code.
    pub fn pose() -> Self {
        Self {
            components: Components::KINEMATIC,
            reference: Reference::Map,
            floor: NoiseFloor { position: 1e-3, yaw: 1e-3, velocity: 1e-3, yaw_rate: 1e-3, acceleration: 1e-2 },
            motion: MotionNoise::NONE,
            scaled: false,
            gate: 0.9999,
            gate_patience: 0,
            latency: 0.0,
            late: false,
            timeout: 1.0,
        }
    }

    /// Places in the map, without headings.
    pub fn position() -> Self {
        Self::pose()
    }

    /// Wheel odometry: motions or velocities, of which a standing vehicle's are certain to a hundredth of a millimetre.
    pub fn wheels() -> Self {
        Self {
            reference: Reference::Previous,
            floor: NoiseFloor { position: 1e-5, yaw: 1e-5, ..Self::pose().floor },
            motion: MotionNoise::default(),
            scaled: true,
            timeout: 0.2,
            ..Self::pose()
        }
    }

    /// An inertial unit's turn rate, and its heading if it has one that refers to the map; for its accelerations add
    /// [`Components::ACCELERATION`], and a [`MotionParams::acceleration`](super::MotionParams::acceleration) to estimate.
    pub fn imu() -> Self {
        Self { timeout: 0.2, ..Self::pose() }
    }

    /// Velocities, by a radar or a flow sensor.
    pub fn velocity() -> Self {
        Self { timeout: 0.2, ..Self::pose() }
    }

    fn passing(&self) -> Result<Gate, Error> {
        if self.gate == 1.0 { Ok(Gate::OPEN) } else { Gate::at_probability(self.gate) }
    }

    pub(super) fn validate(&self, filter: &FusionParams) -> Result<(), Error> {
        let NoiseFloor { position, yaw, velocity, yaw_rate, acceleration } = self.floor;
        for (name, sigma) in [
            ("position floor", position),
            ("yaw floor", yaw),
            ("velocity floor", velocity),
            ("yaw_rate floor", yaw_rate),
            ("acceleration floor", acceleration),
        ] {
            check::in_range(name, sigma, 0.0, 1e6)?;
        }
        for (name, variance) in [
            ("position_per_metre", self.motion.position_per_metre),
            ("yaw_per_metre", self.motion.yaw_per_metre),
            ("yaw_per_radian", self.motion.yaw_per_radian),
            ("position_per_radian", self.motion.position_per_radian),
        ] {
            check::in_range(name, variance, 0.0, 1e6)?;
        }
        check::in_range("gate", self.gate, f64::MIN_POSITIVE, 1.0)?;
        check::in_range("latency", self.latency, -1e3, 1e3)?;
        check::positive("timeout", self.timeout)?;
        if self.late && self.reference != Reference::Map {
            return Err(Error::Empty { name: "map that a late source refers to" });
        }
        // Only poses and places are led back to when they were measured.
        if self.late && !self.components.among([Components::X, Components::Y]).contains(&true) {
            return Err(Error::Empty { name: "position that a late source measures" });
        }
        // Accelerations that are not estimated cannot be corrected.
        let accelerates = self.components.among([Components::AX, Components::AY]).contains(&true);
        if accelerates && filter.motion.acceleration.is_none() {
            return Err(Error::Empty { name: "acceleration of the motion" });
        }
        Ok(())
    }
}

/// A source with what is worked out once.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSource"))]
pub(super) struct Source {
    pub(super) params: SourceParams,
    /// Its anchor, if its poses refer to one another.
    pub(super) slot: Option<u8>,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    pub(super) gate: Gate,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSource {
    params: SourceParams,
    slot: Option<u8>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawSource> for Source {
    type Error = Error;

    fn try_from(raw: RawSource) -> Result<Self, Error> {
        Ok(Self { params: raw.params, slot: raw.slot, gate: raw.params.passing()? })
    }
}

impl Source {
    /// Whether its poses refer to one another, so that it needs an anchor.
    #[cfg(feature = "serde")]
    pub(super) fn refers(&self) -> bool {
        self.params.reference != Reference::Map
    }

    pub(super) fn new(params: SourceParams, slot: Option<u8>, filter: &FusionParams) -> Result<Self, Error> {
        params.validate(filter)?;
        Ok(Self { params, slot, gate: params.passing()? })
    }
}
