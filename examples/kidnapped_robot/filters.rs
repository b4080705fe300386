//! The filters that are compared, from the plainest to the fullest.

use super::{Result, drive::Step, site::Site};
use agv_nav::{
    core::{
        compute::Par,
        grid::{LikelihoodField, LikelihoodFieldParams},
        sensors::MarkerObservation,
    },
    filters::{
        marker::{MarkerLocalizer, MarkerLocalizerParams},
        particle::{
            Amcl, AmclParams, DifferentialOdometryModel, EffectiveSampleSizeBelow, ImprovedSwarm, KldParams,
            KldSampling, LikelihoodFieldModel, LikelihoodFieldModelParams, LikelihoodSearch, LikelihoodSearchParams,
            MarkerModel, MarkerModelParams, MarkerProposal, Mcl, MclParams, MotionThreshold, OdometryNoise,
            PoseProposal, RecoveryParams, SampleSize, Sensors, Systematic, TemperingParams, UniformProposal,
        },
    },
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};

/// The laser, and codes on the floor.
type LaserAndCodes = Sensors<LikelihoodFieldModel, Option<MarkerModel>>;

/// Codes count for as much as they say: a third of the particles are drawn from a code itself, which is dense enough.
const CODES: MarkerModelParams =
    MarkerModelParams { position_sigma: 1e-3, heading_sigma: 1e-3, outlier: 1e-3, area: 100.0 };

/// Which filter.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    /// A fixed number of particles.
    Fixed,
    /// As many as KLD sampling asks for.
    Kld,
    /// The same, with new ones anywhere by `w_slow` and `w_fast`: `nav2_amcl`'s recovery.
    Augmented,
    /// The same, with new ones where the scan fits: the defaults of [`Amcl`].
    Search,
    /// `Augmented` with the codes on the floor.
    Codes,
    /// `Search` with the codes on the floor.
    SearchAndCodes,
}

impl Kind {
    pub(crate) const ALL: [Self; 6] =
        [Self::Fixed, Self::Kld, Self::Augmented, Self::Search, Self::Codes, Self::SearchAndCodes];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Fixed => "mcl",
            Self::Kld => "kld",
            Self::Augmented => "kld_augmented",
            Self::Search => "amcl",
            Self::Codes => "kld_augmented_codes",
            Self::SearchAndCodes => "amcl_codes",
        }
    }

    /// The filter, which starts where the vehicle does; or anywhere.
    pub(crate) fn build(self, site: &Site, belief: &PoseBelief<Se2>, seed: Seed, par: Par) -> Result<Box<dyn Filter>> {
        let field = LikelihoodField::new(&site.map, LikelihoodFieldParams::default())?;
        let laser = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
        let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.05))?;
        let (space, codes) = (site.free_space.clone(), site.code_map.clone());
        let markers = (!codes.is_empty()).then(|| MarkerModel::new(codes.iter().map(|(id, &pose)| (id, pose)), CODES));
        let sensors = LaserAndCodes { scans: laser, markers: markers.transpose()?, landmarks: () };
        let codes = MarkerLocalizer::new(codes, MarkerLocalizerParams::default())?;
        // Paper 001 starts with 1500 particles where their number adapts.
        let kld = KldParams { max_particles: 1500, ..KldParams::default() };
        let mcl = |particles| {
            let params = MclParams { particles, ..MclParams::default() };
            Mcl::new(motion, sensors.clone(), space.clone(), params, seed)
        };
        let with_codes = matches!(self, Self::Codes | Self::SearchAndCodes);
        let mut filter: Box<dyn Filter> = match self {
            Self::Fixed => Box::new(Plain(mcl(1000)?.with_parallelism(par))),
            Self::Kld => Box::new(Plain(mcl(1500)?.with_parallelism(par).with_sample_size(KldSampling::new(kld)?)?)),
            Self::Augmented | Self::Codes => {
                let recovery = RecoveryParams::augmented(0.001, 0.1);
                let params = AmclParams {
                    particles: 1500,
                    kld,
                    recovery,
                    tempering: TemperingParams::never(),
                    ..AmclParams::default()
                };
                let amcl = Amcl::new(motion, sensors, space, params, seed)?.with_parallelism(par);
                // Uniform for scans; a code is drawn from all the same.
                Box::new(Adaptive { amcl: amcl.with_proposal(MarkerProposal::new(codes, UniformProposal)), with_codes })
            }
            Self::Search | Self::SearchAndCodes => {
                let amcl = Amcl::new(motion, sensors, space, AmclParams::default(), seed)?.with_parallelism(par);
                let search = LikelihoodSearch::new(LikelihoodSearchParams::default())?;
                Box::new(Adaptive { amcl: amcl.with_proposal(MarkerProposal::new(codes, search)), with_codes })
            }
        };
        filter.start(belief)?;
        Ok(filter)
    }
}

