//! The cost of gains in a step test: how fast, how smoothly, with how much effort, and how near to instability.
//!
//! ```text
//! J = max over plants of  criterion + w_o max(0, overshoot - allowed) + w_t travel + w_e energy + w_s max(0, Ms - allowed)
//! ```

use super::pid::{for_each_batch, gains_of};
use crate::margin::FrequencySweep;
use crate::optimize::comparable;
use crate::plant::LinearPlant;
use crate::step_response::{PidGains, StepFigures, StepTest, StepTestParams};
use crate::{BATCH, Error, Objective};
use agv_core::check;

/// What is summed over the error of a step response.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Criterion {
    /// `Σ t |e| dt`: late errors weigh most, so that responses settle.
    #[default]
    Itae,
    /// `Σ |e| dt`.
    Iae,
    /// `Σ e² dt`: great errors weigh most, so that responses are fast.
    Ise,
    /// `Σ t e² dt`.
    Itse,
}

/// Weights of a [`StepCost`]. A weight is the cost of one unit of its figure.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepCostParams {
    /// What is summed over the error.
    pub criterion: Criterion,
    /// Overshoot that costs nothing, in the measurement's unit.
    pub overshoot_allowed: f64,
    /// Cost of overshoot beyond it, per unit of the measurement.
    pub overshoot_weight: f64,
    /// Cost of the way that the actuator moves, `Σ |Δu|`, per unit of the input.
    pub travel_weight: f64,
    /// Cost of the actuator's effort, `Σ u² dt`.
    pub energy_weight: f64,
    /// Greatest maximum sensitivity `Ms` that costs nothing; see [`margin`](crate::margin).
    pub sensitivity_allowed: f64,
    /// Cost of sensitivity beyond it, per unit.
    pub sensitivity_weight: f64,
}

impl Default for StepCostParams {
    /// The ITAE of paper 000, Eq. 31, and nothing else; the allowances are those of usual designs, 2 of sensitivity among
    /// them.
    fn default() -> Self {
        Self {
            criterion: Criterion::Itae,
            overshoot_allowed: 0.0,
            overshoot_weight: 0.0,
            travel_weight: 0.0,
            energy_weight: 0.0,
            sensitivity_allowed: 2.0,
            sensitivity_weight: 0.0,
        }
    }
}

/// An objective of the three gains Kp, Ki, Kd: the weighted figures of a step test, at the worst of several plants.
///
/// ```
/// use agv_control::Objective;
/// use agv_control::plant::{LinearPlant, TransferFunction};
/// use agv_control::step_response::StepTestParams;
/// use agv_control::tune::{StepCost, StepCostParams, tune_pid};
/// use agv_core::compute::Seed;
///
/// // A vehicle that may be empty or loaded: one set of gains for both, without overshoot.
/// let speed = |mass: f64| LinearPlant::new(TransferFunction::new(&[1.0], &[mass, 40.0])?);
/// let params = StepCostParams { overshoot_weight: 100.0, sensitivity_weight: 10.0, ..StepCostParams::default() };
/// let cost = StepCost::new(&[speed(300.0)?, speed(1200.0)?], StepTestParams::default(), params)?;
/// let tuned = tune_pid(&cost, [5e3, 5e3, 100.0].into(), Seed(1))?;
/// assert!(tuned.cost < cost.evaluate(&[500.0, 100.0, 0.0]));
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct StepCost {
    params: StepCostParams,
    plants: Vec<(StepTest, FrequencySweep)>,
}

