//! Features of clouds without laser lines: by the spread of each point's neighbours.
//!
//! With the eigenvalues `λ0 <= λ1 <= λ2` of the neighbours' scatter, a surface has `λ0` much below `λ1`, an edge or a pole `λ1` much
//! below `λ2`; a lone laser line looks like an edge, too, so what runs along the sweep is none (Weinmann et al., *Feature relevance assessment for the semantic interpretation of 3D point cloud data*, 2013).

use super::features::{Feature, FeatureParams, Features};
use crate::Error;
use crate::eigen::SymmetricEigen;
use crate::preprocess::{KdTree, Neighbour};
use agv_core::{
    compute::{CHUNK, Par},
    sensors::{PointCloud, PointSource, VoxelGrid},
};
use nalgebra::{Matrix3, Vector3};

/// Neighbours that are looked at, the point itself included.
const NEIGHBOURS: usize = 10;

/// Distance of the farthest neighbour, in leaves.
const REACH: f32 = 5.0;

/// Cosine of the angle to the sweep, below which a row of points is the sensor's doing and no edge.
const ALONG: f64 = 0.9;

/// Thinned clouds and their trees.
#[derive(Debug, Clone)]
pub(super) struct Neighbourhoods {
    grid: VoxelGrid,
    cropped: PointCloud,
    thinned: PointCloud,
    tree: KdTree,
    kinds: Vec<Kind>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Kind {
    #[default]
    Neither,
    Surface,
    Edge,
}

impl Neighbourhoods {
    pub(super) fn new(leaf: f32) -> Result<Self, Error> {
        Ok(Self {
            grid: VoxelGrid::new(leaf)?,
            cropped: PointCloud::default(),
            thinned: PointCloud::default(),
            tree: KdTree::default(),
            kinds: Vec::new(),
        })
    }

    pub(super) fn extract_into(
        &mut self,
        cloud: &PointCloud,
        params: &FeatureParams,
        par: Par,
        out: &mut Features,
    ) -> Result<(), Error> {
        self.cropped.copy_from(cloud);
        self.cropped.crop_range(params.min_range as f32, params.max_range as f32)?;
        self.grid.filter_into(&self.cropped, &mut self.thinned);
        self.tree.rebuild(&self.thinned);
        self.kinds.clear();
        self.kinds.resize(self.thinned.len(), Kind::Neither);
        let (tree, thinned, reach) = (&self.tree, &self.thinned, REACH * self.grid.leaf());
        par.for_each_chunk(self.kinds.as_mut_slice(), CHUNK, |chunk, kinds| {
            for (offset, kind) in kinds.iter_mut().enumerate() {
                *kind = kind_of(thinned, tree, &thinned.point(chunk * CHUNK + offset), reach);
            }
        });
        for (index, kind) in self.kinds.iter().enumerate() {
            let time = self.thinned.time().and_then(|time| time.get(index)).copied().unwrap_or(0.0);
            let feature = Feature { position: self.thinned.point(index), time };
            match kind {
                Kind::Surface if time.is_finite() => out.surfaces.push(feature),
                Kind::Edge if time.is_finite() => out.edges.push(feature),
                _ => {}
            }
        }
        Ok(())
    }
}

fn kind_of(cloud: &PointCloud, tree: &KdTree, at: &Vector3<f32>, reach: f32) -> Kind {
    let mut near = [Neighbour::default(); NEIGHBOURS];
    let count = tree.nearest_into(at, reach, &mut near);
    if count < NEIGHBOURS / 2 {
        return Kind::Neither;
    }
    let offset = |neighbour: &Neighbour| (cloud.point(neighbour.index as usize) - at).cast::<f64>();
    let mean = near[..count].iter().map(offset).sum::<Vector3<f64>>() / count as f64;
    let scatter: Matrix3<f64> =
        near[..count].iter().map(|n| offset(n) - mean).map(|d: Vector3<f64>| d * d.transpose()).sum();
    let eigen = SymmetricEigen::new(&scatter);
    let [least, middle, greatest] = eigen.values.into();
    if middle < 0.1 * greatest {
        // The ring that a beam draws on the floor goes where the sensor goes.
        let sweep = Vector3::z().cross(&at.cast::<f64>());
        let along = eigen.vectors.column(2).dot(&sweep).abs() > ALONG * sweep.norm();
        return if along { Kind::Neither } else { Kind::Edge };
    }
    if least < 0.05 * middle { Kind::Surface } else { Kind::Neither }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(points: impl Iterator<Item = Vector3<f32>>) -> Features {
        let (mut out, params) = (Features::default(), FeatureParams::default());
        let cloud = PointCloud::from_points(points);
        Neighbourhoods::new(0.3).unwrap().extract_into(&cloud, &params, Par::Seq, &mut out).unwrap();
        out
    }

    #[test]
    fn rings_on_a_floor_are_no_edges_and_a_pole_is_one() {
        // Rings that are farther apart than the neighbourhoods reach, as lines low over the horizon draw.
        let turn = |i: u16| f32::from(i) * std::f32::consts::TAU / 1800.0;
        let ring =
            |radius: f32| (0..1800).map(turn).map(move |a| Vector3::new(radius * a.cos(), radius * a.sin(), -1.7));
        let rings = features([10.0, 14.0, 20.0, 30.0, 45.0].into_iter().flat_map(ring));
        assert!(rings.edges.is_empty(), "{}", rings.edges.len());
        let pole = features((0..300_u16).map(|i| Vector3::new(8.0, 3.0, -1.5 + 0.01 * f32::from(i))));
        assert!(pole.edges.len() >= 8, "{}", pole.edges.len());
    }
}
