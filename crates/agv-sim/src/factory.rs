//! A generated smart factory: a hall with long aisles of pallet racks, goods of varying size, pillars, machines and a
//! loading ramp.
//!
//! Racks stand back to back in double rows along x; aisles run between them, and a cross aisle along either end of the
//! hall. The hall's inside spans (0, 0) to (`length`, `width`) of the map frame, its floor is z = 0. Goods are what
//! makes aisles differ: without them every bay looks like the next.

use crate::{Error, Fixture, Solid, World2d, World3d};
use agv_core::{
    check,
    compute::{Seed, Stream},
    geometry::Se2,
    grid::{CellState, Grid, GridLayout},
};
use nalgebra::{Vector2, Vector3};
use rand::RngExt;

/// Thickness of the walls, in metres.
const WALL: f64 = 0.3;
/// Edge of an upright's square section, in metres.
const POST: f64 = 0.1;
/// Thickness of a shelf, in metres.
const SHELF: f64 = 0.12;
/// Pallet places per bay and level.
const PLACES: usize = 3;

/// What the factory is like; all lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FactoryParams {
    /// Inside length of the hall, along x.
    pub length: f64,
    /// Inside width of the hall, along y.
    pub width: f64,
    /// Height of the roof.
    pub height: f64,
    /// Clear width of the aisles between the racks.
    pub aisle: f64,
    /// Clear width of the cross aisles at both ends.
    pub cross_aisle: f64,
    /// Depth of one rack; a double row is twice as deep.
    pub rack_depth: f64,
    /// Length of a rack's bay.
    pub bay: f64,
    /// Storage levels, the floor included.
    pub levels: usize,
    /// Height of a level.
    pub level_height: f64,
    /// Share of pallet places that hold goods, from 0 to 1.
    pub fill: f64,
}

impl Default for FactoryParams {
    /// A 60 x 40 m hall with racks of common European dimensions: 2.7 m bays for three 0.8 x 1.2 m pallets, 1.1 m deep,
    /// four levels, aisles of 3 m as reach trucks and AGVs use.
    fn default() -> Self {
        Self {
            length: 60.0,
            width: 40.0,
            height: 9.0,
            aisle: 3.0,
            cross_aisle: 5.0,
            rack_depth: 1.1,
            bay: 2.7,
            levels: 4,
            level_height: 1.8,
            fill: 0.8,
        }
    }
}

impl FactoryParams {
    fn validate(&self) -> Result<(), Error> {
        for (name, value) in [
            ("length", self.length),
            ("width", self.width),
            ("height", self.height),
            ("aisle", self.aisle),
            ("cross_aisle", self.cross_aisle),
            ("bay", self.bay),
            ("rack_depth", self.rack_depth),
            ("level_height", self.level_height),
        ] {
            check::in_range(name, value, 0.3, 10_000.0)?;
        }
        check::in_range("levels", self.levels as f64, 1.0, 100.0)?;
        check::in_range("fill", self.fill, 0.0, 1.0)?;
        let rack_height = self.levels as f64 * self.level_height;
        if rack_height > self.height {
            return Err(Error::NoRoom { name: "rack height", needed: rack_height, available: self.height });
        }
        if self.rows() == 0 {
            let needed = 2.0 * self.aisle + 2.0 * self.rack_depth;
            return Err(Error::NoRoom { name: "a double row", needed, available: self.width });
        }
        if self.bays() == 0 {
            let needed = 2.0 * self.cross_aisle + self.bay + POST;
            return Err(Error::NoRoom { name: "a bay", needed, available: self.length });
        }
        let bays = self.rows() * self.bays() * self.levels;
        let max = World3d::MAX_FIXTURES / 32;
        if bays > max {
            return Err(agv_core::Error::TooMany { name: "bays", len: bays, max }.into());
        }
        Ok(())
    }

    /// Double rows that fit, with an aisle on either side of each.
    fn rows(&self) -> usize {
        ((self.width - self.aisle) / (self.aisle + 2.0 * self.rack_depth)) as usize
    }

