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
    /// The term of a beam that ends on what the map shows.
    pub(super) greatest: f32,
    /// Standard deviation of hits, in metres.
    pub(super) sigma: f64,
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
        // Most of a map is far from everything: a logarithm per run of equal cells is enough.
        let mut last = (f32::NAN, border);
        for row in field.values().chunks_exact(width) {
            terms.push(border);
            terms.extend(row.iter().map(|&density| {
                if density != last.0 {
                    last = (density, term(density));
                }
                last.1
            }));
            terms.push(border);
        }
        terms.resize((width + 2) * (height + 2), border);
        Ok(Self {
            greatest: term(field.params().density(0.0) as f32),
            sigma: field.params().sigma_hit,
            terms,
            stride: width as u32 + 2,
            last: [(width + 1) as f32, (height + 1) as f32],
            grid_from_map: layout.map_from_grid().inverse(),
            cells_per_metre: layout.resolution().recip(),
            explained: term(field.params().density(params.explained_within) as f32),
        })
    }
}
