//! The spatial world: what the rays of a lidar meet.

mod solid;

use crate::bvh::{Bvh, Ray};
use crate::{Body, Error, PlanarWorld, World2d};
use agv_core::{
    check,
    geometry::Se2,
    grid::{Cell, CellState, Grid, GridLayout},
};
use nalgebra::Vector3;
use solid::Primitive;

pub use solid::Solid;

/// A solid and how well it reflects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fixture {
    /// Its shape.
    pub solid: Solid,
    /// Diffuse reflectivity, from 0 (black) to 1 (white).
    pub reflectivity: f64,
}

impl From<Solid> for Fixture {
    /// Half of the light comes back.
    fn from(solid: Solid) -> Self {
        Self { solid, reflectivity: 0.5 }
    }
}

/// Where a ray ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in metres.
    pub range: f64,
    /// What was hit: its place in [`World3d::fixtures`].
    pub fixture: usize,
    /// Unit normal of the surface, towards where the ray came from.
    pub normal: Vector3<f64>,
}

/// A world of exact solids; ranges are analytic.
///
/// ```
/// use agv_core::nalgebra::Vector3;
/// use agv_sim::{Solid, World3d};
///
/// let floor = Solid::Plane { point: Vector3::zeros(), normal: Vector3::z() };
/// let crate_ahead = Solid::block(Vector3::new(4.0, -1.0, 0.0), Vector3::new(5.0, 1.0, 1.0));
/// let world = World3d::new(vec![floor.into(), crate_ahead.into()])?;
///
/// let eye = Vector3::new(0.0, 0.0, 0.5);
/// let hit = world.cast(&eye, &Vector3::x(), 30.0).unwrap();
/// assert_eq!((hit.range, hit.fixture, hit.normal), (4.0, 1, -Vector3::x()));
/// assert_eq!(world.cast(&eye, &-Vector3::z(), 30.0).unwrap().range, 0.5);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct World3d {
    fixtures: Vec<Fixture>,
    /// Bounded solids in the order of the tree, and their places in `fixtures`.
    primitives: Vec<Primitive>,
    places: Vec<u32>,
    tree: Bvh<3>,
    /// Point, unit normal and place in `fixtures` of each plane.
    planes: Vec<(Vector3<f64>, Vector3<f64>, usize)>,
}

impl World3d {
    /// Most fixtures of a world.
    pub const MAX_FIXTURES: usize = 1 << 22;

    /// A world of these fixtures in the map frame; none makes an empty world. Takes O(n log n).
    ///
    /// # Errors
    /// A size that is not finite and positive, a position that is not finite, a reflectivity outside 0 to 1, or more
    /// than [`MAX_FIXTURES`](Self::MAX_FIXTURES).
    pub fn new(fixtures: Vec<Fixture>) -> Result<Self, Error> {
        if fixtures.len() > Self::MAX_FIXTURES {
            let (len, max) = (fixtures.len(), Self::MAX_FIXTURES);
            return Err(agv_core::Error::TooMany { name: "fixtures", len, max }.into());
        }
        let (mut bounded, mut planes) = (Vec::new(), Vec::new());
        for (index, fixture) in fixtures.iter().enumerate() {
            fixture.solid.validate()?;
            check::in_range("reflectivity", fixture.reflectivity, 0.0, 1.0)?;
            match fixture.solid {
                Solid::Plane { point, normal } => planes.push((point, normal.normalize(), index)),
                ref solid => bounded.extend(Primitive::new(solid).map(|p| (p, index as u32))),
            }
        }
        let boxes: Vec<_> = bounded.iter().map(|(p, _)| p.bounds()).collect();
        let (tree, order) = Bvh::build(&boxes);
        let (primitives, places) = order.iter().map(|&i| bounded[i]).unzip();
        Ok(Self { fixtures, primitives, places, tree, planes })
    }

    /// What it was made of.
    pub fn fixtures(&self) -> &[Fixture] {
        &self.fixtures
    }

    /// Reflectivity of a fixture, by its place in [`fixtures`](Self::fixtures); zero beyond the last.
    #[inline]
    pub(crate) fn reflectivity(&self, fixture: usize) -> f64 {
        self.fixtures.get(fixture).map_or(0.0, |f| f.reflectivity)
    }