    /// Bays that fit between the cross aisles.
    fn bays(&self) -> usize {
        ((self.length - 2.0 * self.cross_aisle - POST) / self.bay).max(0.0) as usize
    }

    /// Centre line along y of double row `row`.
    fn row_center(&self, row: usize) -> f64 {
        let pitch = self.aisle + 2.0 * self.rack_depth;
        self.aisle + self.rack_depth + row as f64 * pitch
    }
}

/// A generated factory.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::nalgebra::Vector3;
/// use agv_sim::{Factory, FactoryParams};
///
/// let factory = Factory::generate(FactoryParams::default(), Seed(7))?;
/// let aisle = factory.aisles()[1];
/// let eye = Vector3::new(20.0, aisle.y(), 1.75);
/// // Clear along the aisle to the far wall, and the first shelf at its side.
/// assert_eq!(factory.world().cast(&eye, &Vector3::x(), 100.0).unwrap().range, 40.0);
/// assert!((factory.world().cast(&eye, &Vector3::y(), 100.0).unwrap().range - 1.5).abs() < 1e-9);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Factory {
    params: FactoryParams,
    world: World3d,
    aisles: Vec<Se2>,
}

impl Factory {
    /// The factory of this seed.
    ///
    /// # Errors
    /// A parameter outside its range, or a hall too small for one double row of one bay.
    pub fn generate(params: FactoryParams, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        let mut fixtures = Vec::new();
        hall(&params, &mut fixtures);
        for row in 0..params.rows() {
            for side in 0..2 {
                // A stream per rack: one more level in this rack changes no other.
                let mut stream = seed.stream(row as u64, side);
                let front = params.row_center(row) - params.rack_depth * (1.0 - side as f64);
                rack(&params, front, &mut stream, &mut fixtures);
            }
        }
        ends(&params, &mut seed.derive(1).stream(0, 0), &mut fixtures);
        let aisles = (0..=params.rows())
            .map(|i| {
                params.row_center(0) - params.rack_depth - 0.5 * params.aisle
                    + i as f64 * (params.aisle + 2.0 * params.rack_depth)
            })
            .map(|y| Se2::new(params.cross_aisle, y, 0.0))
            .collect();
        Ok(Self { params, world: World3d::new(fixtures)?, aisles })
    }

    /// What it was generated from.
    pub const fn params(&self) -> &FactoryParams {
        &self.params
    }

    /// The solids.
    pub const fn world(&self) -> &World3d {
        &self.world
    }

    /// The western entrance of each aisle in its middle, facing along it, from south to north.
    pub fn aisles(&self) -> &[Se2] {
        &self.aisles
    }

    /// Length of the aisles, in metres.
    pub fn aisle_length(&self) -> f64 {
        self.params.length - 2.0 * self.params.cross_aisle
    }

    /// The planar world that a laser at height `z` metres sees: its ranges are those of horizontal rays in
    /// [`world`](Self::world).
    ///
    /// # Errors
    /// A height that is not finite.
    pub fn section(&self, z: f64) -> Result<World2d, Error> {
        self.world.section(z)
    }

    /// The occupancy map of what stands between two heights, walls included, with cells of `resolution` metres. All is
    /// known: there are no unknown cells.
    ///
    /// # Errors
    /// A resolution that is not finite and positive or makes too many cells, or heights that are not in order.
    pub fn map(&self, resolution: f64, z_min: f64, z_max: f64) -> Result<Grid<CellState>, Error> {
        check::positive("resolution", resolution)?;
        let cells = |length: f64| ((length + 2.0 * WALL) / resolution).ceil() as usize;
        let origin = Se2::new(-WALL, -WALL, 0.0);
        let layout = GridLayout::new(cells(self.params.length), cells(self.params.width), resolution, origin)?;
        self.world.slice(layout, z_min, z_max)
    }
}

