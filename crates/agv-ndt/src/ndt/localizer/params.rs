//! What a localizer by normal distributions may be told.

use super::super::params::NdtParams;
use agv_core::{Error, check, geometry::PoseSigma, roles::StatusParams};

/// How fast a prediction gets uncertain, beyond what the odometry says of its own noise.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DriftParams {
    /// Of the position along every axis, in metres per square root of a metre driven.
    pub position: f64,
    /// Of the attitude about every axis, in radians per square root of a metre driven.
    pub attitude: f64,
    /// Of the attitude, in radians per square root of a radian turned.
    pub turning: f64,
    /// Of position and attitude at rest, in metres or radians per square root of a second.
    pub resting: f64,
}

impl Default for DriftParams {
    /// A well kept vehicle on an industrial floor: 2 cm and 0.6° after a metre, 1.1° after a turn of a radian, and a millimetre a
    /// second for what its springs do.
    fn default() -> Self {
        Self { position: 0.02, attitude: 0.01, turning: 0.02, resting: 0.001 }
    }
}

/// How a vehicle is looked for that may be anywhere.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SearchParams {
    /// Distance of the places on the map's floor that are tried, in metres; places of one's own may replace them.
    pub spacing: f64,
    /// Headings that are tried at each place.
    pub headings: usize,
    /// Most starts, places times headings, that a search judges: of more places one in every square is tried that is just large
    /// enough, so that the work of an update is bounded. Where that is less than a place every 2 m or so the right one may be missed: give
    /// places of one's own, or more starts, in larger maps.
    pub max_starts: usize,
    /// Best of the starts, by their score on the coarsest voxels, that are followed to their optimum; the belief's mean is besides.
    pub finalists: usize,
    /// How far the best one's share of inliers must exceed that of every other place, from 0 to 1.
    pub lead: f64,
    /// How far around the last belief a lost vehicle is looked for first, in metres; twice as far at each further try.
    pub radius: f64,
}

impl Default for SearchParams {
    /// Places every metre and headings every 22.5°, well within the basin of the 4 m voxels that they are judged by; a twentieth of
    /// the points for which no other place may come up. 20 000 starts are a place per square metre of a hall of 50 m x 25 m. 30 m is
    /// a quarter of a minute without a fix at 2 m/s; in a smaller circle the right place may be missing, and one that looks like it be
    /// taken.
    fn default() -> Self {
        Self { spacing: 1.0, headings: 16, max_starts: 20_000, finalists: 32, lead: 0.05, radius: 30.0 }
    }
}

impl SearchParams {
    fn validate(&self) -> Result<(), Error> {
        check::in_range("search spacing", self.spacing, 0.1, 1000.0)?;
        check::in_range("search headings", self.headings as f64, 1.0, 360.0)?;
        check::in_range("search starts", self.max_starts as f64, self.headings as f64, 1e7)?;
        check::in_range("search finalists", self.finalists as f64, 1.0, 10_000.0)?;
        check::in_range("search lead", self.lead, 0.0, 1.0)?;
        check::positive("search radius", self.radius)?;
        Ok(())
    }
}

/// Parameters of an [`NdtLocalizer`](super::NdtLocalizer).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NdtLocalizerParams {
    /// The registration; its voxels must be those of the map.
    pub ndt: NdtParams,
    /// Edge of the cubes that a cloud is thinned out to, in metres.
    pub leaf: f32,
    /// Points that a thinned cloud must have.
    pub min_points: usize,
    /// How fast predictions get uncertain.
    pub drift: DriftParams,
    /// Share of the points whose errors are independent of each other's, in (0, 1]: what the registration's information is multiplied
    /// with.
    pub independent: f64,
    /// Standard deviation that a match has however many points there are: errors of the map's cells and of the mount.
    pub floor: PoseSigma,
    /// Normalised innovation squared beyond which a match is not believed.
    pub gate: f64,
    /// For how long motions are remembered, in seconds: a cloud may be as old.
    pub history: f64,
    /// How far beyond the remembered motions they may be carried on, in seconds.
    pub extrapolation: f64,
    /// How a vehicle is looked for that may be anywhere, or is lost; none to follow the prediction alone, as while a map grows.
    pub search: Option<SearchParams>,
    /// When an estimate is trusted.
    pub status: StatusParams,
}

impl Default for NdtLocalizerParams {
    /// Directions that are not observed are held to the prediction. Half of the points, and a floor of 1.5 mm and 0.02°, for which the
    /// normalised errors in generated factories are those of their covariances. A gate of 60, far beyond six degrees of freedom, but
    /// below the next bay of a rack. Right poses explain 0.64 to 0.81 of the points and wrong ones at most 0.50 (as [`NdtParams`]
    /// has it).
    fn default() -> Self {
        Self {
            ndt: NdtParams { hold_unobserved: true, ..NdtParams::default() },
            leaf: 0.25,
            min_points: 100,
            drift: DriftParams::default(),
            independent: 0.5,
            floor: PoseSigma { translation: 0.0015, rotation: 0.02_f64.to_radians() },
            gate: 60.0,
            history: 1.0,
            extrapolation: 0.2,
            search: Some(SearchParams::default()),
            status: StatusParams { explained: 0.55, unexplained: 0.4, smoothing: 0.3, ..StatusParams::default() },
        }
    }
}

impl NdtLocalizerParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first parameter that is out of its range, by name.
    pub fn validate(&self) -> Result<(), Error> {
        let drift = &self.drift;
        self.ndt.validate()?;
        self.status.validate()?;
        self.floor.checked()?;
        check::in_range("leaf", f64::from(self.leaf), 0.001, 1000.0)?;
        check::at_least("min_points", self.min_points, 1)?;
        check::non_negative("position drift", drift.position)?;
        check::non_negative("attitude drift", drift.attitude)?;
        check::non_negative("turning drift", drift.turning)?;
        check::non_negative("resting drift", drift.resting)?;
        check::positive("independent", self.independent)?;
        check::in_range("independent", self.independent, 0.0, 1.0)?;
        check::positive("gate", self.gate)?;
        check::non_negative("history", self.history)?;
        check::non_negative("extrapolation", self.extrapolation)?;
        self.search.as_ref().map_or(Ok(()), SearchParams::validate)
    }
}
