//! Where the vehicle drives: the map, the world that it was made of, and a route with codes on the floor.

use agv_nav::{
    core::path::shapes,
    filters::{marker::MarkerMap, particle::FreeSpace},
    nalgebra::Vector2,
    prelude::*,
};
use agv_sim::{Factory, FactoryParams, FloorCode, GridWorld, PlanarWorld, Shape, World2d};
use agv_support::map;
use std::{f64::consts::FRAC_PI_8, path::Path as FilePath};

use super::Result;

/// A place to drive in.
pub(crate) struct Site {
    pub(crate) name: String,
    pub(crate) map: Grid<CellState>,
    pub(crate) world: Box<dyn PlanarWorld>,
    /// A closed route, a pose each 2 cm; empty where the vehicle wanders.
    pub(crate) route: Vec<Se2>,
    pub(crate) codes: Vec<FloorCode>,
    pub(crate) code_map: MarkerMap,
    pub(crate) free_space: FreeSpace,
}

/// Room that the vehicle needs around its middle, in metres.
pub(crate) const RADIUS: f64 = 0.25;

/// Poses of the route per metre.
pub(crate) const PER_METRE: usize = 50;

/// Metres from code to code along the route.
const CODE_PITCH: usize = 1;

impl Site {
    /// The room of paper 001, 10 x 10 m, with furniture that makes it look different from every side.
    pub(crate) fn room() -> Result<Self> {
        let mut shapes = Shape::room(Vector2::new(0.0, 0.0), Vector2::new(10.0, 10.0)).to_vec();
        for (x, y, yaw, length, width) in [
            (5.3, 5.2, FRAC_PI_8, 2.4, 1.4),
            (0.5, 4.0, 0.0, 1.0, 1.6),
            (0.4, 8.9, 0.0, 0.8, 0.5),
            (6.9, 9.6, 0.0, 1.8, 0.8),
            (9.5, 6.4, 0.0, 1.0, 0.7),
            (9.7, 2.6, 0.0, 0.6, 1.9),
            (4.4, 0.45, 0.0, 0.9, 0.9),
            (1.7, 0.3, 0.0, 0.5, 0.6),
        ] {
            shapes.push(Shape::rectangle(Se2::new(x, y, yaw), length, width));
        }
        shapes.push(Shape::Circle { center: Vector2::new(3.5, 6.3), radius: 0.3 });
        let world = World2d::new(shapes)?;
        let map = drawn(&world, GridLayout::new(208, 208, 0.05, Se2::new(-0.2, -0.2, 0.0))?)?;
        let corners = [(5.0, 2.0), (8.0, 2.0), (8.0, 8.0), (2.0, 8.0), (2.0, 2.0), (5.0, 2.0)];
        Self::with_route("room", map, Box::new(world), &corners)
    }

    /// A warehouse, 40 x 30 m, with racks of which one place in four is empty.
    pub(crate) fn warehouse() -> Result<Self> {
        let params = FactoryParams {
            length: 40.0,
            width: 30.0,
            height: 6.0,
            cross_aisle: 4.0,
            levels: 2,
            fill: 0.75,
            ..FactoryParams::default()
        };
        let factory = Factory::generate(params, Seed(1))?;
        // The height of a safety scanner, at which it sees uprights and goods.
        let (world, map) = (factory.section(0.25)?, factory.map(0.05, 0.24, 0.26)?);
        let y = |aisle: usize| factory.aisles()[aisle].y();
        let (west, east) = (2.0, 38.0);
        let corners = [
            (20.0, y(0)),
            (east, y(0)),
            (east, y(1)),
            (west, y(1)),
            (west, y(3)),
            (east, y(3)),
            (east, y(4)),
            (west - 0.6, y(4)),
            (west - 0.6, y(0)),
            (20.0, y(0)),
        ];
        Self::with_route("warehouse", map, Box::new(world), &corners)
    }

    /// A map of a file, in which the vehicle wanders.
    pub(crate) fn of_file(yaml: &FilePath) -> Result<Self> {
        let map = map::read(yaml)?;
        let world = Box::new(GridWorld::with_unknown_solid(&map));
        let free_space = FreeSpace::new(&map, RADIUS)?.largest();
        let name = yaml.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self { name, map, world, route: Vec::new(), codes: Vec::new(), code_map: MarkerMap::new(), free_space })
    }

    fn with_route(
        name: &str,
        map: Grid<CellState>,
        world: Box<dyn PlanarWorld>,
        corners: &[(f64, f64)],
    ) -> Result<Self> {
        let corners: Vec<Vector2<f64>> = corners.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
        let path = shapes::rounded(&corners, 0.7, 1.0 / PER_METRE as f64)?;
        let route: Vec<Se2> = path.points().iter().map(|point| point.pose).collect();
        let codes = route.iter().step_by(PER_METRE * CODE_PITCH).enumerate();
        let codes: Vec<_> = codes.map(|(id, &map_from_code)| FloorCode { id: id as u32, map_from_code }).collect();
        let code_map = MarkerMap::from_exact(codes.iter().map(|code| (code.id, code.map_from_code)))?;
        let free_space = FreeSpace::new(&map, RADIUS)?.reached_from(&corners[0])?;
        Ok(Self { name: name.to_owned(), map, world, route, codes, code_map, free_space })
    }
}

/// The map of a planar world: cells that something lies in are occupied.
fn drawn(world: &World2d, layout: GridLayout) -> Result<Grid<CellState>> {
    let body = agv_sim::Body::circle(0.5 * layout.resolution())?;
    let mut map = Grid::filled(layout, CellState::Free);
    for (index, state) in map.values_mut().iter_mut().enumerate() {
        let center = layout.center(layout.cell(index));
        if world.touches(&body, &Se2::new(center.x, center.y, 0.0)) {
            *state = CellState::Occupied;
        }
    }
    Ok(map)
}
