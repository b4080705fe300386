//! From a drawing to a file: SVG as it is, PNG drawn twice as large and averaged down, so that its edges are smooth.

use crate::{Error, input};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::{ExtendedColorType, ImageEncoder as _, RgbImage, codecs::png, imageops};
use plotters::{
    coord::Shift,
    drawing::IntoDrawingArea as _,
    prelude::{BitMapBackend, DrawingArea, DrawingBackend, SVGBackend},
    style::{FontStyle, RGBColor, register_font},
};
use std::{path::Path, sync::OnceLock};

/// Colour of the rectangle that stands for the raster in an SVG until it is put in; nothing else has it.
pub(super) const PLACEHOLDER: RGBColor = RGBColor(1, 2, 3);

/// How much larger a PNG is drawn than it is stored.
const OVERSAMPLING: u32 = 2;

/// Something that can be drawn at any scale.
pub(super) trait Picture {
    /// Width and height at scale 1, in pixels.
    fn size(&self) -> (u32, u32);

    /// The image that lies under the lines, where there is one; `scale` as in [`draw`](Self::draw).
    fn raster(&self, _scale: u32) -> Option<RgbImage> {
        None
    }

    /// Draws everything; lengths in pixels are multiplied by `scale`. The raster is blitted, or a rectangle of
    /// [`PLACEHOLDER`] is drawn in its place if it is none.
    fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        scale: u32,
        raster: Option<&RgbImage>,
    ) -> Result<(), String>;
}

/// Draws and writes; `.svg` gives SVG, any other name PNG.
pub(super) fn write(picture: &impl Picture, path: &Path) -> Result<(), Error> {
    static FONT: OnceLock<bool> = OnceLock::new();
    let fault = |reason: String| Error::file(path, format_args!("the picture could not be drawn: {reason}"));
    if !FONT.get_or_init(|| register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).is_ok()) {
        return Err(fault("the font is damaged".into()));
    }
    let bytes = if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("svg")) {
        svg(picture).map_err(fault)?.into_bytes()
    } else {
        png(picture).map_err(fault)?
    };
    input::write(path, &bytes)
}

fn svg(picture: &impl Picture) -> Result<String, String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, picture.size()).into_drawing_area();
    picture.draw(&area, 1, None)?;
    area.present().map_err(|error| error.to_string())?;
    drop(area);
    // Lines that turn back would else end in spikes.
    text = text.replacen("<svg ", "<svg stroke-linejoin=\"round\" ", 1);
    let Some(raster) = picture.raster(OVERSAMPLING) else { return Ok(text) };
    let link = format!("href=\"data:image/png;base64,{}\"", STANDARD.encode(encode(&raster)?));
    // <rect x= y= width= height= ... fill="#010203" .../> keeps its place and becomes the image.
    let colour = format!("fill=\"#{:02X}{:02X}{:02X}\"", PLACEHOLDER.0, PLACEHOLDER.1, PLACEHOLDER.2);
    if let Some(start) = text.find(&colour).and_then(|at| text[..at].rfind("<rect")) {
        text.replace_range(start..start + "<rect".len(), "<image preserveAspectRatio=\"none\"");
        text = text.replacen(&colour, &link, 1);
    }
    Ok(text)
}

fn png(picture: &impl Picture) -> Result<Vec<u8>, String> {
    let (width, height) = picture.size();
    let large = (width * OVERSAMPLING, height * OVERSAMPLING);
    let mut buffer = vec![255; large.0 as usize * large.1 as usize * 3];
    let area = BitMapBackend::with_buffer(&mut buffer, large).into_drawing_area();
    picture.draw(&area, OVERSAMPLING, picture.raster(OVERSAMPLING).as_ref())?;
    area.present().map_err(|error| error.to_string())?;
    drop(area);
    let large = RgbImage::from_raw(large.0, large.1, buffer).ok_or("the buffer is too small")?;
    encode(&imageops::resize(&large, width, height, imageops::FilterType::Triangle))
}

fn encode(image: &RgbImage) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    png::PngEncoder::new_with_quality(&mut bytes, png::CompressionType::Best, png::FilterType::Adaptive)
        .write_image(image, image.width(), image.height(), ExtendedColorType::Rgb8)
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}
