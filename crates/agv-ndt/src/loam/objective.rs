//! Features and what they are matched with, as a cost over poses.
//!
//! A matched point `x` with the place `q` on its plane or line costs, with `F` for what that fixes and the kernel of Geman and
//! `McClure`,
//!
//! ```text
//! r² = (x - q)ᵀ F (x - q)         ρ = ½ k² r² / (k² + r²)        w = (k² / (k² + r²))²
//! ```
//!
//! gradient `w F (x - q)` and Hessian `w F`. Matches are made at one pose and kept while that is improved.

use super::fit::{self, POINTS};
use super::mapping::{LocalMap, PlacedFeatures};
use crate::odometry::PointMap;
use crate::registration::{Facing, MotionSums, Objective, PointDerivatives, Quadratic};
use agv_core::{
    compute::{CHUNK, Par},
    geometry::{LieGroup, Se3},
};
use nalgebra::{Matrix3, Matrix6, Vector3};

/// A feature, and what it is matched with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Match {
    /// Place in the base frame.
    place: Vector3<f64>,
    is_edge: bool,
    /// Where in the map it was when it was matched; far from everything before.
    matched_at: Vector3<f64>,
    /// On the plane or line, in the map; `None` if there was none near enough.
    anchor: Option<Anchor>,
}

/// How far a feature may move before it is matched anew, as a share of the spacing of what it is matched with: a plane through five points does not change
/// over a tenth of their distance.
const STILL: f64 = 0.1;

#[derive(Debug, Clone, Copy)]
struct Anchor {
    place: Vector3<f64>,
    fixed: Matrix3<f64>,
    /// A plane that lies level within 30°.
    is_level: bool,
}

#[cfg(test)]
impl Match {
    /// A surface's feature on a plane with that normal.
    pub(super) fn on_plane(place: Vector3<f64>, normal: Vector3<f64>) -> Self {
        let (fixed, is_level) = (normal * normal.transpose(), normal.z.abs() > 0.866);
        Self { place, is_edge: false, matched_at: place, anchor: Some(Anchor { place, fixed, is_level }) }
    }
}

impl Anchor {
    /// Square of a place's distance from the plane or line.
    fn square(&self, place: &Vector3<f64>) -> f64 {
        let offset = place - self.place;
        offset.dot(&(self.fixed * offset))
    }
}

/// Which matches count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Selection {
    All,
    /// Level planes: the ground, and what is parallel to it.
    Level,
    Edges,
}

/// The features that take part, at most so many surfaces and edges, evenly over the list.
pub(super) fn choose(features: &PlacedFeatures, surfaces: usize, edges: usize, out: &mut Vec<Match>) {
    out.clear();
    let mut take = |places: &[Vector3<f64>], most: usize, is_edge: bool| {
        let count = most.min(places.len());
        // i n / count is below n.
        let matched_at = Vector3::repeat(f64::INFINITY);
        let place = |i: usize| places[i * places.len() / count];
        out.extend((0..count).map(|i| Match { place: place(i), is_edge, matched_at, anchor: None }));
    };
    take(&features.surfaces, surfaces, false);
    take(&features.edges, edges, true);
}

/// Matches features at a pose, those that have moved since they were matched.
pub(super) fn associate(matches: &mut [Match], map: &LocalMap, level: usize, pose: &Se3, par: Par) {
    let (planes, lines) = (map.level(level), map.edges());
    par.for_each_chunk(matches, CHUNK, |_, matches| {
        for item in matches {
            let x = pose.act(&item.place);
            let still = STILL * if item.is_edge { lines } else { planes }.spacing();
            if (x - item.matched_at).norm_squared() <= still * still {
                continue;
            }
            item.matched_at = x;
            let nearest = |points: &PointMap| points.nearest::<POINTS>(&x, points.reach());
            let surface = if item.is_edge {
                nearest(lines).and_then(|near| fit::line(&near, 0.2 * lines.spacing()))
            } else {
                nearest(planes).and_then(|near| fit::plane(&near, 0.2 * planes.spacing()))
            };
            item.anchor = surface.map(|surface| Anchor {
                place: x + surface.offset,
                fixed: surface.fixed,
                is_level: !item.is_edge && surface.direction.z.abs() > 0.866,
            });
        }
    });
}

