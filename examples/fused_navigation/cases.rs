//! The experiments: maps, what they do not show, vehicles and planners.

use crate::Result;
use agv_nav::{
    core::{
        grid::{Footprint, Inflation, InflationParams},
        kinematics::{Ackermann, AckermannParams, SteeringLimits},
    },
    nalgebra::Vector2,
    pipeline::{Navigation, NavigationParams},
    plan::{
        aco::{AntColony, ColonyParams},
        dwa::{Dwa, DwaParams},
        grid::{AStar, AStarParams, Dijkstra, GridParams, GridPlannerParams, UnknownCells},
        local::critics::{BoundedObstacle, Clearance, Critic, Heading, KeyNodeDistance, KeyNodeHeading, Velocity},
        smooth::{KeyNodes, LineOfSightParams, Straightened},
        teb::{Teb, TebParams},
    },
    prelude::*,
};
use agv_sim::{Drive, KeyFrame, MovingDisc, MovingDiscs, Shape};
use rand::RngExt as _;

/// An experiment of one of the papers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Experiment {
    /// Paper 000: A* and dynamic window among unknown obstacles
    Grid,
    /// Paper 002, Figs 3 and 8: critics that detour, and improved ones
    Detour,
    /// Paper 002, Figs 4 and 9: a goal near obstacles
    Near,
    /// Paper 002: improved ants and improved dynamic window
    Ants,
    /// Paper 003: A* or Dijkstra and the elastic band, steered
    Hall,
}

/// All that a run needs.
pub(crate) struct Case {
    pub(crate) name: String,
    /// What the vehicle knows before.
    pub(crate) map: Grid<CellState>,
    /// What it does not, beside the map's own cells.
    pub(crate) unknown: Vec<Shape>,
    pub(crate) moving: MovingDiscs,
    pub(crate) start: Se2,
    pub(crate) goal: Se2,
    pub(crate) drive: Drive,
    pub(crate) limits: MotionLimits,
    /// Length and width of the vehicle, in metres, centred.
    pub(crate) size: (f64, f64),
    pub(crate) navigation: Navigation,
}

/// The experiments that were asked for.
pub(crate) fn all(asked: Option<Experiment>, seed: Seed) -> Result<Vec<Case>> {
    let mut cases = Vec::new();
    let is_asked = |experiment| asked.is_none_or(|asked| asked == experiment);
    if is_asked(Experiment::Grid) {
        cases.push(grid(seed)?);
    }
    for (experiment, name, goal) in
        [(Experiment::Detour, "detour", (17.5, 11.5)), (Experiment::Near, "near", (9.5, 12.5))]
    {
        if is_asked(experiment) {
            for improved in [false, true] {
                cases.push(window_alone(name, goal, improved, seed)?);
            }
        }
    }
    if is_asked(Experiment::Ants) {
        cases.push(ants(seed)?);
    }
    if is_asked(Experiment::Hall) {
        for dijkstra in [false, true] {
            cases.push(hall(dijkstra)?);
        }
    }
    Ok(cases)
}

/// A map of unit cells with obstacles of one to three of them, none near the places to be kept free.
fn blocks(size: usize, count: usize, keep: &[Vector2<f64>], seed: Seed) -> Result<Grid<CellState>> {
    let mut map = Grid::filled(GridLayout::new(size, size, 1.0, Se2::default())?, CellState::Free);
    let mut stream = seed.stream(0, 0);
    for _ in 0..count {
        let mut draw = |below: i32| (stream.random::<f64>() * f64::from(below)) as i32;
        let (x, y, width, height) = (draw(size as i32), draw(size as i32), 1 + draw(3), 1 + draw(2));
        for cell in (x..x + width).flat_map(|x| (y..y + height).map(move |y| Cell::new(x, y))) {
            let centre = map.layout().center(cell);
            if keep.iter().all(|place| (centre - place).norm() > 1.5) {
                map.set(cell, CellState::Occupied);
            }
        }
    }
    Ok(map)
}

fn footprint((length, width): (f64, f64)) -> Result<Footprint> {
    Ok(Footprint::rectangle(-0.5 * length, 0.5 * length, width)?)
}

fn grid_params() -> GridParams {
    GridParams { cost_weight: 4.0, unknown: UnknownCells::AtCost(0), ..GridParams::default() }
}

fn key_nodes() -> Result<KeyNodes> {
    Ok(KeyNodes::new(LineOfSightParams { max_cost: 60, cross_unknown: true, ..LineOfSightParams::default() })?)
}

fn astar() -> Result<Straightened<AStar>> {
    let params =
        AStarParams { grid: grid_params(), start_tolerance: 1.0, goal_tolerance: 1.0, ..AStarParams::default() };
    Ok(Straightened::new(AStar::new(params)?, key_nodes()?))
}

/// What the navigation of all experiments is like; the local planner gets the way to the next key node three metres on.
fn params() -> NavigationParams {
    NavigationParams {
        plan_period: 0.5,
        cost_weight: 4.0,
        reach: 3.0,
        goal_tolerance: 0.3,
        ..NavigationParams::default()
    }
}

