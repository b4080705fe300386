use super::*;
use agv_core::{geometry::Se2, time::Stamp};
use nalgebra::Vector3;

/// Finds what it is told to, and writes down what it was asked.
#[derive(Default)]
struct Script {
    /// Points that each cloud is taken for, and the true place along x of a cloud that fits.
    count: usize,
    place: Option<f64>,
    /// How far a guess may be off.
    reach: f64,
    /// Deviations of the guesses that were tried on the last cloud.
    tries: Vec<(f64, f64)>,
    map: Vec<f64>,
    placings: usize,
    forgotten: usize,
}

fn at(x: f64) -> Se3 {
    Se3::from(Se2::new(x, 0.0, 0.0))
}

impl Matcher for Script {
    fn place(&mut self, _: &PointCloud, _: Option<&Vector6<f64>>) -> Result<(), AlignmentError> {
        self.placings += 1;
        Ok(())
    }

    fn placed(&self) -> (usize, f64) {
        (self.count, 5.0)
    }

    fn has_map(&self) -> bool {
        !self.map.is_empty()
    }

    fn track(&mut self, guess: &Se3, sigma: f64) -> Result<Tracked, AlignmentError> {
        let x = guess.translation().x;
        self.tries.push((x, sigma));
        let place = self.place.filter(|place| (place - x).abs() <= self.reach.max(3.0 * sigma));
        let termination = if place.is_some() { Termination::Converged } else { Termination::PoorFit };
        let mut alignment = Alignment::unknown(at(place.unwrap_or(x)), termination);
        if place.is_some() {
            alignment.unobserved.fill(0.0);
        }
        Ok(Tracked { alignment, is_usable: place.is_some(), is_clear: place.is_some() })
    }

    fn remember(&mut self, pose: &Se3) {
        self.map.push(pose.translation().x);
    }

    fn forget(&mut self) {
        self.map.clear();
        self.forgotten += 1;
    }
}

/// A cloud a second, of so many points, taken at a place or fitting nowhere.
fn step(
    tracker: &mut Tracker,
    script: &mut Script,
    second: i32,
    count: usize,
    place: Option<f64>,
) -> LidarOdometryStep {
    (script.count, script.place) = (count, place);
    (script.tries, script.placings) = (Vec::new(), 0);
    let cloud = PointCloud::from_points([Vector3::x()]).with_stamp(Stamp::from_seconds(f64::from(second)));
    tracker.step(script, &cloud, None).unwrap()
}

#[test]
fn a_cloud_that_fits_is_aligned_once_and_one_that_does_not_in_three_ways() {
    let (mut tracker, mut script) = (Tracker::new(2.0), Script::default());
    step(&mut tracker, &mut script, 0, 500, Some(0.0));
    // A vehicle at rest is predicted at rest: as far as the first deviation may be, and that is all.
    step(&mut tracker, &mut script, 1, 500, None);
    assert_eq!(script.tries, [(0.0, 2.0)]);
    step(&mut tracker, &mut script, 2, 500, Some(0.5));
    assert_eq!(script.tries, [(0.0, 2.0)]);
    for second in 3..30 {
        step(&mut tracker, &mut script, second, 500, Some(0.5 * f64::from(second - 1)));
        assert_eq!((script.tries.len(), script.placings), (1, 1));
    }
    let lost = step(&mut tracker, &mut script, 30, 500, None);
    assert_eq!(lost.odom_from_base.translation().x, 14.5, "goes on as it went");
    let [(first, narrow), (second, wide), (rest, as_wide)] = script.tries[..] else { panic!("{:?}", script.tries) };
    assert_eq!((first, second, rest), (14.5, 14.5, 14.0));
    assert!(narrow < 0.2 && wide == 2.0 && as_wide == 2.0, "{narrow} {wide} {as_wide}");
    // The cloud has no times: there is no skew that differs.
    assert_eq!(script.placings, 1);
}

