//! A library of codes laid out in a pattern, by which codes are known that cannot be read (paper 001, section 3.2, Eqs. 11
//! and 15–17).
//!
//! A dirty code still shows where it is, not who it is. Three codes that are seen form a triangle; the library holds every
//! triangle of its codes by its sides, and each that matches proposes where the pattern lies. The proposal that explains most
//! of what is seen wins; if another explains as much with other numbers, the match is ambiguous, and said to be.

use super::{
    rigid_fit::{RigidFit, rigid_motion},
    triangle::Triangle,
};
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose},
};
use nalgebra::{Matrix2, Vector2};

/// Most codes of one image that are looked at.
pub const MOST_SIGHTED: usize = 16;

/// Most codes of a library.
const MOST_CODES: usize = 256;

/// Parameters of a [`TemplateLibrary`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TemplateParams {
    /// Standard deviation of a sighted place along each axis, in metres.
    pub place_sigma: f64,
    /// Distance up to which a sighted place is that of a code, in metres; at least three deviations.
    pub tolerance: f64,
    /// Longest side of a triangle that one image can show, in metres.
    pub longest_side: f64,
}

impl Default for TemplateParams {
    /// The places of a floor camera half a metre up, 2 mm by half a pixel and a floor that is not quite level, and four deviations; an
    /// image a metre wide.
    fn default() -> Self {
        Self { place_sigma: 0.002, tolerance: 0.008, longest_side: 1.0 }
    }
}

/// A code of the image: where it is, in any one frame of the vehicle in metres, and who, if it could be read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SightedCode {
    /// Place of the centre.
    pub place: Vector2<f64>,
    /// What was read.
    pub id: Option<u32>,
}

/// What the library says of the codes of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
#[expect(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum TemplateMatch {
    /// They are known.
    Identified(Identification),
    /// Two readings explain as many of them, with different numbers.
    Ambiguous {
        /// How many codes either explains.
        explained: usize,
    },
    /// No triangle of them is in the library.
    Unmatched,
}

/// Who the codes of an image are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identification {
    /// The number of each sighted code, in their order; none for what is no code of the library.
    pub ids: [Option<u32>; MOST_SIGHTED],
    /// How many have a number.
    pub explained: usize,
    /// Pose of the frame that the places were given in, in the library's frame.
    pub library_from_sighted: UncertainPose<Se2>,
    /// Squared residuals by the places' variance: chi-square of `2 explained - 3` degrees of freedom.
    pub chi_square: f64,
}

/// Codes by their places, and every triangle of them.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_filters::marker::{SightedCode, TemplateLibrary, TemplateMatch, TemplateParams, nine_codes};
///
/// let library = TemplateLibrary::new(nine_codes(40, 0.3), TemplateParams::default())?;
/// // Three codes of which not one could be read, in the frame of a camera that is turned by a quarter.
/// let seen = [40, 43, 47].map(|id| library.place(id).expect("a code of the library"));
/// let seen = seen.map(|place| SightedCode { place: Vector2::new(place.y, -place.x), id: None });
/// let TemplateMatch::Identified(found) = library.identify(&seen) else { panic!("they are known") };
/// assert_eq!(found.ids[..3], [Some(40), Some(43), Some(47)]);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct TemplateLibrary {
    params: TemplateParams,
    /// By their numbers.
    codes: Vec<(u32, Vector2<f64>)>,
    /// By their longest sides.
    triangles: Vec<Triangle>,
}

/// Nine codes numbered from `first` on, three by three about `pitch` metres apart, shifted so that no two of their 84 triangles
/// are alike: some side differs by 0.143 pitches or more, reflections apart. The best of a search over shifts by multiples of
/// 0.05 pitches.
pub fn nine_codes(first: u32, pitch: f64) -> [(u32, Vector2<f64>); 9] {
    const PLACES: [(f64, f64); 9] = [
        (-0.15, -0.05),
        (0.9, 0.3),
        (2.3, -0.35),
        (0.3, 0.75),
        (0.9, 0.9),
        (2.1, 1.35),
        (-0.1, 2.2),
        (1.25, 2.1),
        (2.1, 1.75),
    ];
    let mut id = first;
    PLACES.map(|(x, y)| {
        let code = (id, Vector2::new(x, y) * pitch);
        id = id.wrapping_add(1);
        code
    })
}

