//! The line of a band: how far along it each pose lies, how it bends there, and how fast it may be driven.

use super::{edges::Circle, params::TebParams};
use agv_core::{
    grid::LocalMap,
    kinematics::MotionLimits,
    obstacle::MovingObstacle,
    roles::{BlockReason, LocalPlanRequest},
};
use nalgebra::Vector2;

/// Vehicle and surroundings that a line is driven in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ground<'a> {
    pub(super) params: &'a TebParams,
    pub(super) limits: &'a MotionLimits,
    pub(super) map: &'a LocalMap,
    pub(super) circles: &'a [Circle],
    /// 1 forwards, -1 backwards.
    pub(super) gear: f64,
}

impl<'a> Ground<'a> {
    pub(super) const fn new(
        params: &'a TebParams,
        circles: &'a [Circle],
        request: &LocalPlanRequest<'a>,
        gear: f64,
    ) -> Self {
        Self { params, limits: request.limits, map: request.map, circles, gear }
    }

    /// Speed that a way is taken to be driven at before more is known, in metres per second.
    pub(super) fn usual_speed(&self) -> f64 {
        let twist = &self.limits.twist;
        (0.7 * if self.gear < 0.0 { twist.reverse_speed } else { twist.forward_speed }).max(0.05)
    }

    /// Where the vehicle's circles are at a pose, and their radii.
    fn circles_at(&self, [x, y, yaw]: [f64; 3]) -> impl Iterator<Item = (Vector2<f64>, f64)> {
        let (sin, cos) = yaw.sin_cos();
        self.circles.iter().map(move |&Circle { center: c, radius }| {
            (Vector2::new(x + cos * c.x - sin * c.y, y + sin * c.x + cos * c.y), radius)
        })
    }

    /// Least clearance of a pose from something that moves, some seconds from now.
    pub(super) fn clearance_from(&self, mover: &MovingObstacle, time: f64, pose: [f64; 3]) -> f64 {
        let clearance = |(center, radius)| mover.distance_after(time, &center) - radius;
        self.circles_at(pose).map(clearance).fold(f64::INFINITY, f64::min)
    }

    /// Least clearance of a pose on the field; none off the map.
    pub(super) fn clearance(&self, pose: [f64; 3]) -> Option<f64> {
        let half_cell = 0.5 * self.map.layout().resolution();
        self.circles_at(pose)
            .map(|(center, radius)| self.map.distance_at(&center).map(|(distance, _)| distance - radius - half_cell))
            .try_fold(f64::INFINITY, |least, clearance| clearance.map(|c| least.min(c)))
    }
}

/// A band by arc length.
#[derive(Debug, Clone, Default)]
pub(super) struct Line {
    /// Poses, headings unwrapped.
    nodes: Vec<[f64; 3]>,
    /// Arc length at each, in metres.
    arc_lengths: Vec<f64>,
    /// Turn of the heading per metre of travel at each, in rad/m.
    curvatures: Vec<f64>,
    /// Greatest squared speed at each with no regard to braking, and with.
    caps: Vec<f64>,
    squares: Vec<f64>,
    /// Arc length at which its speeds lead to a stop.
    stop: f64,
    /// Why it is not driven to its end.
    stopped: Option<BlockReason>,
}

/// A place on a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) arc_length: f64,
    pub(super) position: Vector2<f64>,
    pub(super) yaw: f64,
    pub(super) segment: usize,
}

impl Line {
    pub(super) fn length(&self) -> f64 {
        self.arc_lengths.last().copied().unwrap_or(0.0)
    }

