//! Where a vehicle can be, as far as a map says.

use super::super::map::NdtMap;
use agv_core::{
    check,
    geometry::{Se3, So3, UncertainPose},
    roles::LocalizationError,
};
use nalgebra::{Matrix6, Vector2, Vector3, Vector6};
use std::{cmp::Ordering, collections::BTreeMap};

/// Share of a voxel's spread that is upright, below which it is a floor.
const LEVEL: f64 = 0.02;

/// A level pose on the floor of every square of `spacing` metres that has one: on the lowest voxel whose points lie level.
pub(super) fn places(map: &NdtMap, spacing: f64) -> Vec<Se3> {
    let level = || {
        map.voxels().filter_map(|(cell, _)| {
            let surface = map.gaussian(cell)?;
            let spread = &surface.covariance;
            let least_width = (0.1 * map.params().resolution).powi(2);
            let is_level = spread.m33 <= LEVEL * spread.trace() && spread.m11.min(spread.m22) >= least_width;
            let square = [surface.mean.x, surface.mean.y].map(|along| (along / spacing).floor() as i64);
            is_level.then_some((square, surface.mean))
        })
    };
    let mut lowest: BTreeMap<[i64; 2], f64> = BTreeMap::new();
    for (square, mean) in level() {
        lowest.entry(square).and_modify(|z| *z = z.min(mean.z)).or_insert(mean.z);
    }
    // The middle-most of those that are as low, so that places are evenly apart, in whatever order the voxels were met.
    let mut floors: BTreeMap<[i64; 2], Vector3<f64>> = BTreeMap::new();
    for (square, mean) in level().filter(|(square, mean)| lowest.get(square).is_some_and(|z| mean.z < z + STEP)) {
        let middle = Vector2::new(square[0] as f64 + 0.5, square[1] as f64 + 0.5) * spacing;
        let off = |mean: &Vector3<f64>| [(mean.xy() - middle).norm_squared(), mean.x, mean.y, mean.z];
        let floor = floors.entry(square).or_insert(mean);
        let order = off(&mean).into_iter().zip(off(floor)).map(|(a, b)| a.total_cmp(&b)).find(|order| order.is_ne());
        if order == Some(Ordering::Less) {
            *floor = mean;
        }
    }
    floors.into_values().map(|floor| Se3::from_parts(floor, So3::default())).collect()
}

/// As many of the places as may be tried, and how far apart these are: the middle-most of every cube whose edge is just long enough. In
/// space, since every so many-th of a list that comes in rows can be all of a few rows.
pub(super) fn spread_out(places: Vec<Se3>, spacing: f64, most: usize) -> (Vec<Se3>, f64) {
    if places.len() <= most {
        return (places, spacing);
    }
    let corner = places.iter().map(Se3::translation).reduce(|a, b| a.inf(&b)).unwrap_or_default();
    let mut edge = spacing * (places.len() as f64 / most.max(1) as f64).sqrt();
    loop {
        let mut best: BTreeMap<[i64; 3], (f64, &Se3)> = BTreeMap::new();
        for place in &places {
            let at = (place.translation() - corner) / edge;
            let cube = at.map(f64::floor);
            let off = (at - cube).add_scalar(-0.5).norm_squared();
            let middle = best.entry([cube.x as i64, cube.y as i64, cube.z as i64]).or_insert((off, place));
            if off < middle.0 {
                *middle = (off, place);
            }
        }
        // In the end one cube holds all.
        if best.len() <= most.max(1) {
            return (best.into_values().map(|(_, place)| *place).collect(), edge);
        }
        edge *= WIDER;
    }
}

/// The belief that a vehicle is at any of the places, heading anywhere.
pub(super) fn spread_over(places: &[Se3]) -> Result<UncertainPose<Se3>, LocalizationError> {
    check::at_least("places", places.len(), 1)?;
    let n = places.len() as f64;
    let mean = places.iter().map(Se3::translation).sum::<Vector3<f64>>() / n;
    let variance = places.iter().map(|p| (p.translation() - mean).norm_squared()).sum::<f64>() / n;
    let heading = std::f64::consts::PI.powi(2) / 3.0;
    let spread = Vector6::new(variance.max(1.0), variance.max(1.0), 0.01, 0.01, 0.01, heading);
    let pose = Se3::from_parts(mean, So3::default());
    Ok(UncertainPose::new(pose, Matrix6::from_diagonal(&spread))?)
}

/// Heights that differ by less belong to one floor, in metres.
const STEP: f64 = 0.2;

/// By what the edge of cubes grows that are too many.
const WIDER: f64 = 1.1;

#[cfg(test)]
mod tests {
    use super::super::super::gaussian::VoxelParams;
    use super::*;
    use crate::scenes::{ROOM, sheets};
    use agv_core::sensors::PointCloud;

    /// Halls of which every eighth place of the list, or every fiftieth, lies on a few lines.
    #[test]
    fn of_too_many_places_those_that_are_tried_lie_evenly() {
        let hall = |columns: i32, rows: i32| {
            let places = (0..columns * rows).map(|i| Vector3::new(f64::from(i / rows), f64::from(i % rows), 0.0));
            places.map(|place| Se3::from_parts(place, So3::default())).collect::<Vec<_>>()
        };
        for (columns, rows, most) in [(100, 96, 1250), (120, 50, 120), (3, 417, 1250), (20, 20, 3), (9, 9, 1)] {
            let all = hall(columns, rows);
            let (tried, apart) = spread_out(all.clone(), 1.0, most);
            assert!((1..=most).contains(&tried.len()), "{columns} {rows}: {}", tried.len());
            let off = |place: &Se3, other: &Se3| (place.translation() - other.translation()).norm();
            let nearest = |place: &Se3| tried.iter().map(|other| off(place, other)).fold(f64::INFINITY, f64::min);
            let farthest = all.iter().map(nearest).fold(0.0, f64::max);
            // Half a diagonal of a square, and as much again as the middle-most may be off the middle.
            assert!(farthest <= 0.71 * (apart + 1.0), "{columns} {rows}: {farthest} {apart}");
            let fair = (all.len() as f64 / most as f64).sqrt();
            assert!(apart <= 1.35 * fair.max(1.0) || most < 10, "{columns} {rows}: {apart} {fair}");
        }
        let all = hall(5, 5);
        assert_eq!(spread_out(all.clone(), 1.0, 25), (all, 1.0));
        // Storeys and places anywhere, the absurd too.
        let far = [0.0, 3.0, 1e9, -1e300].map(|z| Se3::from_parts(Vector3::new(0.2, 0.1, z), So3::default()));
        assert_eq!(spread_out(far.to_vec(), 1.0, 2).0.len(), 2);
        assert_eq!(spread_out(far.to_vec(), 1.0, 1).0.len(), 1);
    }

    #[test]
    fn places_stand_on_the_floor_of_the_room_and_nowhere_else() {
        let mut map = NdtMap::new(VoxelParams::default()).unwrap();
        let cloud = PointCloud::from_points(sheets(&ROOM, 100.0, 1).iter().map(|p| p.cast()));
        map.insert(&cloud, &Se3::default());
        let places = places(&map, 1.0);
        assert!((80..=140).contains(&places.len()), "{}", places.len());
        for place in &places {
            let at = place.translation();
            assert!((at.z + 1.0).abs() < 0.02, "{at}");
            assert!((-6.3..=7.7).contains(&at.x) && (-4.2..=5.8).contains(&at.y), "{at}");
        }
        assert!(super::places(&NdtMap::new(VoxelParams::default()).unwrap(), 1.0).is_empty());
    }
}