fn limits(v: f64, a: f64, yaw_rate: f64, yaw_acceleration: f64) -> TwistLimits {
    TwistLimits {
        forward_speed: v,
        reverse_speed: 0.5 * v,
        lateral_speed: 0.0,
        yaw_rate,
        acceleration: a,
        deceleration: a,
        yaw_acceleration,
    }
}

/// Paper 000, section 2.
fn grid(seed: Seed) -> Result<Case> {
    let (start, goal) = (Se2::new(1.5, 1.5, 0.8), Se2::new(23.5, 23.5, 0.8));
    let map = blocks(25, 45, &[start.translation(), goal.translation()], seed)?;
    let size = (0.6, 0.5);
    let outline = footprint(size)?;
    // Where the first path leads, so that the unknown ones stand in the way.
    let fine = agv_nav::core::grid::RollingCostmap::new(agv_nav::core::grid::RollingParams {
        width: 560,
        height: 560,
        resolution: 0.1,
        inflation: Some(InflationParams::for_footprint(&outline)),
        ..Default::default()
    })?
    .with_static_map(map.clone())?;
    let mut path = Path::new();
    astar()?.plan_into(fine.costmap(), &start, &goal, &mut path)?;
    let at = |share: f64| along(&path, share * path.length());
    let radius = 0.35;
    let unknown = [0.2, 0.4, 0.65, 0.85].map(|share| Shape::Circle { center: at(share).0, radius }).to_vec();
    // One that crosses the path in the middle, to and fro, when the vehicle may be there.
    let (middle, direction) = at(0.5);
    let side = Vector2::new(-direction.y, direction.x) * 2.0;
    let frame = |time, position| KeyFrame { time, position };
    let frames = vec![frame(0.0, middle - side), frame(10.0, middle + side), frame(20.0, middle - side)];
    let moving = MovingDiscs::new(vec![MovingDisc::new(0.3, 20.0, frames)?]);
    let mut dwa = DwaParams::for_footprint(&outline);
    dwa.horizon = 3.0;
    Ok(Case {
        name: "grid_astar_dwa".into(),
        navigation: Navigation::new(Box::new(astar()?), Box::new(Dwa::new(dwa)?), outline, params())?,
        map,
        unknown,
        moving,
        start,
        goal,
        drive: Drive::default(),
        limits: limits(0.48, 0.2, 0.3, 1.3).into(),
        size,
    })
}

/// The place on a path after so many metres, and the direction there.
fn along(path: &Path, mut length: f64) -> (Vector2<f64>, Vector2<f64>) {
    for pair in path.points().windows(2) {
        let (a, b) = (pair[0].pose.translation(), pair[1].pose.translation());
        let piece = (b - a).norm();
        if length <= piece && piece > 0.0 {
            return (a + (b - a) * (length / piece), (b - a) / piece);
        }
        length -= piece;
    }
    (path.points().last().map_or_else(Vector2::zeros, |point| point.pose.translation()), Vector2::x())
}

/// Straight to the goal: no global planner at all.
struct Straight;

impl GlobalPlanner for Straight {
    fn plan_with_cancel(
        &mut self,
        _: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        _: &mut dyn FnMut() -> bool,
    ) -> std::result::Result<PlanOutcome, agv_nav::core::roles::PlanError> {
        path.set_positions([start.translation(), goal.translation()])?;
        Ok(PlanOutcome::Found { cost: path.length(), expansions: 0 })
    }
}

/// Table 2 of paper 002, with a faster turn: 20 degrees a second.
fn table_2() -> TwistLimits {
    limits(1.0, 0.2, 20_f64.to_radians(), 50_f64.to_radians())
}

fn window_critics(improved: bool) -> Vec<Critic> {
    if improved {
        vec![
            Critic::normalized(0.2, KeyNodeHeading),
            Critic::normalized(0.3, Velocity),
            Critic::normalized(0.2, BoundedObstacle::default()),
            Critic::normalized(0.2, KeyNodeDistance),
        ]
    } else {
        // Obstacles count for much, and wherever they are: what the paper finds fault with.
        vec![
            Critic::normalized(0.2, Heading),
            Critic::normalized(0.3, Velocity),
            Critic::normalized(0.6, Clearance { enough: 3.0 }),
        ]
    }
}

/// Paper 002, section 4.2: the dynamic window without a global planner.
fn window_alone(name: &str, goal: (f64, f64), improved: bool, seed: Seed) -> Result<Case> {
    let (start, goal) = (Se2::new(2.5, 0.5, 1.0), Se2::new(goal.0, goal.1, 1.0));
    let mut map = blocks(20, 18, &[start.translation(), goal.translation()], seed.derive(2))?;
    let cell = map.layout().cell_at(&goal.translation()).ok_or("the goal lies off the map")?;
    // In the second figure the goal lies near obstacles.
    let around: &[(i32, i32)] = if name == "near" { &[(1, 1), (-1, 1), (0, 2)] } else { &[] };
    for (x, y) in around {
        map.set(Cell::new(cell.x + x, cell.y + y), CellState::Occupied);
    }
    let size = (0.4, 0.4);
    let outline = footprint(size)?;
    let mut dwa = DwaParams::for_footprint(&outline);
    dwa.horizon = 3.0;
    let local = Dwa::with_critics(dwa, window_critics(improved))?;
    let params = NavigationParams { reach: f64::INFINITY, ..params() };
    Ok(Case {
        name: format!("{name}_{}", if improved { "improved" } else { "classic" }),
        navigation: Navigation::new(Box::new(Straight), Box::new(local), outline, params)?,
        map,
        unknown: Vec::new(),
        moving: MovingDiscs::default(),
        start,
        goal,
        drive: Drive::default(),
        limits: table_2().into(),
        size,
    })
}

