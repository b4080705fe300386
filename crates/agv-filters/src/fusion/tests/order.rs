//! Order of arrival, history and clocks.

use super::*;

#[derive(Clone, Copy)]
enum Source {
    Wheels,
    Gyro,
    Tracker,
    Beacon,
    Own,
}

/// Three seconds of a drive in order of time, each measurement with its source and time.
fn drive(seed: u64) -> Vec<(f64, Source, Measurement)> {
    let mut truth = Wanderer::new(FusionParams::default(), seed);
    let (mut messages, mut last) = (Vec::new(), (0.0, truth.pose));
    for step in 1..=300 {
        truth.step();
        let now = truth.time();
        messages.push((now, Source::Gyro, rates(now, truth.twist.yaw_rate, 1e-3).into()));
        if step % 3 == 0 {
            let read = last.1.between(&truth.pose).plus(&truth.noisy([1e-3, 1e-3, 1e-3]));
            messages.push((now, Source::Wheels, motion(last.0, &Se2::default(), now, &read, Matrix3::zeros()).into()));
            last = (now, truth.pose);
        }
        if step % 20 == 0 {
            let error = truth.noisy([0.02, 0.02, 0.01]);
            let pose = truth.pose.plus(&error);
            messages.push((now, Source::Tracker, seen(now, pose, squares([0.02, 0.02, 0.01])).into()));
        }
        if step % 25 == 0 {
            let pose = Se2::new(4.0, -1.0, 2.0) * truth.pose;
            messages.push((now, Source::Own, seen(now, pose, squares([0.02, 0.02, 0.01])).into()));
        }
        if step % 45 == 0 {
            let place = UncertainVector::from_sigmas(truth.pose.translation(), &Vector2::repeat(0.1)).unwrap();
            messages.push((now, Source::Beacon, PositionObservation::new(at(now), place).into()));
        }
    }
    messages
}

fn filter(params: FusionParams) -> (FusionFilter, [SourceId; 5]) {
    let mut filter = FusionFilter::new(params).unwrap();
    let own = SourceParams { reference: Reference::First, ..SourceParams::pose() };
    let sources = [SourceParams::wheels(), SourceParams::imu(), SourceParams::pose(), SourceParams::position(), own]
        .map(|source| filter.add_source(SourceParams { gate: 0.99, ..source }).unwrap());
    filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
    (filter, sources)
}

fn fuse_all(filter: &mut FusionFilter, ids: [SourceId; 5], messages: &[(f64, Source, Measurement)]) {
    for (_, source, measurement) in messages {
        filter.fuse(ids[*source as usize], *measurement).unwrap();
    }
}

/// Messages delayed at random, by up to `most` seconds.
fn delayed(messages: &[(f64, Source, Measurement)], most: f64, seed: u64) -> Vec<(f64, Source, Measurement)> {
    let mut stream = Seed(seed).stream(0, 0);
    let mut by_arrival: Vec<_> =
        messages.iter().map(|m| (m.0 + most * (0.3 * normal(&mut stream)).abs().min(1.0), *m)).collect();
    by_arrival.sort_by(|a, b| a.0.total_cmp(&b.0));
    by_arrival.into_iter().map(|(_, message)| message).collect()
}

fn assert_same(a: &FusionFilter, b: &FusionFilter, ids: [SourceId; 5], tolerance: f64) {
    let (x, y) = (a.state().unwrap(), b.state().unwrap());
    assert_eq!(x.stamp, y.stamp);
    assert!(x.pose.mean().minus(y.pose.mean()).norm() <= tolerance);
    assert!((x.pose.covariance() - y.pose.covariance()).norm() <= tolerance);
    assert!((Vector3::from(x.twist) - Vector3::from(y.twist)).norm() <= tolerance);
    assert!((x.twist_covariance - y.twist_covariance).norm() <= tolerance);
    assert!((x.gyro_bias.0 - y.gyro_bias.0).abs() <= tolerance);
    for id in ids {
        let [p, q] = [a, b].map(|filter| filter.diagnostics(id).unwrap());
        assert_eq!((p.accepted, p.gated, p.dropped), (q.accepted, q.gated, q.dropped));
    }
}

/// Whatever the order of arrival, the belief is the one of the order of time; without motions to the bit.
#[test]
fn order_of_arrival_does_not_matter() {
    for seed in 0..5 {
        let messages = drive(seed);
        let without_motions: Vec<_> = messages.iter().copied().filter(|m| !matches!(m.1, Source::Wheels)).collect();
        for (messages, tolerance) in [(messages, 1e-12), (without_motions, 0.0)] {
            let (mut in_order, ids) = filter(FusionParams::default());
            fuse_all(&mut in_order, ids, &messages);
            for most in [0.05, 0.4] {
                let (mut late, ids) = filter(FusionParams::default());
                let arrived = delayed(&messages, most, seed + 10);
                assert!(arrived.windows(2).any(|pair| pair[0].0 > pair[1].0), "nothing was late");
                fuse_all(&mut late, ids, &arrived);
                assert_same(&in_order, &late, ids, tolerance);
            }
        }
    }
}

