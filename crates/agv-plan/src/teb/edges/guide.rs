//! Wishes: points to pass, and a side to turn to.

use super::{BandEdge, Residuals, Term, Window};
use nalgebra::Vector2;

/// A pose should be near a point: `√w (x - point)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViaPoint {
    /// The point, in the map.
    pub point: Vector2<f64>,
    /// Weight, in 1/m².
    pub weight: f64,
}

impl BandEdge<3> for ViaPoint {
    #[inline]
    fn residuals(&self, window: &Window<3>, out: &mut impl Residuals) {
        let root = self.weight.sqrt();
        out.add(root * (window.unknowns[0] - self.point.x), &[root, 0.0, 0.0]);
        out.add(root * (window.unknowns[1] - self.point.y), &[0.0, root, 0.0]);
    }
}

/// The vehicle should not turn to the other side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    /// 1 to turn left, -1 to turn right.
    pub side: f64,
    /// Weight, in 1/rad².
    pub weight: f64,
}

impl BandEdge<7> for Rotation {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let (side, turn) = (self.side, window.unknowns[6] - window.unknowns[2]);
        let gradient = [0.0, 0.0, side, 0.0, 0.0, 0.0, -side];
        Term { value: -side * turn, gradient }.at_most(0.0, self.weight.sqrt(), out);
    }
}
