//! The filter behind `dyn Localizer`.

use super::*;
use agv_core::{
    Error,
    roles::{Correct, LocalizationError, Localizer, SkipReason, UpdateOutcome, laws},
    sensors::SensorId,
};

fn connected() -> FusionFilter {
    let mut filter = FusionFilter::new(FusionParams::default()).unwrap();
    let [wheels, front, rear, gyro] =
        [SourceParams::wheels(), SourceParams::pose(), SourceParams::pose(), SourceParams::imu()]
            .map(|source| filter.add_source(source).unwrap());
    for (input, source) in [
        (RoleInput::Odometry, wheels),
        (RoleInput::Pose(SensorId(0)), front),
        (RoleInput::Pose(SensorId(1)), rear),
        (RoleInput::Imu(SensorId(0)), gyro),
    ] {
        filter.connect(input, source).unwrap();
    }
    filter
}

#[test]
fn the_filter_obeys_the_laws_of_its_roles() {
    let mut filter = connected();
    let (start, ahead) = (Se2::new(3.0, 1.0, 2.0), Se2::new(1.0, 0.1, 0.2));
    let moved = motion(0.0, &Se2::default(), 1.0, &ahead, Matrix3::zeros());
    laws::localizer(&mut filter, &start, &squares([0.05, 0.05, 0.02]), &moved).unwrap();
    let at_end = |sensor| seen(1.0, start * ahead, squares([0.05; 3])).with_sensor(SensorId(sensor));
    laws::two_sensors(&mut filter, &at_end(0), &at_end(1)).unwrap();
}

/// One call by the role, the other by the source: the same filter.
#[test]
fn a_role_is_another_way_to_the_same_sources() {
    let (mut by_role, mut by_source) = (connected(), connected());
    Localizer::initialize(&mut by_role, &belief(Se2::default())).unwrap();
    by_source.initialize(&belief(Se2::default())).unwrap();
    for step in 0..20 {
        let (start, end) = (0.05 * f64::from(step), 0.05 * f64::from(step + 1));
        let moved = motion(start, &Se2::default(), end, &Se2::new(0.02, 0.0, 0.01), Matrix3::zeros());
        Localizer::predict(&mut by_role, &moved).unwrap();
        by_role.update(&rates(end, 0.2, 1e-3)).unwrap();
        by_source.fuse(SourceId(0), moved).unwrap();
        by_source.fuse(SourceId(3), rates(end, 0.2, 1e-3)).unwrap();
    }
    let late = seen(0.7, Se2::new(0.25, 0.02, 0.14), squares([0.05; 3]));
    let UpdateOutcome::Applied(report) = by_role.update(&late).unwrap() else { panic!("gated") };
    let FusionOutcome::Applied { nis, .. } = by_source.fuse(SourceId(1), late).unwrap() else { panic!("gated") };
    assert_eq!(report.nis, Some(nis));
    assert_eq!(by_role, by_source);
    let held: Box<dyn Correct<PoseObservation<Se2>, Pose = Se2> + Send> = Box::new(by_role);
    assert_eq!(held.estimate().unwrap().stamp, Some(at(1.0)));
}

#[test]
fn what_is_not_taken_in_says_why() {
    let mut filter = connected();
    assert_eq!(filter.update(&rates(0.0, 0.1, 0.01)), Err(LocalizationError::NotInitialized));
    filter.initialize(&belief(Se2::default())).unwrap();
    assert_eq!(filter.estimate().unwrap().stamp, None);
    filter.update(&rates(5.0, 0.1, 0.01)).unwrap();
    let twice = filter.update(&rates(5.0, 0.2, 0.01));
    assert_eq!(twice, Ok(UpdateOutcome::Skipped(SkipReason::Duplicate)));
    let old = filter.update(&rates(1.0, 0.1, 0.01)).unwrap();
    assert!(matches!(old, UpdateOutcome::Skipped(SkipReason::OutsideHistory { age }) if age == 4.0), "{old:?}");
    let early = filter.update(&rates(95.0, 0.1, 0.01)).unwrap();
    assert!(matches!(early, UpdateOutcome::Skipped(SkipReason::OutsideHistory { age }) if age == -90.0), "{early:?}");
    let far = filter.update(&seen(5.0, Se2::new(9.0, 0.0, 0.0), squares([0.01; 3]))).unwrap();
    assert!(matches!(far, UpdateOutcome::Skipped(SkipReason::Gated { .. })));

    let before = filter.clone();
    let stranger = rates(5.1, 0.1, 0.01).with_sensor(SensorId(7));
    assert!(matches!(filter.update(&stranger), Err(LocalizationError::Invalid(Error::Empty { .. }))));
    let place = PositionObservation::new(
        at(5.1),
        UncertainVector::from_sigmas(Vector2::zeros(), &Vector2::repeat(0.1)).unwrap(),
    );
    assert!(filter.update(&place).is_err(), "not connected");
    assert!(filter.connect(RoleInput::Odometry, SourceId(9)).is_err());
    assert_eq!(filter, before);
}
