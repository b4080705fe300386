//! The residuals as their formulas say them, in dual numbers: values and Jacobians to rounding.
//!
//! Written from the definitions, with the heading half-way as an angle and no gradient by hand.

use super::{
    Acceleration, BandEdge, CautiousSpeed, Circle, Clearance, Duration, EndSpeed, Length, MovingClearance,
    NonHolonomic, Residuals, Rotation, Speed, SteeringRate, TurningRadius, ViaPoint, Window,
    tests::{limits, windows},
};
use agv_core::{
    geometry::{Se2, Twist2},
    grid::{Cell, CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams, cost},
    kinematics::{MotionLimits, TwistLimits},
    obstacle::MovingObstacle,
};
use nalgebra::Vector2;
use num_dual::{Dual64, DualNum};
use proptest::prelude::*;
use rand_distr::num_traits::Signed;

#[derive(Default)]
struct Said(Vec<(f64, [f64; 11])>);

impl Residuals for Said {
    fn add<const K: usize>(&mut self, residual: f64, gradient: &[f64; K]) {
        let mut all = [0.0; 11];
        all[..K].copy_from_slice(gradient);
        self.0.push((residual, all));
    }

    fn add_difference(&mut self, residual: f64, slope: f64, to: usize, from: Option<usize>) {
        let mut all = [0.0; 11];
        all[to] = slope;
        if let Some(from) = from {
            all[from] = -slope;
        }
        self.0.push((residual, all));
    }
}

/// What is said against the formulas, of which those at most zero are hinges that are shut.
fn agrees<const K: usize>(
    edge: &impl BandEdge<K>,
    window: &[f64; 11],
    hinges: bool,
    formula: impl Fn(&[Dual64; K]) -> Vec<Dual64>,
) -> usize {
    let window: [f64; K] = std::array::from_fn(|i| window[i]);
    let mut said = Said::default();
    edge.residuals(&Window::new(&window), &mut said);
    let seeded = |k: usize| -> Vec<Dual64> {
        let all = formula(&std::array::from_fn(|i| Dual64::new(window[i], f64::from(i == k))));
        // A hinge that opens just here may be either.
        all.into_iter().filter(|r| !hinges || r.re > 1e-9).collect()
    };
    let open: Vec<_> = said.0.iter().filter(|(r, _)| !hinges || *r > 1e-9).collect();
    for k in 0..K {
        let exact = seeded(k);
        assert_eq!(open.len(), exact.len(), "{open:?} {exact:?}");
        for ((residual, gradient), exact) in open.iter().zip(&exact) {
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * (1.0 + a.abs());
            assert!(near(*residual, exact.re), "{residual} {exact:?}");
            assert!(near(gradient[k], exact.eps), "by {k}: {} {exact:?} at {window:?}", gradient[k]);
        }
    }
    open.len()
}

/// Along, across, turn and time of the segment that begins at unknown `at`.
fn segment(w: &[Dual64], at: usize) -> [Dual64; 4] {
    let (dx, dy) = (w[at + 4] - w[at], w[at + 5] - w[at + 1]);
    let (sin, cos) = ((w[at + 2] + w[at + 6]) * 0.5).sin_cos();
    [dx * cos + dy * sin, dy * cos - dx * sin, w[at + 6] - w[at + 2], w[at + 3]]
}

/// Both sides of a limit, in the order in which they are said.
fn within(value: Dual64, limit: f64, weight: f64) -> [Dual64; 2] {
    [(value - limit) * weight.sqrt(), (-value - limit) * weight.sqrt()]
}

fn linear(limits: &TwistLimits, before: f64, after: f64) -> f64 {
    if after.abs() > before.abs() { limits.acceleration } else { limits.deceleration }
}

/// Where a circle is at the window's first pose, and its clearance by a distance and its slope at that place.
fn clearance(
    w: &[Dual64],
    circle: &Circle,
    distance: impl Fn(&Vector2<f64>) -> Option<(f64, Vector2<f64>)>,
) -> Option<Dual64> {
    let (sin, cos) = w[2].sin_cos();
    let c = circle.center;
    let (x, y) = (w[0] + cos * c.x - sin * c.y, w[1] + sin * c.x + cos * c.y);
    let (d, slope) = distance(&Vector2::new(x.re, y.re))?;
    Some((x - x.re) * slope.x + (y - y.re) * slope.y + d - circle.radius)
}

