//! Convergence and paths, as in Figs. 6, 7, 10 and 11 of paper 002.

use super::{Result, cases::Set, trials::Trials};
use agv_support::plot::{Color, Scene, TimeSeries};
use std::path::Path;

/// What is drawn of the ladder, over one another.
const PATHS: [(&str, Color); 4] = [
    ("ACO", Color::Red),
    ("heuristic", Color::Orange),
    ("pheromone (IACO)", Color::Sky),
    ("IACO, key nodes", Color::Blue),
];
const CURVES: [(&str, Color); 6] = [
    ("ACO", Color::Red),
    ("ACO, goal seen", Color::Purple),
    ("heuristic", Color::Orange),
    ("pheromone (IACO)", Color::Blue),
    ("refined", Color::Green),
    ("ISSA", Color::Grey),
];

/// Greatest length that is drawn over the iterations, as a ratio to the shortest octile path.
const FAR: f64 = 1.3;

pub(crate) fn draw(set: &Set, trials: &Trials, out: &Path) -> Result<()> {
    let Some(case) = set.cases.first() else { return Ok(()) };
    let shown = |name: &str| trials.shown.iter().find(|shown| shown.name == name);
    let mut scene =
        Scene::new(format!("{}, map {}: shortest of all runs", set.title, case.name)).width(900).map(&case.map);
    for (name, color) in PATHS {
        if let Some(shown) = shown(name) {
            scene = scene.trajectory(name, color, shown.path.points().iter().map(|point| &point.pose));
        }
    }
    let scene =
        scene.mark("start", Color::Green, case.start.translation()).mark("goal", Color::Black, case.goal.translation());
    for kind in ["svg", "png"] {
        scene.write(out.join(format!("{}_paths.{kind}", set.key)))?;
    }
    let title = format!("{}, map {}: best length so far, mean over seeds", set.title, case.name);
    let mut series = TimeSeries::new(title, "iteration", "length [m]");
    for (name, color) in CURVES {
        if let Some(shown) = shown(name) {
            let points = shown.convergence.iter().enumerate().map(|(i, &length)| ((i + 1) as f64, length));
            // What is far off would leave the rest no room.
            series = series.curve(name, color, points.filter(|&(_, length)| length < FAR * case.octile));
        }
    }
    for kind in ["svg", "png"] {
        series.write(out.join(format!("{}_convergence.{kind}", set.key)))?;
    }
    Ok(())
}
