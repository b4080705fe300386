//! The vehicle, and what drives it.

use crate::Result;
use agv_nav::{
    control::track::{FollowerParams, PurePursuit, PurePursuitParams},
    core::{compute::Seed, grid::Footprint},
    pipeline::{Navigation, NavigationParams},
    plan::{
        dwa::{AdaptiveWindow, Dwa, DwaParams},
        grid::{AStar, AStarParams, GridParams, UnknownCells},
        local::{
            Tracked, TrackedParams,
            critics::{BoundedObstacle, Critic, KeyNodeDistance, KeyNodeHeading, Velocity},
        },
        mppi::{Mppi, MppiParams},
        smooth::{KeyNodes, LineOfSightParams, Straightened},
        teb::{Teb, TebParams},
    },
    prelude::{GlobalPlanner, LocalPlanner, TwistLimits},
};
use agv_sim::Body;

/// Length and width of the vehicle, in metres.
pub(crate) const SIZE: (f64, f64) = (0.508, 0.43);

/// What planners keep free around it, in metres: cells, noise, and that it moves on while it is told to brake.
const PADDING: f64 = 0.02;

/// How dear it is to pass obstacles closely, for paths: one that squeezes by may be a sixth as long as one that has room.
const COST_WEIGHT: f64 = 6.0;

/// Which local planner drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Planner {
    /// Pure pursuit that stops before obstacles: what the global plan is worth alone
    Tracker,
    /// Dynamic window approach
    Dwa,
    /// Dynamic window approach with the critics of paper 002
    Idwa,
    /// Model predictive path integral control
    Mppi,
    /// Timed elastic band
    Teb,
}

/// The vehicle as it is.
pub(crate) fn body() -> Result<Body> {
    Ok(Body::rectangle(SIZE.0, SIZE.1)?)
}

/// The vehicle as planners take it.
pub(crate) fn footprint() -> Result<Footprint> {
    let half = 0.5 * SIZE.0 + PADDING;
    Ok(Footprint::rectangle(-half, half, SIZE.1 + 2.0 * PADDING)?)
}

/// What it can do.
pub(crate) fn limits(v_max: f64) -> TwistLimits {
    TwistLimits {
        forward_speed: v_max,
        reverse_speed: 0.5_f64.min(v_max),
        lateral_speed: 0.0,
        yaw_rate: 2.0,
        acceleration: 2.0,
        deceleration: 2.0,
        yaw_acceleration: 4.0,
    }
}

/// A* on what is seen, over what is not where that is shorter, along key nodes.
fn global() -> Result<Box<dyn GlobalPlanner + Send>> {
    let grid = GridParams { cost_weight: COST_WEIGHT, unknown: UnknownCells::AtCost(0), ..GridParams::default() };
    let astar = AStar::new(AStarParams { grid, start_tolerance: 0.5, goal_tolerance: 3.0, ..AStarParams::default() })?;
    let key_nodes =
        KeyNodes::new(LineOfSightParams { max_cost: 90, cross_unknown: true, ..LineOfSightParams::default() })?;
    Ok(Box::new(Straightened::new(astar, key_nodes)))
}

fn local(planner: Planner, adaptive_window: bool) -> Result<Box<dyn LocalPlanner + Send>> {
    let footprint = footprint()?;
    let adaptive = adaptive_window.then(AdaptiveWindow::default);
    let window = DwaParams { adaptive, ..DwaParams::for_footprint(&footprint) };
    Ok(match planner {
        Planner::Dwa => Box::new(Dwa::new(window)?),
        Planner::Idwa => {
            // Weights of paper 002, Table 2: heading, speed, obstacles, key node.
            let critics = vec![
                Critic::normalized(0.2, KeyNodeHeading),
                Critic::normalized(0.3, Velocity),
                Critic::normalized(0.2, BoundedObstacle::default()),
                Critic::normalized(0.2, KeyNodeDistance),
            ];
            Box::new(Dwa::with_critics(window, critics)?)
        }
        Planner::Mppi => Box::new(Mppi::new(MppiParams::for_footprint(&footprint), Seed(0))?),
        Planner::Teb => Box::new(Teb::new(TebParams::for_footprint(footprint))?),
        Planner::Tracker => {
            let follower = FollowerParams {
                lateral_acceleration: 1.0,
                bend_window: 0.3,
                response_time: 0.0,
                max_yaw_slip: 0.0,
                ..FollowerParams::default()
            };
            let tracker = PurePursuit::new(PurePursuitParams {
                look_ahead_min: 0.3,
                look_ahead_time: 0.3,
                follower,
                ..PurePursuitParams::default()
            })?;
            Box::new(Tracked::new(tracker, footprint, TrackedParams::default())?)
        }
    })
}

/// All of it.
pub(crate) fn navigation(planner: Planner, adaptive_window: bool) -> Result<Navigation> {
    let params = NavigationParams { cost_weight: COST_WEIGHT, ..NavigationParams::default() };
    Ok(Navigation::new(global()?, local(planner, adaptive_window)?, footprint()?, params)?)
}