/// Floor, roof and walls.
fn hall(p: &FactoryParams, fixtures: &mut Vec<Fixture>) {
    let (outside, far) = (-WALL, Vector2::new(p.length + WALL, p.width + WALL));
    let wall = |x0, y0, x1, y1| Solid::block(Vector3::new(x0, y0, 0.0), Vector3::new(x1, y1, p.height));
    for (solid, reflectivity) in [
        (Solid::Plane { point: Vector3::zeros(), normal: Vector3::z() }, 0.3),
        (Solid::Plane { point: Vector3::new(0.0, 0.0, p.height), normal: -Vector3::z() }, 0.5),
        (wall(outside, outside, far.x, 0.0), 0.7),
        (wall(outside, p.width, far.x, far.y), 0.7),
        (wall(outside, 0.0, 0.0, p.width), 0.7),
        (wall(p.length, 0.0, far.x, p.width), 0.7),
    ] {
        fixtures.push(Fixture { solid, reflectivity });
    }
}

/// One rack whose side towards smaller y is at `front`.
fn rack(p: &FactoryParams, front: f64, stream: &mut Stream, fixtures: &mut Vec<Fixture>) {
    let top = p.levels as f64 * p.level_height;
    let mut block = |x: (f64, f64), y: (f64, f64), z: (f64, f64), reflectivity| {
        let solid = Solid::block(Vector3::new(x.0, y.0, z.0), Vector3::new(x.1, y.1, z.1));
        fixtures.push(Fixture { solid, reflectivity });
    };
    for frame in 0..=p.bays() {
        let x = p.cross_aisle + frame as f64 * p.bay;
        for y in [front, front + p.rack_depth - POST] {
            block((x, x + POST), (y, y + POST), (0.0, top), 0.4);
        }
    }
    for bay in 0..p.bays() {
        let (start, end) = (p.cross_aisle + bay as f64 * p.bay + POST, p.cross_aisle + (bay + 1) as f64 * p.bay);
        let place = (end - start) / PLACES as f64;
        for level in 0..p.levels {
            let shelf_top = level as f64 * p.level_height;
            if level > 0 {
                block((start, end), (front, front + p.rack_depth), (shelf_top - SHELF, shelf_top), 0.4);
            }
            for slot in 0..PLACES {
                // All draws are made whether the place is filled or not: `fill` takes goods away and moves none.
                let [filled, width, depth, height, reflectivity]: [f64; 5] = std::array::from_fn(|_| stream.random());
                if filled >= p.fill {
                    continue;
                }
                let (width, depth) = ((0.65 + 0.3 * width) * place, (0.7 + 0.28 * depth) * p.rack_depth);
                let height = (0.3 + 0.65 * height) * (p.level_height - SHELF);
                let (x, y) = (start + (slot as f64 + 0.5) * place, front + 0.5 * p.rack_depth);
                block(
                    (x - 0.5 * width, x + 0.5 * width),
                    (y - 0.5 * depth, y + 0.5 * depth),
                    (shelf_top, shelf_top + height),
                    0.15 + 0.7 * reflectivity,
                );
            }
        }
    }
}

