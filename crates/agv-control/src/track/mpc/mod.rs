//! Linear time-varying model predictive control within the vehicle's limits.
//!
//! Each cycle plans the inputs of a horizon, and gives the first: speed and turn rate; speed and steering angle, where the
//! vehicle steers; speed, turn rate and sideways speed, where it moves sideways. The reference runs along the course by the speed profile as fast as
//! the drives follow; the model is the kinematic one about it, with the drives' lag as states (see `stage`); and
//! beyond the horizon the cost to go is that of the linear quadratic regulator, so that without a limit in sight on a straight line
//! both trackers are one (Rawlings, Mayne and Diehl, *Model predictive control*, 2017, section 2.5). What a
//! regulator cannot know is that turn rate, steering and their changes end somewhere: the horizon begins the turn in time.
//!
//! Pose and slip are those of the filter that the regulator uses, too.
//!
//! # When there is no answer
//! The limits of the inputs never contradict each other, so only the limit of iterations leaves a cycle without a plan. The
//! stage of the last plan that is due is then driven, brought within the limits; when the last plan has run out, the vehicle
//! brakes. [`MpcSteering::report`] says so.

mod programme;
mod stage;
mod vehicle;

use super::{
    errors::{TrackingErrors, curvature},
    follower::{Facing, Follower, FollowerParams, able_to_stop, top_speed},
    lateral::{LEAST_SPEED, LateralTable, Sampled, TrackingWeights},
    observer::{Observer, ObserverParams},
    steering::{Steering, SteeringInput},
};
use crate::Error;
use agv_core::{
    check,
    geometry::Twist2,
    roles::{TrackError, VehicleState},
    solve::{QuadraticOutcome, QuadraticParams},
};
use programme::{Costs, Programme};
use stage::Stage;
use vehicle::{Turn, input_limits};

/// Parameters of [`Mpc`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MpcParams {
    /// What the errors cost, at the end of each step of the horizon. There is no integral action.
    pub weights: TrackingWeights,
    /// Speed less than planned that is worth as much as one of the errors, in metres per second.
    pub speed_worth: f64,
    /// Sideways speed that is worth as much, in metres per second, for vehicles that have it.
    pub sideways_worth: f64,
    /// Steps of the horizon.
    pub horizon: usize,
    /// Length of a step, in seconds; may be longer than a cycle.
    pub step: f64,
    /// Greatest speed that the cost to go is computed for, in metres per second.
    pub max_speed: f64,
    /// Most iterations of the solver in one cycle.
    pub max_iterations: usize,
    /// How well poses and the floor are known.
    pub observer: ObserverParams,
    /// What all trackers share.
    pub follower: FollowerParams,
}

impl Default for MpcParams {
    /// One second ahead, as long as a fast AGV takes to brake for a bend, in twenty steps.
    fn default() -> Self {
        Self {
            weights: TrackingWeights::default(),
            speed_worth: 0.1,
            sideways_worth: 0.1,
            horizon: 20,
            step: 0.05,
            max_speed: 2.0,
            max_iterations: 100,
            observer: ObserverParams::default(),
            follower: FollowerParams { bend_window: 0.2, ..FollowerParams::default() },
        }
    }
}

/// Most steps of a horizon: beyond it a dense programme is the wrong one.
const MOST_STEPS: usize = 100;

/// Where the command of a cycle came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum MpcSource {
    /// From the plan of this cycle.
    Solved,
    /// From the last plan that was solved.
    LastPlan,
    /// There was no plan: the vehicle brakes.
    Braking,
}

/// What became of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MpcReport {
    /// Where the command came from.
    pub source: MpcSource,
    /// What the solver said.
    pub outcome: QuadraticOutcome,
}

/// The steering law of [`Mpc`].
#[derive(Debug, Clone)]
pub struct MpcSteering {
    params: MpcParams,
    table: LateralTable,
    observer: Observer,
    sampled: Sampled,
    stages: Vec<Stage>,
    /// For two inputs and for three.
    programmes: [Programme; 2],
    /// The inputs of the last plan that was solved, how many a stage has, and its age in seconds.
    plan: Vec<f64>,
    planned: usize,
    age: f64,
    /// Time since the working set was moved on, in seconds.
    since_shift: f64,
    report: Option<MpcReport>,
}

