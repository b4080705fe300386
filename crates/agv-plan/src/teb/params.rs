//! What a band is asked for.

use agv_core::{Error, check, grid::Footprint};

/// Parameters of a [`Teb`](super::Teb).
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TebParams {
    /// Outline of the vehicle.
    pub footprint: Footprint,
    /// How far ahead of the vehicle the band reaches along the path at the least, in metres: farther if the vehicle needs more to
    /// brake from its greatest speed (a fifth more than that, but no more than 10 000 spacings).
    pub horizon: f64,
    /// Distance of the band's poses, in metres.
    pub spacing: f64,
    /// Turn between two poses of the band, in radians.
    pub turn: f64,
    /// Clearance that the band keeps from obstacles wherever there is room, in metres.
    pub clearance: f64,
    /// Clearance beyond that, which it is drawn to by the weight of [`TebWeights::inflation`], in metres; zero for none.
    pub inflation: f64,
    /// Clearance below which the vehicle drives more slowly, in metres.
    pub caution: f64,
    /// Speed at no clearance at all, in metres per second.
    pub cautious_speed: f64,
    /// Share of the accelerations that is planned with: what is left is for following the plan.
    pub acceleration_share: f64,
    /// How far from the end the vehicle has arrived, in metres.
    pub position_tolerance: f64,
    /// How far from the last heading it has arrived, in radians.
    pub yaw_tolerance: f64,
    /// Most steps of the solver in a cycle, for a band that goes on from the last cycle's.
    pub warm_iterations: usize,
    /// Most steps of the solver for a band that is new.
    pub cold_iterations: usize,
    /// Share of the chosen way's duration that another way must not exceed to be taken instead, below one.
    pub switch_share: f64,
    /// How far to the side of the path ways around obstacles are looked for, in metres; zero to keep to the path.
    pub max_detour: f64,
    /// Most ways around obstacles that are optimised in one cycle, each of another homotopy class: the least detours first. Zero
    /// to keep to the path.
    pub max_ways: usize,
    /// What the residuals weigh.
    pub weights: TebWeights,
}

/// Weights of the squared residuals; named as those of `teb_local_planner` are where it has them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TebWeights {
    /// Square of each interval, in 1/s².
    pub time: f64,
    /// Square of each length, in 1/m².
    pub length: f64,
    /// Speed and turn rate beyond their limits.
    pub velocity: f64,
    /// Accelerations beyond their limits.
    pub acceleration: f64,
    /// Motion sideways of a vehicle that cannot.
    pub kinematics: f64,
    /// Motion against the gear.
    pub gear: f64,
    /// Curvature beyond the tightest turn.
    pub turning_radius: f64,
    /// Clearance missing.
    pub obstacle: f64,
    /// Clearance missing to [`TebParams::inflation`].
    pub inflation: f64,
    /// Clearance missing to obstacles that move.
    pub moving: f64,
    /// Distance to points to pass.
    pub via: f64,
    /// Turning to the other side than wanted.
    pub rotation: f64,
}

impl Default for TebWeights {
    /// `teb_local_planner`'s, but for: speeds, gear and turning radius, which weigh 2, 1 and 1 there and more here, for limits are kept
    /// in the end; a side of rotation that is preferred, 50 there; and tension, none there, so that a slow band is a short one too.
    fn default() -> Self {
        Self {
            time: 1.0,
            length: 1.0,
            velocity: 10.0,
            acceleration: 1.0,
            kinematics: 1000.0,
            gear: 100.0,
            turning_radius: 100.0,
            obstacle: 50.0,
            inflation: 0.1,
            moving: 50.0,
            via: 1.0,
            rotation: 10.0,
        }
    }
}

