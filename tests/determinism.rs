//! Same inputs and seed, same bits: for any number of threads, and across a checkpoint.
//!
//! A component is added by a function that runs it under a [`Par`] and returns every number that it can show, as bits.

mod scenes;

use agv_nav::core::{
    compute::Par,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
};
use agv_nav::nalgebra::Matrix3;
use scenes::ScanFilter;

/// Runs `component` with one, two and four threads, inside pools of one, two and four, and compares the bits.
fn assert_same_bits(name: &str, component: impl Fn(Par) -> Vec<u64> + Sync) {
    let reference = component(Par::Seq);
    assert!(!reference.is_empty());
    for pool_threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(pool_threads).build().unwrap();
        for par in [Par::Seq, Par::threads(2), Par::threads(4)] {
            let bits = pool.install(|| component(par));
            assert_eq!(bits, reference, "{name} differs with {par:?} in a pool of {pool_threads}");
        }
    }
}

/// Particles, weights and estimate of a filter.
fn bits_of(filter: &ScanFilter) -> Vec<u64> {
    let estimate = filter.estimate();
    let pose = |p: &agv_nav::core::geometry::Se2| [p.x(), p.y(), p.rotation().cos(), p.rotation().sin()];
    let particles = filter.particles().poses().iter().flat_map(pose);
    let weights = filter.particles().weights().iter().chain(filter.particles().log_weights()).copied();
    let mean = pose(&estimate.map_from_base).into_iter().chain(estimate.covariance.iter().copied());
    particles.chain(weights).chain(mean.collect::<Vec<_>>()).map(f64::to_bits).collect()
}

fn localize(filter: &mut ScanFilter, steps: std::ops::Range<usize>) {
    for (motion, scan) in &scenes::circle(steps.end)[steps] {
        filter.predict(motion).unwrap();
        assert_eq!(filter.update(scan), Ok(UpdateOutcome::Applied));
    }
}

fn initialized(particles: usize, par: Par) -> ScanFilter {
    let mut filter = scenes::scan_filter(particles, par);
    filter.initialize(&PoseBelief::around(scenes::start(), Matrix3::identity() * 0.04)).unwrap();
    filter
}

#[test]
fn monte_carlo_localisation_does_not_depend_on_threads() {
    // Not a multiple of the chunk, and several chunks per thread.
    assert_same_bits("Mcl around a pose", |par| {
        let mut filter = initialized(3001, par);
        localize(&mut filter, 0..12);
        bits_of(&filter)
    });
    assert_same_bits("Mcl from anywhere", |par| {
        let mut filter = scenes::scan_filter(5000, par);
        filter.initialize(&PoseBelief::Anywhere).unwrap();
        localize(&mut filter, 0..4);
        bits_of(&filter)
    });
}

#[test]
fn another_seed_gives_another_run() {
    let run = |particles| {
        let mut filter = initialized(particles, Par::Seq);
        localize(&mut filter, 0..3);
        bits_of(&filter)
    };
    assert_eq!(run(600), run(600));
    assert_ne!(run(600), run(601));
}

#[cfg(feature = "serde")]
#[test]
fn a_resumed_filter_continues_with_the_same_bits() {
    use agv_nav::filters::particle::MclCheckpoint;

    let mut uninterrupted = initialized(1000, Par::Seq);
    localize(&mut uninterrupted, 0..5);
    // Odometry that is pending must survive as well.
    let (motion, _) = &scenes::circle(1)[0];
    let small = agv_nav::core::odometry::OdometryIncrement {
        start_from_end: agv_nav::core::geometry::Se2::new(0.03, 0.001, 0.02),
        ..*motion
    };
    uninterrupted.predict(&small).unwrap();

    let text = serde_json::to_string(&uninterrupted.checkpoint()).unwrap();
    let checkpoint: MclCheckpoint = serde_json::from_str(&text).unwrap();
    let mut resumed = scenes::scan_filter(10, Par::threads(2));
    resumed.restore(&checkpoint).unwrap();
    assert_eq!(bits_of(&resumed), bits_of(&uninterrupted));
    localize(&mut uninterrupted, 5..12);
    localize(&mut resumed, 5..12);
    assert_eq!(bits_of(&resumed), bits_of(&uninterrupted));
}

#[cfg(feature = "serde")]
#[test]
fn a_spoilt_checkpoint_is_refused_and_changes_nothing() {
    let mut filter = initialized(50, Par::Seq);
    let before = bits_of(&filter);
    let good = serde_json::to_value(filter.checkpoint()).unwrap();
    for (path, value) in [
        ("/poses/3/0", serde_json::json!(5.0)),
        ("/poses/3/2", serde_json::json!(7.0)),
        ("/weights/3", serde_json::json!(-0.5)),
        ("/weights", serde_json::json!([1.0])),
        ("/log_weights/0", serde_json::json!(1.0)),
        ("/poses", serde_json::json!([])),
    ] {
        let mut spoilt = good.clone();
        *spoilt.pointer_mut(path).unwrap() = value;
        let checkpoint = serde_json::from_value(spoilt).unwrap();
        if path == "/poses/3/0" {
            // Another finite position is a valid state: the check must not be stricter than the filter.
            assert!(scenes::scan_filter(1, Par::Seq).restore(&checkpoint).is_ok());
            continue;
        }
        assert!(filter.restore(&checkpoint).is_err(), "{path}");
        assert_eq!(bits_of(&filter), before, "{path}");
    }
}
