//! The pose of a vehicle from the landmarks that it sees by range and bearing, two or more.
//!
//! A reading is a point of the base frame, so two of them and their places in the map fix the pose without a guess: where
//! ranges alone would leave two positions, mirror images in the line through both places, the bearings say which. From there
//! Levenberg–Marquardt minimises the residuals in range and bearing,
//!
//! ```text
//! rᵢ = (|sᵢ| - ρᵢ, wrap(atan2(sᵢ) - φᵢ)),        sᵢ the place of landmark i in the sensor's frame at the pose
//! ```
//!
//! weighted by the inverse of `Rᵢ + Hᵢ Mᵢ Hᵢᵀ`, the covariances of the reading and of the place in the map. If the residuals are
//! more than chance allows, every pair of landmarks proposes a pose, and the one that most landmarks agree with decides who is
//! left out.

use super::rigid_fit::rigid_motion;
use crate::landmark::View;
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose, UncertainVector, wrap_angle},
    sensors::LandmarkObservation,
    solve::{LeastSquares, LevenbergMarquardt, LevenbergMarquardtParams, NormalEquations},
};
use nalgebra::{Matrix2, Matrix2x3, SVector, Vector2};

/// Most landmarks that are looked at.
pub const MOST_LANDMARKS: usize = 32;

/// Least distance of a landmark from the sensor that has a direction, in metres.
const NEAREST: f64 = 1e-6;

/// A landmark that was seen, and where it is known to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLandmark {
    /// The reading.
    pub observation: LandmarkObservation,
    /// Place in the map, in metres, with its covariance in map axes.
    pub place: UncertainVector<2>,
}

/// A pose that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkFix {
    /// Pose of the vehicle in the map.
    pub map_from_base: UncertainPose<Se2>,
    /// Squared residuals of the landmarks that were used: chi-square of `2 used - 3` degrees of freedom.
    pub chi_square: f64,
    /// How many landmarks agree with it.
    pub used: usize,
    /// Which of the landmarks do, bit by bit in the order in which they were given.
    pub used_mask: u32,
}

/// How a landmark of the fit is weighted: the reading, the place, and the whitening `L⁻¹` of their covariance `L Lᵀ`.
#[derive(Debug, Clone, Copy)]
struct Weighted {
    sensor: Se2,
    place: Vector2<f64>,
    reading: Vector2<f64>,
    whiten: Matrix2<f64>,
}

impl Weighted {
    /// Range and bearing that a vehicle at the pose would read, their Jacobians by the pose's right increment and by the
    /// place; none on top of the landmark.
    fn predicted(&self, map_from_base: &Se2) -> Option<(Vector2<f64>, Matrix2x3<f64>, Matrix2<f64>)> {
        let view = View::of(map_from_base, &self.sensor, &self.place);
        let distance = view.distance();
        if distance < NEAREST {
            return None;
        }
        let polar = view.polar_by_seen();
        let turn = (*map_from_base * self.sensor).rotation();
        let by_place = polar * Matrix2::new(turn.cos(), turn.sin(), -turn.sin(), turn.cos());
        Some((Vector2::new(distance, view.bearing()), polar * view.by_pose, by_place))
    }

    /// The whitened residual and its Jacobian.
    fn residual(&self, map_from_base: &Se2) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let (predicted, by_pose, _) = self.predicted(map_from_base)?;
        let difference = predicted - self.reading;
        let wrapped = Vector2::new(difference.x, wrap_angle(difference.y));
        Some((self.whiten * wrapped, self.whiten * by_pose))
    }
}

/// A subset of the landmarks, as a problem of least squares.
struct Problem<'a> {
    landmarks: &'a [Weighted],
    mask: u32,
}

impl Problem<'_> {
    fn chosen(&self) -> impl Iterator<Item = &Weighted> {
        self.landmarks.iter().enumerate().filter(|(i, _)| self.mask & (1 << i) != 0).map(|(_, landmark)| landmark)
    }
}

impl LeastSquares<3> for Problem<'_> {
    type State = Se2;

    fn linearize(&mut self, pose: &Se2, normal: &mut NormalEquations<3>) {
        for (residual, jacobian) in self.chosen().filter_map(|landmark| landmark.residual(pose)) {
            normal.add(&residual, &jacobian, 1.0);
        }
    }

    fn cost(&mut self, pose: &Se2) -> f64 {
        self.chosen().filter_map(|landmark| landmark.residual(pose)).map(|(r, _)| 0.5 * r.norm_squared()).sum()
    }

    fn retract(&self, pose: &Se2, step: &SVector<f64, 3>) -> Se2 {
        pose.plus(step)
    }
}

