//! BARN: fields of cylinders between two walls (Perille et al., *Benchmarking Metric Ground Navigation*, SSRR 2020).

use super::MAX_INDEX;
use crate::{Error, Input, table::Table};
use agv_core::nalgebra::Vector2;
use std::{collections::BTreeMap, path::Path};

/// A world of BARN.
#[derive(Debug, Clone, PartialEq)]
pub struct BarnWorld {
    /// Its number in the set.
    pub index: usize,
    /// Centres of the cylinders, in metres.
    pub cylinders: Vec<Vector2<f64>>,
    /// The set's own grid path, in metres; empty where none was given.
    pub path: Vec<Vector2<f64>>,
    /// Official length of the way from start to goal, in metres.
    pub optimal_length: f64,
    /// Official least time, in seconds: what scores refer to.
    pub optimal_time: f64,
}

impl BarnWorld {
    /// Radius of all cylinders, in metres.
    pub const CYLINDER_RADIUS: f64 = 0.075;
}

/// Reads the worlds of a table (`world, optimal_path_len_m, optimal_time_s`), their cylinders (`world, x_m, y_m`), and their grid
/// paths (`world, k, row, col`) if there are any; in the order of the table.
///
/// # Errors
/// A file that cannot be read, a line that is none, or a world without cylinders.
pub fn read_barn(
    worlds: impl AsRef<Path>,
    cylinders: impl AsRef<Path>,
    paths: Option<&Path>,
) -> Result<Vec<BarnWorld>, Error> {
    let paths = paths.map(Input::read).transpose()?;
    parse(&Input::read(worlds)?, &Input::read(cylinders)?, paths.as_ref())
}

fn parse(worlds: &Input, cylinders: &Input, paths: Option<&Input>) -> Result<Vec<BarnWorld>, Error> {
    let mut centres: BTreeMap<usize, Vec<Vector2<f64>>> = BTreeMap::new();
    for row in Table::new(cylinders, &["world", "x_m", "y_m"])?.rows() {
        let row = row?;
        let centre = Vector2::new(row.number("x_m")?, row.number("y_m")?);
        centres.entry(row.count("world", MAX_INDEX)?).or_default().push(centre);
    }
    let mut grid_paths: BTreeMap<usize, Vec<Vector2<f64>>> = BTreeMap::new();
    if let Some(paths) = paths {
        for row in Table::new(paths, &["world", "row", "col"])?.rows() {
            let row = row?;
            // Cells of 0.15 m; the mapping under which the paths keep clear of the cylinders.
            let cell = Vector2::new(row.count("row", MAX_INDEX)? as f64, row.count("col", MAX_INDEX)? as f64);
            let place = Vector2::new(-4.425, 5.175) + cell * 0.15;
            grid_paths.entry(row.count("world", MAX_INDEX)?).or_default().push(place);
        }
    }
    let table = Table::new(worlds, &["world", "optimal_path_len_m", "optimal_time_s"])?;
    table
        .rows()
        .map(|row| {
            let row = row?;
            let index = row.count("world", MAX_INDEX)?;
            let Some(cylinders) = centres.get(&index) else {
                return Err(cylinders.file_error(format_args!("world {index} has no cylinders")));
            };
            let [optimal_length, optimal_time] = [row.number("optimal_path_len_m")?, row.number("optimal_time_s")?];
            if optimal_length <= 0.0 || optimal_time <= 0.0 {
                return Err(row.error("length and time of the optimal path must be positive"));
            }
            let path = grid_paths.get(&index).cloned().unwrap_or_default();
            Ok(BarnWorld { index, cylinders: cylinders.clone(), path, optimal_length, optimal_time })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(name: &str, text: &str) -> Input {
        Input::new(name, text)
    }

    #[test]
    fn worlds_find_their_cylinders_and_paths() {
        let worlds = input("w", "world,n_cyl,optimal_path_len_m,optimal_time_s\n3,2,12.5,6.25\n1,1,11,5.5\n");
        let cylinders = input("c", "world,x_m,y_m\n1,0.5,1\n3,-1,2\n3,-2,2\n");
        let paths = input("p", "world,k,row,col\n3,0,1,2\n3,1,2,2\n");
        let read = parse(&worlds, &cylinders, Some(&paths)).unwrap();
        assert_eq!(
            read.iter().map(|w| (w.index, w.cylinders.len(), w.path.len())).collect::<Vec<_>>(),
            [(3, 2, 2), (1, 1, 0)]
        );
        assert!((read[0].path[0] - Vector2::new(-4.275, 5.475)).norm() < 1e-12);
        assert_eq!((read[1].optimal_length, read[1].optimal_time), (11.0, 5.5));
    }

    #[test]
    fn faults_are_named() {
        let worlds = input("w", "world,optimal_path_len_m,optimal_time_s\n3,12.5,6.25\n");
        let cylinders = input("c", "world,x_m,y_m\n3,-1,2\n");
        for (w, c, said) in [
            (&input("w", ""), &cylinders, "empty"),
            (&input("w", "world\n3\n"), &cylinders, "optimal_path_len_m"),
            (&input("w", "world,optimal_path_len_m,optimal_time_s\n3,0,1\n"), &cylinders, "positive"),
            (&input("w", "world,optimal_path_len_m,optimal_time_s\nx,1,1\n"), &cylinders, "whole number"),
            (&input("w", "world,optimal_path_len_m,optimal_time_s\n4,1,1\n"), &cylinders, "world 4"),
            (&worlds, &input("c", "world,x_m,y_m\n3,inf,2\n"), "finite"),
            (&worlds, &input("c", "world,x_m,y_m\n3,1\n"), "2 fields"),
            (&worlds, &input("c", "world,x_m,y_m\n3,1,y\n"), "number"),
        ] {
            let error = parse(w, c, None).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
