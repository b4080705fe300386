//! The crate's one error type.

/// Why a value was refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value that the core refuses.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
    /// Two maps that are to be combined were made with different parameters.
    #[error("maps differ in {name}: {left} and {right}")]
    MapMismatch {
        /// What differs.
        name: &'static str,
        /// Its value in the first map.
        left: f64,
        /// Its value in the second map.
        right: f64,
    },
    /// Two tiles that are to be one are of different places.
    #[error("tile ({}, {}) cannot be merged with tile ({}, {}): it is another place", left[0], left[1], right[0], right[1])]
    TileMismatch {
        /// Index of the first tile.
        left: [i32; 2],
        /// Index of the second tile.
        right: [i32; 2],
    },
    /// A tile that was stored has a voxel of another tile.
    #[error("voxel ({}, {}, {}) does not lie in tile ({}, {})", voxel[0], voxel[1], voxel[2], tile[0], tile[1])]
    VoxelOutsideTile {
        /// The voxel.
        voxel: [i32; 3],
        /// Index of the tile.
        tile: [i32; 2],
    },
    /// A tile that is to be loaded is not away: its points would count twice.
    #[error("tile ({x}, {y}) was not unloaded, or is loaded already")]
    TileNotAway {
        /// Its index along x.
        x: i32,
        /// Its index along y.
        y: i32,
    },
}

impl From<Error> for agv_core::roles::AlignmentError {
    fn from(error: Error) -> Self {
        match error {
            Error::Core(error) => Self::Invalid(error),
            Error::MapMismatch { name, left, right } => {
                Self::Invalid(agv_core::Error::LayoutMismatch { name, left, right })
            }
            // No registration meets tiles. Indices are no coordinates, which is all that the core could say them as.
            Error::TileMismatch { left, right } => {
                let (name, axis) =
                    if left[0] == right[0] { ("tile index along y", 1) } else { ("tile index along x", 0) };
                let (left, right) = (f64::from(left[axis]), f64::from(right[axis]));
                Self::Invalid(agv_core::Error::LayoutMismatch { name, left, right })
            }
            Error::VoxelOutsideTile { .. } => Self::Invalid(agv_core::Error::LengthMismatch {
                name: "voxels outside their tile",
                len: 1,
                expected: 0,
            }),
            Error::TileNotAway { .. } => Self::Invalid(agv_core::Error::LengthMismatch {
                name: "tiles of an index that are away",
                len: 0,
                expected: 1,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::roles::AlignmentError;

    #[test]
    fn indices_of_tiles_are_told_as_no_coordinates() {
        for (error, told) in [
            (Error::TileMismatch { left: [3, -2], right: [3, 5] }, "tile index along y: -2 and 5"),
            (Error::TileMismatch { left: [3, -2], right: [4, -2] }, "tile index along x: 3 and 4"),
            (Error::VoxelOutsideTile { voxel: [1, 2, 3], tile: [3, -2] }, "voxels outside their tile"),
            (Error::TileNotAway { x: 3, y: -2 }, "tiles of an index that are away"),
        ] {
            let text = AlignmentError::from(error).to_string();
            assert!(text.contains(told) && !text.contains("(3, -2)"), "{text}");
        }
    }
}
