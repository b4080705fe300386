//! Masks, references, mounts and gates of sources.

use super::*;
use agv_core::geometry::{Se3, So3};

fn single(source: SourceParams, params: FusionParams) -> (FusionFilter, SourceId) {
    let mut filter = FusionFilter::new(params).unwrap();
    let id = filter.add_source(source).unwrap();
    filter.initialize_at(at(0.0), &belief(Se2::new(1.0, 2.0, 0.0))).unwrap();
    (filter, id)
}

/// Each mask lets its own number through and leaves the others as they were.
#[test]
fn masks_choose_numbers() {
    let target = Se2::new(1.03, 1.96, 0.02);
    for (components, moves) in [
        (Components::X, [true, false, false]),
        (Components::Y, [false, true, false]),
        (Components::YAW, [false, false, true]),
        (Components::X | Components::YAW, [true, false, true]),
    ] {
        let (mut filter, id) =
            single(bare(SourceParams { components, ..SourceParams::pose() }), FusionParams::default());
        filter.fuse(id, seen(0.0, target, squares([1e-4; 3]))).unwrap();
        let state = filter.state().unwrap();
        let (pose, sigmas) = (state.pose.mean(), state.pose.covariance().diagonal().map(f64::sqrt));
        for (i, (now, goal)) in [(pose.x(), 1.03), (pose.y(), 1.96), (pose.yaw(), 0.02)].into_iter().enumerate() {
            assert_eq!((now - goal).abs() < 1e-4, moves[i], "{components:?} {i}");
            // In the axes of the base, which the heading has turned by 0.02 rad.
            assert_eq!(sigmas[i] < 5e-3, moves[i]);
        }
    }
}

/// A tracking system in a frame of its own: as odometry it gives the same as increments do; with a reference to its first pose it
/// holds the vehicle to the map without drift. Both with the sensor off the centre and turned.
#[test]
fn frames_of_their_own_are_no_matter() {
    let mount = Se2::new(0.3, -0.2, 2.0);
    let (own_from_map, noise) =
        (Se2::new(-7.0, 3.0, 2.5), MotionNoise { position_per_metre: 1e-4, ..Default::default() });
    let mut filters = [Reference::Previous, Reference::First, Reference::Previous].map(|reference| {
        let floor = NoiseFloor { position: 1e-3, yaw: 1e-3, ..NoiseFloor::default() };
        single(SourceParams { reference, floor, motion: noise, ..bare(SourceParams::pose()) }, FusionParams::default())
    });
    let mut truth = Se2::new(1.0, 2.0, 0.0);
    for step in 0..200 {
        let now = 0.02 * f64::from(step);
        let next = truth * Twist2::new(0.7, 0.0, 0.4).integrate(0.02);
        for (filter, id) in &mut filters[..2] {
            let reading = seen(now, own_from_map * truth * mount, Matrix3::zeros()).with_mount(mount).unwrap();
            filter.fuse(*id, reading).unwrap();
        }
        if step < 199 {
            let (filter, id) = &mut filters[2];
            filter.fuse(*id, motion(now, &truth, now + 0.02, &next, Matrix3::zeros())).unwrap();
            truth = next;
        }
    }
    let [by_poses, by_first, by_motions] = filters.each_ref().map(|(filter, _)| filter.state().unwrap());
    for state in [by_poses, by_first, by_motions] {
        assert!(state.pose.mean().minus(&truth).norm() < 1e-3, "{:?}", state.pose.mean().minus(&truth));
    }
    let deviation = |state: &FusedState| state.pose.position_deviation();
    assert!((deviation(&by_poses) / deviation(&by_motions) - 1.0).abs() < 0.02, "of the same size wherever it sits");
    assert!(
        deviation(&by_first) < 0.95 * deviation(&by_poses),
        "no drift, but the frame is no better known than the start"
    );
}

/// A flow sensor ahead of the axle slides sideways as the vehicle turns; its forward speed says nothing of the turn.
#[test]
fn mounts_count_for_velocities_and_places() {
    let (mut filter, id) =
        single(bare(SourceParams { components: Components::VY, ..SourceParams::velocity() }), FusionParams::default());
    let ahead = Se2::new(0.5, 0.0, 0.0);
    for step in 0..50 {
        let sliding = Vector3::new(9.0, 0.5 * 0.4, 9.0);
        let reading = VelocityObservation::new(at(0.02 * f64::from(step)), sliding, squares([1e-3; 3])).unwrap();
        filter.fuse(id, reading.with_mount(ahead).unwrap()).unwrap();
    }
    let state = filter.state().unwrap();
    assert!((state.twist.yaw_rate - 0.4).abs() < 0.1 && state.twist.vx.abs() < 1e-9, "{:?}", state.twist);

    // A beacon two metres ahead tells the heading.
    let (mut filter, id) = single(bare(SourceParams::position()), FusionParams::default());
    let lever = Se2::new(2.0, 0.0, 0.0);
    let place = UncertainVector::from_sigmas(Vector2::new(3.0, 2.06), &Vector2::repeat(1e-3)).unwrap();
    filter.fuse(id, PositionObservation::new(at(0.0), place).with_mount(lever).unwrap()).unwrap();
    let state = filter.state().unwrap();
    let beacon = state.pose.mean().act(&lever.translation());
    assert!((beacon - Vector2::new(3.0, 2.06)).norm() < 1e-3 && state.pose.mean().yaw() > 0.005);
}

