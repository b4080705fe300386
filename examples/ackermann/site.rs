//! The vehicle, the map and the queries.

use crate::{Args, Result, Vehicle};
use agv_core::{
    geometry::Se2,
    grid::{CellState, CollisionChecker, CollisionParams, Costmap, Footprint, Grid, Inflation, InflationParams},
    kinematics::{AckermannParams, DoubleAckermannParams},
};
use agv_plan::hybrid::HybridAStarParams;
use agv_sim::{Factory, FactoryParams};
use agv_support::map;
use rand::RngExt as _;
use std::f64::consts::PI;

/// Ends of the outline along the vehicle, and its width, in metres.
pub(crate) const LENGTH: f64 = 2.0;
pub(crate) const WIDTH: f64 = 0.8;

/// A map, and from where to where.
pub(crate) struct Site {
    pub(crate) map: Grid<CellState>,
    pub(crate) costmap: Costmap,
    pub(crate) queries: Vec<(Se2, Se2)>,
}

/// The tugger; with two steered axles its base is in its middle.
pub(crate) fn vehicle(args: &Args) -> Result<(HybridAStarParams, Footprint)> {
    let (params, rear) = match args.vehicle {
        Vehicle::Both => (HybridAStarParams::for_double_ackermann(&DoubleAckermannParams::default())?, -0.5 * LENGTH),
        Vehicle::Front | Vehicle::Forward => (HybridAStarParams::for_ackermann(&AckermannParams::default())?, -0.4),
    };
    let may_reverse = args.vehicle != Vehicle::Forward;
    let params = HybridAStarParams { may_reverse, cost_weight: args.cost_weight, ..params };
    Ok((params, Footprint::rectangle(rear, rear + LENGTH, WIDTH)?))
}

/// The costmap of a map: inflated if near things have a price, else only obstacles count.
pub(crate) fn costmap(args: &Args, map: &Grid<CellState>, footprint: &Footprint) -> Result<Costmap> {
    if args.cost_weight == 0.0 {
        return Ok(Costmap::from_map(map));
    }
    let params = InflationParams { cost_scaling_factor: 3.0, ..InflationParams::for_footprint(footprint) };
    Ok(Inflation::new(params)?.inflate(map)?)
}

pub(crate) fn load(args: &Args) -> Result<Site> {
    let (_, footprint) = vehicle(args)?;
    let map = match &args.map {
        Some(path) => map::read(path)?,
        None => Factory::generate(FactoryParams::default(), args.common.seed())?.map(0.05, 0.1, 1.8)?,
    };
    let costmap = costmap(args, &map, &footprint)?;
    let queries = match args.start.zip(args.goal) {
        Some(query) => vec![query],
        None => random_queries(args, &map, &footprint)?,
    };
    Ok(Site { map, costmap, queries })
}

/// Pairs of poses where the vehicle can stand.
fn random_queries(args: &Args, map: &Grid<CellState>, footprint: &Footprint) -> Result<Vec<(Se2, Se2)>> {
    let checker = CollisionChecker::new(map, footprint.clone(), CollisionParams::default())?;
    let mut stream = args.common.seed().stream(0, 0);
    let layout = map.layout();
    let mut free = || -> Result<Se2> {
        for _ in 0..100_000 {
            let cell = layout.cell(stream.random_range(0..layout.len()));
            let center = layout.center(cell);
            let pose = Se2::new(center.x, center.y, stream.random_range(-PI..PI));
            if !checker.collides(&pose)? {
                return Ok(pose);
            }
        }
        Err("the vehicle can hardly stand anywhere in this map".into())
    };
    (0..args.queries).map(|_| Ok((free()?, free()?))).collect()
}
