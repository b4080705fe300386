//! Features of clouds without laser lines: by the spread of each point's neighbours.
//!
//! With the eigenvalues `λ0 <= λ1 <= λ2` of the neighbours' scatter, a surface has `λ0` much below `λ1`, an edge or a pole `λ1` much
//! below `λ2` (Weinmann et al., *Feature relevance assessment for the semantic interpretation of 3D point cloud data*, 2013).

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
    let [least, middle, greatest] = SymmetricEigen::new(&scatter).values.into();
    if middle < 0.1 * greatest {
        return Kind::Edge;
    }
    if least < 0.05 * middle { Kind::Surface } else { Kind::Neither }
}