    /// The first surface from `origin` along the unit vector `direction`, if it is at most `max_range` metres away.
    /// None for a ray that is not finite. O(log n + planes).
    #[inline]
    pub fn cast(&self, origin: &Vector3<f64>, direction: &Vector3<f64>, max_range: f64) -> Option<Hit> {
        if !(origin + direction).sum().is_finite() || max_range.is_nan() {
            return None;
        }
        let mut nearest = None;
        let mut limit = max_range;
        for (point, normal, fixture) in &self.planes {
            let t = (point - origin).dot(normal) / direction.dot(normal);
            // A parallel ray makes an infinity or NaN.
            if t >= 0.0 && t <= limit && t < f64::INFINITY {
                limit = t;
                nearest = Some((*fixture, *normal));
            }
        }
        let ray = Ray::new((*origin).into(), (*direction).into());
        let hit = self.tree.cast(&ray, limit, |entry, limit| self.primitives[entry].cast(&ray).filter(|&t| t <= limit));
        if let Some((range, entry)) = hit {
            limit = range;
            let normal = self.primitives[entry].normal(&(origin + direction * range));
            nearest = Some((self.places[entry] as usize, normal));
        }
        nearest.map(|(fixture, normal)| {
            let facing = if normal.dot(direction) > 0.0 { -normal } else { normal };
            Hit { range: limit, fixture, normal: facing }
        })
    }

    /// The horizontal section at height `z`, in metres: a planar world in which rays have the ranges that horizontal
    /// rays at that height have here. Planes do not appear in it.
    ///
    /// # Errors
    /// A height that is not finite.
    pub fn section(&self, z: f64) -> Result<World2d, Error> {
        check::finite("section height", z)?;
        World2d::new(self.fixtures.iter().filter_map(|f| f.solid.footprint(z, z)).collect())
    }

    /// The occupancy map of what stands between two heights, in metres: a cell is occupied if any solid reaches into
    /// it there, and free otherwise. Planes do not appear in it. O(cells covered).
    ///
    /// # Errors
    /// Heights that are not finite or not in order.
    pub fn slice(&self, layout: GridLayout, z_min: f64, z_max: f64) -> Result<Grid<CellState>, Error> {
        check::finite("z_max", z_max)?;
        check::in_range("z_min", z_min, f64::MIN, z_max)?;
        let mut map = Grid::filled(layout, CellState::Free);
        // A cell that a solid merely touches, wall on cell border, stays free.
        let edge = layout.resolution() * (1.0 - 1e-6);
        let square = Body::rectangle(edge, edge)?;
        let rotation = layout.map_from_grid().rotation();
        for shape in self.fixtures.iter().filter_map(|f| f.solid.footprint(z_min, z_max)) {
            let (low, high) = cells_around(&shape, &layout);
            let alone = World2d::new(vec![shape])?;
            for cell in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| Cell::new(x, y))) {
                let untouched = map.get(cell) == Some(&CellState::Free);
                if untouched && alone.touches(&square, &Se2::from_parts(layout.center(cell), rotation)) {
                    map.set(cell, CellState::Occupied);
                }
            }
        }
        Ok(map)
    }
}

