//! Local planners in fields of posts, as the BARN worlds have them: random fill, smoothed, posts of 0.075 m radius; only what is
//! near is known. The vehicle does what it is told, and the map is exact to its cells.

use agv_core::compute::Seed;
use agv_core::geometry::{LieGroup, Se2, Twist2};
use agv_core::grid::{
    CellState, Costmap, Footprint, Grid, GridLayout, Inflation, InflationParams, LocalMap, LocalMapParams,
};
use agv_core::kinematics::{MotionLimits, TwistLimits};
use agv_core::nalgebra::Vector2;
use agv_core::obstacle::MovingObstacle;
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, LocalPlanRequest, LocalPlanStatus, LocalPlanner, PlanOutcome, VehicleState};
use agv_plan::dwa::{Dwa, DwaParams};
use agv_plan::grid::{AStar, AStarParams, GridParams};
use rand_distr::{Bernoulli, Distribution};

const POST: f64 = 0.075;
const DT: f64 = 0.05;
const SIGHT: f64 = 4.0;

fn vehicle() -> (Footprint, MotionLimits) {
    let twist = TwistLimits {
        forward_speed: 2.0,
        reverse_speed: 0.5,
        yaw_rate: 2.0,
        acceleration: 2.0,
        deceleration: 2.0,
        yaw_acceleration: 4.0,
        ..TwistLimits::default()
    };
    (Footprint::rectangle(-0.254, 0.254, 0.43).unwrap(), twist.into())
}

/// Posts on a lattice of 0.15 m, 30 by 30, filled at random and smoothed; walls to both sides of the field and of the room before it.
fn field_of_posts(seed: u64, fill: f64, smoothing: usize) -> Vec<Vector2<f64>> {
    let (mut stream, filled) = (Seed(seed).stream(0, 0), Bernoulli::new(fill).unwrap());
    let mut cells = [[false; 30]; 30];
    cells.iter_mut().flatten().for_each(|cell| *cell = filled.sample(&mut stream));
    for _ in 0..smoothing {
        let before = cells;
        let neighbours = |r: usize, c: usize| {
            let near = |i: usize| i.saturating_sub(1)..(i + 2).min(30);
            near(r)
                .flat_map(|y| near(c).map(move |x| (y, x)))
                .filter(|&(y, x)| (y, x) != (r, c) && before[y][x])
                .count()
        };
        for (r, c) in (0..30).flat_map(|r| (0..30).map(move |c| (r, c))) {
            cells[r][c] = match neighbours(r, c) {
                5.. => true,
                0..=1 => false,
                _ => before[r][c],
            };
        }
    }
    let at = |r: usize, c: usize| Vector2::new(0.15 * r as f64, 3.0 + 0.15 * c as f64);
    let field = (0..30).flat_map(|r| (0..30).map(move |c| (r, c))).filter(|&(r, c)| cells[r][c]).map(|(r, c)| at(r, c));
    let sides = (0..75).flat_map(|k| [-0.15, 4.5].map(|x| Vector2::new(x, 0.15 * f64::from(k) - 0.75)));
    let behind = (0..30).map(|k| Vector2::new(0.15 * f64::from(k), -0.75));
    field.chain(sides).chain(behind).collect()
}

