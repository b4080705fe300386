//! Robots of MRCLAM 6 among landmarks, at every pose of the motion capture system. Skipped where the shared data is not
//! present.

#[path = "../../examples/landmarks/replay.rs"]
#[allow(dead_code, reason = "the example draws what it has")]
mod replay;
#[path = "../../examples/landmarks/settings.rs"]
mod settings;

use agv_support::mrclam::MrclamLog;
use std::path::Path;

#[test]
fn robots_among_landmarks_keep_their_bounds() {
    let shared = |root: &Path| Some(root.join("shared/data/landmarks/mrclam6")).filter(|folder| folder.is_dir());
    let Some(folder) = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find_map(shared) else {
        eprintln!("skipped: MRCLAM 6 is not beside the repository");
        return;
    };
    // Half of what a plain filter reaches, or a little more.
    for (robot, bound) in [(1, 0.15), (2, 0.18), (4, 0.20)] {
        let log = MrclamLog::read(&folder, robot).unwrap();
        let run = replay::replay(&log, &settings::of_the_make(true)).unwrap();
        let mean = |of: fn(&replay::Sample) -> f64| run.samples.iter().map(of).sum::<f64>() / run.samples.len() as f64;
        let (rmse, nees) = (mean(|one| one.error.xy().norm_squared()).sqrt(), mean(|one| one.nees));
        eprintln!("robot {robot}: {rmse:.3} m, NEES {nees:.1}, {} used, {} rejected", run.used, run.rejected);
        assert!(rmse < bound && (1.5..=6.0).contains(&nees), "robot {robot}");
        assert!(run.rejected * 100 < run.used, "robot {robot}");
    }
}