/// A unit that lies on its side and leans reads the base's heading, rate and acceleration, gravity taken off.
#[test]
fn an_inertial_unit_may_be_mounted_anyhow() {
    let motion = MotionParams { acceleration: Some(Wander::new(1.0, 0.5)), ..MotionParams::differential() };
    let source = SourceParams { components: Components::KINEMATIC | Components::ACCELERATION, ..SourceParams::imu() };
    let (mut filter, id) =
        single(bare(source), FusionParams { motion, gyro_bias_sigma: 0.0, ..FusionParams::default() });
    let mount = Se3::from_parts(Vector3::new(0.1, 0.2, 0.3), So3::from_roll_pitch_yaw(1.5, -0.4, 0.8));
    // The vehicle stands on a ramp of 0.1 rad, nose up, and starts with 0.6 m/s².
    let world_from_base = So3::from_roll_pitch_yaw(0.0, -0.1, 0.05);
    let force = Vector3::new(0.6, 0.0, 0.0) + world_from_base.inverse().act(&Vector3::new(0.0, 0.0, 9.806_65));
    let spread = Vector3::repeat(1e-3);
    let in_unit = |v: Vector3<f64>| UncertainVector::from_sigmas(mount.rotation().inverse().act(&v), &spread).unwrap();
    for step in 0..20 {
        let sample = ImuSample::new(at(0.01 * f64::from(step)))
            .with_angular_velocity(in_unit(Vector3::zeros()))
            .with_specific_force(in_unit(force))
            .with_orientation(
                UncertainPose::new(world_from_base.compose(&mount.rotation()), squares([1e-3; 3])).unwrap(),
            )
            .with_mount(mount)
            .unwrap();
        assert!(matches!(filter.fuse(id, sample).unwrap(), FusionOutcome::Applied { degrees: 4, .. }));
    }
    let state = filter.state().unwrap();
    assert!((state.pose.mean().yaw() - 0.05).abs() < 2e-3 && state.twist.yaw_rate.abs() < 1e-2);
    assert!((state.acceleration - Vector2::new(0.6, 0.0)).norm() < 0.02, "{}", state.acceleration);
}

#[test]
fn gates_keep_outliers_out_until_patience_ends() {
    let source = SourceParams { gate_patience: 3, ..SourceParams::pose() };
    let (mut filter, id) = single(source, FusionParams::default());
    let before = filter.state().unwrap();
    let away = |time| seen(time, Se2::new(4.0, 2.0, 0.0), squares([0.01; 3]));
    for i in 0..3 {
        let outcome = filter.fuse(id, away(0.01 * f64::from(i))).unwrap();
        assert!(matches!(outcome, FusionOutcome::Gated { nis, limit } if nis > limit && (limit - 21.1).abs() < 0.1));
    }
    assert!((filter.state().unwrap().pose.mean().x() - before.pose.mean().x()).abs() < 1e-9);
    assert_eq!(filter.diagnostics(id).unwrap().gated_in_a_row, 3);
    assert!(matches!(filter.fuse(id, away(0.03)).unwrap(), FusionOutcome::Applied { .. }));
    let diagnostics = filter.diagnostics(id).unwrap();
    assert_eq!((diagnostics.accepted, diagnostics.gated, diagnostics.gated_in_a_row), (1, 3, 0));
    assert!(filter.state().unwrap().pose.mean().x() > 3.5);
}

#[test]
fn latency_is_taken_off_and_silence_is_noticed() {
    let source = SourceParams { latency: 0.1, timeout: 0.5, ..SourceParams::pose() };
    let (mut filter, id) = single(bare(source), FusionParams::default());
    assert_eq!(filter.silent(at(0.0)).collect::<Vec<_>>(), [id], "never heard of");
    filter.fuse(id, seen(1.1, Se2::new(1.0, 2.0, 0.0), squares([0.01; 3]))).unwrap();
    assert_eq!(filter.state().unwrap().stamp, at(1.0));
    assert_eq!((filter.silent(at(1.4)).count(), filter.silent(at(1.6)).count()), (0, 1));
}

