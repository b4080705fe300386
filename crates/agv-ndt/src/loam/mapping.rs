//! The local map: edges and surfaces of the last clouds around the vehicle.

use super::features::Features;
use crate::Error;
use crate::odometry::{PointMap, Window};
use agv_core::{
    check,
    geometry::{LieGroup, Se3},
};
use nalgebra::Vector3;

/// How much coarser each level of the surfaces is than the finest.
const COARSENESS: [f64; 3] = [1.0, 4.0, 8.0];

/// What a local map keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LocalMapParams {
    /// Distance from the vehicle up to which features are kept, in metres.
    pub radius: f64,
    /// Edge of the cubes of which each keeps one surface point, in metres.
    pub surface_spacing: f64,
    /// Edge of the cubes of which each keeps one point of an edge, in metres.
    pub edge_spacing: f64,
}

impl Default for LocalMapParams {
    /// 100 m is paper 003's; planes through five points 0.25 m apart are as large as the smallest surfaces worth a match.
    fn default() -> Self {
        Self { radius: 100.0, surface_spacing: 0.25, edge_spacing: 0.25 }
    }
}

impl LocalMapParams {
    pub(super) fn validate(&self) -> Result<(), agv_core::Error> {
        check::positive("radius", self.radius)?;
        check::in_range("surface_spacing", self.surface_spacing, 0.01, 10.0)?;
        check::in_range("edge_spacing", self.edge_spacing, 0.01, 10.0)?;
        Ok(())
    }
}

/// Features around the vehicle: surfaces at three spacings, edges at one. It slides with the vehicle.
#[derive(Debug, Clone)]
pub struct LocalMap {
    surfaces: [PointMap; COARSENESS.len()],
    edges: PointMap,
    window: Window,
}

impl LocalMap {
    /// An empty map.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: LocalMapParams) -> Result<Self, Error> {
        params.validate()?;
        let surface = |level: usize| PointMap::new(params.surface_spacing * COARSENESS[level]);
        Ok(Self {
            surfaces: [surface(0)?, surface(1)?, surface(2)?],
            edges: PointMap::new(params.edge_spacing)?,
            window: Window::new(params.radius),
        })
    }

    /// Surface points, the finest.
    pub const fn surfaces(&self) -> &PointMap {
        &self.surfaces[0]
    }

    /// Points of edges.
    pub const fn edges(&self) -> &PointMap {
        &self.edges
    }

    /// The surfaces of a level: each is coarser than the one before.
    pub(super) const fn level(&self, level: usize) -> &PointMap {
        &self.surfaces[level]
    }

    /// The coarsest level.
    pub(super) const COARSEST: usize = COARSENESS.len() - 1;

    /// Points, those of the finest surfaces and of edges.
    pub const fn len(&self) -> usize {
        self.surfaces[0].len() + self.edges.len()
    }

    /// Whether there is nothing.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Forgets everything; the memory stays.
    pub fn clear(&mut self) {
        self.surfaces.iter_mut().for_each(PointMap::clear);
        self.edges.clear();
        self.window.recenter();
    }

    /// Adds features, given by their places in the base frame, and slides to the vehicle's pose if it has gone on a tenth of the
    /// radius since the last time.
    pub(super) fn insert(&mut self, features: &PlacedFeatures, map_from_base: &Se3) {
        for place in &features.surfaces {
            let place = map_from_base.act(place);
            self.surfaces.iter_mut().for_each(|level| level.insert(&place));
        }
        for place in &features.edges {
            self.edges.insert(&map_from_base.act(place));
        }
        let here = map_from_base.translation();
        if let Some(radius) = self.window.slides(&here) {
            self.surfaces.iter_mut().for_each(|level| level.retain_around(&here, radius));
            self.edges.retain_around(&here, radius);
        }
    }
}

/// Places of features in the base frame at the time of the cloud's stamp.
#[derive(Debug, Clone, Default)]
pub(super) struct PlacedFeatures {
    pub(super) edges: Vec<Vector3<f64>>,
    pub(super) surfaces: Vec<Vector3<f64>>,
}

impl PlacedFeatures {
    /// Takes features of a sensor mounted at `base_from_sensor` that saw them while the base moved by `motion` a second.
    pub(super) fn rebuild(
        &mut self,
        features: &Features,
        base_from_sensor: &Se3,
        motion: Option<&nalgebra::Vector6<f64>>,
    ) {
        let mut last = (0.0_f32, *base_from_sensor);
        let mut place = |feature: &super::Feature| {
            if let Some(motion) = motion.filter(|_| feature.time != last.0) {
                let moved = Se3::exp(&(motion * f64::from(feature.time)));
                last = (feature.time, moved.compose(base_from_sensor));
            }
            last.1.act(&feature.position.cast())
        };
        // A time that is absurd puts a feature nowhere.
        let somewhere = |place: &Vector3<f64>| place.iter().all(|v| v.is_finite());
        self.edges.clear();
        self.edges.extend(features.edges.iter().map(&mut place).filter(somewhere));
        self.surfaces.clear();
        self.surfaces.extend(features.surfaces.iter().map(&mut place).filter(somewhere));
    }

    /// How many there are, and their mean distance from the base, in metres.
    pub(super) fn count_and_range(&self) -> (usize, f64) {
        let (count, all) = (self.edges.len() + self.surfaces.len(), self.edges.iter().chain(&self.surfaces));
        (count, all.map(nalgebra::Matrix::norm).sum::<f64>() / count.max(1) as f64)
    }
}