/// Lowest and highest cell of the layout that the shape can reach; in the wrong order if there is none.
fn cells_around(shape: &crate::Shape, layout: &GridLayout) -> (Cell, Cell) {
    let bounds = shape.bounds();
    let corners = [[0, 1], [2, 1], [0, 3], [2, 3]].map(|[x, y]| {
        let sides = [bounds.min[0], bounds.min[1], bounds.max[0], bounds.max[1]];
        layout.to_grid(&nalgebra::Vector2::new(sides[x], sides[y]))
    });
    let span = |axis: usize, size: usize| {
        let low = corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
        let high = corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
        (low.floor().max(0.0) as i32, high.floor().min(size as f64 - 1.0) as i32)
    };
    let ((x0, x1), (y0, y1)) = (span(0, layout.width()), span(1, layout.height()));
    (Cell::new(x0, y0), Cell::new(x1, y1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn solid() -> impl Strategy<Value = Solid> {
        let point = || prop::array::uniform3(-8.0..8.0_f64).prop_map(Vector3::from);
        let size = || prop::array::uniform3(0.1..3.0_f64).prop_map(Vector3::from);
        prop_oneof![
            (point(), size(), -3.1..3.1_f64).prop_map(|(center, size, yaw)| Solid::Box { center, size, yaw }),
            (point(), size()).prop_map(|(center, size)| Solid::Box { center, size, yaw: 0.0 }),
            (point(), size()).prop_map(|(base, s)| Solid::Cylinder { base, radius: s.x, height: s.y }),
            (point(), size(), -3.1..3.1_f64).prop_map(|(foot, s, yaw)| Solid::Ramp {
                foot,
                yaw,
                length: s.x,
                width: s.y,
                height: s.z
            }),
        ]
    }

    fn world(solids: &[Solid]) -> World3d {
        World3d::new(solids.iter().map(|&s| s.into()).collect()).unwrap()
    }

    /// Signed distance-like test, written from the definitions and not from the ray code: is the point in the solid?
    fn contains(solid: &Solid, p: &Vector3<f64>, play: f64) -> bool {
        let local = |origin: &Vector3<f64>, yaw: f64| {
            nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), -yaw) * (p - origin)
        };
        match solid {
            Solid::Box { center, size, yaw } => {
                local(center, *yaw).iter().zip(size.iter()).all(|(v, s)| v.abs() <= 0.5 * s + play)
            }
            Solid::Cylinder { base, radius, height } => {
                let q = p - base;
                q.xy().norm() <= radius + play && q.z >= -play && q.z <= height + play
            }
            Solid::Ramp { foot, yaw, length, width, height } => {
                let q = local(foot, *yaw);
                q.x <= length + play
                    && q.y.abs() <= 0.5 * width + play
                    && q.z >= -play
                    && q.z <= height / length * q.x + play * (1.0 + height / length)
            }
            Solid::Plane { .. } => false,
        }
    }

    proptest! {
        /// The hit lies on the surface: just before it the ray is outside (or, starting inside, inside), just behind
        /// it the other way about; and no sample before it has changed sides.
        #[test]
        fn hits_are_where_the_solid_begins(
            solid in solid(), origin in prop::array::uniform3(-12.0..12.0_f64), target in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let (origin, target) = (Vector3::from(origin), Vector3::from(target));
            let center = match solid {
                Solid::Box { center, .. } => center,
                Solid::Cylinder { base, height, .. } => base + Vector3::z() * 0.5 * height,
                Solid::Ramp { foot, .. } => foot,
                Solid::Plane { point, .. } => point,
            };
            let direction = (center + target - origin).normalize();
            let started_inside = contains(&solid, &origin, 0.0);
            let hit = world(&[solid]).cast(&origin, &direction, 60.0);
            let end = hit.map_or(40.0, |h| h.range);
            for i in 0..200 {
                let p = origin + direction * (end * f64::from(i) / 200.0);
                let play = if started_inside { 1e-9 } else { -1e-9 };
                prop_assert_eq!(contains(&solid, &p, play), started_inside);
            }
            if let Some(hit) = hit {
                let p = origin + direction * hit.range;
                prop_assert!(contains(&solid, &p, 1e-9) && !contains(&solid, &p, -1e-9));
                // The normal leaves the solid, away from edges.
                prop_assert!((hit.normal.norm() - 1.0).abs() < 1e-12 && hit.normal.dot(&direction) <= 0.0);
                let out = if started_inside { -hit.normal } else { hit.normal };
                prop_assert!(!contains(&solid, &(p + out * 1e-6), -1e-9));
            }
        }

        #[test]
        fn the_tree_changes_no_range(
            solids in prop::collection::vec(solid(), 0..40), origin in prop::array::uniform3(-10.0..10.0_f64),
            azimuth in -3.1..3.1_f64, elevation in -1.5..1.5_f64,
        ) {
            let direction = Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let origin = Vector3::from(origin);
            let all = solids.iter().filter_map(|s| world(&[*s]).cast(&origin, &direction, 25.0)).map(|h| h.range).min_by(f64::total_cmp);
            prop_assert_eq!(world(&solids).cast(&origin, &direction, 25.0).map(|h| h.range), all);
        }

        /// A horizontal ray in space and a ray in the section agree.
        #[test]
        fn sections_agree_with_horizontal_rays(
            solids in prop::collection::vec(solid(), 1..20), x in -10.0..10.0_f64, y in -10.0..10.0_f64, z in -8.0..8.0_f64, yaw in -3.1..3.1_f64,
        ) {
            let world = world(&solids);
            let spatial = world.cast(&Vector3::new(x, y, z), &Vector3::new(yaw.cos(), yaw.sin(), 0.0), 30.0).map(|h| h.range);
            let planar = world.section(z).unwrap().cast(&Vector2::new(x, y), &Vector2::new(yaw.cos(), yaw.sin()), 30.0);
            match (spatial, planar) {
                (Some(a), Some(b)) => prop_assert!((a - b).abs() < 1e-9, "{} {}", a, b),
                (a, b) => prop_assert_eq!(a.is_some(), b.is_some()),
            }
        }
    }

    #[test]
    fn a_ramp_is_met_on_its_slope() {
        // One in four, seen horizontally at 0.5 m height: 2 m behind the foot.
        let ramp = Solid::Ramp { foot: Vector3::new(3.0, 0.0, 0.0), yaw: 0.0, length: 4.0, width: 2.0, height: 1.0 };
        let hit = world(&[ramp]).cast(&Vector3::new(0.0, 0.3, 0.5), &Vector3::x(), 30.0).unwrap();
        assert!((hit.range - 5.0).abs() < 1e-12);
        assert!((hit.normal - Vector3::new(-1.0, 0.0, 4.0).normalize()).norm() < 1e-12);
    }

    #[test]
    fn a_slice_marks_what_reaches_into_its_cells() {
        let solids = [
            Solid::block(Vector3::new(1.0, 1.0, 0.0), Vector3::new(2.0, 1.5, 1.0)),
            Solid::block(Vector3::new(3.0, 3.0, 2.0), Vector3::new(4.0, 4.0, 3.0)),
            Solid::Plane { point: Vector3::zeros(), normal: Vector3::z() },
        ];
        let layout = GridLayout::new(20, 20, 0.25, Se2::default()).unwrap();
        let map = world(&solids).slice(layout, 0.1, 1.5).unwrap();
        let occupied: Vec<Cell> =
            (0..400).map(|i| layout.cell(i)).filter(|c| map.get(*c) == Some(&CellState::Occupied)).collect();
        assert_eq!(occupied.len(), 8);
        assert!(occupied.iter().all(|c| (4..8).contains(&c.x) && (4..6).contains(&c.y)));
        assert!(world(&solids).slice(layout, 1.0, 0.5).is_err());
        assert!(world(&solids).slice(layout, f64::NAN, 0.5).is_err());
        assert!(world(&solids).section(f64::NAN).is_err());
    }

    #[test]
    fn bad_solids_and_rays_are_refused() {
        let (zero, nan, one) = (Vector3::zeros(), Vector3::new(f64::NAN, 0.0, 0.0), Vector3::repeat(1.0));
        for bad in [
            Solid::Box { center: nan, size: one, yaw: 0.0 },
            Solid::Box { center: zero, size: zero, yaw: 0.0 },
            Solid::Box { center: zero, size: one, yaw: f64::INFINITY },
            Solid::Cylinder { base: zero, radius: 0.0, height: 1.0 },
            Solid::Cylinder { base: zero, radius: 1.0, height: -1.0 },
            Solid::Ramp { foot: zero, yaw: 0.0, length: 0.0, width: 1.0, height: 1.0 },
            Solid::Ramp { foot: nan, yaw: 0.0, length: 1.0, width: 1.0, height: 1.0 },
            Solid::Plane { point: zero, normal: zero },
        ] {
            assert!(World3d::new(vec![bad.into()]).is_err(), "{bad:?}");
        }
        let black = Fixture { solid: Solid::block(zero, one), reflectivity: -0.1 };
        assert!(World3d::new(vec![black]).is_err());
        let floor = world(&[Solid::Plane { point: zero, normal: Vector3::z() }, Solid::block(zero, one)]);
        assert_eq!(floor.cast(&nan, &Vector3::x(), 10.0), None);
        assert_eq!(floor.cast(&one, &nan, 10.0), None);
        assert_eq!(floor.cast(&one, &-Vector3::z(), f64::NAN), None);
        assert_eq!(floor.cast(&Vector3::new(3.0, 3.0, 1.0), &Vector3::x(), f64::INFINITY), None);
    }
}
