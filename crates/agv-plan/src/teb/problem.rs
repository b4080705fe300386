//! All residuals of a band in one case: what it costs, and its normal equations.

use super::{
    band::Band,
    edges::{
        Acceleration, BandEdge, CautiousSpeed, Circle, Clearance, Direction, Duration, EndSpeed, Length,
        MovingClearance, NonHolonomic, Residuals, Rotation, Speed, SteeringRate, TurningRadius, ViaPoint, Window,
    },
    params::TebParams,
};
use agv_core::{
    geometry::Twist2,
    grid::LocalMap,
    kinematics::{MotionLimits, TwistLimits},
    obstacle::MovingObstacle,
    solve::BandedMatrix,
};
use nalgebra::Vector2;

/// What a band is bent by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) params: &'a TebParams,
    pub(super) limits: &'a MotionLimits,
    pub(super) map: &'a LocalMap,
    pub(super) circles: &'a [Circle],
    pub(super) obstacles: &'a [MovingObstacle],
    /// 1 forwards, -1 backwards, 0 where any will do.
    pub(super) gear: f64,
    /// What the vehicle does at the first pose.
    pub(super) start: Twist2,
    /// Whether it stops at the last pose.
    pub(super) stops: bool,
    /// Whether the last heading is given.
    pub(super) goal_heading: bool,
    /// Points to pass; each pulls at the pose that is nearest to it.
    pub(super) via: &'a [Vector2<f64>],
    /// Side that the first turn should be to: 1 left, -1 right, 0 any.
    pub(super) rotation: f64,
}

/// Poses at the band's beginning that a wished side of rotation is asked of.
const ROTATING: usize = 3;

/// Entries of the band below the diagonal: three poses and the two times between them.
pub(super) const HALF_BANDWIDTH: usize = 10;

impl Problem<'_> {
    /// Says all residuals, pose by pose.
    fn walk(&self, band: &Band, state: &Stages<'_>, out: &mut Sums<'_>) {
        let (w, unknowns) = (&self.params.weights, band.unknowns());
        let poses = band.len();
        let share = self.params.acceleration_share;
        let duration = Duration { weight: w.time };
        let length = Length { weight: w.length };
        let speed = Speed::new(self.limits, self.gear, w.velocity, w.gear);
        let rolling = NonHolonomic { weight: w.kinematics };
        let radius = TurningRadius { max_curvature: self.limits.max_curvature(), weight: w.turning_radius };
        let acceleration = Acceleration::new(self.limits, share, w.acceleration);
        let curvature_rate = self.limits.steering.map(|steering| share * steering.max_rate / steering.wheelbase);
        let steering = curvature_rate.map(|curvature_rate| SteeringRate { curvature_rate, weight: w.acceleration });
        let clear = Clearance {
            map: self.map,
            circles: self.circles,
            clearance: self.params.clearance,
            weight: w.obstacle,
            inflation: self.params.inflation,
            inflation_weight: w.inflation,
        };
        let cautious = self.cautious();
        let holonomic = self.limits.is_holonomic();
        let heading = |i: usize| {
            let yaw = unknowns.get(4 * i + 2).copied().unwrap_or(0.0);
            (yaw, Direction::of(yaw))
        };
        let mut ahead = (heading(0), heading(1));
        let mut middle = Direction::between(ahead.0, ahead.1);
        for i in 0..poses {
            let rest = unknowns.get(4 * i..).unwrap_or_default();
            let next = heading(i + 2);
            let (headings, middles) = ([ahead.0.1, ahead.1.1], [middle, Direction::between(ahead.1, next)]);
            (ahead, middle) = ((ahead.1, next), middles[1]);
            if let (Some(&unknowns), true) = (rest.first_chunk::<3>(), i > 0) {
                let window = &Window { unknowns, headings, middles };
                clear.residuals(window, out);
                for obstacle in self.obstacles {
                    let time = state.times.get(i).copied().unwrap_or(0.0);
                    let (circles, clearance) = (self.circles, self.params.clearance);
                    MovingClearance { obstacle, circles, time, clearance, weight: w.moving }.residuals(window, out);
                }
                for (&point, _) in self.via.iter().zip(state.nearest).filter(|(_, nearest)| **nearest == i) {
                    ViaPoint { point, weight: w.via }.residuals(window, out);
                }
            }
            if let (Some(&unknowns), true) = (rest.first_chunk::<7>(), i + 1 < poses) {
                let window = &Window { unknowns, headings, middles };
                duration.residuals(window, out);
                length.residuals(window, out);
                speed.residuals(window, out);
                if !holonomic {
                    rolling.residuals(window, out);
                }
                if self.limits.steering.is_some() {
                    radius.residuals(window, out);
                }
                if let Some(cautious) = &cautious {
                    cautious.residuals(window, out);
                }
                if i < ROTATING && self.rotation != 0.0 {
                    Rotation { side: self.rotation, weight: w.rotation }.residuals(window, out);
                }
                if i == 0 {
                    self.end(&self.start, false).residuals(window, out);
                }
                if i + 2 == poses && self.stops {
                    self.end(&Twist2::ZERO, true).residuals(window, out);
                }
            }
            if let (Some(&unknowns), true) = (rest.first_chunk::<11>(), i + 2 < poses) {
                let window = &Window { unknowns, headings, middles };
                acceleration.residuals(window, out);
                if let Some(steering) = &steering {
                    steering.residuals(window, out);
                }
            }
            out.stage(4 * i);
        }
    }

    fn cautious(&self) -> Option<CautiousSpeed<'_>> {
        let TebParams { caution, cautious_speed: speed, .. } = *self.params;
        let top = self.limits.twist.forward_speed;
        (caution > 0.0 && top > speed).then(|| CautiousSpeed {
            map: self.map,
            circles: self.circles,
            speed,
            caution,
            per_metre: (top - speed) / caution,
            weight: self.params.weights.velocity,
        })
    }

    fn end(&self, twist: &Twist2, at_end: bool) -> EndSpeed {
        // The turn rate of a vehicle that steers follows from its wheels.
        let yaw_acceleration =
            if self.limits.steering.is_some() { f64::INFINITY } else { self.limits.twist.yaw_acceleration };
        let limits = TwistLimits { yaw_acceleration, ..self.limits.twist };
        let (sideways, weight) = (self.limits.is_holonomic(), self.params.weights.acceleration);
        EndSpeed { twist: *twist, limits, sideways, at_end, weight }
    }

    /// Half the sum of the squared residuals, and the normal equations, in which what is given is tied to its place.
    pub(super) fn linearize(
        &self,
        band: &Band,
        state: &Stages<'_>,
        matrix: &mut BandedMatrix,
        gradient: &mut Vec<f64>,
    ) -> f64 {
        let dimension = (4 * band.len()).saturating_sub(1);
        matrix.reset(dimension, HALF_BANDWIDTH);
        gradient.clear();
        gradient.resize(dimension, 0.0);
        let mut sums = Sums { matrix, gradient, block: [[0.0; WIDEST]; WIDEST], slope: [0.0; WIDEST], cost: 0.0 };
        self.walk(band, state, &mut sums);
        let cost = 0.5 * sums.cost;
        let last = dimension.saturating_sub(3);
        let tied = if self.goal_heading { 3 } else { 2 };
        for unknown in (0..3).chain(last..last + tied) {
            matrix.pin(unknown);
            if let Some(entry) = gradient.get_mut(unknown) {
                *entry = 0.0;
            }
        }
        cost
    }
}