    /// Takes a band. With `timed`, it is driven hardly faster than the band is, which has seen what moves: by a twentieth and 0.05 m/s.
    pub(super) fn set(&mut self, band: &[[f64; 4]], ground: &Ground<'_>, timed: bool) {
        self.nodes.clear();
        self.arc_lengths.clear();
        self.curvatures.clear();
        self.caps.clear();
        let mut arc_length = 0.0;
        for (i, node) in band.iter().enumerate() {
            if let Some(before) = i.checked_sub(1).and_then(|i| band.get(i)) {
                arc_length += (node[0] - before[0]).hypot(node[1] - before[1]);
            }
            self.nodes.push([node[0], node[1], node[2]]);
            self.arc_lengths.push(arc_length);
        }
        for i in 0..self.nodes.len() {
            let (a, b) = (i.saturating_sub(1), (i + 1).min(self.nodes.len() - 1));
            let way = (self.arc_lengths[b] - self.arc_lengths[a]).max(1e-3);
            self.curvatures.push((self.nodes[b][2] - self.nodes[a][2]) / way);
        }
        for (i, node) in self.nodes.iter().enumerate() {
            let mut speed = self.speed_at_node(i, ground);
            if let Some(clearance) = ground.clearance(*node) {
                let TebParams { caution, cautious_speed, .. } = *ground.params;
                if clearance < caution {
                    let top = ground.limits.twist.forward_speed.max(cautious_speed);
                    speed = speed.min(cautious_speed + (top - cautious_speed) * (clearance / caution).max(0.0));
                }
            }
            if let (true, Some(&next)) = (timed, self.arc_lengths.get(i + 1)) {
                speed = speed.min(1.05 * (next - self.arc_lengths[i]) / band[i][3] + 0.05);
            }
            self.caps.push(speed * speed);
        }
    }

    /// Greatest speed that the bend at a pose allows.
    fn speed_at_node(&self, i: usize, ground: &Ground<'_>) -> f64 {
        let limits = ground.limits;
        let twist = &limits.twist;
        let curvature = self.curvatures[i];
        let way_speed = if ground.limits.is_holonomic() {
            self.holonomic_speed(i, ground)
        } else if ground.gear < 0.0 {
            twist.reverse_speed
        } else {
            twist.forward_speed
        };
        let bend = limits.speed_in_bend(curvature.abs().min(limits.max_curvature()));
        // How fast the bend begins.
        let next = (i + 1).min(self.nodes.len() - 1);
        let before = i.saturating_sub(1);
        let way = (self.arc_lengths[next] - self.arc_lengths[before]).max(1e-3);
        let change = (self.curvatures[next] - self.curvatures[before]).abs() / way;
        let share = ground.params.acceleration_share;
        let entering = match &limits.steering {
            _ if change <= 1e-9 => f64::INFINITY,
            Some(s) => {
                let slope = s.wheelbase * curvature.abs().min(limits.max_curvature());
                share * s.max_rate * (1.0 + slope * slope) / (s.wheelbase * change)
            }
            None => (share * twist.yaw_acceleration / change).sqrt(),
        };
        way_speed.min(bend).min(entering.max(0.05))
    }

    /// Speed of a vehicle that drives in any direction, by the direction in its own frame.
    fn holonomic_speed(&self, i: usize, ground: &Ground<'_>) -> f64 {
        let twist = &ground.limits.twist;
        let (a, b) = (i.saturating_sub(1), (i + 1).min(self.nodes.len() - 1));
        let (from, to) = (self.nodes[a], self.nodes[b]);
        let ahead = Vector2::new(to[0] - from[0], to[1] - from[1]);
        let length = ahead.norm();
        if length < 1e-9 {
            return twist.forward_speed;
        }
        let (sin, cos) = self.nodes[i][2].sin_cos();
        let (x, y) = ((ahead.x * cos + ahead.y * sin) / length, (ahead.y * cos - ahead.x * sin) / length);
        let along = if x < 0.0 { twist.reverse_speed / -x } else { twist.forward_speed / x.max(1e-9) };
        along.min(twist.lateral_speed / y.abs().max(1e-9)).min(twist.forward_speed)
    }

    /// Why the speeds lead to a stop before the end, if they do.
    pub(super) const fn stopped(&self) -> Option<BlockReason> {
        self.stopped
    }

    /// Speeds that lead to a stop before something that is in the way.
    pub(super) fn stop_at(&mut self, stop: f64, reason: Option<BlockReason>, ground: &Ground<'_>) {
        self.plan_stop(stop, 0.5, ground);
        self.stopped = reason.or(Some(BlockReason::Obstacle));
    }

    /// Arc length at which the speeds lead to a stop.
    pub(super) const fn stop(&self) -> f64 {
        self.stop
    }

