//! Whether a vehicle on its way touches an obstacle that moves too: each at its own time.
//!
//! In a stretch of `T` seconds, vehicle and obstacle come nearer by `(|v| + |ω| R + |u|) T` at the most, `R` being the radius of the
//! circle around the vehicle and `u` the obstacle's velocity. If in the middle of the stretch they are farther apart than half of that, they
//! do not touch in it; if not, either half is looked at, until that is no more than a centimetre: nothing that is touched is
//! missed.

use agv_core::{
    geometry::{LieGroup, Se2, Twist2},
    grid::Footprint,
    obstacle::MovingObstacle,
};

/// Gap, in metres, below which vehicle and obstacle count as touching when they pass each other.
pub const MARGIN: f64 = 0.01;

/// Most times that a stretch is halved: ten kilometres down to a centimetre.
const MOST_HALVES: u32 = 20;

/// A stretch of a vehicle's way at a constant twist.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// Pose at the beginning.
    pub map_from_base: Se2,
    /// Velocity in the base frame.
    pub twist: Twist2,
    /// Time of the beginning since the obstacles' positions were taken, in seconds.
    pub begin: f64,
    /// How long it lasts, in seconds.
    pub duration: f64,
}

/// Whether the vehicle touches the obstacle in a stretch, or passes it within [`MARGIN`].
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::Footprint;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::obstacle::MovingObstacle;
/// use agv_plan::local::moving::{Stretch, touches};
///
/// // Somebody crosses the way 3 m ahead, from the right.
/// let person = MovingObstacle::new(Vector2::new(3.0, -3.0), Vector2::new(0.0, 1.0), 0.3)?;
/// let vehicle = Footprint::rectangle(-0.5, 0.5, 0.6)?;
/// let ahead = |speed| Stretch {
///     map_from_base: Se2::default(),
///     twist: Twist2::new(speed, 0.0, 0.0),
///     begin: 0.0,
///     duration: 4.0,
/// };
/// assert!(touches(&vehicle, &person, &ahead(1.0)));
/// assert!(!touches(&vehicle, &person, &ahead(2.0)), "gone before");
/// # Ok::<(), agv_core::Error>(())
/// ```
pub fn touches(footprint: &Footprint, obstacle: &MovingObstacle, stretch: &Stretch) -> bool {
    let own = stretch.twist.speed() + stretch.twist.yaw_rate.abs() * footprint.circumscribed_radius();
    let closing = own + obstacle.velocity.norm();
    let half = 0.5 * stretch.duration;
    let search = Search { footprint, obstacle, stretch, closing };
    search.touches(half, half, MOST_HALVES)
}

struct Search<'a> {
    footprint: &'a Footprint,
    obstacle: &'a MovingObstacle,
    stretch: &'a Stretch,
    /// How fast the two come nearer at the most, in metres per second.
    closing: f64,
}

impl Search<'_> {
    fn touches(&self, middle: f64, half: f64, levels: u32) -> bool {
        let Stretch { map_from_base, twist, begin, .. } = self.stretch;
        let pose = map_from_base.compose(&twist.integrate(middle));
        let (time, nearer) = (begin + middle, self.closing * half);
        // From the circles around both first: most obstacles are far.
        let apart = (pose.translation() - self.obstacle.position_after(time)).norm();
        if apart - self.footprint.circumscribed_radius() - self.obstacle.circumscribed_radius() > nearer + MARGIN {
            return false;
        }
        let gap = self.obstacle.gap_after(time, self.footprint, &pose);
        if gap > nearer {
            return false;
        }
        if gap <= 0.0 || levels == 0 || nearer <= MARGIN {
            return true;
        }
        let quarter = 0.5 * half;
        self.touches(middle - quarter, quarter, levels - 1) || self.touches(middle + quarter, quarter, levels - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::obstacle::Hull;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    proptest! {
        /// Against a fine sampling in time: what it sees is found, and what is found passes within the margin.
        #[test]
        fn contacts_are_found_at_their_time(
            x in -3.0..3.0_f64, y in -3.0..3.0_f64, u in -2.0..2.0_f64, w in -2.0..2.0_f64, radius in 0.0..0.5_f64, long: bool,
            vx in -1.0..2.0_f64, yaw_rate in -2.0..2.0_f64, begin in 0.0..2.0_f64,
        ) {
            let footprint = Footprint::rectangle(-0.3, 0.6, 0.5).unwrap();
            let hull = Hull::new(&[Vector2::new(-0.6, 0.0), Vector2::new(0.6, 0.2)]).unwrap();
            let obstacle = MovingObstacle::new(Vector2::new(x, y), Vector2::new(u, w), radius).unwrap();
            let obstacle = if long { obstacle.with_hull(hull) } else { obstacle };
            let stretch =
                Stretch { map_from_base: Se2::new(0.2, -0.1, 0.7), twist: Twist2::new(vx, 0.0, yaw_rate), begin, duration: 1.5 };
            let nearest = (0..=3000)
                .map(|i| {
                    let t = 1.5 * f64::from(i) / 3000.0;
                    obstacle.gap_after(begin + t, &footprint, &stretch.map_from_base.compose(&stretch.twist.integrate(t)))
                })
                .fold(f64::INFINITY, f64::min);
            let found = touches(&footprint, &obstacle, &stretch);
            prop_assert!(found || nearest > 0.0);
            prop_assert!(!found || nearest <= 2.0 * MARGIN, "{nearest}");
        }
    }
}
