//! Marker model: codes on the floor or on walls that tell who they are and how they lie (paper 001, Eq. 14 in its right form).
//!
//! A code that lies at `map_from_marker` and is seen at `base_from_marker` puts the vehicle at one pose, with the covariance
//! of both:
//!
//! ```text
//! d = log(expected⁻¹ pose)          S = Σ_expected + diag(σ_p², σ_p², σ_θ²)
//! p = (1 - o) (2π)^(-3/2) |S|^(-1/2) exp(-dᵀ S⁻¹ d / 2) + o / (2π area)
//! ```
//!
//! The heading is wrapped by the logarithm. A share `o` of the readings is false: a number that was misread, a code that was
//! moved. Without it one of them, far from every particle, would kill the set.

use super::{PoseLikelihood, SensorModel, weigh_per_pose};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose},
    roles::SkipReason,
    sensors::MarkerObservation,
};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Parameters of a [`MarkerModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MarkerModelParams {
    /// Standard deviation that is added along each axis, in metres: how well the codes were laid, and how densely the
    /// particles must stand. Where codes are more exact than that, few particles find themselves right.
    pub position_sigma: f64,
    /// Standard deviation that is added to the heading, in radians.
    pub heading_sigma: f64,
    /// Share of readings that are false, in (0, 1).
    pub outlier: f64,
    /// Area over which those spread, in square metres: the map's.
    pub area: f64,
}

impl Default for MarkerModelParams {
    /// 2 cm and 0.02 rad, where a code itself is good for 5 mm and half a degree (paper 001), which a thousand particles 0.2 m
    /// around resolve; one reading in a hundred is false, anywhere on the paper's map of 10 m by 10 m.
    fn default() -> Self {
        Self { position_sigma: 0.02, heading_sigma: 0.02, outlier: 0.01, area: 100.0 }
    }
}

impl MarkerModelParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A deviation or an area that is not finite and positive, or a share outside (0, 1).
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("position_sigma", self.position_sigma)?;
        check::positive("heading_sigma", self.heading_sigma)?;
        check::open_probability("outlier", self.outlier)?;
        check::positive("area", self.area)?;
        Ok(())
    }
}

/// The marker model, for one reading or for all of one image: `MarkerObservation<Se2>` and `[MarkerObservation<Se2>]`.
///
/// A number that lies in several places is taken for the one that fits best, from each pose by itself.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::sensors::MarkerObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{MarkerModel, MarkerModelParams, PoseLikelihood, SensorModel};
///
/// let codes = [(23, UncertainPose::exact(Se2::new(7.0, 2.0, 0.0)))];
/// let mut model = MarkerModel::new(codes, MarkerModelParams::default())?;
/// let seen = MarkerObservation::new(Stamp::default(), 23, UncertainPose::exact(Se2::new(0.1, 0.0, 0.2)));
/// let judged = model.condition(&seen).expect("a code of the map");
/// let there = Se2::new(7.0, 2.0, 0.0) * Se2::new(0.1, 0.0, 0.2).inverse();
/// # use agv_core::geometry::LieGroup;
/// assert!(judged.log_likelihood(&there) > judged.log_likelihood(&Se2::new(6.9, 2.0, 0.0)));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MarkerModel {
    params: MarkerModelParams,
    /// Sorted by number.
    codes: Arc<Vec<(u32, UncertainPose<Se2>)>>,
    expected: Vec<Expected>,
    readings: usize,
}

/// Where a reading puts the vehicle.
#[derive(Debug, Clone, Copy)]
struct Expected {
    base_from_map: Se2,
    information: Matrix3<f64>,
    /// Density of false readings over the greatest one of true ones.
    floor: f64,
    /// Whether it is the first place of its reading.
    first: bool,
}

/// The 99 % quantile of chi-square with three degrees of freedom: what counts as explained.
const EXPLAINED: f64 = 11.345;

impl MarkerModel {
    /// A model of codes, by number and pose in the map.
    ///
    /// # Errors
    /// Parameters that [`validate`](MarkerModelParams::validate) refuses, or no codes.
    pub fn new(
        codes: impl IntoIterator<Item = (u32, UncertainPose<Se2>)>,
        params: MarkerModelParams,
    ) -> Result<Self, Error> {
        params.validate()?;
        let mut codes: Vec<_> = codes.into_iter().collect();
        if codes.is_empty() {
            return Err(Error::Empty { name: "codes" });
        }
        codes.sort_by_key(|(id, _)| *id);
        Ok(Self { params, codes: Arc::new(codes), expected: Vec::with_capacity(16), readings: 0 })
    }

    /// The parameters.
    pub const fn params(&self) -> &MarkerModelParams {
        &self.params
    }

    /// Takes over the readings whose codes are known.
    fn collect(&mut self, observations: &[MarkerObservation<Se2>]) -> Result<(), SkipReason> {
        self.expected.clear();
        self.readings = 0;
        for seen in observations {
            let start = self.codes.partition_point(|(id, _)| *id < seen.id());
            let known = self.codes[start..].iter().take_while(|(id, _)| *id == seen.id());
            let mut first = true;
            for expected in known.filter_map(|(_, code)| Expected::new(seen, code, &self.params)) {
                self.expected.push(Expected { first, ..expected });
                self.readings += usize::from(first);
                first = false;
            }
        }
        if self.readings == 0 { Err(SkipReason::TooFewReadings { usable: 0, needed: 1 }) } else { Ok(()) }
    }
}

impl Expected {
    /// None for covariances that are beyond numbers.
    fn new(seen: &MarkerObservation<Se2>, code: &UncertainPose<Se2>, params: &MarkerModelParams) -> Option<Self> {
        let expected = seen.map_from_base(code);
        let (place, heading) = (params.position_sigma.powi(2), params.heading_sigma.powi(2));
        let spread = expected.covariance() + Matrix3::from_diagonal(&Vector3::new(place, place, heading));
        let information = Se2::inverse_of(&spread)?;
        // A code that says less than a false one would, as one seen from far, has no greater density.
        let ratio = (TAU.powf(1.5) * spread.determinant().sqrt() / (TAU * params.area)).min(1.0);
        let floor = params.outlier / (1.0 - params.outlier) * ratio;
        let base_from_map = expected.mean().inverse();
        (floor.is_finite() && floor > 0.0).then_some(Self { base_from_map, information, floor, first: true })
    }

    /// Squared distance of a pose, in deviations; infinite for one that is not finite.
    #[inline]
    fn squared(&self, map_from_base: &Se2) -> f64 {
        let off = self.base_from_map.compose(map_from_base).log();
        let squared = off.dot(&(self.information * off));
        if squared.is_nan() { f64::INFINITY } else { squared }
    }
}

/// Readings, ready to judge poses.
struct ReadingsOfCodes<'a> {
    expected: &'a [Expected],
    readings: usize,
}

impl ReadingsOfCodes<'_> {
    /// The least squared distance and the floor of every reading.
    fn for_each_reading(&self, map_from_base: &Se2, mut body: impl FnMut(f64, f64)) {
        let mut rest = self.expected;
        while let Some((first, others)) = rest.split_first() {
            let more = others.iter().take_while(|expected| !expected.first).count();
            let (mut least, mut floor) = (first.squared(map_from_base), first.floor);
            for expected in &others[..more] {
                let squared = expected.squared(map_from_base);
                if squared < least {
                    (least, floor) = (squared, expected.floor);
                }
            }
            body(least, floor);
            rest = &others[more..];
        }
    }
}

impl PoseLikelihood for ReadingsOfCodes<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        let mut sum = 0.0;
        // In terms of the density of a reading that fits exactly.
        self.for_each_reading(map_from_base, |squared, floor| sum += ((-0.5 * squared).exp() + floor).ln());
        sum
    }

    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let mut explained = 0.0;
        self.for_each_reading(map_from_base, |squared, _| explained += f64::from(squared <= EXPLAINED));
        Some(explained / self.readings as f64)
    }
}

impl SensorModel<[MarkerObservation<Se2>]> for MarkerModel {
    fn condition<'a>(
        &'a mut self,
        observations: &'a [MarkerObservation<Se2>],
    ) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        self.collect(observations)?;
        Ok(ReadingsOfCodes { expected: &self.expected, readings: self.readings })
    }

    /// Those of the last observation.
    fn independent_readings(&self) -> f64 {
        self.readings.max(1) as f64
    }
}

impl SensorModel<MarkerObservation<Se2>> for MarkerModel {
    fn condition<'a>(
        &'a mut self,
        observation: &'a MarkerObservation<Se2>,
    ) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        self.collect(std::slice::from_ref(observation))?;
        Ok(ReadingsOfCodes { expected: &self.expected, readings: self.readings })
    }

    /// Those of the last observation.
    fn independent_readings(&self) -> f64 {
        self.readings.max(1) as f64
    }
}

weigh_per_pose!(MarkerModel: [MarkerObservation<Se2>]);
weigh_per_pose!(MarkerModel: MarkerObservation<Se2>);

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::time::Stamp;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn uncertain(x: f64, y: f64, yaw: f64, (place, heading): (f64, f64)) -> UncertainPose<Se2> {
        let variances = Vector3::new(place * place, place * place, heading * heading);
        UncertainPose::new(Se2::new(x, y, yaw), Matrix3::from_diagonal(&variances)).unwrap()
    }

    fn seen(id: u32, x: f64, y: f64, yaw: f64) -> MarkerObservation<Se2> {
        let seen = MarkerObservation::new(Stamp::default(), id, uncertain(x, y, yaw, (0.005, 0.0087)));
        seen.with_mount(Se2::new(0.4, 0.0, PI)).unwrap()
    }

    fn model(codes: &[(u32, UncertainPose<Se2>)]) -> MarkerModel {
        MarkerModel::new(codes.iter().copied(), MarkerModelParams::default()).unwrap()
    }

    proptest! {
        /// Seen without error, the code is likeliest from the true pose, with the weight of Eq. 14 elsewhere.
        #[test]
        fn weighs_as_the_normal_distribution(
            x in -3.0..3.0_f64, y in -3.0..3.0_f64, yaw in -3.1..3.1_f64, turned in -3.1..3.1_f64,
            dx in -0.05..0.05_f64, dy in -0.05..0.05_f64, dyaw in -0.05..0.05_f64,
        ) {
            let code = uncertain(5.0, 2.0, turned, (0.01, 0.01));
            let truth = Se2::new(x, y, yaw);
            let sensor_from_marker = (truth * Se2::new(0.4, 0.0, PI)).inverse() * *code.mean();
            let seen = seen(7, sensor_from_marker.x(), sensor_from_marker.y(), sensor_from_marker.yaw());
            let mut model = model(&[(3, uncertain(0.0, 0.0, 0.0, (0.0, 0.0))), (7, code)]);
            let widen = Matrix3::from_diagonal(&Vector3::repeat(0.02 * 0.02));
            let spread = seen.map_from_base(&code).covariance() + widen;
            let judged = model.condition(&seen).unwrap();
            let off = Vector3::new(dx, dy, dyaw);
            let got = judged.log_likelihood(&truth.plus(&off)) - judged.log_likelihood(&truth);
            let floor = 0.01 / 0.99 * (TAU.powf(1.5) * spread.determinant().sqrt() / (TAU * 100.0)).min(1.0);
            let squared = off.dot(&(spread.try_inverse().unwrap() * off));
            let expected = ((-0.5 * squared).exp() + floor).ln() - (1.0 + floor).ln();
            prop_assert!((got - expected).abs() < 1e-6 * expected.abs().max(1.0), "{} {}", got, expected);
        }
    }

    #[test]
    fn false_codes_and_codes_in_two_places_kill_nobody() {
        let exact = |x: f64| uncertain(x, 0.0, 0.0, (0.0, 0.0));
        let mut model = model(&[(1, exact(0.0)), (1, exact(8.0)), (2, exact(3.0))]);
        let at = |x: f64| Se2::new(x, 0.0, 0.0) * (Se2::new(0.4, 0.0, PI) * Se2::new(0.1, 0.0, PI)).inverse();
        let (one, two) = (seen(1, 0.1, 0.0, PI), seen(2, 0.1, 0.0, PI));
        let judged = model.condition(&one).unwrap();
        let (near, far, wrong) = (at(0.0), at(8.0), at(3.0));
        assert!((judged.log_likelihood(&near) - judged.log_likelihood(&far)).abs() < 1e-9);
        assert!(judged.log_likelihood(&wrong) < judged.log_likelihood(&near) - 5.0);
        assert!(judged.log_likelihood(&wrong).is_finite());
        drop(judged);
        // Two readings that contradict each other: both hypotheses live on, each with half explained.
        let both = [one, two];
        let judged = model.condition(both.as_slice()).unwrap();
        assert!((judged.log_likelihood(&wrong) - judged.log_likelihood(&near)).abs() < 0.1);
        assert_eq!(judged.explained(&wrong), Some(0.5));
        assert!(judged.log_likelihood(&Se2::new(50.0, 0.0, 0.0)) < judged.log_likelihood(&near) - 5.0);
    }

    #[test]
    fn readings_that_say_nothing_are_skipped_and_absurd_poses_stay_finite() {
        let mut model = model(&[(1, uncertain(0.0, 0.0, 0.0, (0.0, 0.0)))]);
        let nothing = Err(SkipReason::TooFewReadings { usable: 0, needed: 1 });
        assert_eq!(SensorModel::<[MarkerObservation<Se2>]>::condition(&mut model, &[]).map(|_| ()), nothing);
        assert_eq!(model.condition(&seen(9, 0.0, 0.0, 0.0)).map(|_| ()), nothing);
        let vague = MarkerObservation::new(Stamp::default(), 1, uncertain(1e5, 0.0, 0.0, (1e5, 1e3)));
        for seen in [seen(1, 0.1, 0.0, 0.0), vague] {
            let judged = model.condition(&seen).unwrap();
            for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 1.0), Se2::new(f64::NAN, 0.0, 0.0)] {
                assert!(judged.log_likelihood(&pose).is_finite(), "{pose:?}");
                assert!(judged.explained(&pose).is_some_and(|share| (0.0..=1.0).contains(&share)));
            }
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = MarkerModelParams::default();
        let codes = || [(1, UncertainPose::exact(Se2::default()))];
        for (name, bad) in [
            ("position_sigma", MarkerModelParams { position_sigma: 0.0, ..good }),
            ("heading_sigma", MarkerModelParams { heading_sigma: f64::NAN, ..good }),
            ("outlier", MarkerModelParams { outlier: 1.0, ..good }),
            ("area", MarkerModelParams { area: -1.0, ..good }),
        ] {
            let error = MarkerModel::new(codes(), bad).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
        assert_eq!(MarkerModel::new([], good).map(|_| ()), Err(Error::Empty { name: "codes" }));
    }
}
