//! What hybrid A* knows of the vehicle, and how it searches.

use super::curve::CurveWeights;
use agv_core::{
    Error, check,
    kinematics::{Ackermann, AckermannParams, DoubleAckermannParams, SteeringLimits},
};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Parameters of a [`HybridAStar`](super::HybridAStar).
///
/// Few need a thought: the turning radius, which [`for_ackermann`](Self::for_ackermann) and
/// [`for_double_ackermann`](Self::for_double_ackermann) take from the vehicle, and what reversing costs. All costs are metres.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct HybridAStarParams {
    /// Least turning radius of the base frame, in metres.
    pub turning_radius: f64,
    /// Greatest angle between heading and motion of a vehicle that steers both axles alike, in radians; zero for one that
    /// cannot move aslant.
    pub crab_angle: f64,
    /// Whether the vehicle may drive backwards.
    pub may_reverse: bool,
    /// What a metre backwards costs in metres forwards; at least 1.
    pub reverse_weight: f64,
    /// Cost of a change between forwards and backwards, in metres.
    pub gear_change: f64,
    /// Cost of turning the wheels from straight ahead to their stop, in metres.
    pub steering_change: f64,
    /// How much dearer than a free cell the dearest one is, as [`GridParams::cost_weight`](crate::grid::GridParams::cost_weight).
    pub cost_weight: f64,
    /// Whether cells that were not observed are obstacles.
    pub unknown_is_obstacle: bool,
    /// Length of the motions that the search is made of, in metres. Shorter ones find their way through narrower places, and
    /// take longer. The tightest turn should be by a whole number of headings, as it is from
    /// [`for_turning_radius`](Self::for_turning_radius).
    pub step: f64,
    /// Edge of the cells of the lattice, in metres, rounded to whole cells of the map, as many as a step leaves: of all poses in one cell with about one
    /// heading, the search follows the cheapest.
    pub cell: f64,
    /// Headings that the lattice tells apart.
    pub headings: u16,
    /// Curvatures between straight ahead and the tightest turn, the latter included, to either side. With one, and steps that
    /// turn by four headings, motions from the start reach every fourth of all headings, which finds the same paths in a
    /// third of the expansions; with four they reach all.
    pub curvatures: u8,
    /// Most distance of the path's points, in metres.
    pub spacing: f64,
    /// How far from the goal pose the path may end if the vehicle cannot stand there, in metres.
    pub goal_tolerance: f64,
    /// How much the heading may differ there, in radians.
    pub goal_heading_tolerance: f64,
    /// By how much the search trusts its estimate of what is left to go, at least 1: the larger, the sooner it finds a path, and
    /// the dearer that may be before it is shortened.
    pub heuristic_weight: f64,
    /// A path is taken when no other can be cheaper by more than this share, as far as the weighted heuristic knows.
    pub slack: f64,
    /// Most expansions that are spent on a cheaper path after the first was found.
    pub refinement: u64,
    /// Whether the path is shortened by curves between its points.
    pub shorten: bool,
    /// Most states that a query expands.
    pub max_expansions: u64,
}

impl Default for HybridAStarParams {
    /// The tugger of [`AckermannParams`] (1.7 m turning radius), reversing at the double price as in Nav2's Smac planner, half
    /// a metre for a cusp; 72 headings as there, and motions that turn by four of them at the most: a third of the radius.
    fn default() -> Self {
        let (turning_radius, headings) = (1.2 / 35_f64.to_radians().tan(), 72);
        Self {
            turning_radius,
            crab_angle: 0.0,
            may_reverse: true,
            reverse_weight: 2.0,
            gear_change: 0.5,
            steering_change: 0.05,
            cost_weight: 0.0,
            unknown_is_obstacle: true,
            step: turning_radius * 4.0 * TAU / f64::from(headings),
            cell: 0.3,
            headings,
            curvatures: 1,
            spacing: 0.05,
            goal_tolerance: 0.0,
            goal_heading_tolerance: 0.0,
            heuristic_weight: 1.5,
            slack: 0.05,
            refinement: 200,
            shorten: true,
            max_expansions: 500_000,
        }
    }
}

impl HybridAStarParams {
    /// The parameters of a vehicle that turns no tighter than `radius` metres, its steps in proportion to it.
    ///
    /// # Errors
    /// A radius that is not finite and positive.
    pub fn for_turning_radius(radius: f64) -> Result<Self, Error> {
        check::positive("turning_radius", radius)?;
        let params = Self { turning_radius: radius, ..Self::default() };
        // A whole number of headings, where the step turns by one at all.
        let per_heading = radius * TAU / f64::from(params.headings);
        let wanted = (0.35 * radius).clamp(0.1, 1.5);
        let turned = (wanted / per_heading).round();
        let step = if turned > 0.0 { turned * per_heading } else { wanted };
        Ok(Self { step, cell: 0.5 * step, ..params })
    }

    /// The parameters of a vehicle that steers its front axle; the base frame is in the middle of the rear axle.
    ///
    /// # Errors
    /// A geometry that is none.
    pub fn for_ackermann(vehicle: &AckermannParams) -> Result<Self, Error> {
        Ackermann::new(*vehicle)?;
        Self::for_turning_radius(vehicle.wheelbase / vehicle.max_steering.tan())
    }

