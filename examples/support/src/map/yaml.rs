//! The YAML of a map_server map.

use crate::{Error, Input};
use serde::Deserialize;

/// What a pixel means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Free, occupied or unknown.
    #[default]
    Trinary,
    /// In proportion between the thresholds.
    Scale,
    /// The occupancy itself.
    Raw,
}

/// Description of a map image.
#[derive(Debug, Clone, PartialEq)]
pub struct MapMeta {
    /// File of the image, as the YAML names it: relative to the YAML's folder, or absolute.
    pub image: String,
    /// Edge of a cell, in metres.
    pub resolution: f64,
    /// Pose of the lower-left corner: x, y in metres, heading in radians.
    pub origin: [f64; 3],
    /// What a pixel means.
    pub mode: Mode,
    /// Whether bright is occupied.
    pub negate: bool,
    /// Cells above this occupancy are occupied.
    pub occupied_threshold: f64,
    /// Cells below this occupancy are free.
    pub free_threshold: f64,
}

#[derive(Deserialize)]
struct Raw {
    image: String,
    resolution: f64,
    origin: Vec<f64>,
    #[serde(default)]
    mode: Mode,
    #[serde(default)]
    negate: Negate,
    occupied_thresh: f64,
    free_thresh: f64,
}

/// `negate` is written as 0 or 1 by `map_saver`, as a boolean by hand.
#[derive(Deserialize)]
#[serde(untagged)]
enum Negate {
    Flag(bool),
    Number(i64),
}

impl Default for Negate {
    fn default() -> Self {
        Self::Flag(false)
    }
}

impl MapMeta {
    /// Reads the description.
    ///
    /// # Errors
    /// What is no YAML, lacks a field (only `mode` and `negate` may be absent), or has a value that cannot be.
    pub fn parse(input: &Input) -> Result<Self, Error> {
        let text = std::str::from_utf8(input.bytes())
            .map_err(|error| input.byte_error(error.valid_up_to(), "not text (UTF-8)"))?;
        let raw: Raw = serde_saphyr::from_str(text).map_err(|error| {
            let line = error.location().map_or(1, |location| location.line() as usize);
            let reason = error.to_string();
            input.line_error(line.max(1), reason.lines().next().unwrap_or("not a map description"))
        })?;
        let fault = |name: &str, why: &str| Err(input.line_error(line_of(text, name), format_args!("{name} {why}")));

        if !(raw.resolution.is_finite() && raw.resolution > 0.0) {
            return fault("resolution", "must be finite and positive");
        }
        let Ok(origin) = <[f64; 3]>::try_from(raw.origin) else {
            return fault("origin", "must have three entries: x, y, yaw");
        };
        if origin.iter().any(|value| !value.is_finite()) {
            return fault("origin", "must be finite");
        }
        let thresholds = [("free_thresh", raw.free_thresh), ("occupied_thresh", raw.occupied_thresh)];
        for (name, threshold) in thresholds {
            if !(0.0..=1.0).contains(&threshold) {
                return fault(name, "must lie in [0, 1]");
            }
        }
        if raw.free_thresh > raw.occupied_thresh {
            return fault("free_thresh", "must not exceed occupied_thresh");
        }
        let negate = match raw.negate {
            Negate::Flag(flag) => flag,
            Negate::Number(number @ (0 | 1)) => number == 1,
            Negate::Number(_) => return fault("negate", "must be 0 or 1"),
        };
        if raw.image.is_empty() {
            return fault("image", "must name a file");
        }
        Ok(Self {
            image: raw.image,
            resolution: raw.resolution,
            origin,
            mode: raw.mode,
            negate,
            occupied_threshold: raw.occupied_thresh,
            free_threshold: raw.free_thresh,
        })
    }

    /// Occupancy in percent, or -1, of a pixel whose brightness is `lightness` of 1.
    pub(super) fn occupancy(&self, lightness: f64) -> i8 {
        let p = if self.negate { lightness } else { 1.0 - lightness };
        match self.mode {
            Mode::Raw => {
                // Nav2's map_io: the value itself, `negate` turning the scale as it does for the other modes.
                let value = (if self.negate { 1.0 - lightness } else { lightness } * 255.0).round();
                if value <= 100.0 { value as i8 } else { super::UNKNOWN }
            }
            _ if p > self.occupied_threshold => 100,
            _ if p < self.free_threshold => 0,
            Mode::Trinary => super::UNKNOWN,
            Mode::Scale => {
                let span = self.occupied_threshold - self.free_threshold;
                let ratio = if span > 0.0 { (p - self.free_threshold) / span } else { 0.5 };
                (1.0 + 98.0 * ratio).round() as i8
            }
        }
    }
}

/// Line of the key `name`, from 1.
fn line_of(text: &str, name: &str) -> usize {
    text.lines().position(|line| line.trim_start().starts_with(name)).map_or(1, |index| index + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::survives_damage;

    const GOOD: &str = "image: a.pgm # name\nmode: scale\nresolution: 0.05\norigin: [-1.0, 2, 0.5]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n\n# -3.0 3.5\n";

    fn parse(text: &str) -> Result<MapMeta, Error> {
        MapMeta::parse(&Input::new("m.yaml", text))
    }

    #[test]
    fn a_description_is_read() {
        let meta = parse(GOOD).unwrap();
        assert_eq!((meta.image.as_str(), meta.mode, meta.negate), ("a.pgm", Mode::Scale, false));
        assert_eq!(meta.origin, [-1.0, 2.0, 0.5]);
        let block = GOOD.replace("[-1.0, 2, 0.5]", "\n  - -1.0\n  - 2\n  - 0.5").replace("a.pgm", "'b c.pgm'");
        assert_eq!(parse(&block).unwrap().image, "b c.pgm");
    }

    #[test]
    fn faults_name_line_and_field() {
        for (from, to, line, reason) in [
            ("resolution: 0.05", "resolution: -1", 3, "resolution must be finite and positive"),
            ("resolution: 0.05", "resolution: .nan", 3, "resolution must be finite and positive"),
            ("[-1.0, 2, 0.5]", "[-1.0, 2]", 4, "origin must have three entries"),
            ("[-1.0, 2, 0.5]", "[.inf, 2, 0]", 4, "origin must be finite"),
            ("negate: 0", "negate: 7", 5, "negate must be 0 or 1"),
            ("occupied_thresh: 0.65", "occupied_thresh: 65", 6, "occupied_thresh must lie in [0, 1]"),
            ("free_thresh: 0.25", "free_thresh: 0.9", 7, "free_thresh must not exceed"),
            ("image: a.pgm", "image: ''", 1, "image must name a file"),
            ("resolution: 0.05", "resolution: wide", 3, ""),
            ("mode: scale", "mode: fancy", 2, ""),
        ] {
            let error = parse(&GOOD.replace(from, to)).unwrap_err().to_string();
            assert!(error.starts_with(&format!("m.yaml:{line}: {reason}")), "{error}");
        }
        assert!(parse("").is_err());
        assert!(parse(&GOOD.replace("resolution: 0.05\n", "")).unwrap_err().to_string().contains("resolution"));
        survives_damage(GOOD.as_bytes(), |bytes| drop(MapMeta::parse(&Input::new("m", bytes))));
    }
}
