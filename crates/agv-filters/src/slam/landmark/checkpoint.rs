//! A filter as it is stored: loading checks that its parts belong together.

use super::{
    LandmarkSlam, LandmarkSlamParams,
    ranging::Waiting,
    reading::SCALES,
    state::{POINTS, PointKind, SlamState},
};
use agv_core::{Error, check, geometry::LieGroup};

#[derive(serde::Deserialize)]
pub(super) struct RawLandmarkSlam {
    params: LandmarkSlamParams,
    state: SlamState,
    waiting: Vec<Waiting>,
    next: u32,
}

impl TryFrom<RawLandmarkSlam> for LandmarkSlam {
    type Error = Error;

    fn try_from(raw: RawLandmarkSlam) -> Result<Self, Error> {
        let fresh = Self::new(raw.params)?;
        let state = &raw.state;
        check::length("rows of the covariance", state.covariance.size(), POINTS + 2 * state.points.len())?;
        if !(state.is_finite() && state.map_from_base.is_finite()) {
            return Err(Error::NotFinite { name: "state", value: f64::NAN });
        }
        check::in_range("range_scale", state.scale, *SCALES.start(), *SCALES.end())?;
        check::covariance("pending motion", &state.pending)?;
        let rising = state.points.windows(2).all(|pair| pair[0].key < pair[1].key);
        let last = state.points.last().map_or(0, |point| point.key.saturating_add(1));
        if !rising || last > raw.next {
            return Err(Error::OutOfRange {
                name: "key of a point",
                value: f64::from(last),
                min: 0.0,
                max: f64::from(raw.next),
            });
        }
        for waiting in &raw.waiting {
            check::positive("spacing", waiting.spacing)?;
            check::in_range(
                "ranges that wait",
                waiting.ranges.len() as f64,
                0.0,
                fresh.params.range_start.most as f64,
            )?;
            for kept in &waiting.ranges {
                check::non_negative("range", kept.range)?;
                check::positive("variance of a range", kept.variance)?;
                let anchor = state.index_of(kept.anchor).map(|index| state.points[index].kind);
                if anchor != Some(PointKind::Anchor) {
                    let (value, max) = (f64::from(kept.anchor), f64::from(raw.next));
                    return Err(Error::OutOfRange { name: "anchor of a range", value, min: 0.0, max });
                }
            }
        }
        Ok(Self { state: raw.state, waiting: raw.waiting, next: raw.next, ..fresh })
    }
}
