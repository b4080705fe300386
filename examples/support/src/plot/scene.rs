//! A floor seen from above: map, clouds, trajectories, particles and marks, with a legend and a scale bar.

use super::{
    Color,
    picture::{self, PLACEHOLDER, Picture},
    raster::{Bounds, draw_cells, draw_cloud, draw_map},
};
use crate::Error;
use agv_core::{
    geometry::Se2,
    grid::{CellState, Grid},
    nalgebra::Vector2,
    sensors::PointCloud,
};
use image::RgbImage;
use plotters::{
    coord::Shift,
    element::{BitMapElement, Circle, PathElement, Rectangle},
    prelude::{DrawingArea, DrawingBackend, Text, WHITE},
    style::{Color as _, IntoFont as _, RGBColor, ShapeStyle, TextStyle},
};
use std::path::Path;

/// Pixels around the drawing, of the title, and of the strip with scale bar and legend.
const MARGIN: f64 = 16.0;
const TITLE: f64 = 38.0;
const STRIP: f64 = 40.0;

#[derive(Debug, Clone, PartialEq)]
enum Layer {
    Line(Vec<Vector2<f64>>),
    Particles(Vec<Se2>),
    Mark(Vector2<f64>),
    Cells(Grid<bool>),
}

/// A floor seen from above; what is added later lies over what was added before.
///
/// Points that are not finite are left out, and a map is cut to the part that was observed.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_support::plot::{Color, Scene};
///
/// let route = [Vector2::new(0.0, 0.0), Vector2::new(4.0, 1.0), Vector2::new(8.0, 0.0)];
/// let picture = std::env::temp_dir().join("agv-support-scene.png");
/// Scene::new("A route").line("planned", Color::Blue, route).write(&picture)?;
/// # std::fs::remove_file(picture).ok();
/// # Ok::<(), agv_support::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    title: String,
    width: u32,
    map: Option<Grid<CellState>>,
    clouds: Vec<PointCloud>,
    layers: Vec<(String, Color, Layer)>,
}

impl Scene {
    /// An empty scene, 1200 pixels wide.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), width: 1200, map: None, clouds: Vec::new(), layers: Vec::new() }
    }

    /// The same scene, `pixels` wide (200 to 8000).
    #[must_use]
    pub fn width(mut self, pixels: u32) -> Self {
        self.width = pixels.clamp(200, 8000);
        self
    }

    /// Adds the map, in greys.
    #[must_use]
    pub fn map(mut self, map: &Grid<CellState>) -> Self {
        self.map = Some(map.clone());
        self
    }

    /// Adds a cloud from above, coloured by height.
    #[must_use]
    pub fn cloud(mut self, cloud: &PointCloud) -> Self {
        self.clouds.push(cloud.clone());
        self
    }

    /// Adds a line through points in the map frame, in metres.
    #[must_use]
    pub fn line(self, label: &str, color: Color, points: impl IntoIterator<Item = Vector2<f64>>) -> Self {
        self.layer(label, color, Layer::Line(points.into_iter().collect()))
    }

    /// Adds the line through the positions of poses.
    #[must_use]
    pub fn trajectory<'a>(self, label: &str, color: Color, poses: impl IntoIterator<Item = &'a Se2>) -> Self {
        self.line(label, color, poses.into_iter().map(Se2::translation))
    }

    /// Adds poses as short strokes along their heading.
    #[must_use]
    pub fn particles<'a>(self, label: &str, color: Color, poses: impl IntoIterator<Item = &'a Se2>) -> Self {
        self.layer(label, color, Layer::Particles(poses.into_iter().copied().collect()))
    }

    /// Adds a mark at a point of the map frame, in metres.
    #[must_use]
    pub fn mark(self, label: &str, color: Color, point: Vector2<f64>) -> Self {
        self.layer(label, color, Layer::Mark(point))
    }

    /// Tints the cells that are true, under all lines.
    #[must_use]
    pub fn cells(self, label: &str, color: Color, cells: &Grid<bool>) -> Self {
        self.layer(label, color, Layer::Cells(cells.clone()))
    }

    fn tinted(&self) -> impl Iterator<Item = (Color, &Grid<bool>)> {
        self.layers.iter().filter_map(|(_, color, layer)| match layer {
            Layer::Cells(cells) => Some((*color, cells)),
            _ => None,
        })
    }

    fn layer(mut self, label: &str, color: Color, layer: Layer) -> Self {
        self.layers.push((label.to_owned(), color, layer));
        self
    }

    /// Writes the picture: SVG if `path` ends in `.svg`, else PNG.
    ///
    /// # Errors
    /// The operating system's refusal.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), Error> {
        picture::write(self, path.as_ref())
    }

    /// What must be in sight, and a margin; never empty.
    fn bounds(&self) -> Bounds {
        let known = self.map.iter().flat_map(|map| {
            let layout = map.layout();
            let seen = map.values().iter().enumerate().filter(|(_, state)| **state != CellState::Unknown);
            seen.map(|(index, _)| layout.center(layout.cell(index)))
        });
        let clouds = self.clouds.iter().flat_map(PointCloud::points);
        let lines = self.layers.iter().flat_map(|(_, _, layer)| match layer {
            Layer::Line(points) => points.clone(),
            Layer::Particles(poses) => poses.iter().map(Se2::translation).collect(),
            Layer::Mark(point) => vec![*point],
            // They lie on the map.
            Layer::Cells(_) => Vec::new(),
        });
        let all = known.chain(clouds.map(|p| Vector2::new(f64::from(p.x), f64::from(p.y)))).chain(lines);
        let bounds = Bounds::around(all).unwrap_or(Bounds { min: Vector2::zeros(), max: Vector2::zeros() });
        // Also keeps a straight line from being a picture without height.
        let margin = Vector2::repeat(0.02 * bounds.size().max() + 0.25);
        let slim = (Vector2::repeat(0.2 * bounds.size().max()) - bounds.size()).sup(&Vector2::zeros()) / 2.0;
        Bounds { min: bounds.min - margin - slim, max: bounds.max + margin + slim }
    }

    /// Bounds, and the pixels per metre at scale 1: as wide as asked, at most 1.5 times as high as wide.
    fn view(&self) -> (Bounds, f64) {
        let bounds = self.bounds();
        let inner = f64::from(self.width) - 2.0 * MARGIN;
        (bounds, (inner / bounds.size().x).min(1.5 * inner / bounds.size().y))
    }
}

