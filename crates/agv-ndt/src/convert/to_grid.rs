//! Recorded clouds at the poses of a 3D map, as the 2D grid that planners take.
//!
//! Paper 003, Eqs. 4 to 11: cells add up log-odds. Ground and height band choose the points ([`CloudToScan`]); what a cloud has seen
//! flat is then cast into the grid ray by ray, so that cells before an obstacle become free and those that no ray meets stay unknown.
//! Free space needs the places that clouds were taken from, which the finished 3D map does not know any more: hence the recorded
//! clouds and not the map's points. A direction without an obstacle says nothing, since its beams may all have passed above.
//!
//! Evidence adds up in any order to the same bits ([`EvidenceGrid`]), so that the clouds of many vehicles make one grid.

use super::to_scan::{CloudToScan, CloudToScanParams, CloudToScanReport};
use crate::checks::finite_pose;
use agv_core::{
    Error, check,
    geometry::{Se2, Se3},
    grid::{CellState, EvidenceGrid, Grid, GridLayout, InverseModelParams, OccupancyThresholds, ScanInsertion},
    sensors::{LaserScan, PointCloud, ScanGeometry},
    time::Stamp,
};
use std::f64::consts::{PI, TAU};

/// Cells along an edge of a grid that has seen nothing yet; it grows.
const FIRST_CELLS: usize = 64;

/// Mounts of lidars that are remembered.
const MOST_MOUNTS: usize = 16;

/// How clouds become a grid.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CloudToGridParams {
    /// Edge of a cell, in metres.
    pub resolution: f64,
    /// What counts as an obstacle; heights are those above the base, which stands on the floor.
    pub obstacles: CloudToScanParams,
    /// What a ray says of the cells that it crosses.
    pub model: InverseModelParams,
    /// Least distance from the sensor at which an obstacle counts, in metres: the vehicle itself is none.
    pub min_range: f64,
    /// Greatest distance from the sensor at which an obstacle counts, in metres.
    pub max_range: f64,
}

impl Default for CloudToGridParams {
    /// Cells of 5 cm as planners take them, the obstacles of [`CloudToScanParams`], and 30 m: farther off, neighbouring lines of a
    /// 16-line lidar are more than a metre apart, and goods on the floor hide between them. An obstacle counts 29 times a ray that passes,
    /// not seven times as with a planar scanner: near by, the rays pass above low goods and under shelves that were seen from farther
    /// off.
    fn default() -> Self {
        Self {
            resolution: 0.05,
            obstacles: CloudToScanParams { empty_is_free: false, ..CloudToScanParams::default() },
            model: InverseModelParams { p_hit: 0.97, p_miss: 0.47, ..InverseModelParams::default() },
            min_range: 0.5,
            max_range: 30.0,
        }
    }
}

/// What became of a cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CloudToGridReport {
    /// Where its points went.
    pub points: CloudToScanReport,
    /// What its rays did.
    pub rays: ScanInsertion,
}

/// Builds a grid of clouds. Buffers are reused: nothing is allocated once the grid has grown as far as the clouds reach, and has met
/// the mounts of all lidars, up to 16 of them.
///
/// ```
/// use agv_core::geometry::{Se2, Se3};
/// use agv_core::grid::{CellState, OccupancyThresholds};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::PointCloud;
/// use agv_ndt::convert::{CloudToGrid, CloudToGridParams};
///
/// // Two lines on a wall straight ahead, 0.5 m and 1 m up, seen from (2, 1).
/// let beams = (-50..50).map(|i| 0.01 * i as f32);
/// let (y, z): (Vec<f32>, Vec<f32>) = beams.flat_map(|y| [(y, 0.5), (y, 1.0)]).unzip();
/// let ring = (0..y.len()).map(|i| 4 + i as u16 % 2).collect();
/// let cloud = PointCloud::new(vec![4.02; y.len()], y, z)?.with_ring(ring)?;
///
/// let mut map = CloudToGrid::new(CloudToGridParams::default())?;
/// // One look shows the wall; that a place is free takes more of them.
/// for _ in 0..20 {
///     map.insert(&cloud, &Se3::from(Se2::new(2.0, 1.0, 0.0)))?;
/// }
/// let states = map.states(&OccupancyThresholds::default());
/// let at = |x, y| states.layout().cell_at(&Vector2::new(x, y)).and_then(|cell| states.get(cell).copied());
/// assert_eq!((at(6.02, 1.02), at(6.5, 1.02)), (Some(CellState::Occupied), Some(CellState::Unknown)));
/// assert_eq!(at(4.0, 1.02), Some(CellState::Free));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CloudToGrid {
    params: CloudToGridParams,
    flatten: CloudToScan,
    /// What clouds are pressed into, one for each mount that was met.
    scans: Vec<LaserScan>,
    evidence: EvidenceGrid,
}

