//! Hypotheses: the parts that a belief falls into.
//!
//! Particles are counted in a [`PoseHistogram`]; bins that touch belong together, as the leaves of `nav2_amcl`'s tree do. Each
//! such part is a hypothesis with its weight, mean and covariance. What is most likely is the mean of one of them: the mean
//! over several lies where the vehicle is not.

use super::{ParticleSet, PoseBins, PoseHistogram, moments::MomentSums};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, UncertainPose},
};
use nalgebra::Vector2;

/// A part of a belief.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Hypothesis {
    /// Share of the weight that lies in it.
    pub weight: f64,
    /// Mean and covariance of what lies in it.
    pub pose: UncertainPose<Se2>,
    /// Number of particles.
    pub particles: usize,
}

/// Finds the hypotheses of a set.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_filters::particle::{Clusters, ParticleSet, PoseBins};
///
/// // Two thirds of the particles in one aisle, one third in another.
/// let poses = (0..90).map(|i| Se2::new(0.01 * f64::from(i), if i % 3 == 0 { 4.0 } else { 0.0 }, 0.0)).collect();
/// let mut clusters = Clusters::new(PoseBins::default())?;
/// let hypotheses = clusters.find(&ParticleSet::new(poses)?)?;
/// assert_eq!(hypotheses.len(), 2);
/// assert!((hypotheses[0].weight - 2.0 / 3.0).abs() < 1e-12 && hypotheses[0].pose.mean().y() == 0.0);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Clusters {
    histogram: PoseHistogram,
    /// Bin of each particle.
    bins: Vec<u32>,
    /// Part of each bin.
    parts: Vec<u32>,
    /// Bins whose neighbours are still to be looked at.
    open: Vec<u32>,
    sums: Vec<PartSums>,
    hypotheses: Vec<Hypothesis>,
}

#[derive(Debug, Clone, Copy)]
struct PartSums {
    /// About a particle of the part.
    moments: MomentSums,
    particles: usize,
}

/// A bin that belongs to no part yet.
const NO_PART: u32 = u32::MAX;

impl Clusters {
    /// Finds hypotheses that are farther apart than a bin is wide.
    ///
    /// # Errors
    /// Sizes that [`validate`](PoseBins::validate) refuses.
    pub fn new(bins: PoseBins) -> Result<Self, Error> {
        let histogram = PoseHistogram::new(bins)?;
        let hypotheses = Vec::new();
        Ok(Self { histogram, bins: Vec::new(), parts: Vec::new(), open: Vec::new(), sums: Vec::new(), hypotheses })
    }

    /// The same with room for sets of so many particles.
    #[must_use]
    pub fn with_capacity(mut self, particles: usize) -> Self {
        self.histogram = self.histogram.with_capacity(particles);
        self.bins.reserve(particles);
        self.parts.reserve(particles);
        self.open.reserve(particles);
        self.sums.reserve(particles);
        self.hypotheses.reserve(particles);
        self
    }

    /// What was found last.
    pub fn hypotheses(&self) -> &[Hypothesis] {
        &self.hypotheses
    }

    /// The hypotheses of a set, by falling weight.
    ///
    /// Expected O(particles + 27 bins); no allocation within the capacity.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if the squares of the coordinates are not; nothing is found then.
    pub fn find(&mut self, set: &ParticleSet<Se2>) -> Result<&[Hypothesis], Error> {
        self.count(set);
        self.connect();
        self.sum_up(set);
        self.hypotheses.clear();
        for part in &self.sums {
            let weight = part.moments.weight();
            if weight > 0.0 {
                let pose = part.moments.moments().inspect_err(|_| self.hypotheses.clear())?;
                self.hypotheses.push(Hypothesis { weight, pose, particles: part.particles });
            }
        }
        self.hypotheses.sort_unstable_by(|a, b| b.weight.total_cmp(&a.weight));
        Ok(&self.hypotheses)
    }

    fn count(&mut self, set: &ParticleSet<Se2>) {
        self.histogram.clear();
        self.bins.clear();
        for (pose, &weight) in set.states().iter().zip(set.weights()) {
            self.bins.push(self.histogram.insert(pose, weight) as u32);
        }
    }