impl Picture for Scene {
    fn size(&self) -> (u32, u32) {
        let (bounds, ratio) = self.view();
        (self.width, (bounds.size().y * ratio + TITLE + STRIP + MARGIN).ceil() as u32)
    }

    fn raster(&self, scale: u32) -> Option<RgbImage> {
        if self.map.is_none() && self.clouds.is_empty() {
            return None;
        }
        let (bounds, ratio) = self.view();
        let size = bounds.size() * ratio * f64::from(scale);
        let mut image = RgbImage::from_pixel(size.x.ceil() as u32, size.y.ceil() as u32, image::Rgb([255; 3]));
        if let Some(map) = &self.map {
            draw_map(&mut image, &bounds, map);
        }
        for (color, cells) in self.tinted() {
            draw_cells(&mut image, &bounds, cells, color);
        }
        for cloud in &self.clouds {
            draw_cloud(&mut image, &bounds, cloud);
        }
        Some(image)
    }

    fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        scale: u32,
        raster: Option<&RgbImage>,
    ) -> Result<(), String> {
        let (bounds, ratio) = self.view();
        let scale = f64::from(scale);
        let px = |length: f64| (length * scale).round() as i32;
        let drawn = bounds.size() * ratio;
        let left = (f64::from(self.width) - drawn.x) / 2.0;
        let to_pixel =
            |p: &Vector2<f64>| (px(left + (p.x - bounds.min.x) * ratio), px(TITLE + (bounds.max.y - p.y) * ratio));
        let frame = [(px(left), px(TITLE)), (px(left + drawn.x), px(TITLE + drawn.y))];
        let pen = Pen { area, scale };
        area.fill(&WHITE).map_err(text_of)?;

        match raster {
            Some(image) => {
                let element = BitMapElement::with_ref(frame[0], image.dimensions(), image.as_raw());
                area.draw(&element.ok_or("the raster has no size")?).map_err(text_of)?;
            }
            None if self.map.is_some() || !self.clouds.is_empty() => {
                area.draw(&Rectangle::new(frame, PLACEHOLDER.filled())).map_err(text_of)?;
            }
            None => {}
        }
        for (_, color, layer) in &self.layers {
            let color = color.rgb();
            match layer {
                Layer::Line(points) => {
                    // A point that is not finite parts the line.
                    for part in points.split(|p| !(p.x.is_finite() && p.y.is_finite())) {
                        pen.line(thinned(part.iter().map(to_pixel)), color, 2.2)?;
                    }
                }
                Layer::Particles(poses) => {
                    let length = 7.0 / ratio;
                    for pose in poses.iter().filter(|pose| pose.x().is_finite() && pose.y().is_finite()) {
                        let tip = *pose * Vector2::new(length, 0.0);
                        pen.line(vec![to_pixel(&pose.translation()), to_pixel(&tip)], color, 1.2)?;
                        pen.dot(to_pixel(&pose.translation()), color, 1.6)?;
                    }
                }
                Layer::Mark(point) if point.x.is_finite() && point.y.is_finite() => {
                    pen.dot(to_pixel(point), WHITE, 7.5)?;
                    pen.dot(to_pixel(point), color, 5.5)?;
                }
                Layer::Mark(_) | Layer::Cells(_) => {}
            }
        }

        area.draw(&Rectangle::new(frame, RGBColor(150, 154, 160).stroke_width(px(1.0) as u32))).map_err(text_of)?;
        pen.text(&self.title, (px(left), px(9.0)), 20.0)?;
        let strip = TITLE + drawn.y + STRIP / 2.0;
        let after = self.scale_bar(&pen, left, strip, ratio)?;
        self.legend(&pen, after, strip)
    }
}

