//! What the vehicle sees: a costmap that rolls along, and the obstacles that move in it.

use crate::Result;
use agv_nav::{
    core::{
        grid::{CollisionParams, Footprint, InflationParams, LocalMapParams, RollingCostmap, RollingParams},
        obstacle::MovingObstacle,
    },
    filters::tracking::{ObstacleTracker, TrackerParams},
    nalgebra::Vector2,
    prelude::{CellState, Grid, LaserScan, LieGroup as _, LocalMap, Se2},
};

/// Edge of a cell, in metres.
const RESOLUTION: f64 = 0.05;

pub(crate) struct Sight {
    rolling: RollingCostmap,
    local: LocalMap,
    tracker: ObstacleTracker,
    /// Whether obstacles that move are taken to stand where they are: a planner without a sense of time.
    frozen: bool,
    obstacles: Vec<MovingObstacle>,
}

impl Sight {
    /// A view of a square window of so many metres, over what is known beforehand.
    pub(crate) fn new(
        footprint: &Footprint,
        window: f64,
        frozen: bool,
        known: Option<&Grid<CellState>>,
    ) -> Result<Self> {
        let cells = (window / RESOLUTION).ceil() as usize;
        let inflation = InflationParams {
            inflation_radius: footprint.circumscribed_radius() + 0.4,
            cost_scaling_factor: 4.0,
            ..InflationParams::for_footprint(footprint)
        };
        let params = RollingParams {
            width: cells,
            height: cells,
            resolution: RESOLUTION,
            forget_after: None,
            inflation: Some(inflation),
            ..RollingParams::default()
        };
        let mut rolling = RollingCostmap::new(params)?.with_footprint(footprint.clone());
        let mut tracker = ObstacleTracker::new(TrackerParams::default())?;
        if let Some(map) = known {
            rolling = rolling.with_static_map(map.clone())?;
            tracker = tracker.with_static_map(map)?;
        }
        // The scanner leaves a quarter behind the vehicle in the dark; what it has not seen must not pin it down.
        let collision = CollisionParams { unknown_is_obstacle: false, outside_is_obstacle: false };
        let local = LocalMap::new(rolling.costmap(), LocalMapParams { collision, max_distance: 3.0 })?;
        Ok(Self { rolling, local, tracker, frozen, obstacles: Vec::new() })
    }

    /// Takes a scan from where the vehicle believes to be; `told` is what moves, if that is not to be found in the scan.
    pub(crate) fn look(
        &mut self,
        scan: &LaserScan,
        map_from_base: &Se2,
        told: Option<&[MovingObstacle]>,
    ) -> Result<()> {
        let tracked = self.tracker.update(scan, map_from_base)?;
        self.obstacles.clear();
        self.obstacles.extend_from_slice(told.unwrap_or(tracked));
        if self.frozen {
            self.obstacles.iter_mut().for_each(|obstacle| obstacle.velocity = Vector2::zeros());
        }
        let (tracker, obstacles) = (&self.tracker, &self.obstacles);
        let map_from_sensor = *map_from_base * scan.geometry().base_from_sensor;
        self.rolling.update_where([scan], map_from_base, |_, beam| {
            if told.is_none() {
                return !tracker.is_moving_beam(beam);
            }
            let (sin, cos) = scan.geometry().angle(beam).sin_cos();
            let range = scan.ranges().get(beam).copied().map_or(0.0, f64::from);
            let point = map_from_sensor.act(&Vector2::new(range * cos, range * sin));
            !obstacles.iter().any(|obstacle| obstacle.distance_after(0.0, &point) < 0.15)
        })?;
        self.local.update(self.rolling.costmap())?;
        Ok(())
    }

    /// Forgets all that was seen.
    pub(crate) fn forget(&mut self) -> Result<()> {
        self.rolling.reset()?;
        Ok(())
    }

    pub(crate) const fn map(&self) -> &LocalMap {
        &self.local
    }

    pub(crate) fn obstacles(&self) -> &[MovingObstacle] {
        &self.obstacles
    }
}
