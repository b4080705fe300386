//! Checkpoints.

use super::*;
use crate::slam::RbpfCheckpoint;

/// Killed at a moment with motion pending, and again without odometry.
#[test]
fn a_resumed_run_goes_on_with_the_same_bits() {
    let steps = drive(laser(91, 1.5 * PI), 80, 0.4);
    for with_wheels in [true, false] {
        let run = |slam: &mut Filter, steps: &[Step]| {
            for step in steps {
                if with_wheels {
                    slam.predict(&odometry(step.wheels)).unwrap();
                }
                slam.update(&step.scan).unwrap();
            }
        };
        let mut straight = filter(6);
        run(&mut straight, &steps[..43]);
        let text = serde_json::to_string(&straight.checkpoint()).unwrap();
        let stored: RbpfCheckpoint = serde_json::from_str(&text).unwrap();
        let mut resumed = filter(6);
        resumed.restore(&stored).unwrap();
        assert_eq!(serde_json::to_string(&resumed.checkpoint()).unwrap(), text);
        // What maps shared they share again: but for tables, the same memory.
        assert!(resumed.memory() < straight.memory() + 100_000);
        run(&mut straight, &steps[43..]);
        run(&mut resumed, &steps[43..]);
        let end = |slam: &Filter| serde_json::to_string(&slam.checkpoint()).unwrap();
        assert!(end(&straight) == end(&resumed));
    }
}

#[test]
fn checkpoints_that_do_not_fit_are_refused_and_change_nothing() {
    let steps = drive(laser(91, 1.5 * PI), 20, 0.1);
    let mut slam = filter(4);
    run(&mut slam, &steps);
    let stored = serde_json::to_value(slam.checkpoint()).unwrap();
    let mut other = filter(5);
    assert!(other.restore(&slam.checkpoint()).is_err());
    for (path, bad) in [
        ("/scores", "[0, 0, 0]"),
        ("/scores/0", "null"),
        ("/maps/0", "99"),
        ("/sheets/0/0/1", "99999"),
        ("/sheets/0/0/0/0", "2147483647"),
        ("/resolution", "0.1"),
        ("/tree/leaves/1", "123456"),
        ("/tree/nodes/1/parent", "1"),
        ("/tree/swept", "99999999999"),
        ("/steps", "[]"),
        ("/tiles/0/passes", "[1, 2]"),
        ("/tiles/0/met/0", "4294967295"),
        ("/particles/weights/0", "0.9"),
    ] {
        let mut damaged = stored.clone();
        let value = serde_json::from_str(bad).unwrap();
        *damaged.pointer_mut(path).unwrap_or_else(|| panic!("{path}")) = value;
        let refused = match serde_json::from_value::<RbpfCheckpoint>(damaged) {
            Ok(stored) => slam.restore(&stored).is_err(),
            Err(_) => true,
        };
        assert!(refused, "{path}");
        assert!(serde_json::to_value(slam.checkpoint()).unwrap() == stored, "{path}");
    }
    // Far off all together: as wide as before, where cells are not counted any more.
    let mut damaged = stored.clone();
    for sheet in damaged["sheets"].as_array_mut().unwrap() {
        for tile in sheet.as_array_mut().unwrap() {
            let x = tile[0][0].as_i64().unwrap();
            tile[0][0] = (x + i64::from(i32::MAX) - 1000).into();
        }
    }
    let damaged: RbpfCheckpoint = serde_json::from_value(damaged).unwrap();
    assert!(slam.restore(&damaged).unwrap_err().to_string().contains("place of a tile"));
    // One without any scan is fine.
    let fresh = filter(4).checkpoint();
    slam.restore(&fresh).unwrap();
    assert!(slam.trajectory().is_empty());
}
