//! Who tells whom: the particles that a particle learns from.

use agv_core::{Error, check, compute::Stream};
use rand::RngExt;

/// Which other particles' best places a particle hears of; its own it always knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Topology {
    /// All: news spread at once, and a trap catches the whole swarm.
    Global,
    /// The `neighbours` next ones on either side of a ring: news spread slowly.
    Ring {
        /// Particles on either side.
        neighbours: usize,
    },
    /// Every particle informs `informants` others drawn at random, anew after each iteration that brought nothing (Clerc's
    /// standard PSO 2006): news spread fast enough, and traps are left.
    Random {
        /// Draws per particle.
        informants: usize,
    },
}

impl Topology {
    pub(super) fn check(self, particles: usize) -> Result<(), Error> {
        match self {
            Self::Global => Ok(()),
            Self::Ring { neighbours: count } => {
                check::in_range("neighbours", count as f64, 1.0, particles as f64).map(|_| ())
            }
            Self::Random { informants: count } => {
                check::in_range("informants", count as f64, 1.0, particles as f64).map(|_| ())
            }
        }
    }

    /// Draws who informs whom. Others than [`Topology::Random`] have nothing to draw.
    pub(super) fn draw_links(links: &mut [usize], particles: usize, stream: &mut Stream) {
        links.fill_with(|| stream.random_range(0..particles));
    }

    /// Length of the table of links.
    pub(super) fn link_count(self, particles: usize) -> usize {
        match self {
            Self::Random { informants } => particles.saturating_mul(informants),
            Self::Global | Self::Ring { .. } => 0,
        }
    }

    /// For every particle the index of the best one that it hears of.
    pub(super) fn guides_into(self, costs: &[f64], links: &[usize], guides: &mut [usize]) {
        let count = costs.len();
        let better = |a: usize, b: usize| if costs[b] < costs[a] { b } else { a };
        match self {
            Self::Global => guides.fill((1..count).fold(0, better)),
            Self::Ring { neighbours } => {
                for (i, guide) in guides.iter_mut().enumerate() {
                    let around = (1..=neighbours).flat_map(|k| [(i + k) % count, (i + count - k) % count]);
                    *guide = around.fold(i, better);
                }
            }
            Self::Random { informants } => {
                guides.iter_mut().enumerate().for_each(|(i, guide)| *guide = i);
                for (from, targets) in links.chunks_exact(informants).enumerate() {
                    for &to in targets {
                        guides[to] = better(guides[to], from);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;

    const COSTS: [f64; 6] = [5.0, 1.0, 4.0, f64::INFINITY, 3.0, 2.0];

    #[test]
    fn each_hears_of_the_best_of_its_neighbourhood() {
        let mut guides = [0; 6];
        Topology::Global.guides_into(&COSTS, &[], &mut guides);
        assert_eq!(guides, [1; 6]);
        Topology::Ring { neighbours: 1 }.guides_into(&COSTS, &[], &mut guides);
        assert_eq!(guides, [1, 1, 1, 4, 5, 5]);
        Topology::Ring { neighbours: 6 }.guides_into(&COSTS, &[], &mut guides);
        assert_eq!(guides, [1; 6]);
        // Particle i informs the next two, whatever they know better themselves.
        let links: Vec<usize> = (0..6).flat_map(|i| [(i + 1) % 6, (i + 2) % 6]).collect();
        Topology::Random { informants: 2 }.guides_into(&COSTS, &links, &mut guides);
        assert_eq!(guides, [5, 1, 1, 1, 4, 5]);
    }

    /// A particle is informed by a given other with probability 1 - (1 - 1/n)^K.
    #[test]
    fn links_are_drawn_evenly() {
        let (topology, n, rounds) = (Topology::Random { informants: 3 }, 20, 2000);
        let mut links = vec![0; topology.link_count(n)];
        let mut hits = vec![0_u32; n];
        for round in 0..rounds {
            Topology::draw_links(&mut links, n, &mut Seed(3).stream(round, 0));
            for &to in &links {
                hits[to] += 1;
            }
        }
        // Binomial of 120 000 draws at 1/20: mean 6000, standard deviation 75.5.
        assert!(hits.iter().all(|&h| (f64::from(h) - 6000.0).abs() < 5.0 * 75.5), "{hits:?}");
    }
}