/// The pose from which two or more known landmarks are seen as they are; no guess is needed.
///
/// A landmark whose squared residual is beyond `gate` (chi-square of two degrees of freedom: 13.8 lets all but one of a
/// thousand sound ones pass) is left out, if a majority agrees on a pose without it. O(landmarks), O(landmarks³) if one
/// must be left out; no allocation. Landmarks beyond [`MOST_LANDMARKS`] are not looked at.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, UncertainVector};
/// use agv_core::nalgebra::{Matrix2, Vector2};
/// use agv_core::sensors::LandmarkObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::marker::{KnownLandmark, pose_from_landmarks};
///
/// let truth = Se2::new(2.0, 1.0, 0.5);
/// let seen = [(5.0, 2.0), (3.0, 4.0)].map(|(x, y)| {
///     let away = truth.inverse() * Vector2::new(x, y);
///     let reading = Vector2::new(away.norm(), away.y.atan2(away.x));
///     let measured = UncertainVector::from_sigmas(reading, &Vector2::new(0.05, 0.01)).expect("finite");
///     let observation = LandmarkObservation::new(Stamp::default(), None, measured).expect("a range");
///     let place = UncertainVector::new(Vector2::new(x, y), Matrix2::zeros()).expect("finite");
///     KnownLandmark { observation, place }
/// });
/// let fix = pose_from_landmarks(&seen, 13.8)?;
/// assert!((fix.map_from_base.mean().translation() - truth.translation()).norm() < 1e-9);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::TooFew`] below two, or if no majority agrees on a pose; a gate that is not positive; [`Error::NotCovariance`] for
/// a reading that is exact; [`Error::Singular`] if all landmarks are at one place.
pub fn pose_from_landmarks(landmarks: &[KnownLandmark], gate: f64) -> Result<LandmarkFix, Error> {
    check::in_range("gate", gate, f64::MIN_POSITIVE, f64::INFINITY)?;
    check::at_least("landmarks", landmarks.len(), 2)?;
    let landmarks = &landmarks[..landmarks.len().min(MOST_LANDMARKS)];
    let all = u32::MAX >> (MOST_LANDMARKS - landmarks.len());
    let start = propose(landmarks, all).ok_or(Error::Singular { name: "landmarks", row: 0, pivot: 0.0 })?;
    let fix = settle(landmarks, &start, all)?;
    if agreeing(landmarks, fix.map_from_base.mean(), gate)? == all {
        return Ok(fix);
    }
    let (start, mask) = vote(landmarks, gate)?;
    let fix = settle(landmarks, &start, mask)?;
    let mask = majority(agreeing(landmarks, fix.map_from_base.mean(), gate)?, landmarks.len())?;
    settle(landmarks, fix.map_from_base.mean(), mask)
}

/// The rigid motion that carries the readings, as points of the base frame, onto their places.
fn propose(landmarks: &[KnownLandmark], mask: u32) -> Option<Se2> {
    let chosen = landmarks.iter().enumerate().filter(move |(i, _)| mask & (1 << i) != 0);
    rigid_motion(chosen.map(|(_, l)| (*l.observation.position_in_base().mean(), *l.place.mean())))
}

/// Weights the landmarks as they are seen from a pose; as many of the array count as were given.
fn weigh(landmarks: &[KnownLandmark], pose: &Se2) -> Result<[Weighted; MOST_LANDMARKS], Error> {
    let zero = Vector2::zeros();
    let empty = Weighted { sensor: Se2::default(), place: zero, reading: zero, whiten: Matrix2::zeros() };
    let mut weighted = [empty; MOST_LANDMARKS];
    for (slot, landmark) in weighted.iter_mut().zip(landmarks) {
        let measured = landmark.observation.range_bearing();
        *slot = Weighted {
            sensor: landmark.observation.base_from_sensor(),
            place: *landmark.place.mean(),
            reading: *measured.mean(),
            whiten: Matrix2::identity(),
        };
        let by_place = slot.predicted(pose).map_or(Matrix2::zeros(), |(_, _, by_place)| by_place);
        let spread = measured.covariance() + by_place * landmark.place.covariance() * by_place.transpose();
        check::positive_definite("covariance of a landmark's reading", &spread)?;
        let root = spread.cholesky().map(|factor| factor.l());
        slot.whiten = root.and_then(Matrix2::try_inverse).unwrap_or_else(Matrix2::zeros);
    }
    Ok(weighted)
}

