//! The box that is searched, and how evenly: a scale for each coordinate.

use agv_core::{Error, check};

/// How a coordinate is spread over its interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Scale {
    /// Evenly: `lower + (upper - lower) u`.
    #[default]
    Linear,
    /// Each decade alike: `lower (upper / lower)^u`. The interval must be positive.
    Log,
    /// Denser towards the lower end: `lower + (upper - lower) u^p`. Unlike decades it reaches a lower end of zero, which
    /// is a gain that is switched off.
    Power(f64),
}

/// The values that a coordinate may take.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Interval {
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// How values are spread between the two.
    pub scale: Scale,
}

impl Interval {
    /// An interval that is searched evenly.
    pub const fn linear(lower: f64, upper: f64) -> Self {
        Self { lower, upper, scale: Scale::Linear }
    }

    /// A positive interval whose decades are searched alike.
    pub const fn log(lower: f64, upper: f64) -> Self {
        Self { lower, upper, scale: Scale::Log }
    }

    /// A gain between zero and `upper`: [`Scale::Power`] with exponent three, under which half of the search goes to the
    /// lowest eighth, and a tenth to the lowest thousandth.
    pub const fn gain(upper: f64) -> Self {
        Self { lower: 0.0, upper, scale: Scale::Power(3.0) }
    }

    fn check(&self) -> Result<(), Error> {
        let &Self { lower, upper, scale } = self;
        check::finite("lower", lower)?;
        check::finite("upper", upper)?;
        check::positive("upper - lower", upper - lower)?;
        match scale {
            Scale::Linear => {}
            Scale::Log => {
                check::positive("lower of a logarithmic scale", lower)?;
            }
            Scale::Power(exponent) => {
                check::positive("exponent of a power scale", exponent)?;
            }
        }
        Ok(())
    }

    /// The value at `unit` in `[0, 1]`, always within the interval.
    fn value(&self, unit: f64) -> f64 {
        let &Self { lower, upper, scale } = self;
        let unit = unit.clamp(0.0, 1.0);
        let value = match scale {
            Scale::Linear => lower + (upper - lower) * unit,
            Scale::Log => lower * (upper / lower).powf(unit),
            // By products, which are faster than `powf` and the same on every platform.
            Scale::Power(3.0) => lower + (upper - lower) * (unit * unit * unit),
            Scale::Power(2.0) => lower + (upper - lower) * (unit * unit),
            Scale::Power(exponent) => lower + (upper - lower) * unit.powf(exponent),
        };
        value.clamp(lower, upper)
    }

    /// Where in `[0, 1]` a value lies; values outside of the interval lie at its ends.
    fn unit(&self, value: f64) -> f64 {
        let &Self { lower, upper, scale } = self;
        let value = value.clamp(lower, upper);
        let unit = match scale {
            Scale::Linear => (value - lower) / (upper - lower),
            Scale::Log => (value / lower).ln() / (upper / lower).ln(),
            Scale::Power(exponent) => ((value - lower) / (upper - lower)).powf(exponent.recip()),
        };
        unit.clamp(0.0, 1.0)
    }
}

/// A box in the user's units, with a scale for each coordinate.
///
/// ```
/// use agv_control::optimize::{Interval, SearchSpace};
///
/// let gains = SearchSpace::new(vec![Interval::gain(50.0), Interval::log(0.01, 100.0)])?;
/// let mut point = [0.0; 2];
/// gains.values_into(&[0.5, 0.5], &mut point);
/// assert!((point[0] - 6.25).abs() < 1e-12 && (point[1] - 1.0).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "Vec<Interval>", into = "Vec<Interval>")
)]
pub struct SearchSpace {
    intervals: Vec<Interval>,
}

impl TryFrom<Vec<Interval>> for SearchSpace {
    type Error = Error;

    fn try_from(intervals: Vec<Interval>) -> Result<Self, Error> {
        Self::new(intervals)
    }
}

impl From<SearchSpace> for Vec<Interval> {
    fn from(space: SearchSpace) -> Self {
        space.intervals
    }
}