/// What stands in the cross aisles: pillars at the rows' ends, machines in the east, a ramp in the west.
fn ends(p: &FactoryParams, stream: &mut Stream, fixtures: &mut Vec<Fixture>) {
    let east = p.cross_aisle + p.bays() as f64 * p.bay + POST;
    for row in 0..p.rows() {
        for x in [p.cross_aisle - 0.3, east + 0.3] {
            let base = Vector3::new(x, p.row_center(row), 0.0);
            fixtures
                .push(Fixture { solid: Solid::Cylinder { base, radius: 0.2, height: p.height }, reflectivity: 0.6 });
        }
        // A machine in front of every other row, each turned its own way, out of the way of the aisles.
        if row % 2 == 0 && p.length - east > 3.0 {
            let [yaw, length, height]: [f64; 3] = std::array::from_fn(|_| stream.random());
            let size = Vector3::new(0.8 + 0.6 * length, 0.7, 1.0 + height);
            let center = Vector3::new(p.length - 1.0, p.row_center(row), 0.5 * size.z);
            fixtures.push(Fixture { solid: Solid::Box { center, size, yaw: yaw - 0.5 }, reflectivity: 0.5 });
        }
    }
    if p.cross_aisle > 3.0 && p.width > 6.0 {
        let foot = Vector3::new(0.75, 0.5 * p.width - 2.0, 0.0);
        let ramp = Solid::Ramp { foot, yaw: std::f64::consts::FRAC_PI_2, length: 4.0, width: 1.5, height: 0.5 };
        fixtures.push(Fixture { solid: ramp, reflectivity: 0.3 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Body, GridWorld, PlanarWorld};

    fn factory() -> Factory {
        Factory::generate(FactoryParams::default(), Seed(7)).unwrap()
    }

    #[test]
    fn a_seed_makes_one_factory() {
        assert_eq!(factory().world().fixtures(), factory().world().fixtures());
        let other = Factory::generate(FactoryParams::default(), Seed(8)).unwrap();
        assert_ne!(other.world().fixtures(), factory().world().fixtures());
        assert!(factory().world().fixtures().len() > 3000);
    }

    #[test]
    fn aisles_can_be_driven() {
        let factory = factory();
        let (floor, agv) = (factory.section(0.3).unwrap(), Body::rectangle(1.2, 0.8).unwrap());
        assert_eq!(factory.aisles().len(), 8);
        for entrance in factory.aisles() {
            for metre in 0..=factory.aisle_length() as i32 {
                let pose = *entrance * Se2::new(f64::from(metre), 0.0, 0.0);
                assert!(floor.clearance(&agv, &pose, 5.0) > 0.5, "{pose:?}");
            }
        }
    }

    /// Horizontal rays in space, the section's rays and the map's rays agree: the first two exactly, the map within
    /// the length of a ray in a cell, for it is the coarser of them.
    #[test]
    fn slice_section_and_space_agree() {
        let factory = factory();
        let (z, resolution) = (0.45, 0.1);
        let section = factory.section(z).unwrap();
        let map = GridWorld::new(&factory.map(resolution, z, z).unwrap());
        let mut close = 0;
        for entrance in factory.aisles() {
            for beam in 0..360 {
                let angle = f64::from(beam).to_radians() + 0.003;
                let (origin, direction) = (entrance.translation(), Vector2::new(angle.cos(), angle.sin()));
                let spatial = factory
                    .world()
                    .cast(&Vector3::new(origin.x, origin.y, z), &Vector3::new(direction.x, direction.y, 0.0), 100.0)
                    .unwrap();
                let planar = section.cast(&origin, &direction, 100.0).unwrap();
                assert!((spatial.range - planar).abs() < 1e-9);
                let cell = map.cast(&origin, &direction, 100.0).unwrap();
                assert!(cell <= planar + 1e-9, "a cell that is hit is occupied: {cell} {planar}");
                close += i32::from(planar - cell < 2.0 * resolution);
            }
        }
        // Where a beam passes a corner closely the map's larger obstacle catches it earlier.
        assert!(close > 8 * 360 * 9 / 10, "{close}");
    }

    #[test]
    fn bad_factories_are_refused() {
        let good = FactoryParams::default();
        for bad in [
            FactoryParams { length: 12.0, ..good },
            FactoryParams { width: 5.0, ..good },
            FactoryParams { height: 7.0, ..good },
            FactoryParams { aisle: f64::NAN, ..good },
            FactoryParams { bay: 0.0, ..good },
            FactoryParams { levels: 0, ..good },
            FactoryParams { fill: 1.1, ..good },
            FactoryParams { length: 10_000.0, width: 10_000.0, ..good },
            FactoryParams { length: f64::INFINITY, ..good },
        ] {
            assert!(Factory::generate(bad, Seed(0)).is_err(), "{bad:?}");
        }
        let empty = Factory::generate(FactoryParams { fill: 0.0, ..good }, Seed(0)).unwrap();
        assert!(empty.map(f64::NAN, 0.0, 1.0).is_err());
        assert!(empty.map(1e-9, 0.0, 1.0).is_err());
        assert!(empty.map(0.1, 1.0, 0.0).is_err());
    }
}