fn ends(edge: &EndSpeed) -> impl Fn(&[Dual64; 7]) -> Vec<Dual64> {
    move |w| {
        let [along, across, turn, time] = segment(w, 0);
        let twist = edge.twist;
        let mut said = Vec::new();
        let mut say = |way: Dual64, given: f64, limit: &dyn Fn(f64, f64) -> f64| {
            let rate = way / time;
            let limit = if edge.at_end { limit(rate.re, given) } else { limit(given, rate.re) };
            said.extend(within((rate - given) * 2.0 / time, limit, edge.weight));
        };
        let by_axis = |before: f64, after: f64| linear(&edge.limits, before, after);
        say(along, twist.vx, &by_axis);
        if edge.sideways {
            say(across, twist.vy, &by_axis);
        }
        say(turn, twist.yaw_rate, &|_, _| edge.limits.yaw_acceleration);
        said
    }
}

fn speeds(limits: MotionLimits, gear: f64) -> impl Fn(&[Dual64; 7]) -> Vec<Dual64> {
    move |w| {
        let [along, across, turn, time] = segment(w, 0);
        let (v, u, r) = (along / time, across / time, turn / time);
        let twist = limits.twist;
        let root = 3.0_f64.sqrt();
        let mut said = vec![(v - twist.forward_speed) * root, (-v - twist.reverse_speed) * root];
        said.extend(within(r, twist.yaw_rate, 3.0));
        if limits.is_holonomic() {
            said.extend(within(u, twist.lateral_speed, 3.0));
        } else if gear != 0.0 {
            said.push(-v * gear * 5.0_f64.sqrt());
        }
        said.extend(limits.lateral_acceleration.into_iter().flat_map(|limit| within(v * r, limit, 3.0)));
        said
    }
}

fn accelerations(limits: MotionLimits) -> impl Fn(&[Dual64; 11]) -> Vec<Dual64> {
    move |w| {
        let (a, b) = (segment(w, 0), segment(w, 4));
        let change = |i: usize| (b[i] / b[3] - a[i] / a[3]) * 2.0 / (a[3] + b[3]);
        let limit = |i: usize| 0.9 * linear(&limits.twist, (a[i] / a[3]).re, (b[i] / b[3]).re);
        let mut said = within(change(0), limit(0), 2.0).to_vec();
        if limits.is_holonomic() {
            said.extend(within(change(1), limit(1), 2.0));
        }
        if limits.steering.is_none() {
            said.extend(within(change(2), 0.9 * limits.twist.yaw_acceleration, 2.0));
        }
        said
    }
}

