//! Tuning that goes on while the vehicle drives.
//!
//! Each control cycle spends a few evaluations on a model of the plant as it is now. Sensitive particles notice when the
//! model has changed, because a load was taken up or set down; the swarm then forgets and scatters, and the gains follow
//! when something better is known. With [`Sensing::watch_best`] the values in use are among what is compared; without it the
//! best of the first generation after a change is taken, whatever it is.

use crate::optimize::{Search, SearchSpace};
use crate::pso::{Sensing, Swarm, SwarmParams};
use crate::{Error, Objective};
use agv_core::{check, compute::Seed};

/// How a tuner goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OnlineTunerParams {
    /// The swarm that searches; without [`Sensing`] it does not notice changes.
    pub swarm: SwarmParams,
    /// Most evaluations in a cycle.
    pub evaluations_per_cycle: usize,
    /// Part by which the cost must fall before the proposal moves: gains that change in every cycle help nobody.
    pub min_improvement: f64,
}

impl Default for OnlineTunerParams {
    /// The improved swarm with frugal sensing; a generation takes three cycles of eight evaluations, which as step tests of
    /// a thousand samples last about 10 µs together.
    fn default() -> Self {
        Self {
            swarm: SwarmParams { sensing: Some(Sensing::frugal()), ..SwarmParams::improved() },
            evaluations_per_cycle: 8,
            min_improvement: 0.01,
        }
    }
}

/// What a tuner proposes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal<'a> {
    /// Values to use from now on.
    pub values: &'a [f64],
    /// Whether they differ from those of the cycle before.
    pub moved: bool,
    /// Whether this cycle noticed that the plant has changed.
    pub plant_changed: bool,
}

/// A swarm that tunes without end, within a bounded number of evaluations per cycle. After the first generation a cycle
/// allocates nothing, if the model does not (a [`StepTest`](crate::step_response::StepTest) with a dead time of 32 samples or more does).
///
/// ```
/// use agv_control::plant::{LinearPlant, TransferFunction};
/// use agv_control::step_response::{StepTest, StepTestParams};
/// use agv_control::tune::{OnlineTuner, OnlineTunerParams, gain_space};
/// use agv_core::compute::Seed;
///
/// // Speed of a vehicle of given mass under a driving force.
/// let test = |mass: f64| {
///     let plant = LinearPlant::new(TransferFunction::new(&[1.0], &[0.15 * mass, mass, 40.0])?)?;
///     StepTest::new(&plant, StepTestParams { horizon: 5.0, ..StepTestParams::default() })
/// };
/// let start = [500.0, 20.0, 0.0];
/// let mut tuner = OnlineTuner::new(gain_space([1e4, 1e4, 1e4].into())?, &start, OnlineTunerParams::default(), Seed(1))?;
/// for (mass, cycles) in [(300.0, 200), (1200.0, 200)] {
///     let model = test(mass)?;
///     for _ in 0..cycles {
///         tuner.cycle(&model)?; // one control cycle of the vehicle
///     }
///     assert!(model.cost(<[f64; 3]>::try_from(tuner.values()).unwrap().into()) < 0.5 * model.cost(start.into()));
/// }
/// assert_eq!(tuner.changes(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawOnlineTuner"))]
pub struct OnlineTuner {
    params: OnlineTunerParams,
    search: Search<Swarm>,
    values: Vec<f64>,
    /// Cost of the values when they were proposed; none before the first proposal and after a change.
    cost: Option<f64>,
    changes: usize,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawOnlineTuner {
    params: OnlineTunerParams,
    search: Search<Swarm>,
    values: Vec<f64>,
    cost: Option<f64>,
    changes: usize,
}

#[cfg(feature = "serde")]
impl TryFrom<RawOnlineTuner> for OnlineTuner {
    type Error = Error;

    fn try_from(raw: RawOnlineTuner) -> Result<Self, Error> {
        let RawOnlineTuner { params, search, values, cost, changes } = raw;
        params.check()?;
        check::length("values", values.len(), search.space().dimension())?;
        check::all_finite("values", values.iter().chain(&cost))?;
        Ok(Self { params, search, values, cost, changes })
    }
}

impl OnlineTunerParams {
    fn check(&self) -> Result<(), Error> {
        check::at_least("evaluations_per_cycle", self.evaluations_per_cycle, 1)?;
        check::in_range("min_improvement", self.min_improvement, 0.0, 1.0)?;
        Ok(())
    }
}

impl OnlineTuner {
    /// A tuner that starts at the values in use.
    ///
    /// # Errors
    /// As many values as the space has coordinates are needed, and they must be finite; at least one evaluation per cycle; an
    /// improvement from 0 to 1; a good swarm.
    pub fn new(space: SearchSpace, values: &[f64], params: OnlineTunerParams, seed: Seed) -> Result<Self, Error> {
        check::length("values", values.len(), space.dimension())?;
        check::all_finite("values", values)?;
        params.check()?;
        let mut start = vec![0.0; space.dimension()];
        space.units_into(values, &mut start);
        let swarm = Swarm::new(space.dimension(), params.swarm, seed)?.starting_at(&start)?;
        Ok(Self { params, search: Search::new(space, swarm)?, values: values.to_vec(), cost: None, changes: 0 })
    }

