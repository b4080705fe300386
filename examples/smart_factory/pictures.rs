//! What the paper's Figs 5 to 11 show, and with more than one run its Fig. 16.

use crate::{Result, localization::Lap, mapping::Mapped, navigation::Driven};
use agv_nav::prelude::Se2;
use agv_support::{
    map,
    plot::{Color, Scene, TimeSeries, circle},
};
use std::path::Path;

const COLORS: [Color; 6] = [Color::Blue, Color::Orange, Color::Green, Color::Red, Color::Purple, Color::Sky];

pub(crate) fn write(out: &Path, mapped: &Mapped, laps: &[Lap], driven: &Driven) -> Result<()> {
    map::write(out.join("map.yaml"), &mapped.grid)?;
    Scene::new("The 3D map from above, and the drive that made it")
        .cloud(&mapped.cloud)
        .trajectory("true", Color::Green, &mapped.truths)
        .trajectory("mapped", Color::Blue, &mapped.estimates)
        .write(out.join("map_3d.png"))?;
    Scene::new("The grid that was made of it").map(&mapped.grid).write(out.join("map_2d.png"))?;
    let curve = |times: &[f64], errors: Vec<f64>| times.iter().copied().zip(errors).collect::<Vec<_>>();
    TimeSeries::new("Error of the mapping drive", "time, s", "error, m")
        .curve("position", Color::Blue, curve(&mapped.times, mapped.errors()))
        .write(out.join("mapping_error.svg"))?;

    let mut scene = Scene::new("Laps, localised in the map").map(&mapped.grid);
    let mut errors = TimeSeries::new("Localisation error", "time, s", "error, m");
    for (lap, color) in laps.iter().zip(COLORS) {
        let label = format!("{} m/s", lap.speed);
        let first: Vec<Se2> = lap.own.estimates.iter().take(lap.truths.len()).copied().collect();
        scene = scene.trajectory(&label, color, &first);
        errors = errors.curve(&label, color, curve(&lap.times, lap.own.distances().take(lap.times.len()).collect()));
    }
    scene.write(out.join("localization.png"))?;
    errors.write(out.join("localization_error.svg"))?;
    let mut ends = TimeSeries::new("Error at the end of each run", "run", "error, cm");
    for (lap, color) in laps.iter().zip(COLORS).filter(|(lap, _)| lap.ends.len() > 1) {
        let run = |(run, end): (usize, &[f64; 3])| ((run + 1) as f64, 100.0 * end[0].hypot(end[1]));
        ends = ends.curve(&format!("{} m/s", lap.speed), color, lap.ends.iter().enumerate().map(run));
    }
    if laps.iter().any(|lap| lap.ends.len() > 1) {
        ends.write(out.join("repeatability.svg"))?;
    }

    let planned: Vec<Se2> = driven.planned.points().iter().map(|point| point.pose).collect();
    let mut scene = Scene::new("Planned by A*, driven by TEB")
        .map(&mapped.grid)
        .trajectory("A*, first goal", Color::Orange, &planned)
        .trajectory("driven", Color::Blue, &driven.truths);
    for place in &driven.goods {
        scene = scene.line("goods that the map does not know", Color::Red, circle(&place.xy(), 0.5));
    }
    for goal in &driven.goals {
        scene = scene.mark("goal", Color::Green, goal.translation());
    }
    scene.mark("start", Color::Purple, driven.start.translation()).write(out.join("drive.png"))?;
    Ok(())
}
