//! The site: a room of 10 m by 10 m, a lap through it, and a ring of codes along the lap.

use super::Result;
use agv_nav::{
    core::{
        kinematics::MotionLimits,
        path::shapes,
        sensors::{PinholeCamera, PinholeParams},
    },
    filters::marker::{FloorProjection, MarkerMap, looking_down},
    nalgebra::Vector2,
    prelude::*,
};
use agv_sim::{FloorCode, LaserParams, OdometryErrors, VehicleParams};

/// Seconds of a cycle: odometry, camera and tracker.
pub(crate) const DT: f64 = 0.05;

/// Edge of a map cell, in metres.
const RESOLUTION: f64 = 0.05;

/// Everything that the runs share.
pub(crate) struct Site {
    pub(crate) map: Grid<CellState>,
    pub(crate) lap: Path,
    pub(crate) codes: Vec<FloorCode>,
    pub(crate) code_map: MarkerMap,
    pub(crate) projection: FloorProjection,
    pub(crate) limits: MotionLimits,
    pub(crate) vehicle: VehicleParams,
    pub(crate) laser: LaserParams,
}

impl Site {
    pub(crate) fn new(code_spacing: f64) -> Result<Self> {
        // Paper 001, Table 3: 1 m/s, 1 rad/s, 0.5 m/s², 0.5 rad/s²; laser of 320°, 10 m. 321 beams with 2 cm of noise.
        let limits = TwistLimits { yaw_acceleration: 0.5, ..TwistLimits::default() };
        let vehicle = VehicleParams {
            limits,
            time_constant: 0.15,
            odometry: OdometryErrors::default(),
            ..VehicleParams::default()
        };
        let mut laser = LaserParams::default().with_beams(321, 320_f64.to_radians());
        (laser.geometry.range_max, laser.range_sigma) = (10.0, 0.02);
        let corners = [(5.0, 2.5), (7.5, 2.5), (7.5, 7.5), (2.5, 7.5), (2.5, 2.5), (5.0, 2.5)];
        let lap = shapes::rounded(&corners.map(|(x, y)| Vector2::new(x, y)), 1.0, 0.02)?;
        let codes = ring(&lap, code_spacing);
        let code_map = MarkerMap::from_exact(codes.iter().map(|code| (code.id, code.map_from_code)))?;
        // Under the middle of the vehicle, 30 cm above the floor.
        let camera = PinholeCamera::new(PinholeParams::default())?;
        let projection = FloorProjection::new(camera, looking_down(Vector2::zeros(), 0.3, 0.0))?;
        Ok(Self { map: room()?, lap, codes, code_map, projection, limits: limits.into(), vehicle, laser })
    }

    /// Where every lap begins and ends: over the first code.
    pub(crate) fn station(&self) -> Se2 {
        self.lap.points().first().map(|point| point.pose).unwrap_or_default()
    }
}

/// Codes along the lap, turned as it leads; number 0 is the station.
fn ring(lap: &Path, spacing: f64) -> Vec<FloorCode> {
    let count = (lap.length() / spacing).round().max(1.0);
    let spacing = lap.length() / count;
    let (mut codes, mut driven) = (Vec::new(), 0.0);
    for pair in lap.points().windows(2) {
        if codes.len() < count as usize && driven + 1e-9 >= spacing * codes.len() as f64 {
            codes.push(FloorCode { id: codes.len() as u32, map_from_code: pair[0].pose });
        }
        driven += (pair[1].pose.translation() - pair[0].pose.translation()).norm();
    }
    codes
}

/// Walls, two pillars, a shelf and crates, so that no two corners look alike.
fn room() -> Result<Grid<CellState>> {
    let mut map = Grid::filled(GridLayout::new(200, 200, RESOLUTION, Se2::default())?, CellState::Free);
    // Lower left and upper right corner, in metres.
    let boxes = [
        (0.0, 0.0, 10.0, 0.1),
        (0.0, 9.9, 10.0, 10.0),
        (0.0, 0.0, 0.1, 10.0),
        (9.9, 0.0, 10.0, 10.0),
        (4.0, 4.5, 4.3, 4.8),
        (5.6, 5.8, 6.4, 6.2),
        (0.1, 6.0, 0.7, 8.5),
        (8.8, 1.0, 9.3, 1.6),
        (3.0, 9.2, 4.5, 9.9),
        (6.0, 0.1, 6.4, 0.8),
    ];
    for index in 0..map.layout().len() {
        let cell = map.layout().cell(index);
        let place = map.layout().center(cell);
        let is_inside =
            |&(x0, y0, x1, y1): &(f64, f64, f64, f64)| (x0..x1).contains(&place.x) && (y0..y1).contains(&place.y);
        if boxes.iter().any(is_inside) {
            map.set(cell, CellState::Occupied);
        }
    }
    Ok(map)
}