/// The model predictive tracker. `O(n³)` per command for the `n` inputs of a horizon; the twist of the states is to be the last command.
///
/// ```
/// use agv_control::track::{Mpc, MpcParams, MpcSource};
/// use agv_core::{geometry::{Se2, Twist2}, kinematics::MotionLimits, nalgebra::Vector2, path::Path};
/// use agv_core::roles::{PathTracker, VehicleState};
///
/// let mut tracker = Mpc::new(MpcParams::default())?;
/// tracker.set_path(&Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(5.0, 0.0)])?)?;
/// let beside = VehicleState::new(Se2::new(1.0, 0.1, 0.0), Twist2::new(0.8, 0.0, 0.0));
/// let command = tracker.command(&beside, &MotionLimits::default(), 0.02)?;
/// assert!(command.motion.twist.yaw_rate < 0.0); // back to the right
/// assert!(tracker.steering().report().is_some_and(|report| report.source == MpcSource::Solved));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Mpc = Follower<MpcSteering>;

impl Mpc {
    /// A tracker from its parameters; everything that it will need is allocated here.
    ///
    /// # Errors
    /// The first parameter that is out of its range; [`Error::NotStabilisable`] for weights too far apart for the numbers;
    /// [`Error::FacingNotSupported`] for [`Facing::Path`], as the model is linear about the direction of the path.
    pub fn new(params: MpcParams) -> Result<Self, Error> {
        check::positive("speed_worth", params.speed_worth)?;
        check::positive("sideways_worth", params.sideways_worth)?;
        check::in_range("horizon", params.horizon as f64, 2.0, MOST_STEPS as f64)?;
        check::positive("step", params.step)?;
        let lag = check::non_negative("response_time", params.follower.response_time)?;
        if params.follower.facing == Facing::Path {
            return Err(Error::FacingNotSupported);
        }
        let observer = Observer::new(params.observer, lag, params.follower.max_yaw_slip)?;
        let table = LateralTable::new(&params.weights, lag, params.step, params.max_speed)?;
        let solver = QuadraticParams { max_iterations: params.max_iterations, ..QuadraticParams::default() };
        let programme = |inputs| Programme::new(inputs, params.horizon, solver);
        let steering = MpcSteering {
            params,
            table,
            observer,
            sampled: Sampled::new(lag, params.step),
            stages: vec![Stage::default(); params.horizon],
            programmes: [programme(2)?, programme(3)?],
            plan: vec![0.0; 3 * params.horizon],
            planned: 0,
            age: 0.0,
            since_shift: 0.0,
            report: None,
        };
        // The observer makes up for the slip; the follower must not do so again.
        let follower = FollowerParams { max_yaw_slip: 0.0, ..params.follower };
        Ok(Self::with_steering(follower, steering)?)
    }
}

impl MpcSteering {
    /// What became of the last cycle that was planned.
    pub const fn report(&self) -> Option<MpcReport> {
        self.report
    }

    /// Where the vehicle will be if it drives as fast as planned, stage by stage.
    fn set_stages(&mut self, input: &SteeringInput<'_>, errors: &TrackingErrors, turn: &Turn) {
        let (lag, limits) = (self.params.follower.response_time, &input.limits.twist);
        let (dt, once) = (self.sampled.dt, self.sampled.once);
        let (mut s, mut actual, mut told) = (errors.arc_length, errors.actual.vx, input.twist.vx);
        let course = input.course;
        for (k, stage) in self.stages.iter_mut().enumerate() {
            let time = if k == 0 { input.dt } else { dt };
            let top = input.profile.speed_at(s).min(top_speed(input.limits, input.gear));
            let wanted = able_to_stop(top, course.section_end() - s, limits.deceleration, dt + lag);
            let wanted = if k == 0 { wanted.min(input.speed) } else { wanted };
            let rise = if told < 0.0 { limits.deceleration } else { limits.acceleration };
            told = wanted.clamp(told - limits.deceleration * time, told + rise * time);
            let ahead = once[0] * actual + once[1] * told;
            actual = told + (actual - told) * self.sampled.kept;
            let speed = (ahead / dt).max(0.0);
            let [begin, middle, end] = [0.0, 0.5, 1.0].map(|share| curvature(course, s + share * speed * dt));
            stage.speed = speed;
            stage.curvature = (begin + 4.0 * middle + end) / 6.0;
            stage.slope = if speed * dt > 1e-3 { (end - begin) / (speed * dt) } else { 0.0 };
            let preview = curvature(course, s + speed * (lag + 0.5 * dt));
            stage.inputs = [told, turn.for_curvature(preview, told.max(0.0), errors.slip)];
            turn.linearise(stage, errors.slip);
            s += speed * dt;
        }
    }