impl Scene {
    /// A bar of 1, 2 or 5 times a power of ten, about a seventh of the width. Returns where it ends.
    fn scale_bar<B: DrawingBackend>(&self, pen: &Pen<'_, B>, x: f64, y: f64, ratio: f64) -> Result<f64, String> {
        let wanted = f64::from(self.width) / 7.0 / ratio;
        let power = 10_f64.powf(wanted.log10().floor());
        let length = [5.0, 2.0, 1.0].into_iter().map(|digit| digit * power).find(|&l| l <= wanted).unwrap_or(power);
        let end = x + length * ratio;
        for (from, to) in [((x, y), (end, y)), ((x, y - 5.0), (x, y + 5.0)), ((end, y - 5.0), (end, y + 5.0))] {
            pen.line(vec![pen.at(from), pen.at(to)], Color::Black.rgb(), 2.0)?;
        }
        let label = format!("{length} m");
        pen.text(&label, pen.at((end + 8.0, y - 8.0)), 15.0)?;
        Ok(end + 8.0 + text_width(&label) + 28.0)
    }

    /// The names of the layers, each with its colour, from `x` to the right as far as they fit.
    fn legend<B: DrawingBackend>(&self, pen: &Pen<'_, B>, mut x: f64, y: f64) -> Result<(), String> {
        let drawn = |layer: &Layer| match layer {
            Layer::Line(points) => !points.is_empty(),
            Layer::Particles(poses) => !poses.is_empty(),
            Layer::Mark(_) => true,
            Layer::Cells(cells) => cells.values().contains(&true),
        };
        for (label, color, layer) in self.layers.iter().filter(|(label, _, layer)| !label.is_empty() && drawn(layer)) {
            if x + 30.0 + text_width(label) > f64::from(self.width) {
                break;
            }
            match layer {
                Layer::Line(_) => pen.line(vec![pen.at((x, y)), pen.at((x + 22.0, y))], color.rgb(), 3.0)?,
                _ => pen.dot(pen.at((x + 14.0, y)), color.rgb(), 5.0)?,
            }
            pen.text(label, pen.at((x + 28.0, y - 8.0)), 15.0)?;
            x += 28.0 + text_width(label) + 24.0;
        }
        Ok(())
    }
}

/// Draws with lengths in pixels at scale 1.
struct Pen<'a, B: DrawingBackend> {
    area: &'a DrawingArea<B, Shift>,
    scale: f64,
}

impl<B: DrawingBackend> Pen<'_, B> {
    fn at(&self, (x, y): (f64, f64)) -> (i32, i32) {
        ((x * self.scale).round() as i32, (y * self.scale).round() as i32)
    }

    fn line(&self, points: Vec<(i32, i32)>, color: RGBColor, width: f64) -> Result<(), String> {
        let width = (width * self.scale).round() as u32;
        let style = ShapeStyle::from(color).stroke_width(width);
        if self.scale < 1.5 {
            return self.area.draw(&PathElement::new(points, style)).map_err(text_of);
        }
        // Plotters fills a thick line in a bitmap as one even-odd polygon, which has holes where the line runs back over
        // itself: piece by piece it has none, and discs round the joints.
        for pair in points.windows(2) {
            self.area.draw(&PathElement::new(pair.to_vec(), style)).map_err(text_of)?;
        }
        for point in points.iter().skip(1).take(points.len().saturating_sub(2)) {
            self.area.draw(&Circle::new(*point, width as i32 / 2, color.filled())).map_err(text_of)?;
        }
        Ok(())
    }

    fn dot(&self, center: (i32, i32), color: RGBColor, radius: f64) -> Result<(), String> {
        self.area.draw(&Circle::new(center, (radius * self.scale).round() as i32, color.filled())).map_err(text_of)
    }

    fn text(&self, text: &str, at: (i32, i32), size: f64) -> Result<(), String> {
        let color = Color::Black.rgb();
        let style = TextStyle::from(("sans-serif", size * self.scale).into_font()).color(&color);
        self.area.draw(&Text::new(text, at, style)).map_err(text_of)
    }
}