impl StepCostParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first weight or allowance that is negative or not finite.
    pub fn validate(&self) -> Result<(), Error> {
        for (name, value) in [
            ("overshoot_allowed", self.overshoot_allowed),
            ("overshoot_weight", self.overshoot_weight),
            ("travel_weight", self.travel_weight),
            ("energy_weight", self.energy_weight),
            ("sensitivity_allowed", self.sensitivity_allowed),
            ("sensitivity_weight", self.sensitivity_weight),
        ] {
            check::non_negative(name, value)?;
        }
        Ok(())
    }

    /// The cost of a response, of whatever loop: [`StepResponse::figures`](crate::step_response::StepResponse::figures) gives those
    /// of plants that no step test can run. `sensitivity` is asked for only if it counts. Infinite for a loop that diverged,
    /// never NaN.
    ///
    /// ```
    /// use agv_control::pid::{Pid, PidParams};
    /// use agv_control::plant::{DriveParams, DrivePlant};
    /// use agv_control::step_response::{StepResponse, simulate_step};
    /// use agv_control::tune::StepCostParams;
    ///
    /// // A drive with dry friction.
    /// let mut drive = DrivePlant::new(DriveParams::default())?;
    /// let params = StepCostParams { overshoot_weight: 10.0, ..StepCostParams::default() };
    /// let mut cost = |proportional| {
    ///     let mut pid = Pid::new(PidParams { proportional, integral: 100.0, ..PidParams::default() })?;
    ///     let mut response = StepResponse::default();
    ///     simulate_step(&mut drive, &mut pid, 1.0, 0.01, 3.0, &mut response)?;
    ///     Ok::<_, agv_control::Error>(params.weigh(&response.figures(), || 1.0))
    /// };
    /// assert!(cost(10.0)? < cost(1.0)?);
    /// # Ok::<(), agv_control::Error>(())
    /// ```
    pub fn weigh(&self, figures: &StepFigures, sensitivity: impl FnOnce() -> f64) -> f64 {
        let criterion = match self.criterion {
            Criterion::Itae => figures.itae,
            Criterion::Iae => figures.iae,
            Criterion::Ise => figures.ise,
            Criterion::Itse => figures.itse,
        };
        // Infinite figures times a weight of zero would not be a number.
        if criterion == f64::INFINITY {
            return criterion;
        }
        let beyond = |value: f64, allowed: f64| (value - allowed).max(0.0);
        let mut cost = criterion
            + self.overshoot_weight * beyond(figures.overshoot, self.overshoot_allowed)
            + self.travel_weight * figures.control_travel
            + self.energy_weight * figures.control_energy;
        if self.sensitivity_weight > 0.0 {
            cost += self.sensitivity_weight * beyond(sensitivity(), self.sensitivity_allowed);
        }
        // Energies may overflow where the criterion does not.
        comparable(cost)
    }
}

impl StepCost {
    /// The step test of each plant, from rest.
    ///
    /// # Errors
    /// No plant, a weight or an allowance that is negative, or what [`StepTest::new`] refuses.
    pub fn new(plants: &[LinearPlant], test: StepTestParams, params: StepCostParams) -> Result<Self, Error> {
        check::at_least("plants", plants.len(), 1)?;
        params.validate()?;
        let prepare = |plant: &LinearPlant| {
            let sweep = FrequencySweep::new(plant, test.dt, test.filter_time)?;
            Ok((StepTest::new(plant, test)?, sweep))
        };
        Ok(Self { params, plants: plants.iter().map(prepare).collect::<Result<_, Error>>()? })
    }

    /// Weights and allowances.
    pub const fn params(&self) -> &StepCostParams {
        &self.params
    }

    fn weigh(&self, figures: &StepFigures, sweep: &FrequencySweep, gains: PidGains) -> f64 {
        self.params.weigh(figures, || sweep.margins(gains).sensitivity)
    }
}

impl Objective for StepCost {
    fn evaluate(&self, point: &[f64]) -> f64 {
        let gains = gains_of(point);
        let costs = self.plants.iter().map(|(test, sweep)| self.weigh(&test.figures(gains), sweep, gains));
        costs.fold(f64::NEG_INFINITY, f64::max)
    }