/// What a proposal says.
#[derive(Clone, Copy)]
struct Proposal {
    pose: Se2,
    codes: [Option<u16>; MOST_SIGHTED],
    explained: usize,
    squares: f64,
}

impl TemplateLibrary {
    /// A library of codes at these places of one frame, in metres. O(codes³) once.
    ///
    /// # Errors
    /// [`Error::TooFew`] below three codes, [`Error::TooMany`] above 256; a place that is not finite, a number given twice
    /// ([`Error::OutOfRange`]); parameters out of their range.
    pub fn new(codes: impl IntoIterator<Item = (u32, Vector2<f64>)>, params: TemplateParams) -> Result<Self, Error> {
        check::positive("place_sigma", params.place_sigma)?;
        check::in_range("tolerance", params.tolerance, 3.0 * params.place_sigma, f64::MAX)?;
        check::in_range("longest_side", params.longest_side, params.tolerance, f64::MAX)?;
        let mut codes: Vec<_> = codes.into_iter().take(MOST_CODES + 1).collect();
        check::at_least("codes", codes.len(), 3)?;
        if codes.len() > MOST_CODES {
            return Err(Error::TooMany { name: "codes", len: codes.len(), max: MOST_CODES });
        }
        codes.iter().try_for_each(|(_, place)| check::all_finite("place of a code", place.iter()))?;
        codes.sort_by_key(|&(id, _)| id);
        if let Some(pair) = codes.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let value = f64::from(pair[0].0);
            return Err(Error::OutOfRange {
                name: "number of a second code",
                value,
                min: value + 1.0,
                max: f64::INFINITY,
            });
        }
        let mut triangles = Vec::new();
        for i in 0..codes.len() {
            for j in i + 1..codes.len() {
                for k in j + 1..codes.len() {
                    let corners = [i, j, k];
                    let triangle =
                        Triangle::new(corners.map(|c| c as u16), corners.map(|c| codes[c].1), 2.0 * params.tolerance);
                    triangles.extend(triangle.filter(|t| t.longest() <= params.longest_side));
                }
            }
        }
        triangles.sort_by(|a, b| a.longest().total_cmp(&b.longest()));
        Ok(Self { params, codes, triangles })
    }

    /// Place of a code.
    pub fn place(&self, id: u32) -> Option<Vector2<f64>> {
        let index = self.codes.binary_search_by_key(&id, |&(id, _)| id).ok()?;
        self.codes.get(index).map(|&(_, place)| place)
    }

    /// Number of triangles by which codes are known.
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Least difference between two triangles of the library, or of one and itself turned: the greatest of the differences of
    /// their sides, in metres. Below four tolerances, three codes alone can be ambiguous. O(triangles²).
    pub fn separation(&self) -> f64 {
        let mut least = f64::INFINITY;
        for (i, a) in self.triangles.iter().enumerate() {
            for (shift, b) in (1..3)
                .map(|shift| (shift, a))
                .chain(self.triangles[i + 1..].iter().flat_map(|b| (0..3).map(move |shift| (shift, b))))
            {
                least = least.min(a.mismatch(b, shift));
            }
        }
        least
    }

    /// Who the codes of an image are. Those beyond [`MOST_SIGHTED`] are not looked at, nor are those at places that are not finite.
    ///
    /// O(sighted³ candidates sighted codes) in the worst case, where candidates are the library's triangles of about the same
    /// longest side; no allocation.
    pub fn identify(&self, sighted: &[SightedCode]) -> TemplateMatch {
        let sighted = &sighted[..sighted.len().min(MOST_SIGHTED)];
        let (mut best, mut is_ambiguous) = (None::<Proposal>, false);
        for i in 0..sighted.len() {
            for j in i + 1..sighted.len() {
                for k in j + 1..sighted.len() {
                    let corners = [i, j, k];
                    let places = corners.map(|c| sighted[c].place);
                    let Some(seen) = Triangle::new(corners.map(|c| c as u16), places, 2.0 * self.params.tolerance)
                    else {
                        continue;
                    };
                    self.propose(&seen, sighted, &mut best, &mut is_ambiguous);
                }
            }
        }
        match best {
            None => TemplateMatch::Unmatched,
            Some(best) if is_ambiguous => TemplateMatch::Ambiguous { explained: best.explained },
            Some(best) => self.settle(&best, sighted).map_or(TemplateMatch::Unmatched, TemplateMatch::Identified),
        }
    }

    /// Tries every triangle of the library that may be the one that is seen.
    fn propose(&self, seen: &Triangle, sighted: &[SightedCode], best: &mut Option<Proposal>, is_ambiguous: &mut bool) {
        // Each end of a side may be off by the tolerance.
        let slack = 2.0 * self.params.tolerance;
        let from = self.triangles.partition_point(|known| known.longest() < seen.longest() - slack);
        let candidates = self.triangles[from..].iter().take_while(|known| known.longest() <= seen.longest() + slack);
        for (known, shift) in candidates.flat_map(|known| (0..3).map(move |shift| (known, shift))) {
            if seen.mismatch(known, shift) > slack {
                continue;
            }
            let pairs = (0..3).map(|i| {
                let code = usize::from(known.corners[(i + shift) % 3]);
                (sighted[usize::from(seen.corners[i])].place, self.codes[code].1)
            });
            let Some(pose) = rigid_motion(pairs) else { continue };
            let Some(proposal) = self.explain(&pose, sighted) else { continue };
            let known_best = best.map_or(0, |best| best.explained);
            let differs = best.is_some_and(|best| best.codes != proposal.codes);
            if proposal.explained > known_best {
                (*best, *is_ambiguous) = (Some(proposal), false);
            } else if proposal.explained == known_best && differs {
                *is_ambiguous = true;
            } else if proposal.explained == known_best && best.is_some_and(|best| proposal.squares < best.squares) {
                *best = Some(proposal);
            }
        }
    }

    /// Which codes are where the places are if the pattern lies like that; none for fewer than three, or against what was read.
    fn explain(&self, pose: &Se2, sighted: &[SightedCode]) -> Option<Proposal> {
        let mut proposal = Proposal { pose: *pose, codes: [None; MOST_SIGHTED], explained: 0, squares: 0.0 };
        let numbers = |code: &SightedCode| code.place.iter().all(|value| value.is_finite());
        for (slot, code) in proposal.codes.iter_mut().zip(sighted).filter(|(_, code)| numbers(code)) {
            let place = *pose * code.place;
            let distances = self.codes.iter().map(|(_, known)| (place - known).norm_squared()).enumerate();
            let Some((nearest, squared)) = distances.min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
            let is_there = squared <= self.params.tolerance * self.params.tolerance;
            // A code of the library that was read is where the library has it, or the proposal is wrong.
            if let Some(id) = code.id.filter(|&id| self.place(id).is_some())
                && !(is_there && self.codes[nearest].0 == id)
            {
                return None;
            }
            if is_there {
                *slot = Some(nearest as u16);
                (proposal.explained, proposal.squares) = (proposal.explained + 1, proposal.squares + squared);
            }
        }
        (proposal.explained >= 3).then_some(proposal)
    }

    /// The fit over all codes that are explained.
    fn settle(&self, best: &Proposal, sighted: &[SightedCode]) -> Option<Identification> {
        let mut fit = RigidFit::<MOST_SIGHTED>::default();
        let covariance = Matrix2::identity() * (self.params.place_sigma * self.params.place_sigma);
        let mut ids = [None; MOST_SIGHTED];
        for ((slot, code), seen) in ids.iter_mut().zip(&best.codes).zip(sighted) {
            if let Some(&(id, place)) = code.and_then(|code| self.codes.get(usize::from(code))) {
                *slot = Some(id);
                fit.add(seen.place, place, &covariance)?;
            }
        }
        let fitted = fit.solve(&best.pose)?;
        Some(Identification {
            ids,
            explained: best.explained,
            library_from_sighted: fitted.pose,
            chi_square: fitted.chi_square,
        })
    }
}

#[cfg(test)]
mod tests;
