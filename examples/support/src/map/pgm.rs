//! Images of maps: PGM (`P2` text and `P5` binary, 8 or 16 bits) and PNG.

use crate::{Error, Input};
use agv_core::grid::GridLayout;

/// A grey image, row by row from the top.
#[derive(Debug, PartialEq)]
pub(super) struct Image {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) maxval: u16,
    pub(super) pixels: Vec<u16>,
}

/// Decodes by content.
pub(super) fn decode(input: &Input) -> Result<Image, Error> {
    match input.bytes() {
        [b'P', b'2' | b'5', ..] => decode_pgm(input),
        [0x89, b'P', b'N', b'G', ..] => decode_png(input),
        _ => Err(input.byte_error(0, "neither PGM (P2, P5) nor PNG")),
    }
}

fn decode_pgm(input: &Input) -> Result<Image, Error> {
    let bytes = input.bytes();
    let mut header = Tokens { input, at: 2 };
    let mut field = |name, max| header.number(name, max);
    let (width, height) = (field("width", 1 << 20)?, field("height", 1 << 20)?);
    let maxval = field("maxval", u32::from(u16::MAX))? as u16;
    let (width, height, start) = (width as usize, height as usize, header.at);
    let count = width * height;
    if count == 0 || count > GridLayout::MAX_CELLS || maxval == 0 {
        return Err(input.byte_error(start, format_args!("an image of {width} x {height}, maxval {maxval}")));
    }
    let pixels = if bytes[1] == b'2' {
        // At least a digit and a blank per pixel: the header alone allocates nothing.
        if count > bytes.len() {
            return Err(input.byte_error(bytes.len(), format_args!("{width} x {height} pixels claimed, the file ends")));
        }
        (0..count)
            .map(|_| header.number("pixel", u32::from(maxval)).map(|v| v as u16))
            .collect::<Result<Vec<_>, _>>()?
    } else {
        // One blank after the header; what follows the pixels is ignored, as other readers do.
        let size = if maxval < 256 { 1 } else { 2 };
        let data = bytes.get(start + 1..).unwrap_or_default();
        let Some(data) = data.get(..count * size) else {
            let reason = format!("{width} x {height} pixels need {} bytes, {} are there", count * size, data.len());
            return Err(input.byte_error(bytes.len(), reason));
        };
        if size == 1 {
            data.iter().map(|&v| u16::from(v).min(maxval)).collect()
        } else {
            data.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]).min(maxval)).collect()
        }
    };
    Ok(Image { width, height, maxval, pixels })
}

/// Reads numbers between blanks and `#` comments.
struct Tokens<'a> {
    input: &'a Input,
    at: usize,
}

impl Tokens<'_> {
    fn number(&mut self, name: &str, max: u32) -> Result<u32, Error> {
        let bytes = self.input.bytes();
        while let Some(&byte) = bytes.get(self.at) {
            if byte == b'#' {
                self.at += bytes[self.at..].iter().take_while(|&&b| b != b'\n').count();
            } else if byte.is_ascii_whitespace() {
                self.at += 1;
            } else {
                break;
            }
        }
        let start = self.at;
        let mut value = 0_u32;
        while let Some(digit) = bytes.get(self.at).filter(|byte| byte.is_ascii_digit()) {
            value = value.saturating_mul(10).saturating_add(u32::from(digit - b'0'));
            self.at += 1;
        }
        match value {
            _ if self.at == start => Err(self.input.byte_error(start, format_args!("{name} is missing"))),
            _ if value > max => Err(self.input.byte_error(start, format_args!("{name} is {value}, at most {max}"))),
            _ => Ok(value),
        }
    }
}

fn decode_png(input: &Input) -> Result<Image, Error> {
    let mut reader = image::ImageReader::with_format(std::io::Cursor::new(input.bytes()), image::ImageFormat::Png);
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(1 << 30);
    reader.limits(limits);
    let image = reader.decode().map_err(|error| input.file_error(error))?.into_luma8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let pixels = image.into_raw().into_iter().map(u16::from).collect();
    Ok(Image { width, height, maxval: 255, pixels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::survives_damage;

    fn parse(bytes: &[u8]) -> Result<Image, Error> {
        decode(&Input::new("m.pgm", bytes))
    }

    #[test]
    fn all_kinds_give_the_same_image() {
        let expected = Image { width: 2, height: 2, maxval: 200, pixels: vec![0, 50, 100, 200] };
        assert_eq!(parse(b"P2 # c\n#c\n2 2\n200\n0 50\n100 200\n").unwrap(), expected);
        assert_eq!(parse(b"P5\n# CREATOR: x 1 2\n2 2\n200\n\x00\x32\x64\xc8\n").unwrap(), expected);
        let wide = parse(b"P5 1 2 1000 \x03\xe8\x00\x05").unwrap();
        assert_eq!(wide.pixels, [1000, 5]);
        let mut png = Vec::new();
        let grey = image::GrayImage::from_raw(2, 1, vec![7, 255]).unwrap();
        grey.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
        assert_eq!(parse(&png).unwrap().pixels, [7, 255]);
    }

    #[test]
    fn faults_name_the_byte() {
        for (bytes, reason) in [
            (&b"P6 1 1 255 "[..], "byte 0: neither PGM"),
            (b"", "byte 0: neither"),
            (b"P5 2 x 255 ", "byte 5: height is missing"),
            (b"P5 2 2 70000 ", "byte 7: maxval is 70000"),
            (b"P5 0 2 255 ", "an image of 0 x 2"),
            (b"P5 99999 9999 255 abc", "need 999890001 bytes, 3 are there"),
            (b"P2 9999 9999 255 1", "pixels claimed, the file ends"),
            (b"P2 2 1 255 1 256", "byte 13: pixel is 256, at most 255"),
            (b"P2 2 1 255 1 q", "byte 13: pixel is missing"),
            (b"P5 99999999999 1 255 abc", "byte 3: width is"),
        ] {
            let error = parse(bytes).unwrap_err().to_string();
            assert!(error.contains(reason), "{error} / {reason}");
        }
        survives_damage(b"P2\n#c\n2 2\n200\n0 50\n100 200\n", |bytes| drop(parse(&bytes)));
        survives_damage(b"P5\n#c\n2 2\n200\n\x00\x32\x64\xc8\n", |bytes| drop(parse(&bytes)));
    }
}