impl SearchSpace {
    /// Checks the intervals once.
    ///
    /// # Errors
    /// No interval; an end that is not finite; ends in reverse order or equal; a logarithmic scale that reaches zero; an
    /// exponent that is not positive.
    pub fn new(intervals: Vec<Interval>) -> Result<Self, Error> {
        check::at_least("search space", intervals.len(), 1)?;
        intervals.iter().try_for_each(Interval::check)?;
        Ok(Self { intervals })
    }

    /// The same even interval for each of `dimension` coordinates.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn cube(dimension: usize, lower: f64, upper: f64) -> Result<Self, Error> {
        Self::new(vec![Interval::linear(lower, upper); dimension])
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.intervals.len()
    }

    /// The intervals, one for each coordinate.
    pub fn intervals(&self) -> &[Interval] {
        &self.intervals
    }

    /// Maps points of the unit cube, one after another, to values. Both slices hold the same number of coordinates;
    /// what one has more is left alone.
    pub fn values_into(&self, units: &[f64], values: &mut [f64]) {
        for ((value, &unit), interval) in values.iter_mut().zip(units).zip(self.intervals.iter().cycle()) {
            *value = interval.value(unit);
        }
    }

    /// Maps values to points of the unit cube: the inverse of [`values_into`](Self::values_into).
    pub fn units_into(&self, values: &[f64], units: &mut [f64]) {
        for ((unit, &value), interval) in units.iter_mut().zip(values).zip(self.intervals.iter().cycle()) {
            *unit = interval.unit(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn intervals() -> Vec<Interval> {
        vec![
            Interval::linear(-2.0, 5.0),
            Interval::log(1e-3, 1e2),
            Interval::gain(50.0),
            Interval { lower: -1.0, upper: 3.0, scale: Scale::Power(1.7) },
        ]
    }

    proptest! {
        #[test]
        fn values_stay_inside_grow_and_come_back(units in prop::array::uniform4(0.0..=1.0_f64), step in 1e-3..1.0_f64) {
            let space = SearchSpace::new(intervals()).unwrap();
            let (mut values, mut back, mut more) = ([0.0; 4], [0.0; 4], [0.0; 4]);
            space.values_into(&units, &mut values);
            space.units_into(&values, &mut back);
            space.values_into(&units.map(|u| (u + step).min(1.0)), &mut more);
            for (d, interval) in intervals().iter().enumerate() {
                prop_assert!((interval.lower..=interval.upper).contains(&values[d]));
                prop_assert!((back[d] - units[d]).abs() < 1e-4, "{:?}: {} became {}", interval, units[d], back[d]);
                prop_assert!(more[d] >= values[d]);
            }
        }
    }

    #[test]
    fn ends_are_met_exactly_and_the_outside_is_the_end() {
        let space = SearchSpace::new(intervals()).unwrap();
        let mut values = [0.0; 8];
        space.values_into(&[0.0, 0.0, 0.0, 0.0, 7.0, 1.0, 1.0, 1.0], &mut values);
        assert_eq!(values, [-2.0, 1e-3, 0.0, -1.0, 5.0, 1e2, 50.0, 3.0]);
        let mut units = [0.5; 4];
        space.units_into(&[-9.0, 1e9, -1.0, 9.0], &mut units);
        assert_eq!(units, [0.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn bad_intervals_are_named() {
        for (name, interval) in [
            ("upper - lower", Interval::linear(1.0, -1.0)),
            ("upper - lower", Interval::linear(1.0, 1.0)),
            ("upper - lower", Interval::linear(f64::MIN, f64::MAX)),
            ("lower", Interval::linear(f64::NAN, 1.0)),
            ("upper", Interval::linear(0.0, f64::INFINITY)),
            ("lower of a logarithmic", Interval::log(0.0, 1.0)),
            ("exponent", Interval { scale: Scale::Power(0.0), ..Interval::gain(1.0) }),
            ("exponent", Interval { scale: Scale::Power(f64::NAN), ..Interval::gain(1.0) }),
        ] {
            let error = SearchSpace::new(vec![Interval::gain(1.0), interval]).unwrap_err();
            assert!(error.to_string().starts_with(name), "{name}: {error}");
        }
        assert!(SearchSpace::new(vec![]).is_err() && SearchSpace::cube(0, 0.0, 1.0).is_err());
    }
}
