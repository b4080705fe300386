//! Maps and scenarios of the MovingAI benchmarks (N. Sturtevant, *Benchmarks for grid-based pathfinding*, 2012).
//!
//! The files count rows from the top; grids count them from the bottom. Maps and queries are both turned here, so that a
//! query's cells fit its map; a path's length is the same either way up.

use crate::{Error, Input, fields::Fields, fields::shorten, input};
use agv_core::{
    geometry::Se2,
    grid::{Cell, CellState, Grid, GridLayout},
};
use std::path::Path;

/// One path query of a scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Group of similar length that the benchmark put it in.
    pub bucket: usize,
    /// Map as the file names it; often a path of the benchmark's own tree.
    pub map: String,
    /// Size of the map: columns and rows.
    pub size: (usize, usize),
    /// Where the path starts.
    pub start: Cell,
    /// Where it ends.
    pub goal: Cell,
    /// Length of the shortest octile path without cutting corners, in cells.
    pub optimal_length: f64,
}

/// Reads a map as a grid of 1 m cells; `.`, `G` and `S` are free, `@`, `O`, `T` and `W` are occupied.
///
/// # Errors
/// A file that cannot be read, a wrong header, too few or short rows, or an unknown character.
pub fn read_map(path: impl AsRef<Path>) -> Result<Grid<CellState>, Error> {
    parse_map(&Input::read(path)?)
}

