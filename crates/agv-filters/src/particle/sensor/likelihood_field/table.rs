//! The term that a beam adds, for every cell that it may end in.
//!
//! A term is `ln p` or `p³`, stored as one of 65,536 levels between the least and the greatest of the map, and, for the weighing of
//! particles, as one of 256: a quarter of the memory of an `f32`, so that four times as much of a map is in a cache, and sums that
//! are whole numbers, the same in any order. With the usual densities, from 0.005 to 1 per metre, a logarithm is off by 4e-5 at
//! most, and by 0.011 in the coarse levels: of sixty beams that count as eighteen, 0.015 in the mean. What weighs one pose by
//! distances, the refinement and the share of explained beams, reads the fine ones. In coarse levels of cubes what is below an
//! eighth of the greatest density weighs nothing: beside one beam that fits, a cube that small counts a five hundredth.

use super::{LikelihoodFieldModel, LikelihoodFieldModelParams};
use crate::particle::ScanForm;
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    grid::LikelihoodField,
};

/// What is looked up: the term of a beam, per cell, with a border for all that lies off the map.
#[derive(Debug)]
pub(super) struct Table {
    /// Levels, row by row; one cell more on every side.
    pub(super) terms: Vec<u16>,
    /// The same in 256 levels, for the weighing of many poses.
    pub(super) coarse: Vec<u8>,
    /// What level zero stands for, and how far the levels are apart.
    least: f64,
    step: f64,
    pub(super) stride: u32,
    /// Greatest column and row, border included.
    pub(super) last: [f32; 2],
    /// From the map to the grid, and metres to cells.
    pub(super) grid_from_map: Se2,
    pub(super) cells_per_metre: f64,
    /// Least level of an explained beam; above all levels if no cell of the map explains one.
    pub(super) explained: u32,
    /// The term of a beam that ends on what the map shows.
    pub(super) greatest: f64,
    /// Standard deviation of hits, in metres.
    pub(super) sigma: f64,
}

/// Fine levels from one coarse one to the next.
const COARSENESS: u32 = (u16::MAX / u8::MAX as u16) as u32;

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
    /// A map longer than [`LikelihoodFieldModel::MAX_SIDE`]; beams that are explained beyond the reach of the field.
    pub(super) fn new(field: &LikelihoodField, params: &LikelihoodFieldModelParams) -> Result<Self, Error> {
        let layout = field.layout();
        let (width, height) = (layout.width(), layout.height());
        for (name, side) in [("map width", width), ("map height", height)] {
            if side > LikelihoodFieldModel::MAX_SIDE {
                return Err(Error::TooMany { name, len: side, max: LikelihoodFieldModel::MAX_SIDE });
            }
        }
        let reach = field.params().max_distance;
        check::in_range("explained_within", params.explained_within, 0.0, reach.next_down())?;
        let term = |density: f32| match params.form {
            ScanForm::Product { .. } => f64::from(density).ln(),
            ScanForm::SumOfCubes => f64::from(density).powi(3),
        };
        let bounds = (field.off_map(), field.off_map());
        let (low, high) =
            field.values().iter().fold(bounds, |(low, high), &density| (low.min(density), high.max(density)));
        let (least, greatest) = (term(low), term(high));
        let step = (greatest - least) / f64::from(u16::MAX);
        // A map on which all densities are alike has one level.
        let levels_per_unit = if step > 0.0 { step.recip() } else { 0.0 };
        let level = |density: f32| ((term(density) - least) * levels_per_unit).round() as u16;
        let border = level(field.off_map());
        let explained = field.params().density(params.explained_within) as f32;
        let mut terms = Vec::with_capacity((width + 2) * (height + 2));
        terms.resize(width + 2, border);
        // A field has few values, one for each distance within reach: most logarithms are those of a cell before.
        let mut known = vec![(f32::NAN, border); 1 << PLACE_BITS];
        for row in field.values().chunks_exact(width) {
            terms.push(border);
            terms.extend(row.iter().map(|&density| {
                let (of, level_of) = &mut known[place(density)];
                if density != *of {
                    (*of, *level_of) = (density, level(density));
                }
                *level_of
            }));
            terms.push(border);
        }
        terms.resize((width + 2) * (height + 2), border);
        let coarse = terms.iter().map(|&level| ((u32::from(level) + COARSENESS / 2) / COARSENESS) as u8).collect();
        Ok(Self {
            coarse,
            greatest: term(field.params().density(0.0) as f32),
            sigma: field.params().sigma_hit,
            terms,
            least,
            step,
            stride: width as u32 + 2,
            last: [(width + 1) as f32, (height + 1) as f32],
            grid_from_map: layout.map_from_grid().inverse(),
            cells_per_metre: layout.resolution().recip(),
            explained: if explained > high { u32::MAX } else { u32::from(level(explained)) },
        })
    }

    /// What the levels of so many beams add up to.
    #[expect(clippy::inline_always, reason = "compiled with the kernel, for the instruction set found at run time")]
    #[inline(always)]
    pub(super) fn sum(&self, levels: u32, beams: usize) -> f64 {
        self.least * beams as f64 + self.step * f64::from(levels)
    }

    /// What the coarse levels of so many beams add up to.
    #[expect(clippy::inline_always, reason = "compiled with the kernel, for the instruction set found at run time")]
    #[inline(always)]
    pub(super) fn sum_of_coarse(&self, levels: u32, beams: usize) -> f64 {
        self.sum(levels * COARSENESS, beams)
    }
}
