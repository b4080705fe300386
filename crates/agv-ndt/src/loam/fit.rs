//! The plane or the line through a few points of the map.

use crate::eigen::SymmetricEigen;
use nalgebra::{Matrix3, Vector3};

/// Points that a plane or line is laid through (LOAM's mapping).
pub(super) const POINTS: usize = 5;

/// What a feature is matched with: a place on it, and what it fixes of the feature's point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surface {
    /// Offset of the place from the point.
    pub(super) offset: Vector3<f64>,
    /// Projector onto the directions in which the distance counts: `n nᵀ` of a plane, `I - u uᵀ` of a line.
    pub(super) fixed: Matrix3<f64>,
    /// Normal of the plane, direction of the line.
    pub(super) direction: Vector3<f64>,
}

/// The plane through points given by their offsets; `None` if they lie on a line, or off any plane by more than `tolerance` metres.
pub(super) fn plane(offsets: &[Vector3<f32>; POINTS], tolerance: f64) -> Option<Surface> {
    let (mean, eigen) = spread(offsets);
    let flat = eigen.values[0] <= tolerance * tolerance * POINTS as f64;
    // Noise alone gives the points of one laser line about a hundredth.
    let wide = eigen.values[1] > 1e-9
        && eigen.values[1] >= 0.04 * eigen.values[2]
        && eigen.values[0] <= 0.25 * eigen.values[1];
    let direction = eigen.vectors.column(0).into_owned();
    (flat && wide).then(|| Surface { offset: mean, fixed: direction * direction.transpose(), direction })
}

/// The line through points given by their offsets; `None` if they do not lie on one, within `tolerance` metres.
pub(super) fn line(offsets: &[Vector3<f32>; POINTS], tolerance: f64) -> Option<Surface> {
    let (mean, eigen) = spread(offsets);
    let thin = eigen.values[1] <= tolerance * tolerance * POINTS as f64;
    // LOAM asks for three times.
    let long = eigen.values[2] > 3.0 * eigen.values[1] && eigen.values[2] > 0.0;
    let direction = eigen.vectors.column(2).into_owned();
    let fixed = Matrix3::identity() - direction * direction.transpose();
    (thin && long).then_some(Surface { offset: mean, fixed, direction })
}

fn spread(offsets: &[Vector3<f32>; POINTS]) -> (Vector3<f64>, SymmetricEigen) {
    let offsets = offsets.map(nalgebra::Matrix::cast::<f64>);
    let mean = offsets.iter().sum::<Vector3<f64>>() / POINTS as f64;
    let scatter: Matrix3<f64> = offsets.iter().map(|offset| offset - mean).map(|d| d * d.transpose()).sum();
    (mean, SymmetricEigen::new(&scatter))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(list: [[f32; 3]; POINTS]) -> [Vector3<f32>; POINTS] {
        list.map(Vector3::from)
    }

    #[test]
    fn planes_and_lines_are_told_apart() {
        let flat = points([[0.1, 0.0, 0.2], [-0.2, 0.1, 0.2], [0.0, -0.2, 0.2], [0.2, 0.2, 0.2], [-0.1, -0.2, 0.2]]);
        let surface = plane(&flat, 0.02).unwrap();
        assert!((surface.direction.z.abs() - 1.0).abs() < 1e-9 && (surface.offset.z - 0.2).abs() < 1e-6);
        assert!(line(&flat, 0.02).is_none());
        let thin = points([[0.0, 0.0, 0.1], [0.0, 0.0, 0.4], [0.0, 0.0, -0.2], [0.0, 0.0, 0.2], [0.0, 0.01, 0.0]]);
        let edge = line(&thin, 0.02).unwrap();
        assert!(edge.direction.z.abs() > 0.999 && plane(&thin, 0.02).is_none());
        assert!((edge.fixed * edge.direction).norm() < 1e-12);
        let scattered =
            points([[0.1, 0.2, 0.1], [-0.2, 0.1, 0.3], [0.3, -0.2, -0.2], [-0.1, -0.1, -0.3], [0.2, 0.1, 0.4]]);
        assert!(plane(&scattered, 0.02).is_none() && line(&scattered, 0.02).is_none());
        let heap = [Vector3::new(0.1, 0.1, 0.1); POINTS];
        assert!(plane(&heap, 0.02).is_none_or(|surface| surface.fixed.iter().all(|v| v.is_finite())));
        assert!(line(&heap, 0.02).is_none());
    }
}
