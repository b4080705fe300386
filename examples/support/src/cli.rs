//! The command line that all examples share, and the report that they end with.
//!
//! ```
//! use agv_support::cli::Report;
//!
//! let mut report = Report::new("A drive");
//! report.number("path_length_m", 12.5).flag("arrived", true);
//! assert_eq!(report.to_json(), r#"{"path_length_m":12.5,"arrived":true}"#);
//! assert!(report.to_table().contains("path length"));
//! ```

use crate::Error;
use agv_core::compute::{Par, Seed};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::{
    fmt::Write as _,
    fs,
    io::{self, Write as _},
    path::PathBuf,
};

/// Arguments of every example; flatten them into its own with `#[command(flatten)]`.
#[derive(Debug, Clone, clap::Args)]
pub struct CommonArgs {
    /// Seed of all random numbers: the same seed gives the same result
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for pictures and files; without it, target/agv/ and the example's name
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Print one JSON object on standard output instead of the table
    #[arg(long)]
    pub json: bool,
    /// Threads of the parallel loops; the result does not depend on it
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: u16,
}

impl CommonArgs {
    /// The seed.
    pub fn seed(&self) -> Seed {
        Seed(self.seed)
    }

    /// So many seeds, from [`seed`](Self::seed) on; after the greatest number come the least ones.
    pub fn seeds(&self, count: u64) -> impl ExactSizeIterator<Item = Seed> + Clone + use<> {
        let first = self.seed;
        (0..usize::try_from(count).unwrap_or(usize::MAX)).map(move |i| Seed(first.wrapping_add(i as u64)))
    }

    /// How the parallel loops run.
    pub fn par(&self) -> Par {
        if self.threads == 1 { Par::Seq } else { Par::threads(usize::from(self.threads)) }
    }

    /// The folder for pictures and files, made if it is absent.
    ///
    /// # Errors
    /// The operating system's refusal.
    pub fn out_folder(&self, example: &str) -> Result<PathBuf, Error> {
        let folder = self.out.clone().unwrap_or_else(|| PathBuf::from("target/agv").join(example));
        fs::create_dir_all(&folder).map_err(|source| Error::io(&folder, source))?;
        Ok(folder)
    }
}

#[derive(Debug, Clone, PartialEq)]
enum Figure {
    Number(f64),
    Count(u64),
    Flag(bool),
    Text(String),
    Numbers(Vec<f64>),
    Reports(Vec<Report>),
}

/// The figures that an example ends with: a table for people, or one JSON object for programs.
///
/// A key's suffix is its unit (`_m`, `_deg`, `_ms`, ...), so that the number needs no unit of its own; a statistic may
/// follow it (`localize_ms_p50`). A key that is given twice keeps its first place and its last value.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    title: String,
    figures: Vec<(String, Figure)>,
}

impl Report {
    /// An empty report.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), figures: Vec::new() }
    }

    /// Adds a measured number. One that is not finite becomes `null` in JSON.
    pub fn number(&mut self, key: &str, value: f64) -> &mut Self {
        self.put(key, Figure::Number(value))
    }

    /// Adds a count.
    pub fn count(&mut self, key: &str, value: usize) -> &mut Self {
        self.put(key, Figure::Count(value as u64))
    }

    /// Adds a yes or no.
    pub fn flag(&mut self, key: &str, value: bool) -> &mut Self {
        self.put(key, Figure::Flag(value))
    }

    /// Adds a word.
    pub fn text(&mut self, key: &str, value: impl Into<String>) -> &mut Self {
        self.put(key, Figure::Text(value.into()))
    }

    /// Adds several numbers that belong together: an array in JSON.
    pub fn numbers(&mut self, key: &str, values: &[f64]) -> &mut Self {
        self.put(key, Figure::Numbers(values.to_vec()))
    }

    /// Adds reports of the same kind: an array of objects in JSON, and their number in a table.
    pub fn reports(&mut self, key: &str, reports: Vec<Self>) -> &mut Self {
        self.put(key, Figure::Reports(reports))
    }

    /// Adds all figures of another report.
    pub fn append(&mut self, other: &Self) -> &mut Self {
        for (key, figure) in &other.figures {
            self.put(key, figure.clone());
        }
        self
    }

    fn put(&mut self, key: &str, figure: Figure) -> &mut Self {
        match self.figures.iter_mut().find(|(known, _)| known == key) {
            Some((_, slot)) => *slot = figure,
            None => self.figures.push((key.to_owned(), figure)),
        }
        self
    }

    /// One JSON object, in the order of the figures.
    pub fn to_json(&self) -> String {
        // Keys are strings and values are plain: serialising them cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The title, and a line per figure: what, how much, unit.
    pub fn to_table(&self) -> String {
        let rows: Vec<_> = self.figures.iter().map(|(key, figure)| (label(key), show(figure))).collect();
        let widest = |cells: &mut dyn Iterator<Item = &str>| cells.map(|cell| cell.chars().count()).max().unwrap_or(0);
        let names = widest(&mut rows.iter().map(|((name, _), _)| name.as_str()));
        let values = widest(&mut rows.iter().map(|(_, value)| value.as_str()));
        let mut table = format!("{}\n", self.title);
        for ((name, unit), value) in rows {
            let _ = writeln!(table, "{}", format!("  {name:<names$}  {value:>values$} {unit}").trim_end());
        }
        table
    }

    /// Prints the table, or the JSON object and nothing else, on standard output.
    ///
    /// # Errors
    /// The operating system's refusal; a reader that closed the pipe is not an error.
    pub fn print(&self, json: bool) -> Result<(), Error> {
        let text = if json { format!("{}\n", self.to_json()) } else { self.to_table() };
        match io::stdout().write_all(text.as_bytes()) {
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                Err(Error::io("standard output".as_ref(), error))
            }
            _ => Ok(()),
        }
    }
}

