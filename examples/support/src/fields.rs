//! The fields of a text line, read by name so that a fault can name the field.

use crate::{Error, Input};
use agv_core::{geometry::Se2, time::Stamp};

/// Reads the fields of one line from left to right.
pub(crate) struct Fields<'a, I> {
    input: &'a Input,
    line: usize,
    tokens: I,
    read: usize,
}

impl<'a> Fields<'a, std::str::SplitAsciiWhitespace<'a>> {
    /// The fields of `text`, separated by blanks.
    pub(crate) fn blank_separated(input: &'a Input, line: usize, text: &'a str) -> Self {
        Self { input, line, tokens: text.split_ascii_whitespace(), read: 0 }
    }
}

impl<'a, I: Iterator<Item = &'a str>> Fields<'a, I> {
    /// A fault of this line.
    pub(crate) fn error(&self, reason: impl std::fmt::Display) -> Error {
        self.input.line_error(self.line, reason)
    }

    /// The next field as it stands.
    pub(crate) fn text(&mut self, name: &str) -> Result<&'a str, Error> {
        self.read += 1;
        match self.tokens.next() {
            Some(token) => Ok(token),
            None => Err(self.error(format_args!("the line ends before field {} ({name})", self.read))),
        }
    }

    /// The next field as a number, NaN and infinities included.
    pub(crate) fn number(&mut self, name: &str) -> Result<f64, Error> {
        let token = self.text(name)?;
        token.parse().map_err(|_| self.error(not_a_number(self.read, name, token)))
    }

    /// The next field as a finite number.
    pub(crate) fn finite(&mut self, name: &str) -> Result<f64, Error> {
        let value = self.number(name)?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.error(format_args!("field {} ({name}) must be finite, got {value}", self.read)))
        }
    }

    /// The next `N` fields as finite numbers.
    pub(crate) fn finite_array<const N: usize>(&mut self, names: [&str; N]) -> Result<[f64; N], Error> {
        let mut values = [0.0; N];
        for (value, name) in values.iter_mut().zip(names) {
            *value = self.finite(name)?;
        }
        Ok(values)
    }

    /// The next three fields as a planar pose: x, y in metres, heading in radians.
    pub(crate) fn pose(&mut self, names: [&str; 3]) -> Result<Se2, Error> {
        let [x, y, yaw] = self.finite_array(names)?;
        Ok(Se2::new(x, y, yaw))
    }

    /// The next field as a time in seconds.
    pub(crate) fn stamp(&mut self, name: &str) -> Result<Stamp, Error> {
        self.finite(name).map(Stamp::from_seconds)
    }

    /// The next field as a whole number of at most `max`.
    pub(crate) fn count(&mut self, name: &str, max: usize) -> Result<usize, Error> {
        let token = self.text(name)?;
        match token.parse() {
            Ok(count) if count <= max => Ok(count),
            Ok(count) => {
                Err(self.error(format_args!("field {} ({name}) is {count}, at most {max} is allowed", self.read)))
            }
            Err(_) => Err(self.error(format_args!(
                "field {} ({name}) must be a whole number, got `{}`",
                self.read,
                shorten(token)
            ))),
        }
    }

    /// The next `count` fields as readings; the memory grows with the fields that are there, not with `count`.
    pub(crate) fn readings(&mut self, name: &str, count: usize) -> Result<Vec<f32>, Error> {
        let mut readings = Vec::with_capacity(count.min(4096));
        for _ in 0..count {
            readings.push(self.number(name)? as f32);
        }
        Ok(readings)
    }

    /// Refuses a line that goes on.
    pub(crate) fn end(mut self) -> Result<(), Error> {
        match self.tokens.next() {
            None => Ok(()),
            Some(extra) => Err(self.error(format_args!("`{}` after the {} fields", shorten(extra), self.read))),
        }
    }
}

/// The message for a field that is not a number.
pub(crate) fn not_a_number(index: usize, name: &str, token: &str) -> String {
    format!("field {index} ({name}) must be a number, got `{}`", shorten(token))
}

/// At most the first 24 characters: a message is one line, whatever the file holds.
pub(crate) fn shorten(token: &str) -> String {
    token.chars().take(24).map(|c| if c.is_control() { '?' } else { c }).collect()
}
