//! Maps of ROS's map_server: a YAML file that names an image, and the image.
//!
//! With `p` the occupancy of a pixel, `1 - v/maxval` (or `v/maxval` if `negate`), and the two thresholds of the YAML:
//!
//! | mode | occupancy in percent |
//! |---|---|
//! | `trinary` | 100 if `p > occupied_thresh`, 0 if `p < free_thresh`, else unknown |
//! | `scale` | the same at the ends, between them 1 to 99 in proportion |
//! | `raw` | the pixel itself, of 255; above 100 is unknown |
//!
//! Row 0 of the image is the top, row 0 of a grid the bottom. The origin is the pose of the lower-left corner and may be
//! turned.

mod pgm;
mod yaml;

pub use yaml::{MapMeta, Mode};

use crate::{Error, Input, input};
use agv_core::{
    geometry::Se2,
    grid::{CellState, Grid, GridLayout},
};
use std::{fmt::Write as _, path::Path};

/// Occupancy of a cell that was not observed.
pub const UNKNOWN: i8 = -1;

/// Grey values of the images that are written, as `map_saver` writes them.
const GREY: [(CellState, u8); 3] = [(CellState::Free, 254), (CellState::Unknown, 205), (CellState::Occupied, 0)];

/// Reads a map as planners and localizers take it: 0 % is free, 100 % is occupied, all else is unknown.
///
/// # Errors
/// As [`read_occupancy`].
pub fn read(yaml: impl AsRef<Path>) -> Result<Grid<CellState>, Error> {
    Ok(read_occupancy(yaml)?.map(|&occupancy| match occupancy {
        0 => CellState::Free,
        100 => CellState::Occupied,
        _ => CellState::Unknown,
    }))
}

/// Reads a map as occupancy in percent, [`UNKNOWN`] where not observed.
///
/// # Errors
/// A YAML or image that cannot be read, lacks a field, or holds values that cannot be.
pub fn read_occupancy(yaml: impl AsRef<Path>) -> Result<Grid<i8>, Error> {
    let yaml = Input::read(yaml)?;
    let meta = MapMeta::parse(&yaml)?;
    let folder = yaml.path().parent().unwrap_or(Path::new(""));
    assemble(&meta, &Input::read(folder.join(&meta.image))?)
}

/// The occupancy that `image` has under the description `meta`.
///
/// # Errors
/// An image that cannot be read.
pub fn assemble(meta: &MapMeta, image: &Input) -> Result<Grid<i8>, Error> {
    let image_of = pgm::decode(image)?;
    let [x, y, yaw] = meta.origin;
    let layout = GridLayout::new(image_of.width, image_of.height, meta.resolution, Se2::new(x, y, yaw))
        .map_err(|error| image.file_error(error))?;
    let bottom_up = image_of.pixels.chunks_exact(image_of.width).rev().flatten();
    let values = bottom_up.map(|&grey| meta.occupancy(f64::from(grey) / f64::from(image_of.maxval))).collect();
    Ok(Grid::new(layout, values)?)
}

/// Writes a map as `<name>.yaml` and `<name>.pgm` beside it; [`read`] gives it back.
///
/// # Errors
/// The operating system's refusal, or a path without a file name.
pub fn write(yaml: impl AsRef<Path>, map: &Grid<CellState>) -> Result<(), Error> {
    let path = yaml.as_ref();
    let Some(stem) = path.file_stem() else { return Err(Error::file(path, "a map needs a file name")) };
    let layout = map.layout();
    let mut image = format!("P5\n{} {}\n255\n", layout.width(), layout.height()).into_bytes();
    for row in map.values().chunks_exact(layout.width()).rev() {
        image.extend(row.iter().map(|&state| grey(state)));
    }
    input::write(path.with_extension("pgm"), &image)?;

    let origin = layout.map_from_grid();
    // A JSON string is a YAML string: names with blanks, colons or quotes survive.
    let name = serde_json::Value::from(format!("{}.pgm", stem.to_string_lossy()));
    let mut text = format!("image: {name}\nmode: trinary\nresolution: {:?}\n", layout.resolution());
    let _ = writeln!(text, "origin: [{:?}, {:?}, {:?}]", origin.x(), origin.y(), origin.yaw());
    text.push_str("negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n");
    input::write(path.with_extension("yaml"), text.as_bytes())
}