impl CloudToGrid {
    /// A grid without evidence, whose cells lie along the axes of the map.
    ///
    /// # Errors
    /// The first parameter that is out of its range, by name.
    pub fn new(params: CloudToGridParams) -> Result<Self, Error> {
        check::in_range("resolution", params.resolution, 0.001, 100.0)?;
        let half = 0.5 * FIRST_CELLS as f64 * params.resolution;
        let layout = GridLayout::new(FIRST_CELLS, FIRST_CELLS, params.resolution, Se2::new(-half, -half, 0.0))?;
        Ok(Self {
            flatten: CloudToScan::new(params.obstacles.clone())?,
            scans: vec![imagined(&params, Se2::default())?],
            evidence: EvidenceGrid::new(layout, params.model)?,
            params,
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &CloudToGridParams {
        &self.params
    }

    /// Casts a cloud into the grid that was taken at `map_from_base`.
    ///
    /// Deskew it before, if the vehicle moved. The pose counts as it is seen from above: the base stands on the floor, wherever the
    /// 3D map has it. Points that are not finite are left out, and a cloud without obstacles changes nothing.
    ///
    /// # Errors
    /// A pose that is not finite or too far off, a cloud that [`CloudToScan`] refuses, or a grid that would become too large. The
    /// evidence is then as it was.
    pub fn insert(&mut self, cloud: &PointCloud, map_from_base: &Se3) -> Result<CloudToGridReport, Error> {
        finite_pose("map_from_base", map_from_base)?;
        let mount = cloud.base_from_sensor().to_planar();
        let index = if let Some(known) = self.scans.iter().position(|scan| scan.geometry().base_from_sensor == mount) {
            known
        } else {
            if self.scans.len() >= MOST_MOUNTS {
                self.scans.remove(0);
            }
            self.scans.push(imagined(&self.params, mount)?);
            self.scans.len() - 1
        };
        let scan = &mut self.scans[index];
        let points = self.flatten.convert_into(cloud, scan)?;
        let rays = self.evidence.insert_scan(scan, &map_from_base.to_planar())?;
        Ok(CloudToGridReport { points, rays })
    }

    /// The evidence, to be merged with that of other vehicles, or stored.
    pub const fn evidence(&self) -> &EvidenceGrid {
        &self.evidence
    }

    /// The map that planners take.
    pub fn states(&self, thresholds: &OccupancyThresholds) -> Grid<CellState> {
        self.evidence.states(thresholds)
    }
}

/// The scan of a planar scanner where the lidar is, a beam for each of its directions.
fn imagined(params: &CloudToGridParams, base_from_sensor: Se2) -> Result<LaserScan, Error> {
    let beams = params.obstacles.image.columns;
    let angle_increment = TAU / beams.max(1) as f64;
    let geometry = ScanGeometry {
        base_from_sensor,
        // In the middle of the image's columns.
        angle_min: -PI + 0.5 * angle_increment,
        angle_increment,
        range_min: params.min_range,
        range_max: params.max_range,
        ..ScanGeometry::default()
    };
    LaserScan::new(Stamp::default(), geometry, vec![f32::NAN; beams])
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        compute::Seed,
        geometry::{So3, Twist3},
        grid::{Cell, Inflation, InflationParams, cost, distance_field},
        nalgebra::Vector3,
    };
    use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};

    fn hall() -> Factory {
        let params = FactoryParams { length: 24.0, width: 16.0, ..FactoryParams::default() };
        Factory::generate(params, Seed(3)).unwrap()
    }

    fn lidar() -> Lidar {
        let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 1.2), So3::from_roll_pitch_yaw(0.0, 0.02, 0.4));
        Lidar::new(LidarParams { range_sigma: 0.02, ..LidarParams::vlp16().with_mount(mount) }, Seed(1)).unwrap()
    }

    /// What was seen along two aisles of a factory agrees with what stands there: nearly every face of the truth's map is occupied,
    /// and what is free is free.
    #[test]
    fn a_factory_seen_from_its_aisles_has_its_map() {
        let (factory, mut lidar) = (hall(), lidar());
        let mut map = CloudToGrid::new(CloudToGridParams::default()).unwrap();
        for aisle in &factory.aisles()[..2] {
            for i in 0..13 {
                let pose = Se3::from(Se2::new(1.5 + 1.7 * f64::from(i), aisle.y(), 0.1 * f64::from(i % 3)));
                let cloud = lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::default()).unwrap();
                let report = map.insert(cloud, &pose).unwrap();
                assert!(report.points.ground > 100 && report.rays.beams_used > 1000, "{report:?}");
            }
        }
        let (seen, truth) = (map.states(&OccupancyThresholds::default()), factory.map(0.05, 0.05, 2.0).unwrap());
        let occupied = seen.values().iter().filter(|state| **state == CellState::Occupied).count();
        assert!(occupied > 1_000, "{occupied}");

        // Wherever the grid lets a vehicle of 0.4 m radius go from the aisle, it stays clear of what really stands there, but for two cells' width.
        let circle = InflationParams { inscribed_radius: 0.4, inflation_radius: 0.4, ..InflationParams::default() };
        let costmap = Inflation::new(circle).unwrap().inflate(&seen).unwrap();
        let clearance = distance_field(&truth).unwrap();
        let layout = *costmap.layout();
        let start = factory.aisles()[0].translation();
        let (mut open, mut reached) = (vec![layout.cell_at(&start).unwrap()], vec![false; layout.len()]);
        let (mut least, mut far, mut count) = (f32::INFINITY, 0.0_f64, 0);
        while let Some(cell) = open.pop() {
            let Some(index) = layout.index(cell) else { continue };
            if reached[index] || costmap.costs()[index] >= cost::INSCRIBED || seen.values()[index] != CellState::Free {
                continue;
            }
            reached[index] = true;
            let center = layout.center(cell);
            let there = clearance.layout().cell_at(&center).and_then(|cell| clearance.get(cell));
            // But for the loading ramp in the west, which is ground to wheels.
            if center.x > 2.2 {
                least = least.min(*there.unwrap_or(&0.0));
            }
            (far, count) = (far.max((center - start).norm()), count + 1);
            open.extend([(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(dx, dy)| Cell::new(cell.x + dx, cell.y + dy)));
        }
        assert!(least > 0.29, "{least} m beside an obstacle");
        // Both aisles' ends, across the hall.
        assert!(far > 18.0 && count > 20_000, "{far} m, {count} cells");
    }

    #[test]
    fn the_order_of_the_clouds_does_not_matter() {
        let (factory, mut lidar) = (hall(), lidar());
        let y = factory.aisles()[1].y();
        let taken: Vec<_> = (0..4)
            .map(|i| {
                let pose = Se3::from(Se2::new(3.0 + 4.0 * f64::from(i), y, 0.0));
                let cloud = lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::default()).unwrap().clone();
                (cloud, pose)
            })
            .collect();
        let build = |order: &mut dyn Iterator<Item = &(PointCloud, Se3)>| {
            let mut map = CloudToGrid::new(CloudToGridParams::default()).unwrap();
            order.for_each(|(cloud, pose)| assert!(map.insert(cloud, pose).is_ok()));
            map.evidence().clone()
        };
        assert_eq!(build(&mut taken.iter()), build(&mut taken.iter().rev()));
    }

    #[test]
    fn bad_input_is_refused_and_changes_nothing() {
        let good = CloudToGridParams::default();
        for bad in [
            CloudToGridParams { resolution: 0.0, ..good.clone() },
            CloudToGridParams { resolution: f64::NAN, ..good.clone() },
            CloudToGridParams { min_range: -1.0, ..good.clone() },
            CloudToGridParams { max_range: 0.2, ..good.clone() },
            CloudToGridParams { model: InverseModelParams { p_hit: 2.0, ..good.model }, ..good.clone() },
            CloudToGridParams {
                obstacles: CloudToScanParams { max_height: f64::NAN, ..good.obstacles.clone() },
                ..good.clone()
            },
        ] {
            assert!(CloudToGrid::new(bad.clone()).is_err(), "{bad:?}");
        }
        let mut map = CloudToGrid::new(good).unwrap();
        let wall = PointCloud::new(vec![4.0; 2], vec![0.0; 2], vec![0.5, 1.0]).unwrap();
        let ringed = wall.clone().with_ring(vec![3, 4]).unwrap();
        let before = map.evidence().clone();
        for x in [f64::NAN, f64::INFINITY, 1e300] {
            assert!(map.insert(&ringed, &Se3::from_parts(Vector3::new(x, 0.0, 0.0), So3::default())).is_err(), "{x}");
        }
        assert!(map.insert(&wall, &Se3::default()).is_err(), "no laser lines");
        let empty = PointCloud::default().with_ring(vec![]).unwrap();
        assert_eq!(map.insert(&empty, &Se3::default()).map(|report| report.rays.beams_used), Ok(0));
        assert_eq!(*map.evidence(), before);
    }
}