    /// The inputs of this cycle, within the limits that the programme was given.
    fn inputs(&mut self, which: usize, outcome: QuadraticOutcome, braking: [f64; 3]) -> [f64; 3] {
        let (count, step) = (which + 2, self.params.step);
        let programme = &self.programmes[which];
        let source = if outcome.solved() {
            self.plan[..programme.solution().len()].copy_from_slice(programme.solution());
            (self.planned, self.age) = (count, 0.0);
            MpcSource::Solved
        } else if self.planned == count && self.age < self.params.horizon as f64 * step {
            MpcSource::LastPlan
        } else {
            MpcSource::Braking
        };
        self.report = Some(MpcReport { source, outcome });
        let due = ((self.age / step) as usize).min(self.params.horizon - 1) * count;
        let mut inputs = [0.0; 3];
        for (k, input) in inputs.iter_mut().enumerate().take(count) {
            let wanted = if source == MpcSource::Braking { braking[k] } else { self.plan[due + k] };
            *input = wanted.clamp(programme.lower[k], programme.upper[k]);
        }
        inputs
    }
}

impl Steering for MpcSteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let errors = TrackingErrors::of(&self.observer, input)?;
        let limits = input.limits;
        let turn = Turn::of(limits, input.gear);
        let sideways = limits.twist.lateral_speed;
        let which = usize::from(sideways > 0.0 && limits.steering.is_none());
        self.set_stages(input, &errors, &turn);

        let p = self.params;
        let drives = input_limits(input, &turn, p.step);
        let programme = &mut self.programmes[which];
        let stages = &self.stages;
        programme.set_limits(&drives, |stage, drive| {
            let stage = &stages[stage];
            let most = match drive {
                0 => return (0.0, stage.inputs[0].max(0.0)),
                1 => turn.greatest(limits, stage.inputs[0]),
                _ => sideways,
            };
            (-most, most)
        });
        let [side, heading, _] = p.weights.costs(LEAST_SPEED);
        let end = stages.last().map_or(0.0, |stage| stage.speed);
        let costs = Costs { side, heading, terminal: self.table.cost(end) };
        let turn_now = match turn {
            Turn::Rate => errors.actual.yaw_rate,
            Turn::Angle { .. } => errors.steering.unwrap_or(drives[1].now),
        };
        let state = [0.0, errors.cross_track, errors.heading, errors.actual.vx, turn_now, errors.actual.vy];
        let worth = |speed: f64| 1.0 / (speed * speed);
        programme.set_cost(&state, stages, &self.sampled, &costs, |stage, drive| match drive {
            0 => (worth(p.speed_worth), stage.inputs[0]),
            1 => {
                // As the regulator weighs it, per turn rate of the vehicle.
                let [.., rate] = p.weights.costs(stage.speed);
                let share = match turn {
                    Turn::Rate => stage.turn,
                    Turn::Angle { .. } => stage.turn.abs().max(errors.slip * LEAST_SPEED),
                };
                (rate * share * share, stage.inputs[1])
            }
            _ => (worth(p.sideways_worth), 0.0),
        });
        if self.since_shift >= p.step {
            self.since_shift -= p.step;
            programme.shift()?;
        }
        let outcome = programme.solve()?;
        let [speed, turned, aside] = self.inputs(which, outcome, [0.0, drives[1].now, 0.0]);
        Ok(Twist2::new(speed, aside, turn.yaw_rate(speed, turned)))
    }

    fn observe(&mut self, state: &VehicleState, dt: f64) {
        self.observer.update(state, dt);
        self.age += dt;
        self.since_shift += dt;
    }

    fn reset(&mut self) {
        self.programmes.iter_mut().for_each(Programme::forget);
        (self.planned, self.since_shift) = (0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = MpcParams::default();
        for (name, params) in [
            ("speed_worth", MpcParams { speed_worth: 0.0, ..good }),
            ("sideways_worth", MpcParams { sideways_worth: f64::NAN, ..good }),
            ("horizon", MpcParams { horizon: 1, ..good }),
            ("horizon", MpcParams { horizon: 1000, ..good }),
            ("step", MpcParams { step: 0.0, ..good }),
            ("max_speed", MpcParams { max_speed: f64::NAN, ..good }),
            ("heading", MpcParams { weights: TrackingWeights { heading: 0.0, ..good.weights }, ..good }),
            ("yaw_noise", MpcParams { observer: ObserverParams { yaw_noise: f64::NAN, ..good.observer }, ..good }),
            ("response_time", MpcParams { follower: FollowerParams { response_time: -0.1, ..good.follower }, ..good }),
            ("bend_window", MpcParams { follower: FollowerParams { bend_window: 0.0, ..good.follower }, ..good }),
        ] {
            assert!(Mpc::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
        let follower = FollowerParams { facing: Facing::Path, ..good.follower };
        assert_eq!(Mpc::new(MpcParams { follower, ..good }).err(), Some(Error::FacingNotSupported));
    }
}
