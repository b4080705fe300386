//! Pictures as in Figs 18 to 23 of paper 000: the map, key nodes and track; speed, turn rate and heading over time.

use crate::{Result, drive::Driven};
use agv_sim::Shape;
use agv_support::plot::{Color, Scene, TimeSeries, circle};
use std::path::Path;

/// Draws a drive.
pub(crate) fn draw(out: &Path, name: &str, drive: &Driven) -> Result<()> {
    let mut scene =
        Scene::new(format!("{name}: {:?} after {:.1} s", drive.status, drive.time)).width(900).map(&drive.map);
    for (index, shape) in drive.unknown.iter().enumerate() {
        if let Shape::Circle { center, radius } = shape {
            let label = if index == 0 { "unknown" } else { "" };
            scene = scene.line(label, Color::Red, circle(center, *radius));
        }
    }
    for disc in drive.moving.discs() {
        let states = (0..40).filter_map(|k| disc.at(f64::from(k) * disc.period() / 40.0).ok());
        scene = scene.line("moving", Color::Purple, states.map(|state| state.position));
        if let Ok(state) = disc.at(drive.time) {
            scene = scene.line("", Color::Purple, circle(&state.position, disc.radius()));
        }
    }
    scene = scene.line("first path", Color::Sky, drive.path.iter().copied());
    for (index, node) in drive.path.iter().enumerate() {
        scene = scene.mark(if index == 0 { "key nodes" } else { "" }, Color::Orange, *node);
    }
    scene
        .line("driven", Color::Blue, drive.track.iter().map(|(_, pose, _)| pose.translation()))
        .mark("goal", Color::Green, drive.goal.translation())
        .write(out.join(format!("{name}.png")))?;
    let curve = |of: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
        drive.track.iter().enumerate().map(|(index, (time, ..))| (*time, of(index))).collect()
    };
    TimeSeries::new(name, "time (s)", "m/s, rad/s, rad")
        .curve("speed", Color::Blue, curve(&|i| drive.track[i].2.twist.vx))
        .curve("turn rate", Color::Orange, curve(&|i| drive.track[i].2.twist.yaw_rate))
        .curve("heading", Color::Green, curve(&|i| drive.track[i].1.yaw()))
        .write(out.join(format!("{name}_motion.png")))?;
    Ok(())
}