/// Minimises the residuals of the chosen landmarks.
fn settle(landmarks: &[KnownLandmark], start: &Se2, mask: u32) -> Result<LandmarkFix, Error> {
    let weighted = weigh(landmarks, start)?;
    let mut problem = Problem { landmarks: &weighted, mask };
    let params = LevenbergMarquardtParams { step_tolerance: 1e-10, max_iterations: 50, ..Default::default() };
    let found = LevenbergMarquardt::new(params)?.minimize(&mut problem, *start)?;
    let singular = Error::Singular { name: "landmarks", row: 0, pivot: 0.0 };
    let covariance = Se2::inverse_of(&found.normal.hessian).ok_or(singular)?;
    Ok(LandmarkFix {
        map_from_base: UncertainPose::new(found.state, covariance)?,
        chi_square: 2.0 * found.normal.cost,
        used: mask.count_ones() as usize,
        used_mask: mask,
    })
}

/// The landmarks whose squared residual at a pose is within the gate.
fn agreeing(landmarks: &[KnownLandmark], pose: &Se2, gate: f64) -> Result<u32, Error> {
    let weighted = weigh(landmarks, pose)?;
    let agrees = |landmark: &Weighted| landmark.residual(pose).is_some_and(|(r, _)| r.norm_squared() <= gate);
    Ok(weighted
        .iter()
        .take(landmarks.len())
        .enumerate()
        .filter(|(_, l)| agrees(l))
        .fold(0, |mask, (i, _)| mask | 1 << i))
}

/// The pose of the pair of landmarks that most others agree with, and who they are.
fn vote(landmarks: &[KnownLandmark], gate: f64) -> Result<(Se2, u32), Error> {
    let mut best = None::<(Se2, u32)>;
    for i in 0..landmarks.len() {
        for j in i + 1..landmarks.len() {
            let Some(pose) = propose(landmarks, 1 << i | 1 << j) else { continue };
            // The pose of two errs as much as the others do: twice the deviations.
            let mask = agreeing(landmarks, &pose, 4.0 * gate)?;
            if best.is_none_or(|(_, known)| mask.count_ones() > known.count_ones()) {
                best = Some((pose, mask));
            }
        }
    }
    let (pose, mask) = best.ok_or(Error::Singular { name: "landmarks", row: 0, pivot: 0.0 })?;
    Ok((pose, majority(mask, landmarks.len())?))
}

