//! What the vehicle knows of its pose: by the laser, by codes, or by both.

use super::{
    Result,
    laps::Runs,
    site::{DT, Site},
};
use agv_nav::{
    core::{
        geometry::UncertainPose,
        grid::{LikelihoodField, LikelihoodFieldParams},
        sensors::{CodeSighting, MarkerObservation, PoseObservation},
    },
    filters::{
        kalman::{PoseFilter, PoseFilterParams},
        marker::{
            CodeReader, CodeReaderParams, MarkerLocalizer, MarkerLocalizerParams, PoseSource, SourceSwitch,
            SourceSwitchParams, SwitchInput,
        },
        particle::{
            DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
            OdometryNoise,
        },
    },
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};
use clap::ValueEnum;

/// By what the pose is known.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Variant {
    /// Particle filter on laser scans
    Laser,
    /// Kalman filter on codes
    Codes,
    /// Kalman filter on codes and on the particle filter's poses
    Both,
}

impl Variant {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Laser => "laser",
            Self::Codes => "codes",
            Self::Both => "both",
        }
    }
}

/// The filters of a vehicle.
pub(crate) struct Pilot {
    variant: Variant,
    mcl: Box<dyn Correct<LaserScan, Pose = Se2> + Send>,
    filter: PoseFilter,
    reader: CodeReader,
    markers: MarkerLocalizer,
    switch: SourceSwitch,
    /// Whether codes that cannot be read are known by their places.
    uses_unread: bool,
    travelled: f64,
    /// What the particle filter has said since the Kalman filter was told.
    news: bool,
}

/// Factor of the covariance of a particle filter's pose, which errs much as the one before did: it sees the same walls.
const SHARED_ERRORS: f64 = 9.0;

impl Pilot {
    pub(crate) fn new(site: &Site, variant: Variant, start: &Se2, runs: &Runs, seed: Seed) -> Result<Self> {
        let Runs { par, uses_unread, .. } = *runs;
        let field = LikelihoodField::new(&site.map, LikelihoodFieldParams::default())?;
        let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
        let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
        let free_space = FreeSpace::new(&site.map, 0.3)?.reached_from(&start.translation())?;
        // Paper 001, Table 4.
        let params = MclParams { particles: 1500, ..MclParams::default() };
        let mcl = Mcl::new(motion, sensor, free_space, params, seed)?.with_parallelism(par);
        // The odometry's noise grows with each report, so per metre it is the report's length times its alphas.
        let [_, turn_per_run, run_per_run, _] = site.vehicle.odometry.alphas;
        let run = site.limits.twist.forward_speed * DT;
        let filter = PoseFilterParams {
            position_variance_per_metre: run_per_run * run,
            yaw_variance_per_metre: 2.0 * turn_per_run * run,
            yaw_variance_per_radian: 1e-3,
            ..PoseFilterParams::default()
        };
        let mut pilot = Self {
            variant,
            mcl: Box::new(mcl),
            filter: PoseFilter::new(filter)?,
            reader: CodeReader::new(site.projection, CodeReaderParams::default())?,
            markers: MarkerLocalizer::new(site.code_map.clone(), MarkerLocalizerParams::default())?,
            switch: SourceSwitch::new(SourceSwitchParams::default())?,
            uses_unread,
            travelled: 0.0,
            news: false,
        };
        // 10 cm and 5°.
        let sigmas = Vector3::new(0.1, 0.1, 5_f64.to_radians());
        let belief = PoseBelief::around(*start, Matrix3::from_diagonal(&sigmas.component_mul(&sigmas)))?;
        pilot.mcl.initialize(&belief)?;
        pilot.filter.initialize(&belief)?;
        Ok(pilot)
    }

    pub(crate) fn predict(&mut self, odometry: &OdometryIncrement) -> Result<()> {
        self.travelled += odometry.start_from_end.translation().norm();
        self.mcl.predict(odometry)?;
        Ok(self.filter.predict(odometry)?)
    }

    pub(crate) fn scan(&mut self, scan: &LaserScan) -> Result<()> {
        self.news |= matches!(self.mcl.update(scan)?, UpdateOutcome::Applied(_));
        if self.variant == Variant::Both && self.news {
            let laser = self.by_laser()?;
            let wide = UncertainPose::new(*laser.mean(), laser.covariance() * SHARED_ERRORS)?;
            self.filter.update(&PoseObservation::new(scan.stamp(), wide))?;
            self.news = false;
        }
        Ok(())
    }

    /// Takes in an image; returns the pose that its codes say, if they say one.
    pub(crate) fn image(&mut self, now: Stamp, sightings: &[CodeSighting]) -> Result<Option<UncertainPose<Se2>>> {
        if self.variant == Variant::Laser {
            return Ok(None);
        }
        let belief = self.filter.estimate().ok_or("the filter has no belief")?.pose;
        let seen: Vec<_> = sightings.iter().filter_map(|sighting| self.observe(now, sighting, &belief)).collect();
        let fix = self.markers.locate(&seen)?;
        if let Some(observation) = fix.observation() {
            self.filter.update(observation)?;
        }
        let here = self.map_from_base()?.translation();
        let distance = |pose: &UncertainPose<Se2>| (pose.mean().translation() - here).norm();
        let nearest = self.markers.map().iter().map(|(_, pose)| distance(pose)).min_by(f64::total_cmp);
        let input = SwitchInput {
            distance_to_code: nearest,
            code_seen: fix.observation().is_some(),
            travelled: std::mem::take(&mut self.travelled),
        };
        self.switch.update(&input)?;
        Ok(fix.observation().map(PoseObservation::map_from_base))
    }

    /// A code with its number, as it was read or as the place tells that it must be.
    fn observe(
        &self,
        now: Stamp,
        sighting: &CodeSighting,
        belief: &UncertainPose<Se2>,
    ) -> Option<MarkerObservation<Se2>> {
        let base_from_code = self.reader.locate(&sighting.finders).ok()?.base_from_code;
        let by_place = || self.markers.associate(belief, &base_from_code).filter(|_| self.uses_unread);
        let id = sighting.id.or_else(by_place)?;
        Some(MarkerObservation::new(now, id, base_from_code))
    }

    /// By what the vehicle drives now.
    pub(crate) const fn source(&self) -> PoseSource {
        self.switch.source()
    }

    /// The particle filter's pose.
    pub(crate) fn by_laser(&self) -> Result<UncertainPose<Se2>> {
        Ok(self.mcl.estimate().ok_or("the particle filter has no belief")?.pose)
    }

    /// The pose that the vehicle drives by.
    pub(crate) fn map_from_base(&self) -> Result<Se2> {
        let estimate = match self.variant {
            Variant::Laser => self.mcl.estimate(),
            _ => self.filter.estimate(),
        };
        Ok(*estimate.ok_or("the filter has no belief")?.map_from_base())
    }
}
