//! What lies under the lines of a scene, pixel by pixel: the map in greys, clouds coloured by height.

use super::Color;
use agv_core::{
    grid::{CellState, Grid},
    nalgebra::Vector2,
    sensors::PointCloud,
};
use image::{Rgb, RgbImage};
use plotters::style::RGBColor;

/// A rectangle of the map frame, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    pub(super) min: Vector2<f64>,
    pub(super) max: Vector2<f64>,
}

impl Bounds {
    /// The least rectangle around the finite points; none if there are none.
    pub(super) fn around(points: impl Iterator<Item = Vector2<f64>>) -> Option<Self> {
        points.filter(|p| p.x.is_finite() && p.y.is_finite()).fold(None, |bounds: Option<Self>, p| {
            Some(bounds.map_or(Self { min: p, max: p }, |b| Self { min: b.min.inf(&p), max: b.max.sup(&p) }))
        })
    }

    pub(super) fn size(&self) -> Vector2<f64> {
        self.max - self.min
    }
}

/// Nearly white, light grey, nearly black: free, unknown, occupied. Lines in colour stand out on all three.
fn shade(state: CellState) -> Rgb<u8> {
    match state {
        CellState::Free => Rgb([253, 253, 253]),
        CellState::Unknown => Rgb([222, 225, 229]),
        CellState::Occupied => Rgb([38, 42, 48]),
    }
}

/// Draws the map's part inside `bounds`; outside the map is unknown.
pub(super) fn draw_map(image: &mut RgbImage, bounds: &Bounds, map: &Grid<CellState>) {
    for_each_pixel(image, bounds, |point, pixel| {
        let cell = map.layout().cell_at(&point);
        *pixel = shade(cell.and_then(|cell| map.get(cell)).copied().unwrap_or_default());
    });
}

/// Calls `paint` with each pixel and the point of the map frame at its centre.
fn for_each_pixel(image: &mut RgbImage, bounds: &Bounds, mut paint: impl FnMut(Vector2<f64>, &mut Rgb<u8>)) {
    let (width, height) = image.dimensions();
    let (size, top) = (bounds.size(), bounds.max.y);
    for (column, row, pixel) in image.enumerate_pixels_mut() {
        let x = bounds.min.x + (f64::from(column) + 0.5) / f64::from(width) * size.x;
        let y = top - (f64::from(row) + 0.5) / f64::from(height) * size.y;
        paint(Vector2::new(x, y), pixel);
    }
}

/// Tints the cells inside `bounds` that are true, by a third.
pub(super) fn draw_cells(image: &mut RgbImage, bounds: &Bounds, cells: &Grid<bool>, color: Color) {
    let RGBColor(r, g, b) = color.rgb();
    for_each_pixel(image, bounds, |point, pixel| {
        let cell = cells.layout().cell_at(&point);
        if cell.and_then(|cell| cells.get(cell)) == Some(&true) {
            for (below, above) in pixel.0.iter_mut().zip([r, g, b]) {
                *below = ((2 * u16::from(*below) + u16::from(above)) / 3) as u8;
            }
        }
    });
}

/// Draws the points from above, coloured by height from the 2nd to the 98th percentile, higher ones over lower ones.
pub(super) fn draw_cloud(image: &mut RgbImage, bounds: &Bounds, cloud: &PointCloud) {
    let mut points: Vec<_> = cloud.points().filter(|p| p.iter().all(|v| v.is_finite())).collect();
    points.sort_by(|a, b| a.z.total_cmp(&b.z));
    let height_at = |percent: usize| points.get(points.len() * percent / 100).map_or(0.0, |p| p.z);
    let (low, high) = (height_at(2), height_at(98));
    let (width, height) = image.dimensions();
    for point in &points {
        let column = (f64::from(point.x) - bounds.min.x) / bounds.size().x * f64::from(width);
        let row = (bounds.max.y - f64::from(point.y)) / bounds.size().y * f64::from(height);
        let colour = ramp(f64::from((point.z - low) / (high - low).max(1e-6)));
        // Two by two pixels of the oversampled image are one of the picture; the cast saturates below zero.
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (x, y) = (column as i64 + dx, row as i64 + dy);
            if (0..i64::from(width)).contains(&x) && (0..i64::from(height)).contains(&y) {
                image.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
}

/// Dark blue over green to yellow, of even lightness steps (five knots of matplotlib's viridis).
fn ramp(t: f64) -> Rgb<u8> {
    const KNOTS: [[f64; 3]; 5] =
        [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [235.0, 210.0, 40.0]];
    let t = t.clamp(0.0, 1.0) * 4.0;
    let at = (t as usize).min(3);
    let mix = |channel: usize| KNOTS[at][channel] + (KNOTS[at + 1][channel] - KNOTS[at][channel]) * (t - at as f64);
    Rgb([mix(0) as u8, mix(1) as u8, mix(2) as u8])
}
