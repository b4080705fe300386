//! Where the way of a cycle leads: the target of the field, the next key node, and the speed from which one can stop there.

use super::{Dwa, planner::PROGRESS};
use crate::local::Drive;
use agv_core::{geometry::LieGroup, kinematics::stopping_speed, roles::LocalPlanRequest};
use nalgebra::Vector2;

/// How much farther from the target than the vehicle the field is known, in metres: for backing up.
const BEHIND: f64 = 1.5;

impl Dwa {
    /// Where on the path the way of this cycle should lead: as far as planned if the vehicle can be there and there is a way, else
    /// nearer. The distance field is that of the answer.
    pub(super) fn aim(&mut self, drive: &Drive, position: &Vector2<f64>) -> Option<(Vector2<f64>, bool)> {
        let from = drive.projection.arc_length;
        let mut tried = 0;
        let ahead = drive.to_stop().min(self.params.look_ahead);
        // Then beyond what closes the path, then nearer.
        for share in [1.0, 1.5, 0.6, 0.3] {
            let mut arc_length = (from + share * self.params.look_ahead).min(drive.stop);
            let nearest = from + 0.2 * share * ahead;
            while arc_length >= nearest {
                let (point, _) = self.reference.course().point_at(arc_length)?;
                if self.field.is_open(&point) {
                    tried += 1;
                    if self.field.compute(&point, position, BEHIND) {
                        return Some((point, arc_length >= drive.stop));
                    }
                    break;
                }
                arc_length -= self.params.field.resolution;
            }
            if tried > 2 {
                break;
            }
        }
        None
    }

    /// The next bend of the path, or its end: the key node that leads the way.
    pub(super) fn key_node(&self, drive: &Drive) -> Option<Vector2<f64>> {
        let course = self.reference.course();
        let (mut arc_length, step) = (drive.projection.arc_length + 0.2, 0.1);
        let (mut point, mut direction) = course.point_at(arc_length.min(drive.stop))?;
        for _ in 0..200 {
            arc_length += step;
            if arc_length >= drive.stop {
                break;
            }
            let (next, ahead) = course.point_at(arc_length)?;
            if direction.inverse().compose(&ahead).angle().abs() > 0.17 {
                return Some(point);
            }
            (point, direction) = (next, ahead);
        }
        course.point_at(arc_length.min(drive.stop)).map(|(point, _)| point)
    }

    /// Greatest speed that the way ahead allows: where it ends, the vehicle must stop.
    pub(super) fn speed_cap(&self, request: &LocalPlanRequest<'_>, drive: &Drive) -> f64 {
        let position = request.state.map_from_base.translation();
        let ahead = (drive.stop_pose.translation() - position).norm();
        let deceleration = self.params.stopping_share * request.limits.twist.deceleration;
        // Never so slow that the last decimetre takes for ever.
        let to_stop = drive.to_stop().max(ahead.min(2.0 * drive.to_stop().max(PROGRESS)));
        stopping_speed(to_stop, deceleration, request.dt).max(0.05)
    }
}
