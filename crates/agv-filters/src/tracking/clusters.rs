//! The hits of a scan in groups, each the surface of one thing: adaptive breakpoints.
//!
//! Two neighbouring hits belong together if a surface that the beams meet at no less than the angle `λ` can hold both
//! (Borges and Aldon 2004, *Line extraction in 2D range images for mobile robotics*, section 3):
//!
//! ```text
//! ‖p_j - p_i‖ <= r_i sin Δφ / sin(λ - Δφ) + 3 σ_r
//! ```

use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    sensors::{Beam, LaserScan},
};
use nalgebra::Vector2;
use std::{f64::consts::TAU, ops::Range};

/// Parameters of [`ScanClusters`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ClusterParams {
    /// `λ`: least angle between a beam and a surface that it is believed to follow, in radians.
    pub incidence: f64,
    /// `σ_r`: standard deviation of a range, in metres.
    pub range_sigma: f64,
    /// Invalid beams in a row that are bridged.
    pub bridged_beams: usize,
    /// Fewest points of a cluster; smaller ones are dropped.
    pub min_points: usize,
}

impl Default for ClusterParams {
    /// 15°, which keeps poles 0.2 m apart in two at 6 m where Borges and Aldon's 10° joins them; 1 cm of a common scanner.
    fn default() -> Self {
        Self { incidence: 15_f64.to_radians(), range_sigma: 0.01, bridged_beams: 2, min_points: 3 }
    }
}

/// Points of a scan that belong together, in the order of the beams.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cluster {
    /// Its points, in [`ScanClusters::points`].
    pub points: Range<usize>,
    /// Whether something nearer, or what the scanner does not see, may hide more of it before its first point, and after its
    /// last.
    pub hidden: [bool; 2],
}

/// The clusters of a scan; memory is used again for the next.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::tracking::{ClusterParams, ScanClusters};
///
/// // A wall 4 m away with a post 2 m away before it.
/// let mut ranges = vec![4.0; 41];
/// ranges[18..23].fill(2.0);
/// let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), ranges)?;
/// let mut clusters = ScanClusters::new(ClusterParams::default())?;
/// clusters.segment(&scan, &Se2::default(), |_, _| true);
/// let sizes: Vec<usize> = clusters.clusters().iter().map(|c| c.points.len()).collect();
/// assert_eq!(sizes, [18, 5, 18]);
/// assert_eq!(clusters.clusters()[0].hidden, [true, true]); // the scan's edge, and the post
/// assert_eq!(clusters.clusters()[1].hidden, [false, false]);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ScanClusters {
    params: ClusterParams,
    hits: Vec<Hit>,
    points: Vec<Vector2<f64>>,
    beams: Vec<usize>,
    clusters: Vec<Cluster>,
}

#[derive(Debug, Clone, Copy)]
struct Hit {
    beam: usize,
    range: f64,
    point: Vector2<f64>,
    kept: bool,
}

impl ScanClusters {
    /// No clusters yet.
    ///
    /// # Errors
    /// An `incidence` outside (0, π/2], a negative `range_sigma`, or no `min_points`.
    pub fn new(params: ClusterParams) -> Result<Self, Error> {
        check::in_range("incidence", params.incidence, f64::MIN_POSITIVE, TAU / 4.0)?;
        check::non_negative("range_sigma", params.range_sigma)?;
        check::at_least("min_points", params.min_points, 1)?;
        Ok(Self { params, hits: Vec::new(), points: Vec::new(), beams: Vec::new(), clusters: Vec::new() })
    }