    fn evaluate_batch(&self, points: &[f64], costs: &mut [f64]) {
        let mut figures = [StepFigures::DIVERGED; BATCH];
        for_each_batch(points, costs, |gains, costs| {
            costs.fill(f64::NEG_INFINITY);
            for (test, sweep) in &self.plants {
                // The slices are of one length.
                if test.figures_batch(gains, &mut figures[..costs.len()]).is_err() {
                    costs.fill(f64::INFINITY);
                }
                for ((cost, figures), gains) in costs.iter_mut().zip(&figures).zip(gains) {
                    *cost = cost.max(self.weigh(figures, sweep, *gains));
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::StandIn;
    use crate::tune::tune_pid;
    use agv_core::compute::Seed;

    fn cost(params: StepCostParams) -> StepCost {
        StepCost::new(&[StandIn::P1.plant().unwrap()], StepTestParams::default(), params).unwrap()
    }

    #[test]
    fn without_weights_it_is_the_criterion() {
        let (gains, test) = ([3.18, 3.4, 1.61], StandIn::P1.step_test().unwrap());
        let figures = test.figures(gains.into());
        for (criterion, expected) in [
            (Criterion::Itae, test.cost(gains.into())),
            (Criterion::Iae, figures.iae),
            (Criterion::Ise, figures.ise),
            (Criterion::Itse, figures.itse),
        ] {
            let found = cost(StepCostParams { criterion, ..Default::default() }).evaluate(&gains);
            assert!((found - expected).abs() < 1e-12 * expected, "{criterion:?}: {found} instead of {expected}");
        }
    }

    #[test]
    fn each_weight_buys_its_figure() {
        let test = StandIn::P1.step_test().unwrap();
        let tuned = |params| test.figures(tune_pid(&cost(params), [50.0; 3].into(), Seed(2)).unwrap().gains);
        let plain = tuned(StepCostParams::default());
        let smooth = tuned(StepCostParams { overshoot_weight: 100.0, ..Default::default() });
        let still = tuned(StepCostParams { travel_weight: 0.01, ..Default::default() });
        let frugal = tuned(StepCostParams { energy_weight: 0.1, ..Default::default() });
        assert!(smooth.overshoot < 0.2 * plain.overshoot && smooth.overshoot < 2e-3, "{}", smooth.overshoot);
        assert!(still.control_travel < 0.9 * plain.control_travel);
        assert!(frugal.control_energy < 0.9 * plain.control_energy);
        let robust = StepCostParams { sensitivity_weight: 10.0, sensitivity_allowed: 1.3, ..Default::default() };
        let gains = tune_pid(&cost(robust), [50.0; 3].into(), Seed(2)).unwrap().gains;
        let sweep = FrequencySweep::new(&StandIn::P1.plant().unwrap(), 0.01, 0.02).unwrap();
        let sensitivity = sweep.margins(gains).sensitivity;
        assert!(sensitivity < 1.31, "{sensitivity}");
    }

    #[test]
    fn the_worst_plant_counts_and_batches_have_the_same_bits() {
        let plants = [StandIn::P1, StandIn::P2, StandIn::P3].map(|plant| plant.plant().unwrap());
        let params = StepCostParams {
            overshoot_weight: 3.0,
            travel_weight: 0.1,
            energy_weight: 0.01,
            sensitivity_weight: 1.0,
            ..Default::default()
        };
        let alone = plants
            .each_ref()
            .map(|plant| StepCost::new(std::slice::from_ref(plant), StepTestParams::default(), params).unwrap());
        let all = StepCost::new(&plants, StepTestParams::default(), params).unwrap();
        let points: Vec<f64> = (0..3 * 11).map(|k| f64::from(k * 7 % 13) * 0.3).collect();
        let mut costs = [0.0; 11];
        all.evaluate_batch(&points, &mut costs);
        for (point, cost) in points.chunks_exact(3).zip(costs) {
            assert_eq!(all.evaluate(point), cost);
            assert_eq!(alone.iter().map(|one| one.evaluate(point)).fold(0.0, f64::max), cost);
        }
    }

    #[test]
    fn bad_weights_and_no_plant_are_refused() {
        let good = StepCostParams::default();
        let plant = StandIn::P1.plant().unwrap();
        for params in [
            StepCostParams { overshoot_weight: -1.0, ..good },
            StepCostParams { travel_weight: f64::NAN, ..good },
            StepCostParams { sensitivity_allowed: f64::INFINITY, ..good },
        ] {
            assert!(StepCost::new(std::slice::from_ref(&plant), StepTestParams::default(), params).is_err());
        }
        assert!(StepCost::new(&[], StepTestParams::default(), good).is_err());
        assert_eq!(cost(StepCostParams { travel_weight: 1.0, ..good }).evaluate(&[f64::NAN; 3]), f64::INFINITY);
    }

    #[test]
    fn an_energy_beyond_numbers_does_not_win() {
        let plant = LinearPlant::new(crate::plant::TransferFunction::new(&[1.0], &[1.0, 1.0]).unwrap()).unwrap();
        let cost =
            StepCost::new(&[plant], StepTestParams { horizon: 0.02, ..Default::default() }, StepCostParams::default());
        let (cost, gains) = (cost.unwrap(), [1e80, 0.0, 0.0]);
        let mut batch = [0.0];
        cost.evaluate_batch(&gains, &mut batch);
        assert_eq!((cost.evaluate(&gains), batch[0]), (f64::INFINITY, f64::INFINITY));
    }
}