/// What the matches of a pose amount to.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct MatchFit {
    /// Share of the matched features that lie where the map has them.
    pub(super) agreement: f64,
    /// Share of all features: those of places that were not seen before are not matched.
    pub(super) inlier_ratio: f64,
    /// Directions that the matches leave free.
    pub(super) unobserved: Matrix6<f64>,
    /// Mean square of the inliers' distances, in square metres.
    pub(super) variance: f64,
}

/// Matched features against the pose.
pub(super) struct MatchObjective<'a> {
    pub(super) matches: &'a [Match],
    pub(super) selection: Selection,
    /// `k` of the kernel, in metres.
    pub(super) kernel: f64,
    pub(super) par: Par,
}

impl MatchObjective<'_> {
    /// Matches that count.
    pub(super) fn count(&self) -> usize {
        self.matches.iter().filter(|item| self.anchor(item).is_some()).count()
    }

    fn anchor<'a>(&self, item: &'a Match) -> Option<&'a Anchor> {
        item.anchor.as_ref().filter(|anchor| match self.selection {
            Selection::All => true,
            Selection::Level => anchor.is_level,
            Selection::Edges => item.is_edge,
        })
    }

    /// How well the matches fit: inliers are within `distance` metres.
    pub(super) fn fit(&self, pose: &Se3, distance: f64, min_facing_share: f64) -> MatchFit {
        let rotation = pose.rotation().matrix();
        let chunk = |chunk: usize| {
            let (mut facing, mut inliers, mut square_sum) = (Facing::default(), 0_usize, 0.0);
            for item in self.chunk(chunk) {
                let Some(anchor) = self.anchor(item) else { continue };
                let y = rotation * item.place;
                let square = anchor.square(&(y + pose.translation()));
                if square <= distance * distance {
                    facing.add(&y, &anchor.fixed);
                    inliers += 1;
                    square_sum += square;
                }
            }
            (facing, inliers, square_sum)
        };
        let sums = self.par.map_reduce(self.chunks(), chunk, |(a, n, s), (b, m, t)| (a.merged(b), n + m, s + t));
        let (facing, inliers, square_sum) = sums.unwrap_or_default();
        MatchFit {
            agreement: inliers as f64 / self.count().max(1) as f64,
            inlier_ratio: inliers as f64 / self.matches.len().max(1) as f64,
            unobserved: facing.unobserved(pose, min_facing_share, &Matrix6::identity()),
            variance: square_sum / inliers.max(1) as f64,
        }
    }

    /// Matches within `distance` metres.
    pub(super) fn inliers(&self, pose: &Se3, distance: f64) -> usize {
        let near = |item: &&Match| {
            let square = |anchor: &Anchor| anchor.square(&pose.act(&item.place));
            self.anchor(item).is_some_and(|anchor| square(anchor) <= distance * distance)
        };
        self.matches.iter().filter(near).count()
    }

    const fn chunks(&self) -> usize {
        self.matches.len().div_ceil(CHUNK)
    }

    fn chunk(&self, chunk: usize) -> &[Match] {
        &self.matches[chunk * CHUNK..self.matches.len().min((chunk + 1) * CHUNK)]
    }
}

impl Objective for MatchObjective<'_> {
    fn evaluate(&mut self, pose: &Se3) -> Quadratic {
        let (rotation, square) = (pose.rotation().matrix(), self.kernel * self.kernel);
        let chunk = |chunk: usize| {
            let mut sums = MotionSums::default();
            for item in self.chunk(chunk) {
                let Some(anchor) = self.anchor(item) else { continue };
                let y = rotation * item.place;
                let gradient = anchor.fixed * (y + pose.translation() - anchor.place);
                let distance = gradient.norm_squared();
                let share = square / (square + distance);
                let weight = share * share;
                let point = PointDerivatives {
                    cost: 0.5 * share * distance,
                    gradient: gradient * weight,
                    hessian: anchor.fixed * weight,
                    curvature: 0.0,
                };
                sums.add(&y, &point);
            }
            sums
        };
        self.par.map_reduce(self.chunks(), chunk, MotionSums::merged).unwrap_or_default().quadratic(pose)
    }
}