/// Reads a map from memory.
///
/// # Errors
/// As [`read_map`].
pub fn parse_map(input: &Input) -> Result<Grid<CellState>, Error> {
    let mut lines = input.lines();
    let mut size = [None; 2];
    let mut number = 0;
    loop {
        let Some(line) = lines.next() else { return Err(input.line_error(number + 1, "the header has no line `map`")) };
        let text;
        (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        match text.split_ascii_whitespace().next().unwrap_or_default() {
            "type" => {}
            word @ ("height" | "width") => {
                fields.text(word)?;
                let cells = fields.count(word, 1 << 20)?;
                fields.end()?;
                if cells == 0 {
                    return Err(input.line_error(number, format_args!("a map of {word} 0 has no cells")));
                }
                size[usize::from(word == "width")] = Some(cells);
            }
            "map" => break,
            word => {
                let reason = format!("expected type, height, width or map, got `{}`", shorten(word));
                return Err(input.line_error(number, reason));
            }
        }
    }
    let [Some(height), Some(width)] = size else {
        return Err(input.line_error(number, "the header lacks height or width"));
    };
    let layout =
        GridLayout::new(width, height, 1.0, Se2::default()).map_err(|error| input.line_error(number, error))?;
    // The file must hold a character per cell: the header alone allocates nothing.
    if layout.len() > input.bytes().len() {
        return Err(input.line_error(number, format_args!("{width} x {height} cells claimed, the file is shorter")));
    }
    let mut grid = Grid::filled(layout, CellState::Occupied);
    for row in 0..height {
        let Some(line) = lines.next() else {
            return Err(input.line_error(number + 1, format_args!("rows are missing: {row} of {height} are there")));
        };
        let text;
        (number, text) = line?;
        if text.len() != width {
            let reason = format!("row {row} has {} characters, the header says {width}", text.len());
            return Err(input.line_error(number, reason));
        }
        for (column, byte) in text.bytes().enumerate() {
            let state = match byte {
                b'.' | b'G' | b'S' => CellState::Free,
                b'@' | b'O' | b'T' | b'W' => CellState::Occupied,
                _ => {
                    let character = shorten(&char::from(byte).to_string());
                    return Err(
                        input.line_error(number, format_args!("column {column}: unknown terrain `{character}`"))
                    );
                }
            };
            grid.set(Cell::new(column as i32, (height - 1 - row) as i32), state);
        }
    }
    for line in lines {
        let (number, text) = line?;
        if !text.trim().is_empty() {
            return Err(input.line_error(number, format_args!("a row more than the {height} of the header")));
        }
    }
    Ok(grid)
}

/// Writes a map, gzipped if `path` ends in `.gz`; unknown cells are written as blocked.
///
/// # Errors
/// The operating system's refusal.
pub fn write_map(path: impl AsRef<Path>, map: &Grid<CellState>) -> Result<(), Error> {
    let (width, height) = (map.layout().width(), map.layout().height());
    let mut text = format!("type octile\nheight {height}\nwidth {width}\nmap\n");
    for row in map.values().chunks_exact(width).rev() {
        text.extend(row.iter().map(|&state| if state == CellState::Free { '.' } else { '@' }));
        text.push('\n');
    }
    input::write(path, text.as_bytes())
}

/// Reads the queries of a scenario.
///
/// # Errors
/// A file that cannot be read, or the first line that is not a query inside its map.
pub fn read_scenario(path: impl AsRef<Path>) -> Result<Vec<Query>, Error> {
    parse_scenario(&Input::read(path)?)
}

/// Reads the queries of a scenario from memory.
///
/// # Errors
/// As [`read_scenario`].
pub fn parse_scenario(input: &Input) -> Result<Vec<Query>, Error> {
    let mut queries = Vec::new();
    for line in input.data_lines() {
        let (number, text) = line?;
        if text.starts_with("version") {
            continue;
        }
        let mut fields = Fields::blank_separated(input, number, text);
        let bucket = fields.count("bucket", usize::MAX)?;
        let map = fields.text("map")?.to_owned();
        let size = (fields.count("width", 1 << 20)?, fields.count("height", 1 << 20)?);
        let mut cell = |names: [&str; 2]| {
            let (x, y) = (fields.count(names[0], 1 << 20)?, fields.count(names[1], 1 << 20)?);
            if x >= size.0 || y >= size.1 {
                let reason = format!("({x}, {y}) lies outside the map of {} x {} cells", size.0, size.1);
                return Err(input.line_error(number, reason));
            }
            Ok(Cell::new(x as i32, (size.1 - 1 - y) as i32))
        };
        let (start, goal) = (cell(["start x", "start y"])?, cell(["goal x", "goal y"])?);
        let optimal_length = fields.finite("optimal length")?;
        if optimal_length < 0.0 {
            return Err(input.line_error(number, format_args!("an optimal length of {optimal_length}")));
        }
        fields.end()?;
        queries.push(Query { bucket, map, size, start, goal, optimal_length });
    }
    Ok(queries)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, shared, survives_damage};

    const MAP: &str = "type octile\r\nheight 2\r\nwidth 3\r\nmap\r\n.@T\r\nGSW\r\n";
    const SCENARIO: &str = "version 1\n0\tmaps/a.map\t3\t2\t0\t0\t1\t1\t1.5\n";

    #[test]
    fn rows_are_turned_and_queries_with_them() {
        let map = parse_map(&Input::new("m", MAP)).unwrap();
        assert_eq!(map.get(Cell::new(1, 1)), Some(&CellState::Occupied));
        assert_eq!(map.get(Cell::new(1, 0)), Some(&CellState::Free));
        let query = &parse_scenario(&Input::new("s", SCENARIO)).unwrap()[0];
        assert_eq!((query.start, query.goal), (Cell::new(0, 1), Cell::new(1, 0)));
        let scratch = Scratch::new("movingai");
        write_map(scratch.path("m.map.gz"), &map).unwrap();
        assert_eq!(read_map(scratch.path("m.map")).unwrap(), map);
    }

    #[test]
    fn faults_name_the_line() {
        let map = |text: &str| parse_map(&Input::new("m", text)).unwrap_err().to_string();
        assert!(map("type octile\nheight x\n").contains("m:2: field 2 (height) must be a whole number"));
        assert!(map("height 9\nwidth 9\n").contains("no line `map`"));
        assert!(map("height 2\nwidth 2\nmap\n..\n").contains("rows are missing"));
        assert!(map("height 1\nwidth 2\nmap\n.?\n").contains("m:4: column 1: unknown terrain `?`"));
        assert!(map("height 1000000\nwidth 1000\nmap\n.\n").contains("the file is shorter"));
        for (text, line, reason) in [
            ("", 1, "expected type"),
            ("height 2\nwidth 2\n", 3, "no line `map`"),
            ("type octile\r\nheight 0\r\nwidth 3\r\nmap\r\n", 2, "a map of height 0 has no cells"),
            ("width 0\nheight 3\nmap\n", 1, "a map of width 0"),
            ("height -3\nwidth 3\nmap\n", 1, "must be a whole number"),
            ("height 3.5\n", 1, "must be a whole number"),
            ("height 99999999\n", 1, "at most"),
            ("height 1 2\nwidth 3\nmap\n...\n", 1, ""),
            ("type octile\nwidth 3\nmap\n...\n", 3, "lacks height or width"),
            ("size 3\n", 1, "expected type, height, width or map"),
            ("height 2\nwidth 2\nmap\n..\n", 5, "1 of 2 are there"),
            ("height 2\nwidth 2\nmap\n..\n.\n", 5, "row 1 has 1 characters"),
            ("height 1\nwidth 2\nmap\n..\n\n..\n", 6, "a row more"),
        ] {
            let message = map(text);
            assert!(message.starts_with(&format!("m:{line}: ")) && message.contains(reason), "{text:?}: {message}");
        }
        let scenario = |text: &str| parse_scenario(&Input::new("s", text)).unwrap_err().to_string();
        for (text, reason) in [
            ("0 m 3 2 3 0 1 1 1", "(3, 0) lies outside"),
            ("0 m 3 2 0 0 1 2 1", "(1, 2) lies outside"),
            ("0 m 0 0 0 0 0 0 0", "(0, 0) lies outside"),
            ("0 m 3 2 -1 0 1 1 1", "must be a whole number"),
            ("0 m 3 2 NaN 0 1 1 1", "must be a whole number"),
            ("0 m 3 2 0 0 1 1 NaN", "must be finite"),
            ("0 m 3 2 0 0 1 1 inf", "must be finite"),
            ("0 m 3 2 0 0 1 1 -4", "an optimal length of -4"),
            ("0 m 3 2 0 0 1 1 1 7", ""),
            ("x m 3 2 0 0 1 1 1", "must be a whole number"),
        ] {
            let message = scenario(&format!("version 1\r\n0 m 3 2 0 0 1 1 1.5\r\n{text}\r\n"));
            assert!(message.starts_with("s:3: ") && message.contains(reason), "{text}: {message}");
        }
        assert!(scenario("version 1\n0 m 3 2 0").contains("s:2: the line ends before field 6 (start y)"));
    }

    #[test]
    fn damage_never_panics() {
        survives_damage(MAP.as_bytes(), |bytes| drop(parse_map(&Input::new("m", bytes))));
        survives_damage(SCENARIO.as_bytes(), |bytes| drop(parse_scenario(&Input::new("s", bytes))));
    }

    #[test]
    fn the_benchmarks_have_their_free_cells_and_queries() {
        for (name, free, queries) in [("arena2", 24_311, 929), ("Berlin_0_256", 48_147, 930)] {
            let file = |kind: &str| shared(&format!("gridplan/movingai/{name}.map{kind}.gz"));
            if let (Some(map), Some(scenario)) = (file(""), file(".scen")) {
                let map = read_map(map).unwrap();
                assert_eq!(map.values().iter().filter(|&&state| state == CellState::Free).count(), free);
                let scenario = read_scenario(scenario).unwrap();
                assert_eq!(scenario.len(), queries);
                for query in scenario {
                    assert_eq!(query.size, (map.layout().width(), map.layout().height()));
                    assert_eq!(map.get(query.start), Some(&CellState::Free));
                }
            }
        }
    }
}