    /// Floods from bin to bin.
    fn connect(&mut self) {
        let (histogram, parts, open) = (&self.histogram, &mut self.parts, &mut self.open);
        parts.clear();
        parts.resize(histogram.len(), NO_PART);
        self.sums.clear();
        for first in 0..histogram.len() {
            if parts[first] != NO_PART {
                continue;
            }
            let part = self.sums.len() as u32;
            self.sums.push(PartSums { moments: MomentSums::about(Vector2::zeros()), particles: 0 });
            parts[first] = part;
            open.push(first as u32);
            while let Some(bin) = open.pop() {
                histogram.neighbours(bin as usize, |neighbour| {
                    if parts[neighbour] == NO_PART {
                        parts[neighbour] = part;
                        open.push(neighbour as u32);
                    }
                });
            }
        }
    }

    fn sum_up(&mut self, set: &ParticleSet<Se2>) {
        for ((pose, &weight), &bin) in set.states().iter().zip(set.weights()).zip(&self.bins) {
            let part = &mut self.sums[self.parts[bin as usize] as usize];
            if part.particles == 0 {
                part.moments = MomentSums::about(pose.translation());
            }
            part.particles += 1;
            part.moments.add(pose, weight);
        }
    }
}

/// Which hypothesis to follow.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Hysteresis {
    /// How many times as heavy as the one that is followed another hypothesis must be; at least one.
    pub ratio: f64,
    /// How far from where it was expected a hypothesis may lie to be the one that is followed, in metres.
    pub reach: f64,
    /// How far from the expected heading, in radians.
    pub turn: f64,
}

impl Default for Hysteresis {
    /// Twice as heavy; within a metre and half a radian of what was expected. Without hysteresis (`nav2_amcl`) the estimate
    /// jumps between hypotheses of nearly equal weight.
    fn default() -> Self {
        Self { ratio: 2.0, reach: 1.0, turn: 0.5 }
    }
}

impl Hysteresis {
    /// Checks all fields.
    ///
    /// # Errors
    /// A ratio below one, a reach or a turn that is negative or not finite.
    pub fn validate(&self) -> Result<(), Error> {
        agv_core::check::in_range("hysteresis ratio", self.ratio, 1.0, f64::MAX)?;
        agv_core::check::non_negative("hysteresis reach", self.reach)?;
        agv_core::check::non_negative("hysteresis turn", self.turn)?;
        Ok(())
    }