proptest! {
    #[test]
    fn residuals_between_poses_are_those_of_dual_numbers(window in windows()) {
        let limits = limits();
        let free = MotionLimits { steering: None, ..limits };
        agrees(&Duration { weight: 2.0 }, &window, false, |w: &[_; 7]| vec![w[3] * 2.0_f64.sqrt()]);
        let length = |w: &[Dual64; 7]| [0, 1].map(|i| (w[i + 4] - w[i]) * 2.0_f64.sqrt()).to_vec();
        agrees(&Length { weight: 2.0 }, &window, false, length);
        for (limits, gear) in [(limits, 1.0), (limits, -1.0), (free, 0.0), (free, 1.0)] {
            agrees(&Speed::new(&limits, gear, 3.0, 5.0), &window, true, speeds(limits, gear));
        }
        // Two poses lie on one arc: the chord has the heading half-way, and the sums of sines and cosines its direction.
        agrees(&NonHolonomic { weight: 7.0 }, &window, false, |w: &[_; 7]| {
            let ((s1, c1), (s2, c2)) = (w[2].sin_cos(), w[6].sin_cos());
            vec![((c1 + c2) * (w[5] - w[1]) - (s1 + s2) * (w[4] - w[0])) * 7.0_f64.sqrt()]
        });
        agrees(&TurningRadius { max_curvature: 0.5, weight: 7.0 }, &window, true, |w: &[_; 7]| {
            let [along, _, turn, _] = segment(w, 0);
            vec![(turn.abs() - along.abs() * 0.5) * 7.0_f64.sqrt()]
        });
        agrees(&SteeringRate { curvature_rate: 0.3, weight: 7.0 }, &window, true, |w: &[_; 11]| {
            let ([s, _, turn, t], [s2, _, turn2, t2]) = (segment(w, 0), segment(w, 4));
            if s.re.abs() < 0.01 || s2.re.abs() < 0.01 {
                return Vec::new();
            }
            within((turn2 / s2 - turn / s) * 2.0 / (t + t2), 0.3, 7.0).to_vec()
        });
        for limits in [limits, free] {
            agrees(&Acceleration::new(&limits, 0.9, 2.0), &window, true, accelerations(limits));
        }
        for (twist, sideways, at_end) in [(Twist2::new(0.2, -0.1, 0.1), true, false), (Twist2::ZERO, false, true)] {
            let edge = EndSpeed { twist, limits: limits.twist, sideways, at_end, weight: 2.0 };
            agrees(&edge, &window, true, ends(&edge));
        }
        let point = Vector2::new(1.0, 2.5);
        agrees(&ViaPoint { point, weight: 3.0 }, &window, false, |w: &[_; 3]| {
            vec![(w[0] - point.x) * 3.0_f64.sqrt(), (w[1] - point.y) * 3.0_f64.sqrt()]
        });
        agrees(&Rotation { side: -1.0, weight: 3.0 }, &window, true, |w: &[_; 7]| vec![(w[6] - w[2]) * 3.0_f64.sqrt()]);
    }

    /// The distance's own slope is as given; what follows of it by place and heading is looked at here.
    #[test]
    fn residuals_of_distances_are_those_of_dual_numbers(window in windows(), t in 0.0..1.0_f64) {
        let layout = GridLayout::new(80, 80, 0.05, Se2::default()).unwrap();
        let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        costmap.set(Cell::new(45, 44), cost::LETHAL);
        let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
        let circles = [Circle { center: Vector2::new(0.3, 0.1), radius: 0.2 }, Circle { center: Vector2::new(-0.2, 0.0), radius: 0.2 }];
        let on_map = |w: &[Dual64], circle: &Circle| {
            clearance(w, circle, |point| map.distance_at(point)).map(|c| c - 0.025)
        };
        let edge = Clearance {
            map: &map,
            circles: &circles,
            clearance: 0.5,
            weight: 4.0,
            inflation: 0.7,
            inflation_weight: 0.25,
        };
        agrees(&edge, &window, true, |w: &[_; 3]| {
            circles.iter().filter_map(|circle| on_map(w, circle)).flat_map(|c| [(-c + 0.5) * 2.0, (-c + 0.7) * 0.5]).collect()
        });
        let edge = CautiousSpeed { map: &map, circles: &circles, speed: 0.2, caution: 0.6, per_metre: 1.5, weight: 4.0 };
        agrees(&edge, &window, true, |w: &[_; 7]| {
            let [along, .., time] = segment(w, 0);
            let least = circles.iter().filter_map(|circle| on_map(w, circle)).min_by(|a, b| a.re.total_cmp(&b.re));
            let open = |c: &Dual64| c.re < 0.6 && (along / time).re.abs() > 0.2;
            let room = |c: Dual64| if c.re > 0.0 { c } else { Dual64::from_re(0.0) };
            least.filter(open).map(|c| ((along / time).abs() - room(c) * 1.5 - 0.2) * 2.0).into_iter().collect()
        });
        let mover = MovingObstacle::new(Vector2::new(1.7, 2.2), Vector2::new(0.5, 0.1), 0.1).unwrap();
        // Of a disc the slope is known; that of outlines is looked at by differences.
        let edge = MovingClearance { obstacle: &mover, circles: &circles, time: t, clearance: 0.8, weight: 3.0 };
        agrees(&edge, &window, true, |w: &[_; 3]| {
            let at = mover.position_after(t);
            let away = |point: &Vector2<f64>| Some(((point - at).norm() - mover.radius, (point - at).normalize()));
            circles.iter().filter_map(|c| clearance(w, c, away)).map(|c| (-c + 0.8) * 3.0_f64.sqrt()).collect()
        });
    }
}
