//! Laps through the ring of codes, and a stop at the station after each.

use super::{
    Result,
    pilot::{Pilot, Variant},
    site::{DT, Site},
};
use agv_nav::{
    control::track::{FollowerParams, PurePursuit, PurePursuitParams, Stanley, StanleyParams},
    core::{
        geometry::{UncertainPose, angle_difference},
        path::Course,
    },
    filters::marker::PoseSource,
    pipeline::{Centring, CentringParams, CentringStatus},
    prelude::*,
};
use agv_sim::{Body, CodeCamera, CodeCameraParams, GridWorld, Laser, Simulator2d, Vehicle};

/// What the runs are like.
#[derive(Clone, Copy)]
pub(crate) struct Runs {
    pub(crate) laps: usize,
    /// Share of the codes that cannot be read.
    pub(crate) damaged: f64,
    /// Yaw of the vehicle off the path before the first lap, in radians.
    pub(crate) yaw_offset: f64,
    /// Whether codes that cannot be read are known by their places.
    pub(crate) uses_unread: bool,
    pub(crate) par: Par,
}

/// One moment of a run.
pub(crate) struct Moment {
    pub(crate) time: f64,
    pub(crate) truth: Se2,
    pub(crate) estimate: Se2,
    /// Distance from the path, to the left, in metres.
    pub(crate) cross_track: f64,
    pub(crate) twist: Twist2,
}

/// The pose by the particles and by the image, where a code was seen.
pub(crate) struct Sighting {
    pub(crate) truth: Se2,
    pub(crate) by_laser: UncertainPose<Se2>,
    pub(crate) by_codes: UncertainPose<Se2>,
    pub(crate) fused: Se2,
}

/// What a lap came to.
pub(crate) struct Lap {
    pub(crate) arrived: bool,
    /// Seconds from rest to the tracker's arrival.
    pub(crate) time: f64,
    /// Greatest heading error after the first metre, in radians.
    pub(crate) offset_angle: f64,
    /// Greatest distances from the path to its right and left, in metres.
    pub(crate) offset: (f64, f64),
    /// Distance of the vehicle from the station as the tracker left it, in metres.
    pub(crate) stop_error: f64,
    /// Distance after centring over the station's code; none if that failed or there are no codes.
    pub(crate) centred_error: Option<f64>,
}

/// All laps of one seed.
#[derive(Default)]
pub(crate) struct Run {
    pub(crate) laps: Vec<Lap>,
    pub(crate) moments: Vec<Moment>,
    pub(crate) sightings: Vec<Sighting>,
    /// Share of the cycles that were driven by codes.
    pub(crate) by_codes: f64,
    pub(crate) contacts: usize,
}

/// The vehicle in its world, with its filters.
struct Drive<'a> {
    site: &'a Site,
    simulator: Simulator2d<GridWorld>,
    camera: CodeCamera,
    pilot: Pilot,
    motion: Motion,
    cycles: usize,
    code_cycles: usize,
    run: Run,
}

impl Run {
    pub(crate) fn new(site: &Site, runs: Runs, variant: Variant, seed: Seed) -> Result<Self> {
        let start = site.station() * Se2::new(0.0, 0.0, runs.yaw_offset);
        let vehicle = Vehicle::new(site.vehicle, start, seed)?;
        let simulator = Simulator2d::new(GridWorld::new(&site.map), vehicle, Body::rectangle(0.5, 0.3)?, DT)?
            .with_laser(Laser::new(site.laser, seed)?, 2)?;
        let camera = CodeCameraParams::new(*site.projection.camera(), *site.projection.base_from_camera());
        let camera = CodeCameraParams { damaged: runs.damaged, missed: 0.05, ..camera };
        // The station's code is cleaned, whichever seed: a vehicle that is to stop over a code must have one.
        let mut camera_seed = seed;
        let camera = loop {
            let camera = CodeCamera::new(camera, site.codes.clone(), camera_seed)?;
            if !camera.is_damaged(0) || runs.damaged >= 1.0 {
                break camera;
            }
            camera_seed = camera_seed.derive(1);
        };
        let pilot = Pilot::new(site, variant, &start, &runs, seed)?;
        let (motion, run) = (Motion::REST, Self::default());
        let mut drive = Drive { site, simulator, camera, pilot, motion, cycles: 0, code_cycles: 0, run };
        for _ in 0..runs.laps {
            let lap = drive.lap(variant)?;
            let arrived = lap.arrived;
            drive.run.laps.push(lap);
            if !arrived {
                break;
            }
        }
        drive.run.by_codes = drive.code_cycles as f64 / drive.cycles.max(1) as f64;
        Ok(drive.run)
    }
}