#[test]
fn clouds_that_say_nothing_do_not_cost_the_map_and_five_that_fit_nowhere_do_once() {
    let (mut tracker, mut script) = (Tracker::new(2.0), Script::default());
    let driven = drive(&mut tracker, &mut script, 500);
    for second in driven..driven + 20 {
        step(&mut tracker, &mut script, second, 3, None);
        assert_eq!((script.tries.len(), script.forgotten), (0, 0), "neither tried nor a reason to doubt the map");
    }
    doubted(&mut tracker, &mut script, driven + 20, 500);
    step(&mut tracker, &mut script, driven + 25, 500, None);
    assert_eq!((script.map.len(), script.forgotten), (1, 1), "and not with the next one again");
    let place = 0.5 * f64::from(driven + 26);
    step(&mut tracker, &mut script, driven + 26, 500, Some(place));
    assert_eq!(script.map.len(), 2);
}

/// ... also where a handful of points fits somewhere, as it does anywhere.
#[test]
fn clouds_that_say_nothing_move_neither_the_pose_nor_the_map() {
    let (mut tracker, mut script) = (Tracker::new(2.0), Script::default());
    let driven = drive(&mut tracker, &mut script, 500);
    let last = 0.5 * f64::from(driven - 1);
    for (second, count) in (driven..).zip([0, 1, 5, 20, 49]) {
        let found = step(&mut tracker, &mut script, second, count, Some(last + 1.8));
        let expected = 0.5 * f64::from(second);
        assert!((found.odom_from_base.translation().x - expected).abs() < 1e-9, "{count}: {found:?}");
        assert_eq!(found.alignment.unwrap().termination, Termination::TooFewPoints, "{count}");
        assert_eq!(script.map.len(), 30, "{count}");
    }
    // What the map had before is the measure still.
    let found = step(&mut tracker, &mut script, driven + 5, 500, Some(0.5 * f64::from(driven + 5)));
    assert!(found.alignment.unwrap().converged() && script.map.len() == 31);
}

/// Half a metre a second, until the prediction is trusted; tells the next second.
fn drive(tracker: &mut Tracker, script: &mut Script, count: usize) -> i32 {
    for second in 0..30 {
        step(tracker, script, second, count, Some(0.5 * f64::from(second)));
    }
    assert_eq!(script.map.len(), 30);
    30
}

/// Five clouds that fit nowhere: each is tried in three ways, and the last begins the map.
fn doubted(tracker: &mut Tracker, script: &mut Script, first: i32, count: usize) {
    for second in first..first + 5 {
        assert_eq!((script.map.len(), script.forgotten), (30, 0), "{second}");
        step(tracker, script, second, count, None);
        assert_eq!(script.tries.len(), 3, "{:?}", script.tries);
    }
    assert_eq!((script.map.len(), script.forgotten), (1, 1), "begun anew with this cloud");
}

/// Few lines, wide leaves, or an open place: what is few is told by the clouds that fitted.
#[test]
fn where_clouds_are_small_one_that_fits_nowhere_is_doubted_as_well() {
    let (mut tracker, mut script) = (Tracker::new(2.0), Script::default());
    let driven = drive(&mut tracker, &mut script, 30);
    doubted(&mut tracker, &mut script, driven, 30);
}

#[test]
fn without_a_map_the_next_cloud_begins_it() {
    let (mut tracker, mut script) = (Tracker::new(0.0), Script::default());
    step(&mut tracker, &mut script, 0, 0, None);
    script.map.clear();
    let begun = step(&mut tracker, &mut script, 1, 500, None);
    assert_eq!((begun.odom_from_base, script.map.len()), (Se3::identity(), 1));
}

#[test]
fn what_is_not_finite_changes_nothing() {
    let (mut tracker, mut script) = (Tracker::new(2.0), Script::default());
    let cloud = PointCloud::from_points([Vector3::x()]);
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(tracker.step(&mut script, &cloud, Some(&at(bad))).is_err());
    }
    assert!(tracker.prior.is_none() && script.map.is_empty());
}