/// Accepts more than half of the landmarks, and two at least.
fn majority(mask: u32, count: usize) -> Result<u32, Error> {
    check::at_least("landmarks that agree", mask.count_ones() as usize, (count / 2 + 1).max(2))?;
    Ok(mask)
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        compute::{Seed, Stream},
        time::Stamp,
    };
    use proptest::prelude::*;
    use rand_distr::{Distribution, StandardNormal};

    const PLACES: [(f64, f64); 6] = [(4.0, 1.0), (-3.0, 2.0), (0.5, -5.0), (-1.0, 6.0), (7.0, -2.0), (5.0, 5.0)];
    const SIGMAS: Vector2<f64> = Vector2::new(0.05, 0.01);

    fn normal(sigma: f64, stream: &mut Stream) -> f64 {
        let z: f64 = StandardNormal.sample(stream);
        sigma * z
    }

    /// What is seen from a pose with so many deviations of noise, in a map that errs by `map_sigma`.
    fn seen(pose: &Se2, count: usize, map_sigma: f64, noise: Option<&mut Stream>) -> Vec<KnownLandmark> {
        let mount = Se2::new(0.4, -0.1, 0.8);
        let mut none = Seed(0).stream(0, 0);
        let (scale, stream) = match noise {
            Some(stream) => (1.0, stream),
            None => (0.0, &mut none),
        };
        let landmark = |&(x, y): &(f64, f64)| {
            let away = (*pose * mount).inverse() * Vector2::new(x, y);
            let read = Vector2::new(away.norm(), away.y.atan2(away.x));
            let read = read + SIGMAS.map(|sigma| scale * normal(sigma, stream));
            let measured = UncertainVector::from_sigmas(read, &SIGMAS).unwrap();
            let observation =
                LandmarkObservation::new(Stamp::default(), None, measured).unwrap().with_mount(mount).unwrap();
            let place = Vector2::new(x, y) + Vector2::from_fn(|_, _| scale * normal(map_sigma, stream));
            let place = UncertainVector::new(place, Matrix2::identity() * (map_sigma * map_sigma)).unwrap();
            KnownLandmark { observation, place }
        };
        PLACES[..count].iter().map(landmark).collect()
    }

    proptest! {
        /// Two landmarks are enough, and the mirror image is never taken.
        #[test]
        fn exact_readings_give_the_pose(x in -2.0..2.0_f64, y in -2.0..2.0_f64, yaw in -3.1..3.1_f64, count in 2..7_usize) {
            let truth = Se2::new(x, y, yaw);
            let fix = pose_from_landmarks(&seen(&truth, count, 0.0, None), 13.8).unwrap();
            prop_assert!(fix.map_from_base.mean().minus(&truth).norm() < 1e-8 && fix.used == count);
        }

        /// One landmark that is somewhere else than the map says.
        #[test]
        fn a_landmark_that_was_moved_is_left_out(yaw in -3.1..3.1_f64, which in 0..5_usize, seed in 0..1000_u64) {
            let truth = Se2::new(0.3, -0.2, yaw);
            let mut landmarks = seen(&truth, 5, 0.01, Some(&mut Seed(seed).stream(0, 0)));
            let place = landmarks[which].place;
            landmarks[which].place = UncertainVector::new(place.mean() + Vector2::new(1.5, -1.0), *place.covariance()).unwrap();
            let fix = pose_from_landmarks(&landmarks, 20.0).unwrap();
            prop_assert_eq!(fix.used_mask, 0b11111 ^ (1 << which));
            prop_assert!(fix.map_from_base.mean().minus(&truth).norm() < 0.3);
        }
    }

    /// NEES and squared residuals over 2000 draws of readings and maps, within 4.5 deviations.
    #[test]
    fn the_covariance_is_that_of_readings_and_map() {
        let (truth, mut stream, n) = (Se2::new(0.3, -0.2, 2.9), Seed(12).stream(0, 0), 2000_u32);
        let (mut nees, mut residuals) = (0.0, 0.0);
        for _ in 0..n {
            let fix = pose_from_landmarks(&seen(&truth, 5, 0.03, Some(&mut stream)), 50.0).unwrap();
            let error = fix.map_from_base.mean().minus(&truth);
            nees += error.dot(&(Se2::inverse_of(fix.map_from_base.covariance()).unwrap() * error));
            residuals += fix.chi_square;
        }
        for (sum, freedom) in [(nees, 3.0), (residuals, 7.0)] {
            let mean = freedom * f64::from(n);
            assert!((sum - mean).abs() < 4.5 * (2.0 * mean).sqrt(), "{sum} {mean}");
        }
    }

    #[test]
    fn the_jacobians_are_slopes() {
        let pose = Se2::new(0.3, -0.2, 2.0);
        let weighted = weigh(&seen(&pose, 3, 0.1, None), &pose).unwrap()[1];
        let (_, by_pose, by_place) = weighted.predicted(&pose).unwrap();
        for axis in 0..3 {
            let mut step = nalgebra::Vector3::zeros();
            step[axis] = 1e-6;
            let at = |sign: f64| weighted.predicted(&pose.plus(&(step * sign))).unwrap().0;
            assert!(((at(1.0) - at(-1.0)) / 2e-6 - by_pose.column(axis)).norm() < 1e-8);
        }
        for axis in 0..2 {
            let mut step = Vector2::zeros();
            step[axis] = 1e-6;
            let at =
                |sign: f64| Weighted { place: weighted.place + step * sign, ..weighted }.predicted(&pose).unwrap().0;
            assert!(((at(1.0) - at(-1.0)) / 2e-6 - by_place.column(axis)).norm() < 1e-8);
        }
    }

    #[test]
    fn bad_landmarks_are_refused() {
        let good = seen(&Se2::default(), 4, 0.01, None);
        assert!(matches!(pose_from_landmarks(&good[..1], 13.8), Err(Error::TooFew { .. })));
        for gate in [0.0, -1.0, f64::NAN] {
            assert!(pose_from_landmarks(&good, gate).is_err());
        }
        assert!(matches!(pose_from_landmarks(&[good[0], good[0]], 13.8), Err(Error::Singular { .. })));
        // Two pairs that contradict each other: no majority.
        let mut torn = good.clone();
        for landmark in &mut torn[2..] {
            landmark.place = UncertainVector::new(landmark.place.mean() * -1.0, *landmark.place.covariance()).unwrap();
        }
        assert!(matches!(pose_from_landmarks(&torn, 13.8), Err(Error::TooFew { .. })));
        let exact = UncertainVector::new(Vector2::new(2.0, 0.1), Matrix2::zeros()).unwrap();
        let observation = LandmarkObservation::new(Stamp::default(), None, exact).unwrap();
        let place = UncertainVector::new(Vector2::new(2.0, 0.0), Matrix2::zeros()).unwrap();
        let bad = KnownLandmark { observation, place };
        assert!(matches!(pose_from_landmarks(&[good[0], good[1], bad], 13.8), Err(Error::NotCovariance { .. })));
    }
}