impl Serialize for Report {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.figures.len()))?;
        for (key, figure) in &self.figures {
            match figure {
                Figure::Number(value) => map.serialize_entry(key, value)?,
                Figure::Count(value) => map.serialize_entry(key, value)?,
                Figure::Flag(value) => map.serialize_entry(key, value)?,
                Figure::Text(value) => map.serialize_entry(key, value)?,
                Figure::Numbers(values) => map.serialize_entry(key, values)?,
                Figure::Reports(reports) => map.serialize_entry(key, reports)?,
            }
        }
        map.end()
    }
}

/// Name and unit of a key: `localize_ms_p50` is `localize p50` in `ms`.
fn label(key: &str) -> (String, &'static str) {
    const UNITS: [&str; 13] = ["m", "mm", "cm", "m2", "deg", "rad", "s", "ms", "us", "ns", "hz", "mps", "percent"];
    let mut words: Vec<&str> = key.split('_').collect();
    let mut unit = "";
    if let Some((at, &found)) = words
        .iter()
        .enumerate()
        .rev()
        .take(2)
        .find_map(|(at, word)| UNITS.iter().find(|unit| *unit == word).filter(|_| at > 0).map(|unit| (at, unit)))
    {
        words.remove(at);
        unit = match found {
            "us" => "µs",
            "m2" => "m²",
            "hz" => "Hz",
            "mps" => "m/s",
            "percent" => "%",
            other => other,
        };
    }
    (words.join(" "), unit)
}

fn show(figure: &Figure) -> String {
    match figure {
        Figure::Number(value) if value.abs() >= 1e5 || (*value != 0.0 && value.abs() < 1e-3) => format!("{value:.3e}"),
        Figure::Number(value) => format!("{value:.3}"),
        Figure::Count(value) => value.to_string(),
        Figure::Flag(value) => if *value { "yes" } else { "no" }.into(),
        Figure::Text(value) => value.clone(),
        Figure::Reports(reports) => reports.len().to_string(),
        Figure::Numbers(values) => {
            values.iter().map(|value| show(&Figure::Number(*value))).collect::<Vec<_>>().join(", ")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Example {
        #[command(flatten)]
        common: CommonArgs,
    }

    #[test]
    fn arguments_have_defaults_and_are_checked() {
        let parse = |arguments: &[&str]| Example::try_parse_from([&["x"], arguments].concat()).map(|x| x.common);
        let common = parse(&[]).unwrap();
        assert_eq!((common.seed, common.json, common.threads), (1, false, 1));
        assert_eq!(common.par(), Par::Seq);
        assert!(parse(&["--json", "--seed", "7", "--threads", "2", "--out", "x"]).is_ok());
        let last = parse(&["--seed", &u64::MAX.to_string()]).unwrap();
        assert!(last.seeds(2).eq([Seed(u64::MAX), Seed(0)]));
        for bad in [["--threads", "0"], ["--seed", "-1"], ["--seed", "x"]] {
            assert!(parse(&bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn json_keeps_types_order_and_one_value_per_key() {
        let mut report = Report::new("t");
        report.number("a_m", 1.0).count("n", 3).flag("ok", false).text("map", "a \"b\"").number("bad_s", f64::NAN);
        report.count("n", 4).numbers("gains", &[1.5, f64::INFINITY]);
        let value: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
        assert_eq!(
            value,
            serde_json::json!({"a_m": 1.0, "n": 4, "ok": false, "map": "a \"b\"", "bad_s": null, "gains": [1.5, null]})
        );
        assert!(report.to_json().starts_with(r#"{"a_m":1.0,"n":4"#));
    }

    #[test]
    fn units_come_from_the_key() {
        assert_eq!(label("localization_mean_m"), ("localization mean".into(), "m"));
        assert_eq!(label("localize_ms_p50"), ("localize p50".into(), "ms"));
        assert_eq!(label("map_cells_updated"), ("map cells updated".into(), ""));
        assert_eq!(label("m"), ("m".into(), ""));
    }
}