/// What does not change within a step of the solver.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stages<'a> {
    /// When the vehicle is at each pose, in seconds.
    pub(super) times: &'a [f64],
    /// Pose nearest to each point to pass.
    pub(super) nearest: &'a [usize],
}

/// Unknowns of the widest window.
const WIDEST: usize = HALF_BANDWIDTH + 1;

/// Sums of one window, which are then added to all.
struct Sums<'a> {
    matrix: &'a mut BandedMatrix,
    gradient: &'a mut Vec<f64>,
    block: [[f64; WIDEST]; WIDEST],
    slope: [f64; WIDEST],
    cost: f64,
}

impl Residuals for Sums<'_> {
    #[inline]
    fn add<const K: usize>(&mut self, residual: f64, gradient: &[f64; K]) {
        self.cost += residual * residual;
        for (i, (row, slope)) in self.block.iter_mut().zip(&mut self.slope).enumerate().take(K) {
            *slope += residual * gradient[i];
            for j in i..K {
                row[j] += gradient[i] * gradient[j];
            }
        }
    }

    #[inline]
    fn add_difference(&mut self, residual: f64, slope: f64, to: usize, from: Option<usize>) {
        self.cost += residual * residual;
        self.slope[to] += residual * slope;
        self.block[to][to] += slope * slope;
        if let Some(from) = from {
            self.slope[from] -= residual * slope;
            self.block[from][from] += slope * slope;
            self.block[from.min(to)][from.max(to)] -= slope * slope;
        }
    }
}

impl Sums<'_> {
    /// All residuals of the window that begins at this unknown were said.
    #[inline]
    fn stage(&mut self, first: usize) {
        self.matrix.add_block(first, &self.block);
        for (to, from) in self.gradient.iter_mut().skip(first).zip(&self.slope) {
            *to += from;
        }
        self.block = [[0.0; WIDEST]; WIDEST];
        self.slope = [0.0; WIDEST];
    }
}
