//! The term that a beam adds, for every cell that it may end in.

use super::{LikelihoodFieldModel, LikelihoodFieldModelParams, ScanForm};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
    grid::LikelihoodField,
};

/// What is looked up: the term of a beam, per cell, with a border for all that lies off the map.
#[derive(Debug)]
pub(super) struct Table {
    /// `ln p` or `p³`, row by row; one cell more on every side.
    pub(super) terms: Vec<f32>,
    pub(super) stride: u32,
    /// Greatest column and row, border included.
    pub(super) last: [f32; 2],
    /// From the map to the grid, and metres to cells.
    pub(super) grid_from_map: Se2,
    pub(super) cells_per_metre: f64,
    /// Least term of an explained beam.
    pub(super) explained: f32,
}

/// Places for logarithms that are known, in bits.
const PLACE_BITS: u32 = 11;

/// Where the logarithm of a density is remembered: multiplicative hashing (Knuth, *The Art of Computer Programming*, volume 3,
/// section 6.4).
#[inline]
fn place(density: f32) -> usize {
    (density.to_bits().wrapping_mul(0x9e37_79b1) >> (32 - PLACE_BITS)) as usize
}

impl Table {
    /// The table of a field.
    ///
    /// # Errors
    /// A map longer than [`LikelihoodFieldModel::MAX_SIDE`].
    pub(super) fn new(field: &LikelihoodField, params: &LikelihoodFieldModelParams) -> Result<Self, Error> {
        let layout = field.layout();
        let (width, height) = (layout.width(), layout.height());
        for (name, side) in [("map width", width), ("map height", height)] {
            if side > LikelihoodFieldModel::MAX_SIDE {
                return Err(Error::TooMany { name, len: side, max: LikelihoodFieldModel::MAX_SIDE });
            }
        }
        let term = |density: f32| match params.form {
            ScanForm::Product { .. } => density.ln(),
            ScanForm::SumOfCubes => density * density * density,
        };
        let border = term(field.off_map());
        let mut terms = Vec::with_capacity((width + 2) * (height + 2));
        terms.resize(width + 2, border);
        // A field has few values, one for each distance within reach: most logarithms are those of a cell before.
        let mut known = vec![(f32::NAN, border); 1 << PLACE_BITS];
        for row in field.values().chunks_exact(width) {
            terms.push(border);
            terms.extend(row.iter().map(|&density| {
                let (of, term_of) = &mut known[place(density)];
                if density != *of {
                    (*of, *term_of) = (density, term(density));
                }
                *term_of
            }));
            terms.push(border);
        }
        terms.resize((width + 2) * (height + 2), border);
        Ok(Self {
            terms,
            stride: width as u32 + 2,
            last: [(width + 1) as f32, (height + 1) as f32],
            grid_from_map: layout.map_from_grid().inverse(),
            cells_per_metre: layout.resolution().recip(),
            explained: term(field.params().density(params.explained_within) as f32),
        })
    }
}
