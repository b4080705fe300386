//! Many descriptors, and which of them look like a new one.
//!
//! Two descriptors are compared as Kim and Kim (2018, section III) do: over the sectors in which both have something, the mean of one
//! less the cosine between their columns, at the shift where it is least. Ring keys, which need no shift, choose whom to compare with.
//! All ring keys are looked at: a thousand of them take a few microseconds, and a tree of twenty dimensions would visit most of them.

use super::context::{ScanContext, ScanContextParams, product, square_distance};
use crate::Error;
#[cfg(feature = "serde")]
use agv_core::check;
use agv_core::{geometry::wrap_angle, sensors::PointCloud};
use std::f64::consts::TAU;

/// Least share of the sectors that two views must both see something in, to be compared.
const LEAST_COMMON: f32 = 0.25;

/// How alike a place looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceMatch {
    /// Number of the place, in the order in which they were added.
    pub place: usize,
    /// From 0, the same, to 1, nothing in common.
    pub distance: f32,
    /// Yaw of the query's base in the frame of the place's, in radians, to half a sector.
    pub yaw: f64,
}

/// Descriptors of all places that were met.
///
/// ```
/// use agv_core::{nalgebra::Vector3, sensors::PointCloud};
/// use agv_ndt::places::{ScanContext, ScanContextParams, ScanContexts};
///
/// // What stands around the vehicle, and the same after it turned left by 0.628 rad, six of the sixty sectors.
/// let seen = |yaw: f32| PointCloud::from_points((0..120).map(|i| {
///     let (angle, range) = ((i as f32 + 0.5) * 0.05236 - yaw, 5.0 + 7.0 * (i as f32 * 1.3).sin().abs());
///     Vector3::new(range * angle.cos(), range * angle.sin(), 1.0 + (i as f32 * 2.1).cos())
/// }));
/// let mut places = ScanContexts::new(ScanContextParams::default())?;
/// let (mut here, mut found) = (ScanContext::default(), Vec::new());
/// places.describe_into(&seen(0.0), &mut here);
/// places.push(&here);
/// places.describe_into(&seen(0.628), &mut here);
/// places.find_into(&here, |_| true, &mut found);
/// assert!(found[0].place == 0 && (found[0].yaw - 0.628).abs() < 0.06);
/// # Ok::<(), agv_ndt::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawContexts"))]
pub struct ScanContexts {
    params: ScanContextParams,
    columns: Vec<f32>,
    ring_keys: Vec<f32>,
    sector_keys: Vec<f32>,
}

impl ScanContexts {
    /// No places yet.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(params: ScanContextParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, columns: Vec::new(), ring_keys: Vec::new(), sector_keys: Vec::new() })
    }

    /// The parameters.
    pub const fn params(&self) -> &ScanContextParams {
        &self.params
    }

    /// Places.
    pub const fn len(&self) -> usize {
        self.ring_keys.len() / self.params.column()
    }

    /// Whether there are no places.
    pub const fn is_empty(&self) -> bool {
        self.ring_keys.is_empty()
    }

    /// Describes a cloud in the frame of its base; points that are not finite or out of reach are left out. Linear in the points.
    pub fn describe_into(&self, cloud: &PointCloud, out: &mut ScanContext) {
        out.rebuild(cloud, &self.params);
    }

    /// Adds a place, as [`describe_into`](Self::describe_into) of this or an equal one described it, and says its number.
    pub fn push(&mut self, context: &ScanContext) -> usize {
        let place = self.len();
        let (columns, column, sectors) =
            (self.params.sectors * self.params.column(), self.params.column(), self.params.sectors);
        // A descriptor of other parameters, or none yet, is cut or filled up: the lists stay in step.
        extend(&mut self.columns, &context.columns, columns);
        extend(&mut self.ring_keys, &context.ring_key, column);
        extend(&mut self.sector_keys, &context.sector_key, sectors);
        place
    }

    /// Writes the places that look most like `query` to `out`, most alike first: of those that `among` says yes to, the
    /// [`candidates`](ScanContextParams::candidates) with the nearest ring keys. None for a query that looks like nothing.
    ///
    /// Linear in the places; nothing is allocated once `out` has room for the candidates.
    pub fn find_into(&self, query: &ScanContext, among: impl Fn(usize) -> bool, out: &mut Vec<PlaceMatch>) {
        out.clear();
        if query.is_empty() {
            return;
        }
        let keys = self.ring_keys.chunks_exact(self.params.column());
        for (place, key) in keys.enumerate().filter(|(place, _)| among(*place)) {
            let distance = square_distance(key, &query.ring_key);
            let full = out.len() == self.params.candidates;
            if full && out.last().is_some_and(|last| last.distance <= distance) {
                continue;
            }
            if full {
                out.pop();
            }
            // Those as near came first.
            let at = out.partition_point(|other| other.distance <= distance);
            out.insert(at, PlaceMatch { place, distance, yaw: 0.0 });
        }
        for found in &mut *out {
            *found = self.compare(query, found.place);
        }
        out.sort_unstable_by(|a, b| a.distance.total_cmp(&b.distance).then(a.place.cmp(&b.place)));
    }

    /// How much a place looks like `query`; a distance of 1 for a place that is not there.
    pub fn compare(&self, query: &ScanContext, place: usize) -> PlaceMatch {
        let (column, sectors) = (self.params.column(), self.params.sectors);
        let keys = self.sector_keys.chunks_exact(sectors).nth(place);
        let columns = self.columns.chunks_exact(sectors * column).nth(place);
        let mut best = PlaceMatch { place, distance: 1.0, yaw: 0.0 };
        let (Some(keys), Some(columns)) = (keys, columns) else { return best };
        if query.sector_key.len() != sectors || query.columns.len() != columns.len() {
            return best;
        }
        let mut start = (0, f32::INFINITY);
        for shift in 0..sectors {
            // The sectors of the place from `shift` on are those of the query from the first on.
            let (end, begin) = keys.split_at(shift);
            let (first, second) = query.sector_key.split_at(begin.len());
            let off = square_distance(begin, first) + square_distance(end, second);
            if off < start.1 {
                start = (shift, off);
            }
        }
        let reach = ((0.5 * self.params.shifts * sectors as f64).ceil() as usize).min(sectors / 2);
        for step in 0..=2 * reach {
            let shift = (start.0 + sectors + step - reach) % sectors;
            let distance = column_distance(columns, &query.columns, shift, column);
            if distance < best.distance {
                let yaw = wrap_angle(shift as f64 * TAU / sectors as f64);
                best = PlaceMatch { place, distance, yaw };
            }
        }
        best
    }
}

