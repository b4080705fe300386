//! Tables as CSV with a header line: columns are found by name, in any order; others are ignored.

use crate::{
    Error, Input,
    fields::{not_a_number, shorten},
};

/// A table in memory.
pub(crate) struct Table<'a> {
    input: &'a Input,
    header: Vec<&'a str>,
}

/// A row of a [`Table`].
pub(crate) struct Row<'a> {
    table: &'a Table<'a>,
    line: usize,
    fields: Vec<&'a str>,
}

impl<'a> Table<'a> {
    /// A table whose header has these columns.
    ///
    /// # Errors
    /// An empty file, or the first column that is missing.
    pub(crate) fn new(input: &'a Input, columns: &[&str]) -> Result<Self, Error> {
        let (line, text) = input.data_lines().next().ok_or_else(|| input.file_error("the file is empty"))??;
        let header: Vec<_> = text.split(',').map(str::trim).collect();
        match columns.iter().find(|column| !header.contains(column)) {
            Some(column) => Err(input.line_error(line, format_args!("the header has no column `{column}`"))),
            None => Ok(Self { input, header }),
        }
    }

    /// The rows, from the first below the header.
    pub(crate) fn rows(&self) -> impl Iterator<Item = Result<Row<'_>, Error>> {
        self.input.data_lines().skip(1).map(|line| {
            let (line, text) = line?;
            let fields: Vec<_> = text.split(',').map(str::trim).collect();
            if fields.len() == self.header.len() {
                Ok(Row { table: self, line, fields })
            } else {
                let reason = format!("{} fields, the header has {}", fields.len(), self.header.len());
                Err(self.input.line_error(line, reason))
            }
        })
    }
}

impl<'a> Row<'a> {
    /// A fault of this row.
    pub(crate) fn error(&self, reason: impl std::fmt::Display) -> Error {
        self.table.input.line_error(self.line, reason)
    }

    /// A field as it stands.
    pub(crate) fn text(&self, column: &str) -> Result<&'a str, Error> {
        let index = self.table.header.iter().position(|name| *name == column);
        let field = index.and_then(|index| self.fields.get(index));
        field.copied().ok_or_else(|| self.error(format_args!("no column `{column}`")))
    }

    /// A field as a finite number.
    pub(crate) fn number(&self, column: &str) -> Result<f64, Error> {
        let text = self.text(column)?;
        let index = self.table.header.iter().position(|name| *name == column).unwrap_or_default();
        match text.parse() {
            Ok(value) if f64::is_finite(value) => Ok(value),
            Ok(value) => Err(self.error(format_args!("`{column}` must be finite, got {value}"))),
            Err(_) => Err(self.error(not_a_number(index + 1, column, text))),
        }
    }

    /// A field as a whole number of at most `max`.
    pub(crate) fn count(&self, column: &str, max: usize) -> Result<usize, Error> {
        let text = self.text(column)?;
        let count = text.parse().ok().filter(|&count: &usize| count <= max);
        count.ok_or_else(|| {
            self.error(format_args!("`{column}` must be a whole number up to {max}, got `{}`", shorten(text)))
        })
    }
}