    /// The hypothesis to follow, where the one followed so far was expected at a pose; none of none.
    pub fn choose<'a>(&self, hypotheses: &'a [Hypothesis], expected: &Se2) -> Option<&'a Hypothesis> {
        let is_near = |hypothesis: &&Hypothesis| {
            let offset = expected.minus(hypothesis.pose.mean());
            offset.x.hypot(offset.y) <= self.reach && offset.z.abs() <= self.turn
        };
        let heaviest = hypotheses.iter().reduce(|a, b| if b.weight > a.weight { b } else { a })?;
        let followed = hypotheses.iter().filter(is_near).reduce(|a, b| if b.weight > a.weight { b } else { a });
        Some(followed.filter(|followed| followed.weight * self.ratio >= heaviest.weight).unwrap_or(heaviest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Par;
    use proptest::prelude::*;

    fn clusters() -> Clusters {
        Clusters::new(PoseBins::default()).unwrap()
    }

    proptest! {
        /// The parts are the whole: numbers and weights, and by the law of total expectation the mean position.
        #[test]
        fn hypotheses_add_up_to_the_belief(poses in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64, -3.1..3.1_f64), 1..80)) {
            let set = ParticleSet::new(poses.iter().map(|&(x, y, yaw)| Se2::new(x, y, yaw)).collect()).unwrap();
            let mut clusters = clusters();
            let found = clusters.find(&set).unwrap();
            prop_assert_eq!(found.iter().map(|h| h.particles).sum::<usize>(), set.len());
            prop_assert!((found.iter().map(|h| h.weight).sum::<f64>() - 1.0).abs() < 1e-9);
            prop_assert!(found.windows(2).all(|pair| pair[0].weight >= pair[1].weight));
            let mean: Vector2<f64> = found.iter().map(|h| h.pose.mean().translation() * h.weight).sum();
            prop_assert!((mean - set.estimate(Par::Seq).unwrap().mean().translation()).norm() < 1e-9);
        }

        /// Poses that are nearer than a bin are in one part, those with an empty bin between in two: against union by pairs.
        #[test]
        fn parts_are_what_is_connected(poses in prop::collection::vec((0..9_i32, 0..9_i32, 0..36_i32), 1..60)) {
            let center = |&(x, y, yaw): &(i32, i32, i32)| Se2::new(0.25 + 0.5 * f64::from(x), 0.25 + 0.5 * f64::from(y), (5.0 + 10.0 * f64::from(yaw)).to_radians());
            let set = ParticleSet::new(poses.iter().map(center).collect()).unwrap();
            let touch = |a: &(i32, i32, i32), b: &(i32, i32, i32)| {
                let turn = (a.2 - b.2).rem_euclid(36);
                (a.0 - b.0).abs() < 2 && (a.1 - b.1).abs() < 2 && (turn < 2 || turn == 35)
            };
            let mut labels: Vec<usize> = (0..poses.len()).collect();
            for i in 0..poses.len() {
                for j in 0..i {
                    if touch(&poses[i], &poses[j]) {
                        let (from, to) = (labels[i], labels[j]);
                        labels.iter_mut().filter(|label| **label == from).for_each(|label| *label = to);
                    }
                }
            }
            labels.sort_unstable();
            labels.dedup();
            prop_assert_eq!(clusters().find(&set).unwrap().len(), labels.len());
        }
    }

    #[test]
    fn each_part_has_its_own_moments() {
        let around = |x: f64, yaw: f64| (-20..=20).map(move |i| Se2::new(x, f64::from(i) * 0.02, yaw));
        let set =
            ParticleSet::new(around(0.2, 0.1).chain(around(5.2, 3.1)).chain(around(5.2, -3.1)).collect()).unwrap();
        let mut clusters = clusters();
        let found = clusters.find(&set).unwrap();
        assert_eq!(found.iter().map(|h| h.particles).collect::<Vec<_>>(), [82, 41], "the seam joins the two");
        let far = &found[0].pose;
        assert!((far.mean().yaw().abs() - std::f64::consts::PI).abs() < 1e-9 && (far.mean().x() - 5.2).abs() < 1e-9);
        // Of the numbers -20 ... 20 the variance is 140.
        let across = far.covariance()[(1, 1)];
        assert!((across - 140.0 * 4e-4).abs() < 1e-9, "{across}");
    }

    #[test]
    fn the_followed_hypothesis_is_left_only_for_a_much_heavier_one() {
        let at = |x: f64, weight: f64| Hypothesis {
            weight,
            pose: UncertainPose::exact(Se2::new(x, 0.0, 0.0)),
            particles: 1,
        };
        let chosen = |weights: [f64; 2], expected: f64| {
            let hypotheses = [at(0.0, weights[0]), at(9.0, weights[1])];
            Hysteresis::default().choose(&hypotheses, &Se2::new(expected, 0.0, 0.0)).unwrap().pose.mean().x()
        };
        assert_eq!(chosen([0.6, 0.4], 9.2), 9.0);
        assert_eq!(chosen([0.7, 0.3], 9.2), 0.0);
        assert_eq!(chosen([0.3, 0.7], 4.0), 9.0, "nothing where it was expected");
        assert_eq!(Hysteresis::default().choose(&[], &Se2::identity()), None);
    }

    #[test]
    fn sets_without_finite_squares_have_no_hypotheses() {
        let far =
            ParticleSet::new(vec![Se2::new(1e300, 0.0, 0.0), Se2::new(-1e300, 0.0, 0.0), Se2::new(2e300, 0.0, 0.0)]);
        let mut clusters = clusters();
        assert!(clusters.find(&far.unwrap()).is_err() && clusters.hypotheses().is_empty());
        for bad in [
            Hysteresis { ratio: 0.5, ..Default::default() },
            Hysteresis { reach: f64::NAN, ..Default::default() },
            Hysteresis { turn: -1.0, ..Default::default() },
        ] {
            assert!(bad.validate().is_err());
        }
    }
}
