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

#[cfg(test)]
mod tests {
    use super::super::super::gaussian::VoxelParams;
    use super::*;
    use crate::scenes::{ROOM, sheets};
    use agv_core::sensors::PointCloud;

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