/// Increments that leave a gap are measured from where they begin; between them the motion is the model's.
#[test]
fn lost_odometry_leaves_a_gap_and_no_jump() {
    let (mut filter, id) = single(bare(SourceParams::wheels()), FusionParams::default());
    let step = Twist2::new(0.5, 0.0, 0.0).integrate(0.02);
    for i in (0..100).filter(|i| !(40..60).contains(i)) {
        let start = 0.02 * f64::from(i);
        filter.fuse(id, motion(start, &Se2::default(), start + 0.02, &step, squares([1e-4; 3]))).unwrap();
    }
    let diagnostics = filter.diagnostics(id).unwrap();
    assert_eq!(diagnostics.accepted, 80);
    let state = filter.state().unwrap();
    assert!((state.pose.mean().x() - 2.0).abs() < 0.05, "the speed went on: {}", state.pose.mean().x());
    assert!(state.pose.covariance()[(0, 0)] > 0.05 * 0.05 + 1e-4, "but was not measured");
}

/// A motion that begins before the last one has ended is left out, and neither spoils that one nor those that follow.
#[test]
fn motions_that_overlap_are_left_out() {
    let mut filter = FusionFilter::new(FusionParams::default()).unwrap();
    let wheels = filter.add_source(bare(SourceParams::wheels())).unwrap();
    filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
    let ahead = |start: f64, end: f64| {
        motion(start, &Se2::default(), end, &Se2::new(end - start, 0.0, 0.0), squares([1e-3; 3]))
    };
    assert!(matches!(filter.fuse(wheels, ahead(0.0, 0.1)), Ok(FusionOutcome::Applied { .. })));
    assert_eq!(filter.fuse(wheels, ahead(0.09, 0.2)), Ok(FusionOutcome::Overlapping));
    assert!(matches!(filter.fuse(wheels, ahead(0.1, 0.3)), Ok(FusionOutcome::Applied { .. })));
    let state = filter.state().unwrap();
    assert!((state.pose.mean().x() - 0.3).abs() < 0.01, "{}", state.pose.mean().x());
    let counted = filter.diagnostics(wheels).unwrap();
    assert_eq!((counted.accepted, counted.dropped), (2, 1));
}

/// A reading that says nothing of the pose is no reference for those that do.
#[test]
fn what_has_no_pose_is_no_reference() {
    let mut filter = FusionFilter::new(FusionParams::default()).unwrap();
    let unit = filter.add_source(SourceParams { reference: Reference::First, ..bare(SourceParams::imu()) }).unwrap();
    let wheels = filter.add_source(bare(SourceParams::wheels())).unwrap();
    filter.initialize_at(at(0.0), &belief(Se2::new(0.0, 0.0, 0.5))).unwrap();
    let attitude = |time: f64, yaw: f64| {
        let attitude = UncertainPose::new(So3::exp(&Vector3::new(0.0, 0.0, yaw)), Matrix3::identity() * 1e-6).unwrap();
        rates(time, 0.0, 1e-3).with_orientation(attitude)
    };
    filter.fuse(unit, rates(0.1, 0.0, 1e-3)).unwrap();
    for i in 2..20 {
        filter.fuse(unit, attitude(0.1 * f64::from(i), 2.0)).unwrap();
    }
    let yaw = filter.state().unwrap().pose.mean().yaw();
    assert!((yaw - 0.5).abs() < 0.05, "the heading is the one of the belief: {yaw}");

    // Wheels that report velocities between the ends of their motions.
    for i in 20..30 {
        let now = 0.1 * f64::from(i);
        let still = motion(now, &Se2::default(), now + 0.1, &Se2::default(), squares([1e-3; 3]));
        let velocity = VelocityObservation::new(at(now + 0.05), Vector3::zeros(), squares([1e-2; 3])).unwrap();
        filter.fuse(wheels, velocity).unwrap();
        assert!(matches!(filter.fuse(wheels, still), Ok(FusionOutcome::Applied { .. })));
    }
}

/// Stamps that are rounded do not make motions overlap, in whatever order they come.
#[test]
fn rounded_stamps_do_not_overlap() {
    let ahead = |start: f64, end: f64| {
        motion(start, &Se2::default(), end, &Se2::new(end - start, 0.0, 0.0), squares([1e-3; 3]))
    };
    let run = |motions: [OdometryIncrement; 3]| {
        let mut filter = FusionFilter::new(FusionParams { history: 10.0, ..FusionParams::default() }).unwrap();
        let wheels = filter.add_source(bare(SourceParams::wheels())).unwrap();
        filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
        for motion in motions {
            assert!(matches!(filter.fuse(wheels, motion), Ok(FusionOutcome::Applied { .. })));
        }
        assert_eq!(filter.diagnostics(wheels).unwrap().accepted, 3);
        filter.state().unwrap()
    };
    let (a, b, c) = (ahead(0.0, 0.1), ahead(0.1, 0.2), ahead(0.199_999_6, 0.3));
    let (in_order, late) = (run([a, b, c]), run([a, c, b]));
    assert!(in_order.pose.mean().minus(late.pose.mean()).norm() < 1e-9);
    assert!((in_order.pose.covariance() - late.pose.covariance()).norm() < 1e-9);
}
