//! Filters.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::{
        adaptive_bits, adaptive_filter, circle, filter_bits, initialized,
        kalman::{bootstrap, bootstrap_bits, run_bootstrap},
        localize, localize_adaptively, scan_filter,
    },
};
use agv_nav::core::{
    compute::Par,
    roles::{Localizer, PoseBelief},
};

#[test]
fn monte_carlo_localisation_does_not_depend_on_threads() {
    let drive = circle(12);
    // Not a multiple of the chunk, and several chunks per thread.
    assert_same_bits("Mcl around a pose", |par| {
        let mut filter = initialized(3001, par);
        assert!(localize(&mut filter, &drive), "the drive must exercise resampling");
        Digest::new().bits(filter_bits(&filter))
    });
    assert_same_bits("Mcl from anywhere", |par| {
        let mut filter = scan_filter(5000, par);
        filter.initialize(&PoseBelief::Anywhere).unwrap();
        localize(&mut filter, &drive[..4]);
        Digest::new().bits(filter_bits(&filter))
    });
}

#[test]
fn adaptive_monte_carlo_localisation_does_not_depend_on_threads() {
    let drive = circle(12);
    assert_same_bits("Amcl from anywhere", |par| {
        let mut filter = adaptive_filter(par);
        assert!(localize_adaptively(&mut filter, &drive) > 0, "the drive must exercise the search");
        Digest::new().bits(adaptive_bits(&filter))
    });
}

#[test]
fn a_bootstrap_filter_does_not_depend_on_threads() {
    assert_same_bits("BootstrapFilter", |par| {
        let mut filter = bootstrap(par);
        assert!(run_bootstrap(&mut filter, 0..8), "the drive must exercise resampling");
        Digest::new().bits(bootstrap_bits(&filter))
    });
}

#[test]
fn the_same_run_twice_is_the_same() {
    let drive = circle(3);
    let run = |particles| {
        let mut filter = initialized(particles, Par::Seq);
        localize(&mut filter, &drive);
        filter_bits(&filter)
    };
    assert_eq!(run(600), run(600));
    assert_ne!(run(600), run(601));
}
