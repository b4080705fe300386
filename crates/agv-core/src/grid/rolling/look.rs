//! How a rolling costmap reads a scan: what each of its beams says of the cells of the window.

use super::{Mark, Notes, RollingCostmap, note};
use crate::{
    Error,
    geometry::{LieGroup, Se2},
    grid::{BeamEvidence, Cell, beam_walk::Block, scan_insertion::insert},
    sensors::{Beam, LaserScan},
};
use nalgebra::Vector2;

impl RollingCostmap {
    /// Notes what a scan says of the cells, and returns how many of its beams say something.
    pub(super) fn note(
        &mut self,
        scan: &LaserScan,
        map_from_base: &Se2,
        mut stands: impl FnMut(usize) -> bool,
    ) -> Result<usize, Error> {
        let params = self.params;
        let layout = *self.marks.layout();
        let geometry = scan.geometry();
        let mark_range = params.mark_range.unwrap_or(f64::INFINITY);
        let clear_range = params.clear_range.unwrap_or(f64::INFINITY);
        let grid_from_base = layout.map_from_grid().inverse() * *map_from_base;
        let base_from_grid = grid_from_base.inverse();
        let sensor = grid_from_base * geometry.base_from_sensor;
        // A hair inside the window, so that no rounding takes a beam out of it.
        let hair = 1e-3 * params.resolution;
        let far = (layout.width() as f64 * params.resolution - hair, layout.height() as f64 * params.resolution - hair);
        let inside = sensor.x() > hair && sensor.y() > hair && sensor.x() < far.0 && sensor.y() < far.1;
        if !inside {
            return Ok(0);
        }
        let room = |(c, s): (f64, f64)| {
            let along = |start: f64, direction: f64, far: f64| {
                let end = if direction > 0.0 { far } else { hair };
                if direction == 0.0 { f64::INFINITY } else { (end - start) / direction }
            };
            along(sensor.x(), c, far.0).min(along(sensor.y(), s, far.1))
        };
        let footprint = self.footprint.as_ref();
        let own_reach =
            footprint.map_or(0.0, |own| own.circumscribed_radius() + geometry.base_from_sensor.translation().norm());
        let read = |index: usize, beam: Beam, direction: (f64, f64)| {
            let (range, mut hit) = match beam {
                Beam::Hit(range) => {
                    let end =
                        || base_from_grid.act(&(sensor.translation() + Vector2::new(direction.0, direction.1) * range));
                    if range <= own_reach && footprint.is_some_and(|own| own.contains(&end())) {
                        return None;
                    }
                    let marks = range <= mark_range;
                    (
                        range,
                        if !marks {
                            note::NONE
                        } else if stands(index) {
                            note::HIT
                        } else {
                            note::PASSED
                        },
                    )
                }
                Beam::NoReturn if params.no_return_clears => (geometry.range_max, note::NONE),
                Beam::NoReturn | Beam::Invalid => return None,
            };
            let mut free_until = range;
            if free_until > clear_range && hit != note::HIT {
                (free_until, hit) = (clear_range, note::NONE);
            }
            let room = room(direction);
            if free_until > room {
                (free_until, hit) = (room, note::PASSED);
            }
            Some(BeamEvidence { free_until, hit: i32::from(hit) })
        };
        let reach = geometry.range_max.min(layout.len() as f64 * params.resolution);
        self.scan.project_with(scan, map_from_base, &layout.map_from_grid(), params.resolution, reach, read)?;
        let block = Block { width: layout.width() as i64, height: layout.height() as i64 };
        insert(&mut self.notes, block, (0, 0), &self.scan, &self.model, &mut self.scratch, Notes);
        Ok(self.scan.len())
    }

    /// Where the vehicle stands, nothing else does: unless something was hit there, cells whose centre it covers are free.
    pub(super) fn free_own_place(&mut self, map_from_base: &Se2) {
        let Some(footprint) = &self.footprint else { return };
        let layout = *self.marks.layout();
        let base_from_map = map_from_base.inverse();
        let middle = layout.to_grid(&map_from_base.translation());
        let reach = footprint.circumscribed_radius() / layout.resolution();
        let cells = |middle: f64, size: usize| {
            let first = (middle - reach).floor().clamp(0.0, size as f64) as i32;
            first..=(middle + reach).floor().clamp(-1.0, size as f64 - 1.0) as i32
        };
        for y in cells(middle.y, layout.height()) {
            for x in cells(middle.x, layout.width()) {
                let Some(index) = layout.index(Cell::new(x, y)) else { continue };
                let Some(mark) = self.marks.values_mut().get_mut(index) else { continue };
                let was_hit = self.notes.get(index).is_some_and(|n| n & note::HIT != 0);
                if !was_hit && footprint.contains(&base_from_map.act(&layout.center(Cell::new(x, y)))) {
                    *mark = Mark::FREE;
                }
            }
        }
    }
}
