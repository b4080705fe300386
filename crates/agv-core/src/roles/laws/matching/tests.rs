//! The laws let the simplest players pass that keep them, and catch each fault.

use super::*;
use crate::{
    Error,
    geometry::{PoseSigma, unobserved_directions},
    roles::LidarOdometryStep,
    sensors::ScanGeometry,
    time::Stamp,
};
use nalgebra::{Matrix6, Vector6};

/// What is wrong with a player.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    TakesAnyGuess,
    TakesAnyTarget,
    ForgetsItsTarget,
    NeedsNoTarget,
    NeverConverges,
    BoastsOnNothing,
    NegativeInformation,
    NoProjector,
    NoShare,
    Drifts,
}

/// Moves the centroid of the source onto that of the target, and leaves the attitude.
struct Centroids {
    fault: Fault,
    target: Option<Vector3<f64>>,
    calls: f64,
}

fn centroid(points: &dyn PointSource) -> Option<Vector3<f64>> {
    let points = (0..points.len()).map(|i| points.point(i).map(f64::from)).filter(|p| p.iter().all(|v| v.is_finite()));
    let (sum, count) = points.fold((Vector3::zeros(), 0.0), |(sum, count), p| (sum + p, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

impl Centroids {
    fn new(fault: Fault) -> Self {
        Self { fault, target: None, calls: 0.0 }
    }

    fn aim(&mut self, target: Option<Vector3<f64>>) -> Result<(), AlignmentError> {
        match (target, self.fault) {
            (None, Fault::ForgetsItsTarget) => self.target = Some(Vector3::zeros()),
            (Some(_), _) => self.target = target,
            _ => {}
        }
        let refused = target.is_none() && self.fault != Fault::TakesAnyTarget;
        if refused { Err(Error::Empty { name: "target" }.into()) } else { Ok(()) }
    }

    fn fit(&mut self, source: Option<Vector3<f64>>, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        let fault = self.fault;
        if !guess.is_finite() && fault != Fault::TakesAnyGuess {
            return Err(Error::NotFinite { name: "guess", value: f64::NAN }.into());
        }
        let target = match self.target {
            None if fault == Fault::NeedsNoTarget => Vector3::zeros(),
            target => target.ok_or(AlignmentError::NoTarget)?,
        };
        let mut found = Alignment::unknown(*guess, Termination::TooFewPoints);
        let Some(source) = source else {
            found.inlier_ratio = 1.0; // nobody looks at it
            found.information = Matrix6::identity() * f64::from(u8::from(fault == Fault::BoastsOnNothing));
            return Ok(found);
        };
        self.calls += f64::from(u8::from(fault == Fault::Drifts));
        let offset = target - guess.rotation().act(&source) + Vector3::new(1e-9 * self.calls, 0.0, 0.0);
        found.target_from_source = Se3::from_parts(offset, guess.rotation());
        found.information = Matrix6::from_diagonal(&Vector6::new(100.0, 100.0, 100.0, 0.0, 0.0, 0.0));
        found.unobserved = unobserved_directions::<Se3>(&found.information, PoseSigma::default())?;
        (found.inlier_ratio, found.termination) = (1.0, Termination::Converged);
        match fault {
            Fault::NeverConverges => found.termination = Termination::Stalled,
            Fault::NegativeInformation => found.information = -found.information,
            Fault::NoProjector => found.unobserved *= 0.5,
            Fault::NoShare => found.inlier_ratio = 25.0,
            _ => {}
        }
        Ok(found)
    }
}

impl Registration for Centroids {
    fn set_target(&mut self, target: &dyn PointSource) -> Result<(), AlignmentError> {
        self.aim(centroid(target))
    }

    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        self.fit(centroid(source), guess)
    }
}

fn scan_centroid(scan: &LaserScan, pose: &Se2) -> Option<Vector3<f64>> {
    let points = scan.points_in_base().map(|p| pose.act(&p).push(0.0).map(|v| v as f32));
    centroid(&PointCloud::from_points(points)).filter(|_| pose.is_finite())
}

impl ScanMatcher for Centroids {
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError> {
        self.aim(scans.first().and_then(|target| scan_centroid(target.scan, &target.target_from_base)))
    }

    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        let found = self.fit(scan_centroid(scan, &Se2::default()), &(*guess).into())?;
        let pose = if found.converged() { found.target_from_source.to_planar() } else { *guess };
        let mut planar = Alignment::unknown(pose, found.termination);
        let places = [0, 1, 5];
        planar.information = nalgebra::Matrix3::from_fn(|i, j| found.information[(places[i], places[j])]);
        planar.unobserved = nalgebra::Matrix3::from_fn(|i, j| found.unobserved[(places[i], places[j])]);
        planar.inlier_ratio = found.inlier_ratio;
        Ok(planar)
    }
}

const FAULTS: [Fault; 9] = [
    Fault::TakesAnyGuess,
    Fault::TakesAnyTarget,
    Fault::ForgetsItsTarget,
    Fault::NeverConverges,
    Fault::BoastsOnNothing,
    Fault::NegativeInformation,
    Fault::NoProjector,
    Fault::NoShare,
    Fault::Drifts,
];

#[test]
fn registrations_are_told_apart() {
    let target = PointCloud::from_points([Vector3::new(1.0, 2.0, 3.0), Vector3::new(2.0, 2.0, 3.0)]);
    let source = PointCloud::from_points([Vector3::new(0.0, 0.0, 0.0), Vector3::new(1.0, 0.0, 0.0)]);
    let verdict = |fault| registration(&mut Centroids::new(fault), &target, &source, &Se3::identity());
    assert_eq!(verdict(Fault::None), Ok(()));
    for fault in FAULTS.into_iter().chain([Fault::NeedsNoTarget]) {
        assert!(verdict(fault).is_err(), "{fault:?}");
    }
}

#[test]
fn scan_matchers_are_told_apart() {
    let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![2.0; 50]).unwrap();
    let target = [TargetScan { target_from_base: Se2::new(1.0, 0.0, 0.0), scan: &scan }];
    let verdict = |fault| scan_matcher(&mut Centroids::new(fault), &target, &scan, &Se2::default());
    assert_eq!(verdict(Fault::None), Ok(()));
    for fault in FAULTS {
        assert!(verdict(fault).is_err(), "{fault:?}");
    }
}