/// Leaves out points that fall on the pixel before them.
fn thinned(pixels: impl Iterator<Item = (i32, i32)>) -> Vec<(i32, i32)> {
    let mut points: Vec<_> = pixels.collect();
    points.dedup();
    points
}

/// Width of a label of 15 pixels, about: `DejaVu Sans` averages 0.6 of its height.
fn text_width(label: &str) -> f64 {
    label.chars().count() as f64 * 8.6
}

fn text_of(error: impl std::fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Scratch;
    use agv_core::{
        grid::{Cell, GridLayout},
        nalgebra::Vector3,
    };

    fn map() -> Grid<CellState> {
        let layout = GridLayout::new(40, 20, 0.5, Se2::new(-5.0, -3.0, 0.3)).unwrap();
        let mut map = Grid::filled(layout, CellState::Free);
        for x in 0..40 {
            map.set(Cell::new(x, 0), CellState::Occupied);
        }
        map
    }

    #[test]
    fn walls_lines_and_paper_have_their_colours() {
        let scratch = Scratch::new("scene");
        let line =
            [Vector2::new(0.0, 0.0), Vector2::new(f64::NAN, 1.0), Vector2::new(1.0, 2.0), Vector2::new(5.0, 2.0)];
        let scene = Scene::new("Test").width(600).map(&map()).line("a", Color::Blue, line);
        let scene = scene.cells("seen", Color::Green, &Grid::filled(*map().layout(), true));
        scene.mark("goal", Color::Red, Vector2::new(3.0, 3.0)).write(scratch.path("a.png")).unwrap();
        let image = image::open(scratch.path("a.png")).unwrap().into_rgb8();
        assert_eq!(image.width(), 600);
        let green = Color::Green.rgb();
        let mix = |below: u8, above: u8| ((2 * u16::from(below) + u16::from(above)) / 3) as u8;
        let tint = |r, g, b| RGBColor(mix(r, green.0), mix(g, green.1), mix(b, green.2));
        for wanted in [Color::Blue.rgb(), Color::Red.rgb(), tint(38, 42, 48), RGBColor(222, 225, 229)] {
            let close =
                |p: &&image::Rgb<u8>| p.0.iter().zip([wanted.0, wanted.1, wanted.2]).all(|(a, b)| a.abs_diff(b) < 6);
            assert!(image.pixels().filter(close).count() > 20, "{wanted:?}");
        }
    }

    #[test]
    fn svg_carries_the_map_as_an_image() {
        let scratch = Scratch::new("scene-svg");
        let poses = [Se2::new(0.0, 0.0, 1.0), Se2::new(f64::NAN, 0.0, 0.0)];
        Scene::new("T").map(&map()).particles("p", Color::Green, &poses).write(scratch.path("a.svg")).unwrap();
        let text = std::fs::read_to_string(scratch.path("a.svg")).unwrap();
        assert!(text.contains("<image") && text.contains("base64,") && !text.contains("#010203"));
        assert!(text.len() < 200_000 && !text.contains("NaN"));
    }

    #[test]
    fn nothing_and_very_little_can_be_drawn() {
        let scratch = Scratch::new("scene-empty");
        let cloud = PointCloud::from_points([Vector3::new(1.0_f32, 2.0, 3.0), Vector3::new(f32::NAN, 0.0, 0.0)]);
        for scene in [
            Scene::new(""),
            Scene::new("x").line("", Color::Sky, [Vector2::zeros()]),
            Scene::new("x").cloud(&cloud),
            Scene::new("x").cloud(&PointCloud::default()),
        ] {
            scene.write(scratch.path("a.png")).unwrap();
            scene.write(scratch.path("a.svg")).unwrap();
        }
    }
}
