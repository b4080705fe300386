//! Fields of any parameters as coordinates of a search.

use crate::Objective;
use crate::optimize::{Interval, SearchSpace};
use agv_core::Error;

/// Parameters of type `P` with the fields that may be turned.
///
/// ```
/// use agv_control::optimize::{Interval, Search, Stopping};
/// use agv_control::pso::{Swarm, SwarmParams};
/// use agv_control::track::PurePursuitParams;
/// use agv_control::tune::Knobs;
/// use agv_core::compute::Seed;
///
/// let knobs = Knobs::new(PurePursuitParams::default())
///     .knob(Interval::linear(0.2, 2.0), |p| &mut p.look_ahead_time)
///     .knob(Interval::log(0.05, 1.0), |p| &mut p.look_ahead_min);
/// // A drive's error belongs here.
/// let cost = knobs.objective(|p| (p.look_ahead_time - 0.7).abs() + (p.look_ahead_min - 0.2).abs());
///
/// let swarm = Swarm::new(2, SwarmParams::improved(), Seed(1))?;
/// let outcome = Search::new(knobs.space()?, swarm)?.run(&cost, &Stopping::default())?;
/// assert!((knobs.params(&outcome.point).look_ahead_time - 0.7).abs() < 0.01);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Knobs<P> {
    base: P,
    knobs: Vec<(Interval, Field<P>)>,
}

/// Where in the parameters a value lies.
type Field<P> = fn(&mut P) -> &mut f64;

impl<P: Clone> Knobs<P> {
    /// Parameters of which nothing is turned yet.
    pub const fn new(base: P) -> Self {
        Self { base, knobs: Vec::new() }
    }

    /// Adds a field and the values that it may take: the next coordinate.
    #[must_use]
    pub fn knob(mut self, interval: Interval, field: fn(&mut P) -> &mut f64) -> Self {
        self.knobs.push((interval, field));
        self
    }

    /// The space of the knobs.
    ///
    /// # Errors
    /// No knob, or a bad interval; see [`SearchSpace::new`].
    pub fn space(&self) -> Result<SearchSpace, Error> {
        SearchSpace::new(self.knobs.iter().map(|(interval, _)| *interval).collect())
    }

    /// The parameters with the knobs at a point; what the point lacks stays as it was.
    pub fn params(&self, point: &[f64]) -> P {
        let mut params = self.base.clone();
        for ((_, field), &value) in self.knobs.iter().zip(point) {
            *field(&mut params) = value;
        }
        params
    }

    /// The values of the knobs in given parameters: the inverse of [`params`](Self::params), where a search may start.
    pub fn values(&self, params: &P) -> Vec<f64> {
        let mut params = params.clone();
        self.knobs.iter().map(|(_, field)| *field(&mut params)).collect()
    }

    /// A cost of parameters as an objective of the knobs. For parameters that a part refuses, return NaN: they lose.
    pub fn objective<'a>(&'a self, cost: impl Fn(&P) -> f64 + Sync + 'a) -> impl Objective + 'a
    where
        P: Sync,
    {
        move |point: &[f64]| cost(&self.params(point))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pid::PidParams;

    #[test]
    fn a_knob_turns_its_field_and_no_other() {
        let base = PidParams { derivative: 7.0, ..PidParams::default() };
        let knobs = Knobs::new(base)
            .knob(Interval::gain(10.0), |p| &mut p.integral)
            .knob(Interval::linear(0.0, 1.0), |p| &mut p.set_point_weight);
        let turned = knobs.params(&[3.0, 0.25]);
        assert_eq!(turned, PidParams { integral: 3.0, set_point_weight: 0.25, ..base });
        assert_eq!(knobs.values(&turned), [3.0, 0.25]);
        assert_eq!(knobs.params(&[3.0]), PidParams { integral: 3.0, ..base });
        assert_eq!(knobs.objective(|p| p.integral + p.derivative).evaluate(&[3.0, 0.0]), 10.0);
        assert!(Knobs::new(base).space().is_err());
        assert!(Knobs::new(base).knob(Interval::gain(-1.0), |p| &mut p.integral).space().is_err());
    }
}