    /// Finds the clusters of a scan among the hits for which `keep(beam, point)` is true; a hit that is not kept parts its
    /// neighbours. Points are given in the target frame, those of a laser of any mount.
    ///
    /// O(beams); allocates only for more beams than before. A scan without hits has no clusters.
    pub fn segment(
        &mut self,
        scan: &LaserScan,
        target_from_base: &Se2,
        mut keep: impl FnMut(usize, &Vector2<f64>) -> bool,
    ) {
        let (hits, points, beams, clusters) = (&mut self.hits, &mut self.points, &mut self.beams, &mut self.clusters);
        hits.clear();
        points.clear();
        beams.clear();
        clusters.clear();
        let target_from_sensor = target_from_base.compose(&scan.geometry().base_from_sensor);
        let step = scan.geometry().angle_increment.abs();
        let whole_turn = (step * scan.len() as f64 - TAU).abs() < 1.5 * step;
        // Where beams come back empty between two hits, there is a gap.
        let (mut empty_since, mut empty_before) = (false, false);
        let mut start = 0;
        for (beam, (angle, reading)) in scan.beams().enumerate() {
            let range = match reading {
                Beam::Hit(range) => range,
                Beam::NoReturn => {
                    empty_since = true;
                    continue;
                }
                Beam::Invalid => continue,
            };
            let (sin, cos) = angle.sin_cos();
            let point = target_from_sensor.act(&Vector2::new(range * cos, range * sin));
            let hit = Hit { beam, range, point, kept: keep(beam, &point) };
            if let Some(last) = hits.last()
                && (empty_since || !joined(&self.params, last, &hit, beam - last.beam, step))
            {
                close(clusters, start..hits.len(), hits);
                start = hits.len();
            }
            empty_before |= hits.is_empty() && empty_since;
            hits.push(hit);
            empty_since = false;
        }
        close(clusters, start..hits.len(), hits);
        // Across the seam of a whole turn: whether the last hit and the first are of one surface.
        let len = scan.len();
        let is_joined = match (hits.first(), hits.last()) {
            (Some(first), Some(last)) if whole_turn && !empty_before && !empty_since => {
                joined(&self.params, last, first, first.beam + len - last.beam, step)
            }
            _ => false,
        };
        let has_seam = whole_turn && !is_joined;
        // Ends: hidden by a nearer neighbour, or by the scan's edge. `clusters` still counts hits here.
        for cluster in clusters.iter_mut() {
            let (first, last) = (cluster.points.start, cluster.points.end - 1);
            let near = |from: &Hit, to: &Hit| (to.beam + len - from.beam) % len <= 1 + self.params.bridged_beams;
            let (own, before) = (&hits[first], first.checked_sub(1).or(has_seam.then(|| hits.len() - 1)));
            let at_start =
                before.map_or(own.beam == 0 && !whole_turn, |i| near(&hits[i], own) && hits[i].range < own.range);
            let (own, after) = (&hits[last], hits.get(last + 1).or(hits.first().filter(|_| has_seam)));
            let at_end =
                after.map_or(own.beam + 1 == len && !whole_turn, |other| near(own, other) && other.range < own.range);
            cluster.hidden = [at_start, at_end];
        }
        if let (true, [head, .., tail]) = (is_joined, &mut clusters[..]) {
            // The first cluster goes on where the last ends. Both were kept, being joined.
            let first = head.points.clone();
            tail.hidden[1] = head.hidden[1];
            for index in first {
                hits.push(hits[index]);
            }
            tail.points.end = hits.len();
            clusters.remove(0);
        }
        points.extend(hits.iter().map(|hit| hit.point));
        beams.extend(hits.iter().map(|hit| hit.beam));
        let min = self.params.min_points;
        clusters.retain(|cluster| cluster.points.len() >= min);
    }

    /// The clusters found last, in the order of the beams.
    pub fn clusters(&self) -> &[Cluster] {
        &self.clusters
    }

    /// The hits of that scan in the target frame, in metres.
    pub fn points(&self) -> &[Vector2<f64>] {
        &self.points
    }

    /// The beam of each point.
    pub fn beams(&self) -> &[usize] {
        &self.beams
    }

    /// The points of one cluster.
    pub fn points_of(&self, cluster: &Cluster) -> &[Vector2<f64>] {
        self.points.get(cluster.points.clone()).unwrap_or_default()
    }
}

/// Whether a surface may hold both of two hits that are `apart` beams apart.
fn joined(params: &ClusterParams, a: &Hit, b: &Hit, apart: usize, step: f64) -> bool {
    let turn = apart as f64 * step;
    if !(a.kept && b.kept) || apart > 1 + params.bridged_beams || turn >= params.incidence {
        return false;
    }
    let reach = a.range.min(b.range) * turn.sin() / (params.incidence - turn).sin() + 3.0 * params.range_sigma;
    (b.point - a.point).norm_squared() <= reach * reach
}