    /// Spends the evaluations of a cycle on the plant as `model` has it now.
    ///
    /// # Errors
    /// As [`Search::advance`].
    pub fn cycle<F: Objective + ?Sized>(&mut self, model: &F) -> Result<Proposal<'_>, Error> {
        let complete = self.search.advance(model, self.params.evaluations_per_cycle)?;
        let changes = self.search.optimizer().changes();
        let plant_changed = changes > self.changes;
        self.changes = changes;
        if plant_changed {
            self.cost = None;
        }
        let mut moved = false;
        if let (true, Some((best, cost))) = (complete, self.search.best()) {
            let least = self.cost.map_or(f64::INFINITY, |known| known - self.params.min_improvement * known.abs());
            if cost < least && cost < f64::INFINITY {
                self.cost = Some(cost);
                moved = self.values != best;
                self.values.copy_from_slice(best);
            }
        }
        Ok(Proposal { values: &self.values, moved, plant_changed })
    }

    /// The values to use now.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// How often the plant has changed, as far as was noticed.
    pub fn changes(&self) -> usize {
        self.changes
    }

    /// The search behind it.
    pub fn search(&self) -> &Search<Swarm> {
        &self.search
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bowl(middle: f64) -> impl Fn(&[f64]) -> f64 {
        move |p: &[f64]| 0.1 + p.iter().map(|x| (x - middle) * (x - middle)).sum::<f64>()
    }

    fn tuner(params: OnlineTunerParams) -> OnlineTuner {
        OnlineTuner::new(SearchSpace::cube(2, 0.0, 10.0).unwrap(), &[5.0, 5.0], params, Seed(3)).unwrap()
    }

    #[test]
    fn it_follows_a_plant_that_changes_within_its_budget() {
        let params = OnlineTunerParams { evaluations_per_cycle: 5, ..Default::default() };
        let mut tuner = tuner(params);
        for (round, middle) in [2.0, 8.0, 3.0].into_iter().enumerate() {
            for _ in 0..150 {
                let before = tuner.search().evaluations();
                let old = tuner.values().to_vec();
                let proposal = tuner.cycle(&bowl(middle)).unwrap();
                assert_eq!(proposal.moved, proposal.values != old);
                assert!(tuner.search().evaluations() - before <= 5);
            }
            assert!(tuner.values().iter().all(|x| (x - middle).abs() < 0.1), "{:?}", tuner.values());
            assert_eq!(tuner.changes(), round);
        }
    }

    #[test]
    fn without_sensing_it_stays_where_it_was() {
        let params = OnlineTunerParams { swarm: SwarmParams::improved(), ..Default::default() };
        let mut tuner = tuner(params);
        for middle in [2.0, 8.0] {
            for _ in 0..150 {
                tuner.cycle(&bowl(middle)).unwrap();
            }
        }
        assert!(tuner.values().iter().all(|x| (x - 2.0).abs() < 0.2));
    }

    #[test]
    fn it_starts_at_the_values_in_use_and_keeps_them_until_better_is_known() {
        let mut tuner = tuner(OnlineTunerParams::default());
        let at_start = |p: &[f64]| if (p[0] - 5.0).hypot(p[1] - 5.0) < 1e-9 { 1.0 } else { f64::NAN };
        for _ in 0..20 {
            let proposal = tuner.cycle(&at_start).unwrap();
            assert!(proposal.values.iter().all(|x| (x - 5.0).abs() < 1e-9));
        }
        assert_eq!(tuner.search().best().unwrap().1, 1.0);
    }

    #[test]
    fn bad_input_is_refused() {
        let good = OnlineTunerParams::default();
        let space = || SearchSpace::cube(2, 0.0, 1.0).unwrap();
        for (values, params) in [
            (vec![0.5], good),
            (vec![0.5, f64::NAN], good),
            (vec![0.5; 2], OnlineTunerParams { evaluations_per_cycle: 0, ..good }),
            (vec![0.5; 2], OnlineTunerParams { min_improvement: f64::NAN, ..good }),
            (vec![0.5; 2], OnlineTunerParams { swarm: SwarmParams { particles: 0, ..good.swarm }, ..good }),
        ] {
            assert!(OnlineTuner::new(space(), &values, params, Seed(0)).is_err());
        }
    }
}