/// For the lap: pure pursuit does not look nearer ahead than the vehicle's yaw acceleration can follow.
fn lap_tracker() -> Result<PurePursuit> {
    let follower = FollowerParams { max_yaw_slip: 0.0, ..FollowerParams::default() };
    Ok(PurePursuit::new(PurePursuitParams { follower, ..PurePursuitParams::default() })?)
}

/// For the last half metre, at a walk: to the millimetre.
fn stop_tracker() -> Result<Stanley> {
    let follower =
        FollowerParams { bend_window: 0.4, goal_tolerance: 0.003, max_yaw_slip: 0.0, ..FollowerParams::default() };
    Ok(Stanley::new(StanleyParams { follower, ..StanleyParams::default() })?)
}

impl Drive<'_> {
    /// One cycle under the present motion: what the sensors say goes to the filters.
    fn cycle(&mut self) -> Result<VehicleState> {
        let seen = self.simulator.step(&self.motion.twist)?;
        let (truth, now) = (seen.truth.map_from_base, seen.truth.stamp);
        self.run.contacts += usize::from(seen.contact);
        self.pilot.predict(&seen.odometry)?;
        if let Some(scan) = seen.scan() {
            self.pilot.scan(scan)?;
        }
        let sightings = self.camera.look(&truth)?;
        if let Some(by_codes) = self.pilot.image(now, sightings)? {
            let (by_laser, fused) = (self.pilot.by_laser()?, self.pilot.map_from_base()?);
            self.run.sightings.push(Sighting { truth, by_laser, by_codes, fused });
        }
        self.cycles += 1;
        self.code_cycles += usize::from(self.pilot.source() == PoseSource::Code);
        Ok(VehicleState::new(self.pilot.map_from_base()?, self.motion.twist))
    }

    fn lap(&mut self, variant: Variant) -> Result<Lap> {
        let mut tracker = lap_tracker()?;
        tracker.set_path(&self.site.lap)?;
        let mut course = Course::new(0.2);
        course.set(&self.site.lap)?;
        let limits = self.site.limits;
        let mut lap = Lap {
            arrived: false,
            time: 0.0,
            offset_angle: 0.0,
            offset: (0.0, 0.0),
            stop_error: f64::NAN,
            centred_error: None,
        };
        let at_most = (20.0 * self.site.lap.length() / limits.twist.forward_speed / DT) as usize;
        for cycle in 1..=at_most {
            let state = self.cycle()?;
            let truth = self.simulator.vehicle().map_from_base();
            lap.time = cycle as f64 * DT;
            if let Some(projection) = course.advance(&truth.translation(), 0.5) {
                let left = projection.cross_track;
                if projection.arc_length > 1.0 {
                    let turned = angle_difference(truth.yaw(), projection.direction.angle()).abs();
                    lap.offset_angle = lap.offset_angle.max(turned);
                    lap.offset = (lap.offset.0.min(left), lap.offset.1.max(left));
                }
                let (time, estimate) = (self.cycles as f64 * DT, state.map_from_base);
                self.run.moments.push(Moment { time, truth, estimate, cross_track: left, twist: self.motion.twist });
            }
            let command = tracker.command(&state, &limits, DT)?;
            self.motion = command.motion;
            lap.arrived = command.status == TrackStatus::Arrived;
            if lap.arrived || command.status == TrackStatus::OffPath {
                break;
            }
        }
        self.settle()?;
        lap.stop_error = self.distance_from_station();
        // A vehicle that is told it has arrived, a metre away, has not.
        lap.arrived &= lap.stop_error < 1.0;
        if variant != Variant::Laser && lap.arrived {
            lap.centred_error = self.centre()?;
        }
        Ok(lap)
    }

    /// Comes to rest.
    fn settle(&mut self) -> Result<()> {
        for _ in 0..20 {
            self.motion = self.site.limits.step(&self.motion, &Motion::REST, DT)?;
            self.cycle()?;
        }
        Ok(())
    }

    fn distance_from_station(&self) -> f64 {
        (self.simulator.vehicle().map_from_base().translation() - self.site.station().translation()).norm()
    }

    /// Stops over the station's code.
    fn centre(&mut self) -> Result<Option<f64>> {
        let mut centring = Centring::new(Box::new(stop_tracker()?), CentringParams::default())?;
        let state = VehicleState::new(self.pilot.map_from_base()?, self.motion.twist);
        centring.start(&self.site.station(), &state)?;
        for _ in 0..4000 {
            let state = self.cycle()?;
            let step = centring.command(&state, &self.site.limits, DT)?;
            self.motion = step.motion;
            match step.status {
                CentringStatus::Centred => return Ok(Some(self.distance_from_station())),
                CentringStatus::Failed => break,
                _ => {}
            }
        }
        Ok(None)
    }
}
