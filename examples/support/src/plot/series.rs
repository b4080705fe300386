//! Values over time, with axes.

use super::{
    Color,
    picture::{self, Picture},
};
use crate::Error;
use image::RgbImage;
use plotters::{
    chart::{ChartBuilder, SeriesLabelPosition},
    coord::Shift,
    element::{Circle, PathElement},
    prelude::{DrawingArea, DrawingBackend, LineSeries, WHITE},
    style::{Color as _, IntoFont as _, ShapeStyle},
};
use std::path::Path;

/// Name, colour and points of a curve.
type Curve = (String, Color, Vec<(f64, f64)>);

/// Curves over time, or over anything that grows.
///
/// ```
/// use agv_support::plot::{Color, TimeSeries};
///
/// let picture = std::env::temp_dir().join("agv-support-series.svg");
/// TimeSeries::new("Step response", "time [s]", "speed [m/s]")
///     .curve("measured", Color::Blue, (0..100).map(|i| (f64::from(i) * 0.1, 1.0 - (-f64::from(i) * 0.1).exp())))
///     .write(&picture)?;
/// # std::fs::remove_file(picture).ok();
/// # Ok::<(), agv_support::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct TimeSeries {
    title: String,
    axes: [String; 2],
    curves: Vec<Curve>,
}

impl TimeSeries {
    /// An empty diagram with the names of its axes, units included.
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Self { title: title.into(), axes: [x.into(), y.into()], curves: Vec::new() }
    }

    /// Adds a curve; points that are not finite are left out.
    #[must_use]
    pub fn curve(mut self, label: &str, color: Color, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        self.curves.push((label.to_owned(), color, points));
        self
    }

    /// Writes the picture: SVG if `path` ends in `.svg`, else PNG.
    ///
    /// # Errors
    /// The operating system's refusal.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), Error> {
        picture::write(self, path.as_ref())
    }

    /// Least and greatest value of one coordinate, widened so that there is a span.
    fn span(&self, of: impl Fn(&(f64, f64)) -> f64) -> (f64, f64) {
        let values = || self.curves.iter().flat_map(|(_, _, points)| points).map(&of);
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        match high - low {
            span if span.is_finite() && span > 0.0 => (low, high),
            _ if low.is_finite() && low.abs() < 1e100 => (low - 0.5, low + 0.5),
            _ => (0.0, 1.0),
        }
    }

    /// The corner in which the names of the curves hide the fewest points, the upper right one among equals; the box takes
    /// `size` as parts of the diagram, which spans `x` and `y`.
    fn legend_corner(&self, size: (f64, f64), (x0, x1): (f64, f64), (y0, y1): (f64, f64)) -> SeriesLabelPosition {
        let hidden = |is_right: bool, is_upper: bool| {
            let beyond = |part: f64, size: f64, is_high: bool| if is_high { part > 1.0 - size } else { part < size };
            let is_hidden = |(x, y): &&(f64, f64)| {
                beyond((x - x0) / (x1 - x0), size.0, is_right) && beyond((y - y0) / (y1 - y0), size.1, is_upper)
            };
            // Curves of many points are no more to be seen than those of few.
            let share =
                |points: &[(f64, f64)]| points.iter().filter(is_hidden).count() as f64 / points.len().max(1) as f64;
            self.curves.iter().map(|(_, _, points)| share(points)).sum::<f64>()
        };
        let corners = [
            (SeriesLabelPosition::UpperRight, hidden(true, true)),
            (SeriesLabelPosition::UpperLeft, hidden(false, true)),
            (SeriesLabelPosition::LowerRight, hidden(true, false)),
            (SeriesLabelPosition::LowerLeft, hidden(false, false)),
        ];
        let best = corners.into_iter().min_by(|(_, a), (_, b)| a.total_cmp(b));
        best.map_or(SeriesLabelPosition::UpperRight, |(corner, _)| corner)
    }
}

/// A number at a tick: no digits that say nothing (`1000`, not `1000.0`), no minus before a zero.
fn tick_label(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "0" | "-0" if value.abs() >= 1e-12 => format!("{value:e}"),
        "-0" => "0".to_owned(),
        _ => text.to_owned(),
    }
}

impl Picture for TimeSeries {
    fn size(&self) -> (u32, u32) {
        (1000, 420)
    }

    fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        scale: u32,
        _raster: Option<&RgbImage>,
    ) -> Result<(), String> {
        let text_of = |error: &dyn std::fmt::Display| error.to_string();
        let font = |size: u32| ("sans-serif", size * scale).into_font();
        let label = |value: &f64| tick_label(*value);
        area.fill(&WHITE).map_err(|error| text_of(&error))?;
        let ((x0, x1), (y0, y1)) = (self.span(|p| p.0), self.span(|p| p.1));
        let room = 0.06 * (y1 - y0);
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, font(18))
            .margin(12 * scale)
            // The last label is centred on the end of its axis.
            .margin_right(28 * scale)
            .x_label_area_size(42 * scale)
            .y_label_area_size(64 * scale)
            .build_cartesian_2d(x0..x1, y0 - room..y1 + room)
            .map_err(|error| text_of(&error))?;
        chart
            .configure_mesh()
            .x_desc(&self.axes[0])
            .y_desc(&self.axes[1])
            .x_label_formatter(&label)
            .y_label_formatter(&label)
            .label_style(font(13))
            .light_line_style(WHITE)
            .bold_line_style(Color::Grey.rgb().mix(0.25))
            .draw()
            .map_err(|error| text_of(&error))?;
        for (label, color, points) in &self.curves {
            let style = ShapeStyle::from(color.rgb()).stroke_width(2 * scale);
            let series = if scale < 2 {
                chart.draw_series(LineSeries::new(points.iter().copied(), style))
            } else {
                // Plotters mitres the joints of a thick line in a bitmap, into spikes where it turns back: piece by piece it has
                // none, and discs round the joints.
                let joints = points.iter().map(|point| Circle::new(*point, scale as i32, style.color.filled()));
                chart.draw_series(joints).map_err(|error| text_of(&error))?;
                chart.draw_series(points.windows(2).map(|pair| PathElement::new(pair.to_vec(), style)))
            };
            let series = series.map_err(|error| text_of(&error))?;
            if !label.is_empty() {
                let length = 20 * scale as i32;
                series.label(label).legend(move |(x, y)| PathElement::new([(x, y), (x + length, y)], style));
            }
        }
        let names: Vec<usize> =
            self.curves.iter().map(|(label, ..)| label.chars().count()).filter(|&n| n > 0).collect();
        if let Some(longest) = names.iter().max() {
            // About: a name of 14 pixels averages 8 a letter, beside its line and within the margins.
            let (width, height) = (*longest as f64 * 8.0 + 56.0, names.len() as f64 * 20.0 + 24.0);
            let size = (width / 896.0, height / 330.0);
            chart
                .configure_series_labels()
                .position(self.legend_corner(size, (x0, x1), (y0 - room, y1 + room)))
                .legend_area_size(26 * scale)
                .margin(8 * scale)
                .label_font(font(14))
                .background_style(WHITE.mix(0.85))
                .border_style(Color::Grey.rgb().mix(0.4))
                .draw()
                .map_err(|error| text_of(&error))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Scratch;

    #[test]
    fn ticks_say_no_more_than_they_must() {
        let ticks = [(1000.0, "1000"), (0.25, "0.25"), (-0.0, "0"), (-1e-17, "0"), (0.1 + 0.2, "0.3"), (2e-8, "2e-8")];
        for (value, label) in ticks {
            assert_eq!(tick_label(value), label);
        }
    }

    #[test]
    fn names_stand_where_no_curve_is() {
        let corner = |points: &[(f64, f64)]| {
            let series = TimeSeries::new("", "", "").curve("x", Color::Blue, points.iter().copied());
            format!("{:?}", series.legend_corner((0.3, 0.3), (0.0, 1.0), (0.0, 1.0)))
        };
        assert_eq!(corner(&[]), "UpperRight");
        assert_eq!(corner(&[(0.0, 0.0), (0.5, 0.5), (1.0, 1.0)]), "UpperLeft");
        assert_eq!(corner(&[(0.1, 0.9), (0.9, 0.9)]), "LowerRight");
        assert_eq!(corner(&[(0.1, 0.9), (0.9, 0.9), (0.9, 0.1)]), "LowerLeft");
    }

    #[test]
    fn curves_are_drawn_and_odd_values_do_no_harm() {
        let scratch = Scratch::new("series");
        for (name, points) in [
            ("good", vec![(0.0, 1.0), (1.0, 2.0), (2.0, -1.0)]),
            ("empty", vec![]),
            ("one", vec![(3.0, 3.0)]),
            ("odd", vec![(0.0, f64::NAN), (f64::INFINITY, 1.0), (1.0, 1.0), (2.0, 1.0)]),
        ] {
            let series = TimeSeries::new(name, "t [s]", "x [m]").curve("x", Color::Blue, points);
            for kind in ["png", "svg"] {
                series.write(scratch.path(&format!("{name}.{kind}"))).unwrap();
            }
        }
        let image = image::open(scratch.path("good.png")).unwrap().into_rgb8();
        let blue = |p: &&image::Rgb<u8>| p.0[0] < 40 && p.0[2] > 150;
        assert!(image.pixels().filter(blue).count() > 200);
        assert!(std::fs::read_to_string(scratch.path("good.svg")).unwrap().contains("t [s]"));
    }
}