/// Follows by centroids; with a fault it loses its pose, or starts elsewhere.
struct Follower(Option<Centroids>, Fault, Se3);

impl LidarOdometry for Follower {
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, AlignmentError> {
        if prior.is_some_and(|prior| !prior.is_finite()) {
            return Err(Error::NotFinite { name: "prior", value: f64::NAN }.into());
        }
        let alignment = match &mut self.0 {
            Some(matcher) => Some(matcher.align(cloud, &self.2)?),
            none => {
                let matcher = none.insert(Centroids::new(self.1));
                Registration::set_target(matcher, cloud)?;
                None
            }
        };
        if let Some(found) = alignment.filter(Alignment::converged) {
            self.2 = found.target_from_source;
        }
        let odom_from_base = if self.1 == Fault::ForgetsItsTarget { Se3::identity() } else { self.2 };
        Ok(LidarOdometryStep { odom_from_base, alignment })
    }
}

#[test]
fn odometries_are_told_apart() {
    let first = PointCloud::from_points([Vector3::new(1.0, 2.0, 3.0), Vector3::new(2.0, 2.0, 3.0)]);
    let second = PointCloud::from_points([Vector3::new(1.5, 2.0, 3.0), Vector3::new(2.5, 2.0, 3.0)]);
    let verdict = |fault, start| lidar_odometry(&mut Follower(None, fault, start), &first, &second);
    assert_eq!(verdict(Fault::None, Se3::identity()), Ok(()));
    for fault in [Fault::ForgetsItsTarget, Fault::NeverConverges, Fault::NoProjector] {
        assert!(verdict(fault, Se3::identity()).is_err(), "{fault:?}");
    }
    assert!(verdict(Fault::None, Se2::new(1.0, 0.0, 0.0).into()).is_err());
}