/// Grey value of a cell in pictures of maps: free is nearly white, unknown grey, occupied black.
pub(crate) fn grey(state: CellState) -> u8 {
    GREY.iter().find(|(of, _)| *of == state).map_or(205, |&(_, grey)| grey)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, shared};
    use agv_core::grid::Cell;
    use proptest::prelude::*;

    fn meta(text: &str) -> MapMeta {
        MapMeta::parse(&Input::new("m.yaml", format!("image: a.pgm\nresolution: 0.5\norigin: [1, 2, 0]\n{text}")))
            .unwrap()
    }

    fn occupancies(meta: &MapMeta, greys: &[u8]) -> Vec<i8> {
        let mut image = format!("P5 {} 1 255\n", greys.len()).into_bytes();
        image.extend(greys);
        assemble(meta, &Input::new("a.pgm", image)).unwrap().values().to_vec()
    }

    /// The expected values are map_server's documented rules, worked out by hand.
    #[test]
    fn modes_mean_what_map_server_means() {
        let greys = [0, 100, 205, 206, 254, 255];
        let rest = "occupied_thresh: 0.65\nfree_thresh: 0.196\nnegate:";
        assert_eq!(occupancies(&meta(&format!("{rest} 0")), &greys), [100, -1, -1, 0, 0, 0]);
        assert_eq!(occupancies(&meta(&format!("{rest} true")), &greys), [0, -1, 100, 100, 100, 100]);
        let scale = "mode: scale\noccupied_thresh: 1.0\nfree_thresh: 0.0\nnegate: 0";
        assert_eq!(occupancies(&meta(scale), &[0, 51, 255]), [99, 79, 1]);
        assert_eq!(occupancies(&meta(&format!("mode: raw\n{rest} 0")), &greys), [0, 100, -1, -1, -1, -1]);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(
            width in 1_usize..9, states in prop::collection::vec(0_u8..3, 1..60),
            origin in prop::array::uniform3(-3.0..3.0_f64), resolution in 0.01..1.0_f64,
        ) {
            let height = states.len().div_ceil(width);
            let pose = Se2::new(origin[0], origin[1], origin[2]);
            let layout = GridLayout::new(width, height, resolution, pose).unwrap();
            let mut map = Grid::filled(layout, CellState::Unknown);
            for (value, state) in map.values_mut().iter_mut().zip(states) {
                *value = GREY[usize::from(state)].0;
            }
            let scratch = Scratch::new("map");
            write(scratch.path("odd: \"name\" #1.yaml"), &map).unwrap();
            let again = read(scratch.path("odd: \"name\" #1.yaml")).unwrap();
            prop_assert_eq!(again.values(), map.values());
            prop_assert_eq!(again.layout().resolution(), resolution);
            let (a, b) = (again.layout().map_from_grid(), pose);
            prop_assert!((a.x() - b.x()).abs() + (a.y() - b.y()).abs() + (a.yaw() - b.yaw()).abs() < 1e-12);
        }
    }

    #[test]
    fn the_shared_maps_are_read_the_right_way_up() {
        for (name, width, height) in
            [("intel_map", 665, 662), ("magazino_hallway", 1813, 1182), ("turtlebot3_world", 384, 384)]
        {
            if let Some(path) = shared(&format!("localization/{name}.yaml")) {
                let map = read(path).unwrap();
                assert_eq!((map.layout().width(), map.layout().height()), (width, height), "{name}");
            }
        }
        if let Some(path) = shared("gridplan/ros/TenByTen.yaml") {
            let image = Input::read(path.with_extension("pgm")).unwrap();
            let top_left = image.bytes()[image.bytes().len() - 100];
            let map = read(path).unwrap();
            assert_eq!(map.get(Cell::new(0, 9)) == Some(&CellState::Free), top_left > 205);
        }
    }
}
