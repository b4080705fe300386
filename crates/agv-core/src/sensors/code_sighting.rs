//! A QR code as a decoder finds it in an image.

use nalgebra::Vector2;

/// A QR code in an image: its number, if it could be read, and the centres of its three finder patterns.
///
/// The big squares survive dirt and scratches that the data do not: a damaged code is often still found, without being
/// read.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CodeSighting {
    /// What was read; none for a code that is damaged.
    pub id: Option<u32>,
    /// Centres of the finder patterns in pixels, as the upright code has them: top left (the corner of the right angle), top
    /// right, bottom left.
    pub finders: [Vector2<f64>; 3],
}