/// Whether a vehicle that is as wide as this one in every direction, and four centimetres wider, gets through: the worlds of the challenge
/// are of this kind.
fn has_wide_way(posts: &[Vector2<f64>], start: &Se2, goal: &Se2) -> bool {
    let layout = GridLayout::new(160, 280, 0.05, Se2::new(-1.5, -2.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for index in 0..layout.len() {
        let center = layout.center(layout.cell(index));
        if posts.iter().any(|post| (center - post).norm() < POST) {
            map.set(layout.cell(index), CellState::Occupied);
        }
    }
    let (footprint, _) = vehicle();
    let radius = footprint.circumscribed_radius() + 0.04;
    let params = InflationParams { inscribed_radius: radius, inflation_radius: radius, ..InflationParams::default() };
    let costmap = Inflation::new(params).unwrap().inflate(&map).unwrap();
    let outcome = AStar::new(AStarParams::default()).unwrap().plan_into(&costmap, start, goal, &mut Path::new());
    matches!(outcome, Ok(PlanOutcome::Found { .. }))
}

/// How a run ended, after how many seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    Goal(f64),
    Contact(f64),
    Late,
    NoWay,
}

struct Run {
    end: End,
    /// Length of the first path, metres.
    length: f64,
}

/// Drives from start to goal, with a new path every half second.
fn drive(planner: &mut dyn LocalPlanner, posts: &[Vector2<f64>], start: Se2, goal: Se2, budget: f64) -> Run {
    let (footprint, limits) = vehicle();
    let low = posts.iter().fold(Vector2::repeat(f64::INFINITY), |low, p| low.inf(p)) - Vector2::repeat(0.5);
    let high = posts.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |high, p| high.sup(p)).sup(&goal.translation());
    let size = (high + Vector2::repeat(1.5) - low) / 0.05;
    let layout = GridLayout::new(size.x as usize, size.y as usize, 0.05, Se2::new(low.x, low.y, 0.0)).unwrap();
    let mut known = Grid::filled(layout, CellState::Free);
    let mut hidden: Vec<_> = posts.to_vec();
    let mut local = LocalMap::new(&Costmap::from_map(&known), LocalMapParams::default()).unwrap();
    let mut inflation = Inflation::new(InflationParams {
        // Between the inscribed and the circumscribed radius: the vehicle is nearly square.
        inscribed_radius: 0.3,
        inflation_radius: 0.7,
        cost_scaling_factor: 4.0,
        ..InflationParams::for_footprint(&footprint)
    })
    .unwrap();
    let grid = GridParams { cost_weight: 3.0, ..GridParams::default() };
    let mut astar = AStar::new(AStarParams { grid, ..AStarParams::default() }).unwrap();
    let mut path = Path::new();
    let mut state = VehicleState::new(start, Twist2::ZERO);
    let mut run = Run { end: End::Late, length: 0.0 };
    for cycle in 0..(budget / DT) as usize {
        let position = state.map_from_base.translation();
        let before = hidden.len();
        hidden.retain(|post| {
            let seen = (post - position).norm() < SIGHT;
            if seen {
                for index in 0..layout.len() {
                    if (layout.center(layout.cell(index)) - post).norm() < POST + 0.03 {
                        known.set(layout.cell(index), CellState::Occupied);
                    }
                }
            }
            !seen
        });
        if hidden.len() != before || cycle == 0 {
            local.update(&Costmap::from_map(&known)).unwrap();
        }
        if cycle % 10 == 0 {
            let costmap = inflation.inflate(&known).unwrap();
            let mut fresh = Path::new();
            let outcome = astar.plan_into(&costmap, &state.map_from_base, &goal, &mut fresh).unwrap();
            if matches!(outcome, PlanOutcome::Found { .. }) {
                path = fresh;
            } else if cycle == 0 {
                return Run { end: End::NoWay, length: 0.0 };
            }
            if cycle == 0 {
                run.length = path.length();
            }
        }
        let request = LocalPlanRequest { state, path: &path, map: &local, obstacles: &[], limits: &limits, dt: DT };
        let command = planner.command(request).unwrap();
        assert!(limits.allows_step(&state.motion(), &command.motion, DT));
        for i in 1..=5 {
            let t = DT * f64::from(i) / 5.0;
            let pose = state.map_from_base.compose(&command.motion.twist.integrate(t));
            let touches = |post: &&Vector2<f64>| {
                (*post - pose.translation()).norm() < 0.5
                    && MovingObstacle::new(**post, Vector2::zeros(), POST).unwrap().gap_after(0.0, &footprint, &pose)
                        <= 0.0
            };
            if posts.iter().find(touches).is_some() {
                run.end = End::Contact(cycle as f64 * DT);
                return run;
            }
        }
        state = state.after(&command.motion, DT);
        if command.status == LocalPlanStatus::Arrived
            || (state.map_from_base.translation() - goal.translation()).norm() < 1.0
        {
            run.end = End::Goal(cycle as f64 * DT);
            return run;
        }
    }
    run
}

/// The challenge's score: mean speed along the way, from a quarter of 2 m/s to half of it.
fn score(run: &Run) -> f64 {
    let best = run.length / 2.0;
    match run.end {
        End::Goal(time) => best / time.clamp(2.0 * best, 8.0 * best),
        _ => 0.0,
    }
}

#[test]
fn the_dynamic_window_gets_through_fields_of_posts() {
    let (footprint, _) = vehicle();
    let (start, goal) =
        (Se2::new(2.2, 0.0, std::f64::consts::FRAC_PI_2), Se2::new(2.2, 10.0, std::f64::consts::FRAC_PI_2));
    let mut cases: Vec<_> = Vec::new();
    for (k, (fill, smoothing)) in [(0.15, 2), (0.2, 3), (0.25, 4), (0.3, 2)].into_iter().enumerate() {
        let worlds = (0..25).map(|i| (100 * k + i, field_of_posts((100 * k + i) as u64, fill, smoothing), start, goal));
        cases.extend(worlds.filter(|(_, posts, start, goal)| has_wide_way(posts, start, goal)).take(10));
    }
    let (mut tried, mut arrived, mut total) = (0_usize, 0, 0.0);
    for (name, posts, start, goal) in &cases {
        let mut planner = Dwa::new(DwaParams::for_footprint(&footprint)).unwrap();
        let run = drive(&mut planner, posts, *start, *goal, 60.0);
        if run.end == End::NoWay {
            continue;
        }
        tried += 1;
        arrived += usize::from(matches!(run.end, End::Goal(_)));
        total += score(&run);
        assert!(!matches!(run.end, End::Contact(_)), "world {name}: {:?}", run.end);
        eprintln!("world {name}: {:?} of {:.1} m, {:.3}", run.end, run.length, score(&run));
    }
    eprintln!("{arrived} of {tried}, score {:.3}", total / tried as f64);
    assert!(tried >= 26, "{tried}");
    assert!(arrived * 100 >= tried * 95, "{arrived} of {tried}");
}
