//! One component of a motion in one time step: where it should go, and where it can.

/// Rounding up to which a component counts as within its limit, in m/s and rad/s.
pub(super) const TOLERANCE: f64 = 1e-12;

/// One component of a step: where it should go, and where it can.
#[derive(Clone, Copy)]
pub(super) struct Axis {
    pub(super) target: f64,
    /// Least and greatest value in reach, in this order.
    pub(super) least: f64,
    pub(super) greatest: f64,
    /// Least and greatest speed that is allowed.
    speed: (f64, f64),
}

impl Axis {
    pub(super) fn new(
        target: f64,
        current: f64,
        acceleration: f64,
        deceleration: f64,
        dt: f64,
        speed: (f64, f64),
    ) -> Self {
        let greatest = rise(current, acceleration, deceleration, dt);
        let least = -rise(-current, acceleration, deceleration, dt);
        // Acceleration wins over speed where the two contradict: a vehicle cannot jump.
        Self { target, least: least.max(speed.0.min(greatest)), greatest: greatest.min(speed.1.max(least)), speed }
    }

    pub(super) fn keeps_speed(&self) -> bool {
        self.target >= self.speed.0 - TOLERANCE && self.target <= self.speed.1 + TOLERANCE
    }

    pub(super) fn reaches_target(&self) -> bool {
        self.target >= self.least - TOLERANCE && self.target <= self.greatest + TOLERANCE
    }

    /// The value in reach that is nearest to a wanted one.
    #[inline]
    pub(super) const fn nearest(&self, wanted: f64) -> f64 {
        wanted.clamp(self.least, self.greatest)
    }

    /// The least magnitude in reach, with its sign.
    #[inline]
    pub(super) const fn slowest(&self) -> f64 {
        self.nearest(0.0)
    }

    /// The multiples of `along` that lie in reach, as an interval that may be empty.
    pub(super) fn multiples(&self, along: f64) -> (f64, f64) {
        if along > 0.0 {
            (self.least / along, self.greatest / along)
        } else if along < 0.0 {
            (self.greatest / along, self.least / along)
        } else if self.least <= TOLERANCE && self.greatest >= -TOLERANCE {
            (f64::NEG_INFINITY, f64::INFINITY)
        } else {
            (1.0, 0.0)
        }
    }
}

/// Greatest value that one component of a motion has after `dt` seconds: a negative one brakes first, then accelerates. The least
/// is `-rise(-current, ..)`.
///
/// ```
/// use agv_core::kinematics::rise;
///
/// // Reversing at 0.2 m/s, braking at 1 m/s²: half of 0.4 s until rest, the other half accelerates at 0.5 m/s².
/// assert!((rise(-0.2, 0.5, 1.0, 0.4) - 0.1).abs() < 1e-12);
/// assert!((-rise(0.2, 0.5, 1.0, 0.4) + 0.4).abs() < 1e-12);
/// ```
#[inline]
pub fn rise(current: f64, acceleration: f64, deceleration: f64, dt: f64) -> f64 {
    if current >= 0.0 {
        return current + acceleration * dt;
    }
    let braked = current + deceleration * dt;
    if braked <= 0.0 { braked } else { braked / deceleration * acceleration }
}

/// One component of a motion after `dt` seconds on the way to a target, as near to it as the accelerations allow.
///
/// ```
/// use agv_core::kinematics::approach;
///
/// assert_eq!(approach(0.5, 2.0, 1.0, 2.0, 0.25), 0.75);
/// assert_eq!(approach(0.5, 0.4, 1.0, 2.0, 0.25), 0.4);
/// ```
#[inline]
pub fn approach(current: f64, target: f64, acceleration: f64, deceleration: f64, dt: f64) -> f64 {
    let least = -rise(-current, acceleration, deceleration, dt);
    target.max(least).min(rise(current, acceleration, deceleration, dt))
}
