//! Normals of the surfaces that points lie on: the direction in which a point's neighbours spread least.

use super::kd_tree::{KdTree, MAX_NEIGHBOURS, Neighbour};
use crate::Error;
use crate::eigen::SymmetricEigen;
use agv_core::{
    check,
    compute::{CHUNK, Par},
    sensors::PointSource,
};
use nalgebra::{Matrix3, Vector3};

/// How normals are found.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NormalParams {
    /// Neighbours that are looked at, the point itself included: 4 to 32.
    pub neighbours: usize,
    /// Distance beyond which a point is no neighbour, in metres.
    pub radius: f32,
}

impl Default for NormalParams {
    /// Ten neighbours within 2 m: enough for a plane on a cloud that was thinned out to 0.25 m.
    fn default() -> Self {
        Self { neighbours: 10, radius: 2.0 }
    }
}

/// Fewest neighbours that make a surface.
const FEWEST: usize = 4;

impl NormalParams {
    pub(crate) fn validate(&self) -> Result<(), agv_core::Error> {
        check::in_range("neighbours", self.neighbours as f64, FEWEST as f64, MAX_NEIGHBOURS as f64)?;
        check::positive("radius", f64::from(self.radius))?;
        Ok(())
    }

    /// Writes the unit normal of each point of the cloud that `tree` was built of to `out`; zero where a point has too few
    /// neighbours or is not finite. The sign is arbitrary. O(n log n), parallel over points.
    ///
    /// # Errors
    /// Fewer neighbours than 4 or more than 32, a radius that is not positive, or a tree of a cloud of another length.
    pub fn estimate_into(
        &self,
        cloud: &(impl PointSource + ?Sized),
        tree: &KdTree,
        par: Par,
        out: &mut Vec<Vector3<f32>>,
    ) -> Result<(), Error> {
        self.validate()?;
        check::length("points of the tree's cloud", tree.source_len(), cloud.len())?;
        out.clear();
        out.resize(cloud.len(), Vector3::zeros());
        par.for_each_chunk(out.as_mut_slice(), CHUNK, |chunk, normals| {
            for (offset, normal) in normals.iter_mut().enumerate() {
                *normal = self.normal(cloud, tree, &cloud.point(chunk * CHUNK + offset));
            }
        });
        Ok(())
    }

    fn normal(&self, cloud: &(impl PointSource + ?Sized), tree: &KdTree, at: &Vector3<f32>) -> Vector3<f32> {
        let mut near = [Neighbour::default(); MAX_NEIGHBOURS];
        let count = tree.nearest_into(at, self.radius, &mut near[..self.neighbours]);
        if count < FEWEST {
            return Vector3::zeros();
        }
        let offset = |neighbour: &Neighbour| (cloud.point(neighbour.index as usize) - at).cast::<f64>();
        let mean = near[..count].iter().map(offset).sum::<Vector3<f64>>() / count as f64;
        let scatter: Matrix3<f64> =
            near[..count].iter().map(|n| offset(n) - mean).map(|d: Vector3<f64>| d * d.transpose()).sum();
        let eigen = SymmetricEigen::new(&scatter);
        // A line has no normal.
        if eigen.values[1] <= 1e-6 * eigen.values[2] {
            return Vector3::zeros();
        }
        eigen.vectors.column(0).map(|v| v as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::sensors::PointCloud;

    #[test]
    fn a_plane_has_its_normal_and_a_line_none() {
        let normal = Vector3::new(0.3, -0.5, 0.8_f32).normalize();
        let (a, b) = (normal.cross(&Vector3::x()).normalize(), normal.cross(&normal.cross(&Vector3::x()).normalize()));
        let plane = (0..100_u8).map(|i| a * f32::from(i % 10) * 0.2 + b * f32::from(i / 10) * 0.2);
        let line = (0..20_u8).map(|i| Vector3::new(50.0 + f32::from(i) * 0.1, 0.0, 0.0));
        let bad = [Vector3::repeat(f32::NAN), Vector3::repeat(-90.0)];
        let cloud = PointCloud::from_points(plane.chain(line).chain(bad));
        let mut tree = KdTree::default();
        tree.rebuild(&cloud);
        let (mut out, mut again) = (Vec::new(), Vec::new());
        NormalParams::default().estimate_into(&cloud, &tree, Par::Seq, &mut out).unwrap();
        NormalParams::default().estimate_into(&cloud, &tree, Par::threads(3), &mut again).unwrap();
        assert!(out[..100].iter().all(|n| n.dot(&normal).abs() > 0.9999));
        assert!(out[100..].iter().all(|n| *n == Vector3::zeros()));
        assert_eq!(out, again);
    }

    #[test]
    fn a_tree_of_another_cloud_is_refused() {
        let cloud = |len: u8| PointCloud::from_points((0..len).map(|i| Vector3::new(f32::from(i), 0.0, 0.0)));
        let (mut tree, mut out) = (KdTree::default(), vec![Vector3::x()]);
        for len in [0, 19, 21] {
            tree.rebuild(&cloud(len));
            assert!(NormalParams::default().estimate_into(&cloud(20), &tree, Par::Seq, &mut out).is_err(), "{len}");
            assert_eq!(out, [Vector3::x()]);
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = NormalParams::default();
        for bad in [
            NormalParams { neighbours: 3, ..good },
            NormalParams { neighbours: 33, ..good },
            NormalParams { radius: 0.0, ..good },
            NormalParams { radius: f32::NAN, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