/// Ends a cluster of hits, unless they were not to be kept.
fn close(clusters: &mut Vec<Cluster>, points: Range<usize>, hits: &[Hit]) {
    if hits.get(points.start).is_some_and(|hit| hit.kept) && !points.is_empty() {
        clusters.push(Cluster { points, hidden: [false; 2] });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{sensors::ScanGeometry, time::Stamp};
    use proptest::prelude::*;

    fn segmented(geometry: ScanGeometry, ranges: &[f32], min_points: usize) -> ScanClusters {
        let scan = LaserScan::new(Stamp::default(), geometry, ranges.to_vec()).unwrap();
        let params = ClusterParams { min_points, ..Default::default() };
        let mut clusters = ScanClusters::new(params).unwrap();
        clusters.segment(&scan, &Se2::new(1.0, -2.0, 0.4), |_, _| true);
        clusters
    }

    fn any_ranges() -> impl Strategy<Value = Vec<f32>> {
        let piece = prop_oneof![
            6 => (0.5..9.0_f32, 1_usize..12).prop_map(|(range, len)| vec![range; len]),
            1 => Just(vec![f32::NAN]),
            1 => Just(vec![f32::INFINITY]),
        ];
        prop::collection::vec(piece, 0..20).prop_map(|pieces| pieces.concat())
    }

    proptest! {
        /// Every hit is in exactly one cluster, if single points may be clusters, in the order of the beams.
        #[test]
        fn clusters_part_the_hits(ranges in any_ranges()) {
            let clusters = segmented(ScanGeometry::default(), &ranges, 1);
            let hits: Vec<usize> = (0..ranges.len()).filter(|&i| ranges[i].is_finite()).collect();
            prop_assert_eq!(clusters.beams(), &hits[..]);
            let mut next = 0;
            for cluster in clusters.clusters() {
                prop_assert_eq!(cluster.points.start, next);
                next = cluster.points.end;
            }
            prop_assert_eq!(next, hits.len());
        }

        /// A scanner that turns the other way finds the same things.
        #[test]
        fn mirrored_scans_have_mirrored_clusters(ranges in any_ranges()) {
            let geometry = ScanGeometry { angle_min: -1.0, ..Default::default() };
            let forth = segmented(geometry, &ranges, 2);
            let end = geometry.angle(ranges.len().max(1) - 1);
            let back = ScanGeometry { angle_min: end, angle_increment: -geometry.angle_increment, ..geometry };
            let mut turned = ranges.clone();
            turned.reverse();
            let back = segmented(back, &turned, 2);
            let sizes = |clusters: &ScanClusters| -> Vec<(usize, [bool; 2])> {
                clusters.clusters().iter().map(|c| (c.points.len(), c.hidden)).collect()
            };
            let mut expected = sizes(&forth);
            expected.reverse();
            for (_, hidden) in &mut expected {
                hidden.reverse();
            }
            prop_assert_eq!(sizes(&back), expected);
        }
    }

    #[test]
    fn a_full_turn_has_no_seam() {
        let step = TAU / 360.0;
        let geometry = ScanGeometry { angle_min: 0.0, angle_increment: step, ..Default::default() };
        let mut ranges = vec![6.0; 360];
        // A post across the first beam, and one elsewhere.
        for beam in [357, 358, 359, 0, 1, 180, 181, 182] {
            ranges[beam] = 2.0;
        }
        let clusters = segmented(geometry, &ranges, 3);
        let posts: Vec<&Cluster> = clusters.clusters().iter().filter(|c| c.points.len() < 10).collect();
        assert_eq!(posts.iter().map(|c| c.points.len()).collect::<Vec<_>>(), [3, 5]);
        assert!(posts.iter().all(|c| c.hidden == [false, false]));
        assert_eq!(clusters.beams()[posts[1].points.clone()], [357, 358, 359, 0, 1]);
    }

    #[test]
    fn ends_at_the_seam_look_across_it() {
        let geometry = ScanGeometry { angle_min: 0.0, angle_increment: TAU / 360.0, ..Default::default() };
        // A post that ends at the last beam hides the wall that begins at the first.
        let mut ranges = vec![6.0; 360];
        ranges[355..].fill(2.0);
        let clusters = segmented(geometry, &ranges, 3);
        let hidden: Vec<_> = clusters.clusters().iter().map(|c| (c.points.len(), c.hidden)).collect();
        assert_eq!(hidden, [(355, [true, true]), (5, [false, false])]);
        // A beam between two posts that comes back empty saw through: two they stay.
        let mut ranges = vec![f32::INFINITY; 360];
        for beam in [356, 357, 358, 0, 1, 2] {
            ranges[beam] = 2.0;
        }
        assert_eq!(segmented(geometry, &ranges, 3).clusters().len(), 2);
        ranges[359] = f32::NAN;
        assert_eq!(segmented(geometry, &ranges, 3).clusters().len(), 1);
        // A wall all around hides nothing of itself.
        let ranges: Vec<f32> = (0..360).map(|beam| 6.0 + 0.001 * (beam as f32).sin()).collect();
        let clusters = segmented(geometry, &ranges, 3);
        assert_eq!(clusters.clusters().iter().map(|c| c.hidden).collect::<Vec<_>>(), [[false, false]]);
    }

    #[test]
    fn what_is_not_kept_parts_its_neighbours() {
        let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![3.0; 30]).unwrap();
        let mut clusters = ScanClusters::new(ClusterParams::default()).unwrap();
        clusters.segment(&scan, &Se2::default(), |beam, _| !(10..12).contains(&beam));
        assert_eq!(clusters.clusters().iter().map(|c| c.points.len()).collect::<Vec<_>>(), [10, 18]);
        clusters.segment(
            &LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![]).unwrap(),
            &Se2::default(),
            |_, _| true,
        );
        assert!(clusters.clusters().is_empty() && clusters.points().is_empty());
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = ClusterParams::default();
        for (name, bad) in [
            ("incidence", ClusterParams { incidence: 0.0, ..good }),
            ("incidence", ClusterParams { incidence: f64::NAN, ..good }),
            ("range_sigma", ClusterParams { range_sigma: -1.0, ..good }),
            ("min_points", ClusterParams { min_points: 0, ..good }),
        ] {
            assert!(ScanClusters::new(bad).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