/// What the comparison asks of a filter.
pub(crate) trait Filter {
    fn start(&mut self, belief: &PoseBelief<Se2>) -> Result<()>;

    /// Starts from paper 001's improved swarm: spread evenly over the map, and drawn again by what is seen first.
    fn start_by(&mut self, scan: &LaserScan) -> Result<()>;

    /// Follows a step; whether a scan was applied.
    fn follow(&mut self, step: &Step) -> Result<bool>;

    fn pose(&self) -> Option<Se2>;

    fn particles(&self) -> &[Se2];

    fn status(&self) -> LocalizationStatus;
}

struct Plain<F>(F);

struct Adaptive<G> {
    amcl: Amcl<DifferentialOdometryModel, LaserAndCodes, G>,
    with_codes: bool,
}

macro_rules! filter_methods {
    ($inner:tt) => {
        fn start(&mut self, belief: &PoseBelief<Se2>) -> Result<()> {
            Ok(self.$inner.initialize(belief)?)
        }

        fn start_by(&mut self, scan: &LaserScan) -> Result<()> {
            self.$inner.initialize_swarm(&ImprovedSwarm::default(), &[scan])?;
            Ok(())
        }

        fn pose(&self) -> Option<Se2> {
            self.$inner.estimate().map(|estimate| *estimate.map_from_base())
        }

        fn particles(&self) -> &[Se2] {
            self.$inner.particles().states()
        }

        fn status(&self) -> LocalizationStatus {
            Localizer::status(&self.$inner)
        }
    };
}

type Sized<N> = Mcl<DifferentialOdometryModel, LaserAndCodes, Systematic, EffectiveSampleSizeBelow, MotionThreshold, N>;

impl<N: SampleSize> Filter for Plain<Sized<N>> {
    filter_methods!(0);

    fn follow(&mut self, step: &Step) -> Result<bool> {
        self.0.predict(&step.odometry)?;
        if step.is_standing {
            self.0.request_update();
        }
        Ok(matches!(self.0.update(&step.scan)?, UpdateOutcome::Applied(_)))
    }
}

impl<G> Filter for Adaptive<G>
where
    G: PoseProposal<LaserScan, LaserAndCodes> + PoseProposal<MarkerObservation<Se2>, LaserAndCodes>,
{
    filter_methods!(amcl);

    fn follow(&mut self, step: &Step) -> Result<bool> {
        self.amcl.predict(&step.odometry)?;
        if step.is_standing {
            self.amcl.request_update();
        }
        let applied = matches!(self.amcl.update(&step.scan)?, UpdateOutcome::Applied(_));
        if let Some(code) = step.code.filter(|_| self.with_codes) {
            self.amcl.update(&code)?;
        }
        Ok(applied)
    }
}

/// A belief around the start, as the paper's experiments have it.
pub(crate) fn around(start: Se2) -> Result<PoseBelief<Se2>> {
    Ok(PoseBelief::around(start, Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.03)))?)
}