impl TebParams {
    /// Defaults for a vehicle: poses half its radius apart, from 0.1 to 0.3 m, and a horizon more than three times as long as a
    /// vehicle of 2 m/s takes to stop at 1.7 m/s². With a clearance of 0.12 m, and half a metre per second where there is none, the
    /// fields of cylinders of the tests are all crossed, at more than a metre per second in the mean.
    pub fn for_footprint(footprint: Footprint) -> Self {
        let radius = footprint.circumscribed_radius();
        Self {
            horizon: 4.0,
            spacing: (0.5 * radius).clamp(0.1, 0.3),
            turn: 0.4,
            clearance: 0.12,
            inflation: 0.0,
            caution: 0.3,
            cautious_speed: 0.5,
            acceleration_share: 0.85,
            position_tolerance: 0.1,
            yaw_tolerance: 0.1,
            warm_iterations: 6,
            cold_iterations: 30,
            switch_share: 0.75,
            max_detour: 2.5,
            max_ways: 3,
            weights: TebWeights::default(),
            footprint,
        }
    }

    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range, by name.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("horizon", self.horizon)?;
        check::positive("spacing", self.spacing)?;
        check::in_range("horizon (poses)", self.horizon / self.spacing, 1.0, 10_000.0)?;
        check::in_range("turn", self.turn, 1e-3, std::f64::consts::PI)?;
        check::non_negative("clearance", self.clearance)?;
        check::non_negative("inflation", self.inflation)?;
        check::non_negative("caution", self.caution)?;
        check::positive("cautious_speed", self.cautious_speed)?;
        check::in_range("acceleration_share", self.acceleration_share, 0.01, 1.0)?;
        check::positive("position_tolerance", self.position_tolerance)?;
        check::positive("yaw_tolerance", self.yaw_tolerance)?;
        check::at_least("warm_iterations", self.warm_iterations, 1)?;
        check::at_least("cold_iterations", self.cold_iterations, 1)?;
        check::in_range("switch_share", self.switch_share, 0.0, 1.0)?;
        check::in_range("max_detour", self.max_detour, 0.0, 1000.0)?;
        check::in_range("max_ways", self.max_ways as f64, 0.0, 64.0)?;
        let w = &self.weights;
        for (name, weight) in [
            ("time weight", w.time),
            ("length weight", w.length),
            ("velocity weight", w.velocity),
            ("acceleration weight", w.acceleration),
            ("kinematics weight", w.kinematics),
            ("gear weight", w.gear),
            ("turning radius weight", w.turning_radius),
            ("obstacle weight", w.obstacle),
            ("inflation weight", w.inflation),
            ("moving weight", w.moving),
            ("via weight", w.via),
            ("rotation weight", w.rotation),
        ] {
            check::non_negative(name, weight)?;
        }
        check::positive("time weight", w.time).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = TebParams::for_footprint(Footprint::point());
        assert_eq!(good.validate(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            for (name, params) in [
                ("horizon", TebParams { horizon: bad, ..good.clone() }),
                ("spacing", TebParams { spacing: bad, ..good.clone() }),
                ("turn", TebParams { turn: bad, ..good.clone() }),
                ("clearance", TebParams { clearance: bad, ..good.clone() }),
                ("inflation", TebParams { inflation: bad, ..good.clone() }),
                ("caution", TebParams { caution: bad, ..good.clone() }),
                ("cautious_speed", TebParams { cautious_speed: bad, ..good.clone() }),
                ("acceleration_share", TebParams { acceleration_share: bad, ..good.clone() }),
                ("position_tolerance", TebParams { position_tolerance: bad, ..good.clone() }),
                ("yaw_tolerance", TebParams { yaw_tolerance: bad, ..good.clone() }),
                ("switch_share", TebParams { switch_share: bad, ..good.clone() }),
                ("max_detour", TebParams { max_detour: bad, ..good.clone() }),
                ("via weight", TebParams { weights: TebWeights { via: bad, ..good.weights }, ..good.clone() }),
            ] {
                assert!(params.validate().unwrap_err().to_string().starts_with(name), "{name} {bad}");
            }
        }
        assert!(TebParams { horizon: 0.0, ..good.clone() }.validate().is_err());
        assert!(TebParams { max_ways: 1000, ..good.clone() }.validate().is_err());
        assert!(TebParams { cold_iterations: 0, ..good }.validate().is_err());
    }
}
