//! The gap between a vehicle and an obstacle that moves.
//!
//! Two outlines that do not cross are nearest at a vertex of one of them.

use super::MovingObstacle;
use crate::{
    geometry::{
        LieGroup, Se2,
        outline::{distance_to_segment, edges, segments_meet},
    },
    grid::Footprint,
};

impl MovingObstacle {
    /// Distance of a vehicle that stands at a pose from the obstacle as it is after `dt` seconds, in metres; zero or less where
    /// they touch. O(vertices of the one times those of the other).
    ///
    /// ```
    /// use agv_core::geometry::Se2;
    /// use agv_core::grid::Footprint;
    /// use agv_core::nalgebra::Vector2;
    /// use agv_core::obstacle::MovingObstacle;
    ///
    /// let person = MovingObstacle::new(Vector2::new(4.0, 0.0), Vector2::new(-1.0, 0.0), 0.3)?;
    /// let vehicle = Footprint::rectangle(-0.5, 0.7, 0.6)?;
    /// assert!((person.gap_after(1.0, &vehicle, &Se2::default()) - 2.0).abs() < 1e-12);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn gap_after(&self, dt: f64, footprint: &Footprint, map_from_base: &Se2) -> f64 {
        let position = self.position_after(dt);
        let Some(own) = footprint.vertices() else {
            let centers =
                footprint.circles().map(|(x, radius)| (map_from_base.act(&nalgebra::Vector2::new(x, 0.0)), radius));
            let gaps = centers.map(|(center, radius)| self.hull.distance(&(center - position)) - radius);
            return gaps.fold(f64::INFINITY, f64::min) - self.radius;
        };
        let placed = |vertex| map_from_base.act(&vertex) - position;
        let hull = self.hull.vertices();
        let mut gap = f64::INFINITY;
        for (a, b) in edges(own) {
            let (a, b) = (placed(a), placed(b));
            gap = gap.min(self.hull.distance(&a));
            for (c, d) in edges(hull) {
                if hull.len() > 1 && segments_meet(a, b, c, d) {
                    return -self.radius;
                }
                gap = gap.min(distance_to_segment(c, a, b));
            }
        }
        // An outline that lies within the vehicle crosses none of its edges.
        let inside =
            hull.first().is_some_and(|first| footprint.contains(&map_from_base.inverse().act(&(first + position))));
        (if inside { gap.min(0.0) } else { gap }) - self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obstacle::Hull;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn vehicles() -> [Footprint; 4] {
        let ell = [(-0.5, -0.4), (0.8, -0.4), (0.8, 0.1), (0.2, 0.1), (0.2, 0.6), (-0.5, 0.6)];
        [
            Footprint::circle(0.4).unwrap(),
            Footprint::two_circles(0.5, 0.3, -0.2, 0.4).unwrap(),
            Footprint::segment(Vector2::new(-0.6, 0.1), Vector2::new(0.9, 0.0)).unwrap(),
            Footprint::polygon(ell.map(|(x, y)| Vector2::new(x, y)).to_vec()).unwrap(),
        ]
    }

    fn hulls() -> [Hull; 3] {
        let corners = [(-0.5, -0.1), (0.6, -0.2), (0.2, 0.4)].map(|(x, y)| Vector2::new(x, y));
        [Hull::POINT, Hull::new(&corners[..2]).unwrap(), Hull::new(&corners).unwrap()]
    }

    proptest! {
        /// Against a fine sampling of the obstacle's outline: no sample is nearer, and one is about as near.
        #[test]
        fn gaps_are_those_of_the_nearest_points(
            x in -2.0..2.0_f64, y in -2.0..2.0_f64, yaw in -3.0..3.0_f64, which in 0..4_usize, hull in 0..3_usize,
        ) {
            let (vehicle, hull) = (&vehicles()[which], hulls()[hull]);
            let obstacle = MovingObstacle::new(Vector2::zeros(), Vector2::new(1.0, 0.5), 0.0).unwrap().with_hull(hull);
            let at = obstacle.position_after(0.4);
            let pose = Se2::new(x, y, yaw);
            let gap = obstacle.gap_after(0.4, vehicle, &pose);
            let mut nearest = f64::INFINITY;
            for (a, b) in edges(hull.vertices()) {
                for i in 0..=200 {
                    let point = pose.inverse().act(&(at + a + (b - a) * (f64::from(i) / 200.0)));
                    let distance = if vehicle.contains(&point) {
                        0.0
                    } else if let Some(own) = vehicle.vertices() {
                        edges(own).map(|(a, b)| distance_to_segment(point, a, b)).fold(f64::INFINITY, f64::min)
                    } else {
                        vehicle.circles().map(|(x, r)| (point - Vector2::new(x, 0.0)).norm() - r).fold(f64::INFINITY, f64::min)
                    };
                    nearest = nearest.min(distance);
                }
            }
            if gap > 0.0 {
                prop_assert!(nearest >= gap - 1e-9 && nearest <= gap + 0.006, "{gap} {nearest}");
            } else {
                // A vehicle within a polygon is not seen from its outline.
                let within = hull.distance(&(pose.translation() - at)) <= 0.9;
                prop_assert!(nearest <= 0.006 || within, "{gap} {nearest}");
            }
            let grown = MovingObstacle { radius: 0.3, ..obstacle };
            prop_assert!((grown.gap_after(0.4, vehicle, &pose) - (gap - 0.3)).abs() < 1e-12);
        }
    }

    #[test]
    fn what_lies_within_touches() {
        let (vehicle, at) = (&vehicles()[3], Vector2::new(1.0, 2.0));
        let point = MovingObstacle::new(at, Vector2::zeros(), 0.0).unwrap();
        assert!(point.gap_after(0.0, vehicle, &Se2::new(1.1, 2.0, 0.4)) <= 0.0);
        let large = [(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)].map(|(x, y)| Vector2::new(x, y));
        let hall = point.with_hull(Hull::new(&large).unwrap());
        assert!(hall.gap_after(0.0, vehicle, &Se2::new(1.1, 2.0, 0.4)) < 0.0);
    }
}