    /// The parameters of a vehicle that steers both axles: against each other, which with equal axles halves the turning
    /// radius, and alike, so that it moves aslant.
    ///
    /// # Errors
    /// A geometry that is none, or one that cannot turn without moving sideways.
    pub fn for_double_ackermann(vehicle: &DoubleAckermannParams) -> Result<Self, Error> {
        let radius = SteeringLimits::for_double_ackermann(vehicle, 1.0)?.min_turning_radius();
        let crab_angle = vehicle.max_front_steering.min(vehicle.max_rear_steering);
        Ok(Self { crab_angle, ..Self::for_turning_radius(radius)? })
    }

    /// Least length of a step in edges of a cell: a shorter one may end in the cell in which it began.
    pub(super) const STEP_PER_CELL: f64 = 1.42;

    /// Checks all fields.
    ///
    /// # Errors
    /// Names the first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("turning_radius", self.turning_radius, 1e-3, 1e4)?;
        check::in_range("crab_angle", self.crab_angle, 0.0, FRAC_PI_2.next_down())?;
        check::in_range("reverse_weight", self.reverse_weight, 1.0, 100.0)?;
        check::in_range("gear_change", self.gear_change, 0.0, 1e3)?;
        check::in_range("steering_change", self.steering_change, 0.0, 1e3)?;
        check::in_range("cost_weight", self.cost_weight, 0.0, crate::grid::GridParams::MAX_COST_WEIGHT)?;
        check::positive("cell", self.cell)?;
        // A shorter step may not leave its cell (which is looked at again with the map's own cells), and one of half a circle
        // is no small motion.
        check::in_range(
            "step",
            self.step,
            Self::STEP_PER_CELL * self.cell,
            std::f64::consts::PI * self.turning_radius,
        )?;
        check::in_range("headings", f64::from(self.headings), 8.0, 720.0)?;
        check::in_range("curvatures", f64::from(self.curvatures), 1.0, 8.0)?;
        check::in_range("spacing", self.spacing, 1e-3, f64::MAX)?;
        check::in_range("goal_tolerance", self.goal_tolerance, 0.0, 100.0)?;
        check::in_range("goal_heading_tolerance", self.goal_heading_tolerance, 0.0, std::f64::consts::PI)?;
        check::in_range("heuristic_weight", self.heuristic_weight, 1.0, 100.0)?;
        check::non_negative("slack", self.slack)?;
        Ok(())
    }

    /// What curves cost.
    pub(super) const fn weights(&self) -> CurveWeights {
        CurveWeights { reverse: self.reverse_weight, gear_change: self.gear_change }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vehicles_have_their_turning_radius() {
        let front = HybridAStarParams::for_ackermann(&AckermannParams::default()).unwrap();
        let both = HybridAStarParams::for_double_ackermann(&DoubleAckermannParams::default()).unwrap();
        assert!((front.turning_radius - HybridAStarParams::default().turning_radius).abs() < 1e-12);
        assert!((both.turning_radius - 0.5 * front.turning_radius).abs() < 1e-12);
        assert!(front.crab_angle == 0.0 && (both.crab_angle - 35_f64.to_radians()).abs() < 1e-12);
        assert!(front.validate().is_ok() && both.validate().is_ok() && HybridAStarParams::default().validate().is_ok());
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = HybridAStarParams::default();
        for (name, params) in [
            ("turning_radius", HybridAStarParams { turning_radius: 0.0, ..good }),
            ("turning_radius", HybridAStarParams { turning_radius: f64::NAN, ..good }),
            ("turning_radius", HybridAStarParams { turning_radius: f64::INFINITY, ..good }),
            ("crab_angle", HybridAStarParams { crab_angle: -0.1, ..good }),
            ("crab_angle", HybridAStarParams { crab_angle: 2.0, ..good }),
            ("reverse_weight", HybridAStarParams { reverse_weight: 0.5, ..good }),
            ("gear_change", HybridAStarParams { gear_change: -1.0, ..good }),
            ("gear_change", HybridAStarParams { gear_change: f64::NAN, ..good }),
            ("steering_change", HybridAStarParams { steering_change: f64::INFINITY, ..good }),
            ("cost_weight", HybridAStarParams { cost_weight: -1.0, ..good }),
            ("cell", HybridAStarParams { cell: 0.0, ..good }),
            ("step", HybridAStarParams { step: 0.4, ..good }),
            ("step", HybridAStarParams { step: 1e9, ..good }),
            ("step", HybridAStarParams { step: f64::NAN, ..good }),
            ("headings", HybridAStarParams { headings: 0, ..good }),
            ("curvatures", HybridAStarParams { curvatures: 0, ..good }),
            ("spacing", HybridAStarParams { spacing: 0.0, ..good }),
            ("goal_tolerance", HybridAStarParams { goal_tolerance: -1.0, ..good }),
            ("goal_heading_tolerance", HybridAStarParams { goal_heading_tolerance: 4.0, ..good }),
            ("heuristic_weight", HybridAStarParams { heuristic_weight: 0.5, ..good }),
            ("slack", HybridAStarParams { slack: f64::NAN, ..good }),
        ] {
            let error = params.validate().unwrap_err().to_string();
            assert!(error.starts_with(name), "{name}: {error}");
        }
        assert!(HybridAStarParams::for_turning_radius(f64::NAN).is_err());
        let no_front = DoubleAckermannParams { front: 0.0, ..Default::default() };
        assert!(HybridAStarParams::for_double_ackermann(&no_front).is_err());
        let flat = AckermannParams { max_steering: 0.0, ..Default::default() };
        assert!(HybridAStarParams::for_ackermann(&flat).is_err());
    }
}