fn extend(list: &mut Vec<f32>, values: &[f32], len: usize) {
    let end = list.len() + len;
    list.extend(values.iter().take(len));
    list.resize(end, 0.0);
}

/// Mean of one less the cosine between columns, of those that both have.
fn column_distance(place: &[f32], query: &[f32], shift: usize, column: usize) -> f32 {
    let (end, begin) = place.split_at(shift * column);
    let (mut sum, mut common) = (0.0, 0.0);
    let turned = begin.chunks_exact(column).chain(end.chunks_exact(column));
    for (a, b) in turned.zip(query.chunks_exact(column)) {
        let cosine = product(a, b);
        // Heights are not negative, and a column that has something is of unit length.
        let both = f32::from(u8::from(has_something(a) && has_something(b)));
        sum += both * (1.0 - cosine);
        common += both;
    }
    let sectors = (query.len() / column) as f32;
    if common < LEAST_COMMON * sectors { 1.0 } else { (sum / common).clamp(0.0, 1.0) }
}

fn has_something(column: &[f32]) -> bool {
    column.iter().any(|height| *height > 0.0)
}

/// Descriptors as they are stored.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawContexts {
    params: ScanContextParams,
    columns: Vec<f32>,
    ring_keys: Vec<f32>,
    sector_keys: Vec<f32>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawContexts> for ScanContexts {
    type Error = Error;

    fn try_from(RawContexts { params, columns, ring_keys, sector_keys }: RawContexts) -> Result<Self, Error> {
        params.validate()?;
        let (column, sectors) = (params.column(), params.sectors);
        let places = ring_keys.len() / column;
        check::length("ring_keys", ring_keys.len(), places * column)?;
        check::length("sector_keys", sector_keys.len(), places * sectors)?;
        check::length("columns", columns.len(), places * sectors * column)?;
        for (name, list) in [("columns", &columns), ("ring_keys", &ring_keys), ("sector_keys", &sector_keys)] {
            for value in list {
                check::non_negative(name, f64::from(*value))?;
            }
        }
        Ok(Self { params, columns, ring_keys, sector_keys })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        compute::Seed,
        geometry::{LieGroup, Se2, Se3, Twist3, angle_difference},
        time::Stamp,
    };
    use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn described(places: &ScanContexts, cloud: &PointCloud) -> ScanContext {
        let mut context = ScanContext::default();
        places.describe_into(cloud, &mut context);
        context
    }

    /// Places along all aisles of a factory, 2 m apart, and what a lidar sees near one of them.
    struct Site {
        factory: Factory,
        lidar: Lidar,
        poses: Vec<Se2>,
        places: ScanContexts,
    }

    impl Site {
        fn new(seed: Seed) -> Self {
            let factory = Factory::generate(FactoryParams { length: 40.0, width: 20.0, ..Default::default() }, seed);
            let factory = factory.unwrap();
            let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), agv_core::geometry::So3::default());
            let params = LidarParams { columns: 600, ..LidarParams::vlp16().with_mount(mount) };
            let lidar = Lidar::new(params, seed).unwrap();
            let along =
                |aisle: &Se2| (0..16).map(|i| *aisle * Se2::new(2.0 * f64::from(i), 0.0, 0.0)).collect::<Vec<_>>();
            let poses = factory.aisles().iter().flat_map(along).collect();
            let places = ScanContexts::new(ScanContextParams::default()).unwrap();
            let mut site = Self { factory, lidar, poses, places };
            for i in 0..site.poses.len() {
                let context = site.look(site.poses[i]);
                site.places.push(&context);
            }
            site
        }

        fn look(&mut self, pose: Se2) -> ScanContext {
            let cloud = self.lidar.scan(self.factory.world(), &pose.into(), &Twist3::default(), Stamp::default());
            described(&self.places, cloud.unwrap())
        }
    }

    /// Half a metre aside, turned any way: nine in ten are found within 2.5 m, and the turn to a sector.
    #[test]
    fn places_in_aisles_that_look_alike_are_told_apart() {
        let (mut asked, mut right, mut turned) = (0, 0, 0);
        for seed in 0..2 {
            let mut site = Site::new(Seed(seed));
            let mut found = Vec::new();
            for i in (0..site.poses.len()).step_by(3) {
                let yaw = 2.4 * i as f64;
                let here = site.poses[i] * Se2::new(0.4, if i % 2 == 0 { 0.3 } else { -0.3 }, yaw);
                let context = site.look(here);
                site.places.find_into(&context, |_| true, &mut found);
                let best = found[0];
                asked += 1;
                let pose = site.poses[best.place];
                right += usize::from((pose.translation() - here.translation()).norm() < 2.5);
                turned += usize::from(angle_difference(best.yaw, pose.between(&here).yaw()).abs() < 0.21);
                assert!(found.windows(2).all(|pair| pair[0].distance <= pair[1].distance));
            }
        }
        assert!(10 * right >= 9 * asked && 10 * turned >= 9 * asked, "{right} and {turned} of {asked}");
    }

    proptest! {
        /// Turned by whole sectors, a view is the same to the bit of its heights, and the turn is found.
        #[test]
        fn a_turn_of_the_vehicle_is_a_shift(
            points in prop::collection::vec((0.5..39.0_f64, 0..60_u32, 0.0..6.0_f64), 60..200), turn in 0..60_u32,
        ) {
            let seen = |turn: u32| PointCloud::from_points(points.iter().map(|&(range, sector, height)| {
                let angle = (f64::from(sector) - f64::from(turn) + 0.5) * TAU / 60.0;
                Vector3::new(range * angle.cos(), range * angle.sin(), height).cast::<f32>()
            }));
            // Of all shifts, since sector keys of noise may agree elsewhere.
            let mut places = ScanContexts::new(ScanContextParams { shifts: 1.0, ..Default::default() }).unwrap();
            let here = described(&places, &seen(0));
            places.push(&here);
            let query = described(&places, &seen(turn));
            let found = places.compare(&query, 0);
            let yaw = f64::from(turn) * TAU / 60.0;
            prop_assert!(found.distance < 0.05, "{:?}", found);
            prop_assert!(angle_difference(found.yaw, yaw).abs() < 1e-9, "{:?} {}", found, yaw);
            let off = square_distance(&here.ring_key, &query.ring_key);
            prop_assert!(off < 0.05, "{}", off);
        }
    }

    #[test]
    fn nothing_looks_like_nothing() {
        let mut places = ScanContexts::new(ScanContextParams::default()).unwrap();
        let pillar = PointCloud::from_points((0..300).map(|i| Vector3::new(5.0 + i as f32 * 0.1, (i % 7) as f32, 1.0)));
        let (pillar, blank) = (described(&places, &pillar), described(&places, &PointCloud::default()));
        let mut found = vec![PlaceMatch { place: 7, distance: 0.0, yaw: 0.0 }];
        places.find_into(&pillar, |_| true, &mut found);
        assert!(found.is_empty(), "no places yet");
        for context in [&blank, &pillar, &ScanContext::default()] {
            places.push(context);
        }
        assert_eq!(places.len(), 3);
        places.find_into(&blank, |_| true, &mut found);
        assert!(found.is_empty());
        places.find_into(&pillar, |place| place != 1, &mut found);
        assert!(found.iter().all(|place| place.distance == 1.0), "{found:?}");
        for absent in [3, 99, usize::MAX / 1200, usize::MAX] {
            assert_eq!(places.compare(&pillar, absent).distance, 1.0);
        }
        assert_eq!(places.compare(&ScanContext::default(), 1).distance, 1.0);
    }
}