    /// The same stop for the same reason, with at most a share of the speeds that are allowed.
    pub(super) fn slow_down(&mut self, share: f64, ground: &Ground<'_>) {
        let stopped = self.stopped;
        self.plan_stop(self.stop, share, ground);
        self.stopped = stopped;
    }

    /// Speeds from which the vehicle can stop at an arc length, at most a share of those allowed.
    pub(super) fn plan_stop(&mut self, stop: f64, share: f64, ground: &Ground<'_>) {
        let braking = 2.0 * ground.params.acceleration_share * ground.limits.twist.deceleration;
        (self.stop, self.stopped) = (stop, None);
        self.squares.clear();
        self.squares.extend(self.caps.iter().map(|cap| cap * share * share));
        let mut ahead = (f64::INFINITY, self.length());
        for (square, &s) in self.squares.iter_mut().zip(&self.arc_lengths).rev() {
            *square = square.min(ahead.0 + braking * (ahead.1 - s)).min((braking * (stop - s)).max(0.0));
            ahead = (*square, s);
        }
    }

    /// Greatest speed at a place.
    pub(super) fn speed_at(&self, place: &Place) -> f64 {
        let at = |i: usize| self.squares.get(i).or(self.squares.last()).copied().unwrap_or(0.0);
        let share = self.share(place);
        (at(place.segment) * (1.0 - share) + at(place.segment + 1) * share).sqrt()
    }

    /// Turn per metre at a place.
    pub(super) fn curvature_at(&self, place: &Place) -> f64 {
        let at = |i: usize| self.curvatures.get(i).or(self.curvatures.last()).copied().unwrap_or(0.0);
        let share = self.share(place);
        at(place.segment) * (1.0 - share) + at(place.segment + 1) * share
    }

    fn share(&self, place: &Place) -> f64 {
        let (Some(a), Some(b)) = (self.arc_lengths.get(place.segment), self.arc_lengths.get(place.segment + 1)) else {
            return 0.0;
        };
        if b > a { ((place.arc_length - a) / (b - a)).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The place at an arc length, searched from a segment on.
    pub(super) fn place_at(&self, arc_length: f64, from: usize) -> Option<Place> {
        let mut segment = from;
        while segment + 2 < self.nodes.len() && self.arc_lengths[segment + 1] < arc_length {
            segment += 1;
        }
        let (a, b) = (self.nodes.get(segment)?, self.nodes.get(segment + 1).or(self.nodes.get(segment))?);
        let arc_length = arc_length.clamp(self.arc_lengths[segment], self.length());
        let mut place = Place { arc_length, position: Vector2::zeros(), yaw: 0.0, segment };
        let share = self.share(&place);
        place.position = Vector2::new(a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]));
        place.yaw = a[2] + share * (b[2] - a[2]);
        Some(place)
    }

    /// The nearest place from a segment on, not farther than some segments ahead.
    pub(super) fn nearest(&self, position: &Vector2<f64>, from: usize) -> Option<Place> {
        let mut best = (f64::INFINITY, 0.0, from);
        let last = self.nodes.len().saturating_sub(1);
        for segment in from..last.min(from + 4) {
            let (a, b) = (self.nodes[segment], self.nodes[segment + 1]);
            let (line, offset) =
                (Vector2::new(b[0] - a[0], b[1] - a[1]), Vector2::new(position.x - a[0], position.y - a[1]));
            let square = line.norm_squared();
            let share = if square > 0.0 { (offset.dot(&line) / square).clamp(0.0, 1.0) } else { 0.0 };
            let distance = (offset - line * share).norm_squared();
            // On a tie the farther one, so that the end of a segment is left.
            if distance <= best.0 {
                best = (distance, self.arc_lengths[segment] + share * square.sqrt(), segment);
            }
        }
        self.place_at(best.1, best.2)
    }

    /// Direction of travel of a segment, in the map.
    pub(super) fn direction(&self, segment: usize) -> Vector2<f64> {
        let (Some(a), Some(b)) = (self.nodes.get(segment), self.nodes.get(segment + 1)) else {
            return Vector2::zeros();
        };
        let line = Vector2::new(b[0] - a[0], b[1] - a[1]);
        let length = line.norm();
        if length > 0.0 { line / length } else { Vector2::zeros() }
    }
}
