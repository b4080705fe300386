//! Pictures: a [`Scene`] seen from above, and [`TimeSeries`] over time; as PNG or SVG by the file's name.

mod picture;
mod raster;
mod scene;
mod series;

pub use scene::Scene;
pub use series::TimeSeries;

use agv_core::nalgebra::Vector2;
use plotters::style::RGBColor;
use std::f64::consts::TAU;

/// Colours that people with any colour vision tell apart (M. Okabe and K. Ito, *Color Universal Design*, 2008).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Color {
    Blue,
    Orange,
    Green,
    Red,
    Purple,
    Sky,
    Black,
    Grey,
}

impl Color {
    pub(crate) const fn rgb(self) -> RGBColor {
        match self {
            Self::Blue => RGBColor(0, 114, 178),
            Self::Orange => RGBColor(230, 159, 0),
            Self::Green => RGBColor(0, 158, 115),
            Self::Red => RGBColor(213, 94, 0),
            Self::Purple => RGBColor(204, 121, 167),
            Self::Sky => RGBColor(86, 180, 233),
            Self::Black => RGBColor(30, 30, 30),
            Self::Grey => RGBColor(120, 124, 130),
        }
    }
}

/// A circle as a closed line of 24 pieces.
pub fn circle(center: &Vector2<f64>, radius: f64) -> impl Iterator<Item = Vector2<f64>> + use<> {
    let center = *center;
    (0..=24).map(move |k| {
        let (sin, cos) = (f64::from(k) / 24.0 * TAU).sin_cos();
        center + radius * Vector2::new(cos, sin)
    })
}
