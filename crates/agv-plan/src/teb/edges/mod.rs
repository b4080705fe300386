//! What a band should keep to: typed residuals of a few unknowns that follow each other, with analytic Jacobians.
//!
//! An edge reads a window of the band, `x y θ Δt x y θ Δt x y θ` from its first pose on:
//!
//! | window | edges |
//! |---|---|
//! | 3, one pose | [`Clearance`], [`MovingClearance`], [`ViaPoint`] |
//! | 7, two poses | [`Duration`], [`Length`], [`Speed`], [`CautiousSpeed`], [`NonHolonomic`], [`TurningRadius`], [`Rotation`], [`EndSpeed`] |
//! | 11, three poses | [`Acceleration`], [`SteeringRate`] |
//!
//! Limits are hinges: nothing within, linear beyond, their square in the cost.

mod acceleration;
#[cfg(test)]
mod dual;
mod guide;
mod motion;
mod obstacle;
mod segment;
mod steering;
mod window;

pub use acceleration::{Acceleration, EndSpeed};
pub use guide::{Rotation, ViaPoint};
pub use motion::{Duration, Length, NonHolonomic, Speed};
pub use obstacle::{CautiousSpeed, Circle, Clearance, MovingClearance};
pub use steering::{SteeringRate, TurningRadius};
pub use window::{Direction, Window};

/// Takes residuals as edges compute them.
pub trait Residuals {
    /// A residual, its weight's root included, and its derivative by each unknown of the window.
    fn add<const K: usize>(&mut self, residual: f64, gradient: &[f64; K]);

    /// A residual that depends on one unknown of its window, or on the difference of two: `slope` times the derivative by the
    /// one at `to`, and its negative by the one at `from`, if there is one.
    fn add_difference(&mut self, residual: f64, slope: f64, to: usize, from: Option<usize>);
}

/// Residuals of a band that depend on `K` unknowns that follow each other.
pub trait BandEdge<const K: usize> {
    /// Says the residuals at a window of the band; those that are zero need not be said.
    fn residuals(&self, window: &Window<K>, out: &mut impl Residuals);
}

/// What a value is, and its derivative by each unknown of a window.
#[derive(Debug, Clone, Copy)]
struct Term<const K: usize> {
    value: f64,
    gradient: [f64; K],
}

impl<const K: usize> Term<K> {
    /// `√w (value - limit)` where that is positive.
    #[inline]
    fn at_most(&self, limit: f64, root_weight: f64, out: &mut impl Residuals) {
        let excess = self.value - limit;
        if excess > 0.0 {
            out.add(root_weight * excess, &self.gradient.map(|g| root_weight * g));
        }
    }

    /// `√w` times what the magnitude exceeds the limit by.
    #[inline]
    fn within(&self, limit: f64, root_weight: f64, out: &mut impl Residuals) {
        self.at_most(limit, root_weight, out);
        self.negated().at_most(limit, root_weight, out);
    }

