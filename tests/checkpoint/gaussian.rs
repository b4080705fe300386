//! The Kalman family, fusion, landmarks and codes: stored in the middle of a drive, each goes on with the same bits.

use crate::{
    scenes::kalman::{
        bootstrap, bootstrap_bits, fusion, landmark_filter, marker_localizer, run_bootstrap, run_codes, run_fusion,
        run_landmarks, run_smoother, run_ukf, smoother, source_switch, ukf,
    },
    table::{assert_kept, assert_refused, restored},
};
use agv_nav::core::{compute::Par, roles::Localizer};
use serde_json::json;

#[test]
fn an_unscented_filter_goes_on_with_the_same_bits() {
    let mut filter = ukf();
    run_ukf(&mut filter, 0..10);
    let mut resumed = restored(&filter);
    assert_eq!(resumed, filter);
    run_ukf(&mut filter, 10..20);
    run_ukf(&mut resumed, 10..20);
    assert_eq!(resumed, filter);
    assert_refused(
        "Ukf",
        &filter,
        &[
            ("/belief/covariance/0", json!(-1.0)),
            ("/belief/covariance/1", json!(9.0)),
            ("/belief/state/0", json!(null)),
            ("/params/alpha", json!(0.0)),
            ("/params/kappa", json!(-3.0)),
        ],
    );
}

#[test]
fn a_smoother_keeps_the_drive() {
    let mut filter = smoother();
    assert_kept("RtsSmoother before the first step", &filter);
    run_smoother(&mut filter, 0..10);
    let mut resumed = restored(&filter);
    run_smoother(&mut filter, 10..20);
    run_smoother(&mut resumed, 10..20);
    assert_eq!(resumed, filter);
    assert_eq!(resumed.smooth(), filter.smooth());
    assert_refused(
        "RtsSmoother",
        &filter,
        &[
            ("/ekf/covariance/4", json!(-1.0)),
            ("/steps/3/noise/0", json!(-1.0)),
            ("/steps/3/jacobian/5", json!(null)),
            ("/steps/0/before/state/2", json!(null)),
            ("/steps/9/predicted/covariance/8", json!(-1e-3)),
        ],
    );
}

#[test]
fn a_bootstrap_filter_goes_on_with_the_same_bits() {
    let mut filter = bootstrap(Par::Seq);
    assert!(run_bootstrap(&mut filter, 0..5));
    let mut resumed = restored(&filter).with_parallelism(Par::threads(2));
    assert!(bootstrap_bits(&resumed) == bootstrap_bits(&filter));
    run_bootstrap(&mut filter, 5..10);
    run_bootstrap(&mut resumed, 5..10);
    assert!(bootstrap_bits(&resumed) == bootstrap_bits(&filter));
    assert_refused(
        "BootstrapFilter",
        &filter,
        &[
            ("/particles/states/7/1", json!(null)),
            ("/particles/states", json!([])),
            ("/particles/weights/3", json!(-0.5)),
            ("/particles/weights", json!([1.0])),
            ("/particles/log_weights/0", json!(1.0)),
            ("/particles/capacity", json!(usize::MAX)),
            ("/seed", json!(null)),
        ],
    );
}

#[test]
fn a_landmark_filter_goes_on_with_the_same_bits() {
    let mut filter = landmark_filter();
    assert_kept("LandmarkFilter before the first motion", &filter);
    run_landmarks(&mut filter, 0..40);
    let mut resumed = restored(&filter);
    assert_eq!(resumed, filter);
    run_landmarks(&mut filter, 40..80);
    run_landmarks(&mut resumed, 40..80);
    assert_eq!((resumed.estimate(), &resumed), (filter.estimate(), &filter));
    assert_refused(
        "LandmarkFilter",
        &filter,
        &[
            ("/track/tip/ekf/covariance/0", json!(-1.0)),
            ("/track/anchor/ekf/state/parameters/4", json!(null)),
            ("/history/0/piece/read/0", json!(null)),
            ("/history/1/end", json!(0)),
            ("/params/patience", json!(0)),
            ("/params/gate_probability", json!(1.0)),
            ("/map/0/1/0", json!(null)),
        ],
    );
}

#[test]
fn a_fusion_filter_goes_on_with_the_same_bits() {
    let (mut filter, sources) = fusion();
    // In the midst of a history with anchors and a motion that is handed out.
    run_fusion(&mut filter, sources, 0..35);
    let mut resumed = restored(&filter);
    assert_eq!(resumed, filter);
    run_fusion(&mut filter, sources, 35..70);
    run_fusion(&mut resumed, sources, 35..70);
    assert_eq!((resumed.state(), &resumed), (filter.state(), &filter));
    let mut backwards = serde_json::to_value(&filter).unwrap();
    let events = backwards.pointer_mut("/history/events").unwrap().as_array_mut().unwrap();
    events.reverse();
    assert!(serde_json::from_value::<agv_nav::filters::fusion::FusionFilter>(backwards).is_err());
    assert_refused(
        "FusionFilter",
        &filter,
        &[
            ("/params/capacity", json!(1)),
            ("/sources/0/slot", json!(3)),
            ("/sources/1/slot", json!(0)),
            ("/sources/2/params/gate", json!(0.0)),
            ("/traffic", json!([])),
            ("/outlet", json!(9)),
            ("/history/events", json!([])),
            ("/history/states/0/covariance/0/0", json!(null)),
            ("/history/states/0/covariance/0/0", json!(-1.0)),
            ("/history/states/0/covariance/0/1", json!(7.0)),
            ("/history/states/0/map_from_base/rotation/cos", json!(7.0)),
            ("/history/states/0/distance_scale", json!(3.0)),
        ],
    );
}

#[test]
fn codes_and_the_switch_come_back() {
    let (localizer, mut switch) = (marker_localizer(), source_switch());
    assert_kept("MarkerLocalizer", &localizer);
    run_codes(&localizer, &mut switch, 0..1);
    let (twin, mut resumed) = (restored(&localizer), restored(&switch));
    assert_eq!((&twin, resumed), (&localizer, switch));
    assert_eq!(run_codes(&twin, &mut resumed, 1..20), run_codes(&localizer, &mut switch, 1..20));
    assert_eq!(resumed, switch);
    assert_refused(
        "MarkerLocalizer",
        &localizer,
        &[("/params/gate", json!(0.0)), ("/map/3/mean/translation/0", json!(null))],
    );
    assert_refused(
        "SourceSwitch",
        &switch,
        &[
            ("/since_seen", json!(-1.0)),
            ("/since_seen", json!(null)),
            ("/params/leave_radius", json!(0.1)),
            ("/params/confirmations", json!(0)),
            ("/source", json!("Compass")),
        ],
    );
}