/// Paper 002, section 4.3: improved ants on the coarse map, then the improved dynamic window along their key nodes.
fn ants(seed: Seed) -> Result<Case> {
    let (start, goal) = (Se2::new(1.5, 0.5, 1.0), Se2::new(18.5, 18.5, 1.0));
    let map = blocks(20, 30, &[start.translation(), goal.translation()], seed.derive(3))?;
    let size = (0.4, 0.4);
    let outline = footprint(size)?;
    let colony = AntColony::new(GridPlannerParams::default(), ColonyParams::refined(), seed)?;
    let coarse =
        Inflation::new(InflationParams { inscribed_radius: 0.0, inflation_radius: 0.5, ..InflationParams::default() })?
            .inflate(&map)?;
    let mut dwa = DwaParams::for_footprint(&outline);
    dwa.horizon = 3.0;
    let local = Dwa::with_critics(dwa, window_critics(true))?;
    let global = OnCoarse { planner: colony, map: coarse };
    Ok(Case {
        name: "ants_improved".into(),
        navigation: Navigation::new(
            Box::new(Straightened::new(global, key_nodes()?)),
            Box::new(local),
            outline,
            // Turning as slowly as Table 2 says, the vehicle would miss corners if it looked beyond them.
            NavigationParams { plan_period: 1e6, reach: 1.2, ..params() },
        )?,
        map,
        unknown: Vec::new(),
        moving: MovingDiscs::default(),
        start,
        goal,
        drive: Drive::default(),
        limits: table_2().into(),
        size,
    })
}

/// Plans on a coarse map that does not change, whatever else is seen.
struct OnCoarse<P> {
    planner: P,
    map: Costmap,
}

impl<P: GlobalPlanner> GlobalPlanner for OnCoarse<P> {
    fn plan_with_cancel(
        &mut self,
        _: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> std::result::Result<PlanOutcome, agv_nav::core::roles::PlanError> {
        self.planner.plan_with_cancel(&self.map, start, goal, path, cancelled)
    }
}

/// Paper 003: shelves with aisles, and goods that stand in them.
fn hall(dijkstra: bool) -> Result<Case> {
    let mut map = Grid::filled(GridLayout::new(250, 150, 0.1, Se2::default())?, CellState::Free);
    let is_shelf = |x: i32, y: i32| (30..220).contains(&x) && (y - 20) % 35 < 15 && (20..130).contains(&y);
    for cell in (0..150).flat_map(|y| (0..250).map(move |x| Cell::new(x, y))) {
        let wall = cell.x == 0 || cell.y == 0 || cell.x == 249 || cell.y == 149;
        if wall || is_shelf(cell.x, cell.y) && !(115..140).contains(&cell.x) {
            map.set(cell, CellState::Occupied);
        }
    }
    let (start, goal) = (Se2::new(1.5, 1.2, 0.0), Se2::new(23.0, 13.9, 0.0));
    let size = (0.8, 0.5);
    let outline = footprint(size)?;
    let wheelbase = 0.5;
    let steering = SteeringLimits { wheelbase, max_angle: 40_f64.to_radians(), max_rate: 1.5 };
    let drive = Ackermann::new(AckermannParams { wheelbase, wheel_radius: 0.1, max_steering: steering.max_angle })?;
    let limits = MotionLimits { steering: Some(steering), ..limits(1.0, 0.5, 1.5, 100.0).into() };
    let global: Box<dyn GlobalPlanner + Send> = if dijkstra {
        let params = GridPlannerParams { grid: grid_params(), start_tolerance: 1.0, ..GridPlannerParams::default() };
        Box::new(Straightened::new(Dijkstra::new(params)?, key_nodes()?))
    } else {
        Box::new(astar()?)
    };
    let goods = [(9.0, 4.4, 0.4), (12.7, 8.5, 0.5), (19.0, 11.5, 0.35)];
    let unknown = goods.map(|(x, y, radius)| Shape::Circle { center: Vector2::new(x, y), radius }).to_vec();
    let params = NavigationParams { reach: f64::INFINITY, ..params() };
    Ok(Case {
        name: format!("hall_{}_teb", if dijkstra { "dijkstra" } else { "astar" }),
        navigation: Navigation::new(
            global,
            Box::new(Teb::new(TebParams::for_footprint(outline.clone()))?),
            outline,
            params,
        )?,
        map,
        unknown,
        moving: MovingDiscs::default(),
        start,
        goal,
        drive: Drive::Ackermann(drive),
        limits,
        size,
    })
}