    #[inline]
    fn negated(&self) -> Self {
        Self { value: -self.value, gradient: self.gradient.map(|g| -g) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        geometry::{Se2, Twist2},
        grid::{Cell, CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams, cost},
        kinematics::{MotionLimits, SteeringLimits, TwistLimits},
        obstacle::{Hull, MovingObstacle},
    };
    use nalgebra::Vector2;
    use proptest::prelude::*;

    /// All that was said.
    #[derive(Default)]
    struct Said(Vec<(f64, Vec<f64>)>);

    impl Residuals for Said {
        fn add<const K: usize>(&mut self, residual: f64, gradient: &[f64; K]) {
            self.0.push((residual, gradient.to_vec()));
        }

        fn add_difference(&mut self, residual: f64, slope: f64, to: usize, from: Option<usize>) {
            let mut gradient = vec![0.0; 11];
            gradient[to] = slope;
            if let Some(from) = from {
                gradient[from] = -slope;
            }
            self.0.push((residual, gradient));
        }
    }

    /// The gradient of the cost, which is smooth where hinges begin, against central differences; says whether there was a
    /// residual at all.
    fn check<const K: usize>(edge: &impl BandEdge<K>, window: &[f64; 11], tolerance: f64) -> bool {
        let window: [f64; K] = std::array::from_fn(|i| window[i]);
        let said = |window: &[f64; K]| {
            let mut said = Said::default();
            edge.residuals(&Window::new(window), &mut said);
            said.0
        };
        let cost = |window: &[f64; K]| said(window).iter().map(|(r, _)| 0.5 * r * r).sum::<f64>();
        for k in 0..K {
            let analytic: f64 = said(&window).iter().map(|(r, g)| r * g[k]).sum();
            let step = |h: f64| {
                let mut moved = window;
                moved[k] += h;
                cost(&moved)
            };
            let h = 1e-5;
            let numeric = (step(h) - step(-h)) / (2.0 * h);
            let size = 1.0 + analytic.abs() + cost(&window);
            assert!((analytic - numeric).abs() <= tolerance * size, "{k}: {analytic} {numeric} at {window:?}");
        }
        !said(&window).is_empty()
    }

    pub(super) fn windows() -> impl Strategy<Value = [f64; 11]> {
        let step = || (0.05..0.4_f64, -0.3..0.3_f64, -0.6..0.6_f64, 0.05..0.5_f64, 0.05..0.5_f64);
        (step(), step(), -3.0..3.0_f64).prop_map(|(a, b, yaw)| {
            let (c, s) = (yaw.cos(), yaw.sin());
            let at = |x: f64, y: f64| (2.0 + c * x - s * y, 2.0 + s * x + c * y);
            let ((x1, y1), (x2, y2)) = (at(a.0, a.1), at(a.0 + b.0, a.1 + b.1));
            [2.0, 2.0, yaw, a.3, x1, y1, yaw + a.2, b.3, x2, y2, yaw + a.2 + b.2]
        })
    }

    pub(super) fn limits() -> MotionLimits {
        let twist = TwistLimits { forward_speed: 0.4, yaw_rate: 0.4, lateral_speed: 0.1, ..TwistLimits::default() };
        MotionLimits { twist, steering: Some(SteeringLimits::default()), lateral_acceleration: Some(0.1) }
    }

    proptest! {
        #[test]
        fn jacobians_are_those_of_central_differences(window in windows()) {
            let limits = limits();
            check(&Duration { weight: 2.0 }, &window, 1e-6);
            check(&Length { weight: 2.0 }, &window, 1e-6);
            check(&Speed::new(&limits, 1.0, 3.0, 5.0), &window, 1e-5);
            check(&Speed::new(&limits, -1.0, 3.0, 5.0), &window, 1e-5);
            check(&NonHolonomic { weight: 7.0 }, &window, 1e-6);
            check(&TurningRadius { max_curvature: 0.5, weight: 7.0 }, &window, 1e-5);
            check(&SteeringRate { curvature_rate: 0.3, weight: 7.0 }, &window, 1e-4);
            check(&Acceleration::new(&limits, 0.9, 2.0), &window, 1e-4);
            let (start, goal) = (Twist2::new(0.2, -0.1, 0.1), Twist2::ZERO);
            check(&EndSpeed { twist: start, limits: limits.twist, sideways: true, at_end: false, weight: 2.0 }, &window, 1e-4);
            check(&EndSpeed { twist: goal, limits: limits.twist, sideways: false, at_end: true, weight: 2.0 }, &window, 1e-4);
            let free = MotionLimits { steering: None, ..limits };
            check(&Speed::new(&free, 0.0, 3.0, 5.0), &window, 1e-5);
            check(&Acceleration::new(&free, 0.9, 2.0), &window, 1e-4);
            check(&ViaPoint { point: Vector2::new(1.0, 2.5), weight: 3.0 }, &window, 1e-6);
            check(&Rotation { side: -1.0, weight: 3.0 }, &window, 1e-6);
        }

        #[test]
        fn jacobians_of_distances_are_those_of_central_differences(window in windows(), t in 0.0..1.0_f64) {
            let hull = Hull::new(&[Vector2::new(-0.2, 0.0), Vector2::new(0.3, -0.1), Vector2::new(0.1, 0.4)]).unwrap();
            let mover = MovingObstacle::new(Vector2::new(1.7, 2.2), Vector2::new(0.5, 0.1), 0.1).unwrap().with_hull(hull);
            let circles = [Circle { center: Vector2::new(0.3, 0.1), radius: 0.2 }, Circle { center: Vector2::new(-0.2, 0.0), radius: 0.2 }];
            check(&MovingClearance { obstacle: &mover, circles: &circles, time: t, clearance: 0.8, weight: 3.0 }, &window, 1e-3);
        }
    }

    /// The field is bilinear between cells, so that its slope jumps on their lines: looked at within cells.
    #[test]
    fn jacobians_on_the_field_are_those_of_central_differences() {
        let layout = GridLayout::new(80, 80, 0.05, Se2::default()).unwrap();
        let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        costmap.set(Cell::new(50, 44), cost::LETHAL);
        let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
        let circles = [Circle { center: Vector2::zeros(), radius: 0.2 }];
        let mut seen = 0;
        for i in 0..40 {
            let at = Vector2::new(2.04 + 0.05 * f64::from(i % 8), 2.04 + 0.05 * f64::from(i / 8));
            let window = [at.x, at.y, 0.7, 0.2, at.x + 0.3, at.y + 0.21, 0.5, 0.2, 3.0, 3.0, 0.4];
            let (clearance, inflation) = (0.5, 0.7);
            let (weight, inflation_weight) = (4.0, 1.0);
            let clear = Clearance { map: &map, circles: &circles, clearance, weight, inflation, inflation_weight };
            // f32 cells.
            seen += usize::from(check(&clear, &window, 2e-2));
            let cautious =
                CautiousSpeed { map: &map, circles: &circles, speed: 0.2, caution: 0.6, per_metre: 1.0, weight: 4.0 };
            seen += usize::from(check(&cautious, &window, 2e-2));
        }
        assert!(seen > 40, "{seen}");
    }

    #[test]
    fn within_the_limits_nothing_is_said() {
        let window = [0.0, 0.0, 0.0, 1.0, 0.2, 0.001, 0.01, 1.0, 0.4, 0.004, 0.02];
        let limits = limits();
        assert!(!check(&Speed::new(&limits, 1.0, 1.0, 1.0), &window, 1e-6));
        assert!(!check(&Acceleration::new(&limits, 1.0, 1.0), &window, 1e-6));
        assert!(!check(&TurningRadius { max_curvature: 1.0, weight: 1.0 }, &window, 1e-6));
        assert!(!check(&SteeringRate { curvature_rate: 1.0, weight: 1.0 }, &window, 1e-6));
        assert!(!check(&Rotation { side: 1.0, weight: 1.0 }, &window, 1e-6));
    }
}
