//! Trees of frames, and what a matcher answers.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::core::{
    frames::{FrameTree, FrameTreeParams},
    geometry::{LieGroup, Se2, Se3},
    nalgebra::Matrix3,
    roles::{Alignment, Termination},
    time::Stamp,
};
use serde_json::json;

fn moved(seconds: f64) -> (Stamp, Se3) {
    (Stamp::from_seconds(seconds), Se2::new(0.1 * seconds, 0.3, 0.2 * seconds).into())
}

/// Odometry that wraps around its history, two lasers, and a frame that was cut off.
fn tree() -> FrameTree {
    let mut tree = FrameTree::new(FrameTreeParams { history: 2.0, capacity: 10 }).unwrap();
    tree.set_static("base", "front", Se2::new(0.4, 0.0, 0.1).into()).unwrap();
    tree.set_static("base", "rear", Se2::new(-0.4, 0.0, 3.1).into()).unwrap();
    tree.set_static("base", "gripper", Se3::identity()).unwrap();
    tree.detach("gripper").unwrap();
    for step in 0..30 {
        let (stamp, pose) = moved(0.1 * f64::from(step));
        tree.insert("odom", "base", stamp, pose).unwrap();
    }
    tree
}

#[test]
fn a_tree_of_frames_goes_on_with_the_same_bits() {
    assert_kept("FrameTree without frames", &FrameTree::new(FrameTreeParams::default()).unwrap());
    let mut tree = tree();
    assert_kept("FrameTree", &tree);
    let mut resumed = restored(&tree);
    for tree in [&mut tree, &mut resumed] {
        let (stamp, pose) = moved(3.05);
        tree.insert("odom", "base", stamp, pose).unwrap();
    }
    for seconds in [2.25, 2.5, 3.02, 3.05] {
        let looked = [&tree, &resumed].map(|tree| tree.lookup("rear", "odom", Stamp::from_seconds(seconds)));
        assert!(looked[0].is_ok() && looked[0] == looked[1], "{seconds}");
    }
    // What has left the history has left both.
    let early = Stamp::from_seconds(1.0);
    assert!(tree.lookup("odom", "base", early).is_err() && resumed.lookup("odom", "base", early).is_err());
    assert_eq!(resumed.parent("gripper"), Ok(None));
}

#[test]
fn spoilt_trees_are_refused() {
    let tree = tree();
    let stored = serde_json::to_value(&tree).unwrap();
    let of = |name: &str| {
        let frames = stored["frames"].as_array().unwrap();
        format!("/frames/{}", frames.iter().position(|frame| frame["name"] == name).unwrap())
    };
    let (base, front) = (of("base"), of("front"));
    assert_refused(
        "FrameTree",
        &tree,
        &[
            ("/params/history".to_owned(), json!(0.0)),
            ("/params/capacity".to_owned(), json!(1)),
            (format!("{base}/name"), json!("odom")),
            (format!("{base}/name"), json!("")),
            (format!("{base}/edge/parent"), json!("base")),
            (format!("{base}/edge/parent"), json!("front")),
            (format!("{base}/edge/parent"), json!("nobody")),
            (format!("{base}/edge/motion/Moving"), json!([])),
            (
                format!("{base}/edge/motion/Moving/3/0"),
                stored.pointer(&format!("{base}/edge/motion/Moving/4/0")).unwrap().clone(),
            ),
            (format!("{base}/edge/motion/Moving/3/1/translation/0"), json!(null)),
            (format!("{front}/edge/motion/Static/translation/1"), json!(null)),
        ],
    );
}

#[test]
fn alignments_come_back() {
    let mut flat = Alignment::unknown(Se2::new(0.1, 0.2, 0.3), Termination::IterationLimit);
    (flat.score, flat.inlier_ratio, flat.iterations) = (-12.3, 0.7, 30);
    flat.information = Matrix3::new(4.0, 0.1, 0.0, 0.1, 3.0, 0.2, 0.0, 0.2, 9.0);
    assert_kept("Alignment in the plane", &flat);
    assert_eq!(restored(&flat), flat);
    let deep = Alignment::unknown(Se3::from(Se2::new(0.1, 0.2, 0.3)), Termination::TooFewPoints);
    assert_eq!(restored(&deep), deep);
    assert_refused(
        "Alignment",
        &flat,
        &[
            ("/target_from_source/rotation/cos", json!(7.0)),
            ("/information/0", json!(null)),
            ("/termination", json!("Bored")),
        ],
    );
}