/// What comes later than the history reaches is left out and counted, and nothing else changes.
#[test]
fn the_history_is_bounded() {
    let params = FusionParams { history: 0.2, capacity: 12, clock_patience: 1000, ..FusionParams::default() };
    let (mut filter, ids) = filter(params);
    let messages = drive(1);
    let (late, rest): (Vec<_>, Vec<_>) =
        messages.iter().copied().partition(|m| matches!(m.1, Source::Tracker) && m.0 < 1.0);
    fuse_all(&mut filter, ids, &rest);
    let before = filter.clone();
    for (_, _, measurement) in &late {
        assert_eq!(filter.fuse(ids[2], *measurement), Ok(FusionOutcome::TooOld));
    }
    assert_eq!(filter.state(), before.state());
    assert_eq!(filter.diagnostics(ids[2]).unwrap().dropped, late.len() as u64);
    assert_eq!(filter.state_at(at(1.0)), None);
    // In order, a small history makes no difference.
    let (mut large, ids) = self::filter(FusionParams { clock_patience: 1000, ..FusionParams::default() });
    fuse_all(&mut large, ids, &rest);
    assert_eq!(filter.state(), large.state());
}

#[test]
fn duplicates_count_once() {
    let (mut filter, ids) = filter(FusionParams::default());
    fuse_all(&mut filter, ids, &drive(2));
    let before = filter.state();
    for (_, source, measurement) in drive(2).iter().rev().take(20) {
        assert_eq!(filter.fuse(ids[*source as usize], *measurement), Ok(FusionOutcome::Duplicate));
    }
    assert_eq!(filter.state(), before);
}

/// The past can be asked for, and is what it was; the future is the motion that goes on.
#[test]
fn any_time_can_be_asked_for() {
    let (mut filter, ids) = filter(FusionParams::default());
    let messages = drive(3);
    let (early, late): (Vec<_>, Vec<_>) = messages.iter().copied().partition(|m| m.0 <= 2.4);
    fuse_all(&mut filter, ids, &early);
    let then = filter.state().unwrap();
    fuse_all(&mut filter, ids, &late);
    assert_eq!(filter.state_at(then.stamp), Some(then));
    let (now, ahead) = (filter.state().unwrap(), filter.state_at(filter.state().unwrap().stamp + 0.1).unwrap());
    let coasted = *now.pose.mean() * now.twist.integrate(0.1);
    assert!(ahead.pose.mean().minus(&coasted).norm() < 2e-3);
    assert!(ahead.pose.position_deviation() > now.pose.position_deviation());
}

/// A stamp that lies hours ahead is a mistake; ten of them are a clock that was set, in either direction.
#[test]
fn clocks_that_jump_are_noticed() {
    for jump in [7200.0, -7200.0] {
        let (mut filter, ids) = filter(FusionParams::default());
        fuse_all(&mut filter, ids, &drive(4));
        let before = filter.state().unwrap();
        let shifted = |time: f64| rates(3.0 + jump + time, before.twist.yaw_rate, 1e-3);
        let expected = if jump > 0.0 { FusionOutcome::TooEarly } else { FusionOutcome::TooOld };
        assert_eq!(filter.fuse(ids[1], shifted(0.0)), Ok(expected));
        assert_eq!(filter.state(), Some(before), "one is ignored");
        filter.fuse(ids[1], rates(3.01, before.twist.yaw_rate, 1e-3)).unwrap();
        for i in 1..10 {
            assert_eq!(filter.fuse(ids[1], shifted(0.01 * f64::from(i))), Ok(expected));
        }
        assert!(matches!(filter.fuse(ids[1], shifted(0.1)), Ok(FusionOutcome::Applied { .. })));
        let after = filter.state().unwrap();
        assert_eq!(after.stamp, at(3.1 + jump));
        assert!(after.pose.position_deviation().is_finite());
        let moved = after.pose.mean().minus(before.pose.mean()).norm();
        if jump < 0.0 {
            assert!(moved < 0.05, "the vehicle is where it was");
        } else {
            assert!(after.pose.position_deviation() > 100.0, "two hours may lead anywhere");
        }
        // Odometry takes up again, from where it begins.
        let still = motion(3.1 + jump, &Se2::default(), 3.2 + jump, &Se2::default(), squares([1e-3; 3]));
        assert!(matches!(filter.fuse(ids[0], still), Ok(FusionOutcome::Applied { .. } | FusionOutcome::Gated { .. })));
    }
}

/// What a source sends late, and older than the history reaches, is a backlog as long as its own clock goes on.
#[test]
fn a_backlog_is_no_jump_of_the_clock() {
    let (mut filter, ids) = filter(FusionParams::default());
    fuse_all(&mut filter, ids, &drive(5));
    // The second gyro was silent for long.
    let second = filter.add_source(SourceParams::imu()).unwrap();
    filter.fuse(second, rates(2.5, 0.0, 1.0)).unwrap();
    for time in [4.5, 6.0] {
        filter.fuse(ids[1], rates(time, 0.0, 1.0)).unwrap();
    }
    let before = filter.state();
    for i in 0..100 {
        let late = rates(2.6 + 0.01 * f64::from(i), 0.0, 1e-3);
        assert_eq!(filter.fuse(second, late), Ok(FusionOutcome::TooOld));
    }
    assert_eq!((filter.state(), filter.diagnostics(second).unwrap().dropped), (before, 100));
}

/// Before anything is measured a belief without a time holds at any.
#[test]
fn a_belief_without_a_time_does_not_age() {
    let (mut filter, _) = filter(FusionParams::default());
    filter.initialize(&belief(Se2::new(1.0, 2.0, 3.0))).unwrap();
    let (state, later) = (filter.state().unwrap(), filter.state_at(at(1.7e9)).unwrap());
    assert_eq!((later.pose, later.stamp), (state.pose, at(1.7e9)));
}
