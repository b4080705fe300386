//! Paths on the map, blue forwards and red backwards, with the vehicle's outline along them.

use crate::{
    Result,
    run::{Run, Runs},
    site::Site,
};
use agv_core::{
    geometry::Se2,
    grid::{CellState, Footprint, Grid},
    nalgebra::Vector2,
    path::Gear,
    roles::PlanOutcome,
};
use agv_support::plot::{Color, Scene};
use std::path::Path;

/// Paths that are drawn.
const DRAWN: usize = 6;

pub(crate) fn write(out: &Path, site: &Site, all: &Runs) -> Result<()> {
    let drawn = all.answers.iter().filter(|run| matches!(run.outcome, PlanOutcome::Found { .. })).take(DRAWN);
    draw("Paths of a vehicle that steers", &site.map, &all.footprint, drawn, (1200, 3.0))
        .write(out.join("paths.svg"))?;
    Ok(())
}

/// A scene of some paths, `width` pixels wide, with an outline `every` so many metres.
pub(crate) fn draw<'a>(
    title: &str,
    map: &Grid<CellState>,
    footprint: &Footprint,
    runs: impl IntoIterator<Item = &'a Run>,
    (width, every): (u32, f64),
) -> Scene {
    let mut scene = Scene::new(title).width(width).map(map);
    // A name appears once in the legend.
    let mut named = Vec::new();
    let mut once = move |label: &'static str| {
        let is_new = !named.contains(&label);
        named.push(label);
        if is_new { label } else { "" }
    };
    for run in runs {
        let points = run.path.points();
        // Outlines every so many metres and at each cusp.
        let mut since = f64::INFINITY;
        for (i, pair) in points.windows(2).enumerate() {
            let cusp = pair[0].gear != pair[1].gear;
            if since > every || cusp {
                since = 0.0;
                scene = scene.line("", Color::Grey, outline(footprint, &pair[0].pose));
            }
            since += (pair[1].pose.translation() - pair[0].pose.translation()).norm();
            if i + 2 == points.len() {
                scene = scene.line("", Color::Black, outline(footprint, &pair[1].pose));
            }
        }
        for gear in [Gear::Forward, Gear::Reverse] {
            let (label, color) =
                if gear == Gear::Forward { ("forwards", Color::Blue) } else { ("backwards", Color::Red) };
            let mut stretch: Vec<Vector2<f64>> = Vec::new();
            for pair in points.windows(2) {
                if pair[1].gear == gear {
                    if stretch.is_empty() {
                        stretch.push(pair[0].pose.translation());
                    }
                    stretch.push(pair[1].pose.translation());
                } else if !stretch.is_empty() {
                    scene = scene.line(once(label), color, std::mem::take(&mut stretch));
                }
            }
            if !stretch.is_empty() {
                scene = scene.line(once(label), color, stretch);
            }
        }
        scene = scene.mark(once("start"), Color::Green, run.query.0.translation());
        scene = scene.mark(once("goal"), Color::Orange, run.query.1.translation());
    }
    scene
}

fn outline(footprint: &Footprint, pose: &Se2) -> Vec<Vector2<f64>> {
    let vertices = footprint.vertices().unwrap_or_default();
    vertices.iter().chain(vertices.first()).map(|v| *pose * *v).collect()
}
