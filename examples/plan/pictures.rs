//! The longest path, with what was looked at to find it.

use super::{Args, Result, planners::Planner, site::Site};
use agv_nav::core::path;
use agv_support::plot::{Color, Scene};
use std::path::Path;

pub(crate) fn longest(file: &Path, args: &Args, site: &Site, planner: &mut dyn Planner) -> Result<()> {
    let length = |query: &&super::site::Query| {
        query.optimum.unwrap_or_else(|| (query.goal.translation() - query.start.translation()).norm())
    };
    let Some(query) = site.queries.iter().max_by(|a, b| length(a).total_cmp(&length(b))) else { return Ok(()) };
    let mut way = path::Path::new();
    if planner.plan_into(&site.costmap, &query.start, &query.goal, &mut way).is_err() {
        return Ok(()); // off the map: nothing to draw, and said in the report
    }
    Scene::new(format!("The longest path, by {}", args.algorithm.name()))
        .width(900)
        .map(&site.map)
        .cells("reached", Color::Sky, &planner.reached(site.costmap.layout()))
        .trajectory("path", Color::Red, way.points().iter().map(|point| &point.pose))
        .mark("start", Color::Green, query.start.translation())
        .mark("goal", Color::Blue, query.goal.translation())
        .write(file)?;
    Ok(())
}
