//! Look-ups: up from both frames to where their ways meet.

use super::{
    FrameError,
    tree::{Edge, FrameTree, Motion},
};
use crate::{
    geometry::{LieGroup, Se3},
    time::Stamp,
};

impl FrameTree {
    /// `target_from_source` at `stamp`. Between static frames any stamp will do.
    ///
    /// # Errors
    /// [`FrameError::UnknownFrame`], [`FrameError::NotConnected`], or [`FrameError::Extrapolation`] with the edge that
    /// does not know the stamp and the times that it does know.
    pub fn lookup(&self, target: &str, source: &str, stamp: Stamp) -> Result<Se3, FrameError> {
        let (mut target_up, mut source_up) = (Se3::identity(), Se3::identity());
        self.climb(target, source, |edge, name, from_target| {
            let parent_from_child = at(edge, name, stamp)?;
            let climbed = if from_target { &mut target_up } else { &mut source_up };
            *climbed = parent_from_child.compose(climbed);
            Ok(())
        })?;
        Ok(target_up.between(&source_up))
    }

    /// `target_from_source` at the newest stamp that all moving edges between them know, and that stamp; `None` if all
    /// are static.
    ///
    /// # Errors
    /// As [`lookup`](Self::lookup): extrapolation if the edges' histories do not overlap.
    pub fn lookup_latest(&self, target: &str, source: &str) -> Result<(Se3, Option<Stamp>), FrameError> {
        let stamp = self.latest_common_time(target, source)?;
        Ok((self.lookup(target, source, stamp.unwrap_or_default())?, stamp))
    }

    /// The oldest of the newest stamps of all moving edges between two frames; `None` if all are static.
    ///
    /// # Errors
    /// [`FrameError::UnknownFrame`] or [`FrameError::NotConnected`].
    pub fn latest_common_time(&self, target: &str, source: &str) -> Result<Option<Stamp>, FrameError> {
        let mut common = None::<Stamp>;
        self.climb(target, source, |edge, _, _| {
            if let Motion::Moving(history) = &edge.motion {
                let latest = history.latest();
                common = Some(common.map_or(latest, |c| c.min(latest)));
            }
            Ok(())
        })?;
        Ok(common)
    }

    /// `target_from_source` where the two are seen at different times, through a frame that does not move in between:
    /// where is what `source` saw then, in `target` now? With `fixed = "odom"` it tells, for example, how far the lidar
    /// has moved between two scans.
    ///
    /// # Errors
    /// As [`lookup`](Self::lookup), for either time.
    pub fn lookup_through(
        &self,
        (target, target_stamp): (&str, Stamp),
        (source, source_stamp): (&str, Stamp),
        fixed: &str,
    ) -> Result<Se3, FrameError> {
        let fixed_from_target = self.lookup(fixed, target, target_stamp)?;
        Ok(fixed_from_target.between(&self.lookup(fixed, source, source_stamp)?))
    }

    /// Visits the edges from both frames up to their nearest common ancestor, each way from the bottom up:
    /// `visit(edge, child's name, whether it lies on the target's way)`.
    fn climb(
        &self,
        target: &str,
        source: &str,
        mut visit: impl FnMut(&Edge, &str, bool) -> Result<(), FrameError>,
    ) -> Result<(), FrameError> {
        let (mut low, mut high) = (self.find(target)?, self.find(source)?);
        let (mut low_depth, mut high_depth) = (self.depth(low), self.depth(high));
        while low != high {
            let from_target = low_depth >= high_depth;
            let (at, depth) = if from_target { (&mut low, &mut low_depth) } else { (&mut high, &mut high_depth) };
            let frame = &self.frames[*at];
            // The deeper of two different frames is a root only if both are.
            let Some(edge) = &frame.edge else {
                return Err(FrameError::NotConnected { target: target.to_owned(), source_frame: source.to_owned() });
            };
            visit(edge, &frame.name, from_target)?;
            *at = edge.parent;
            *depth -= 1;
        }
        Ok(())
    }

    /// Edges from a frame up to its root; finite, since there are no cycles.
    fn depth(&self, frame: usize) -> usize {
        std::iter::successors(Some(frame), |&at| self.frames[at].edge.as_ref().map(|edge| edge.parent)).count() - 1
    }
}

/// `parent_from_child` of one edge.
fn at(edge: &Edge, child: &str, stamp: Stamp) -> Result<Se3, FrameError> {
    match &edge.motion {
        Motion::Static(pose) => Ok(*pose),
        Motion::Moving(history) => history.at(stamp).ok_or_else(|| FrameError::Extrapolation {
            frame: child.to_owned(),
            wanted_ns: stamp.nanoseconds(),
            earliest_ns: history.earliest().nanoseconds(),
            latest_ns: history.latest().nanoseconds(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        frames::FrameTreeParams,
        geometry::{Se2, So3},
    };
    use nalgebra::{Vector3, Vector6};
    use proptest::prelude::*;

    fn offset(x: f64, y: f64, z: f64) -> Se3 {
        Se3::from_parts(Vector3::new(x, y, z), So3::default())
    }

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// The chain of papers 001 and 003: the vehicle turns a quarter circle of 1 m radius between 1 s and 2 s.
    fn vehicle() -> FrameTree {
        let mut tree = FrameTree::new(FrameTreeParams::default()).unwrap();
        tree.set_static("base_footprint", "base_link", offset(0.0, 0.0, 0.1)).unwrap();
        tree.set_static("base_link", "imu_link", offset(0.0, 0.0, 0.05)).unwrap();
        tree.set_static("base_link", "lidar_link", offset(0.05, 0.0, 0.0)).unwrap();
        let quarter = std::f64::consts::FRAC_PI_2;
        for (seconds, pose) in [(1.0, Se2::default()), (2.0, Se2::new(1.0, 1.0, quarter))] {
            tree.insert("odom", "base_footprint", at(seconds), pose.into()).unwrap();
        }
        for seconds in [0.5, 1.8] {
            tree.insert("map", "odom", at(seconds), Se2::new(10.0, 0.0, quarter).into()).unwrap();
        }
        tree.set_static("elsewhere", "there", Se3::default()).unwrap();
        tree
    }

    #[test]
    fn the_paper_s_chain_is_looked_up_at_a_time() {
        let tree = vehicle();
        // Half-way on the arc the vehicle is at (sin 45°, 1 - cos 45°) in odom, which is turned by 90° in the map.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let (x, y) = (half + 0.05 * half, 1.0 - half + 0.05 * half);
        let pose = tree.lookup("map", "lidar_link", at(1.5)).unwrap();
        assert!((pose.translation() - Vector3::new(10.0 - y, x, 0.1)).norm() < 1e-12, "{pose:?}");
        assert!((pose.to_planar().yaw() - 1.5 * std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        // Across two branches, without any time.
        let between = tree.lookup("imu_link", "lidar_link", at(1e6)).unwrap();
        assert!((between.translation() - Vector3::new(0.05, 0.0, -0.05)).norm() < 1e-15);
        assert_eq!(tree.lookup("odom", "odom", at(-1e6)), Ok(Se3::identity()));
    }

    #[test]
    fn the_latest_common_time_is_the_slowest_edge_s() {
        let tree = vehicle();
        assert_eq!(tree.latest_common_time("map", "imu_link"), Ok(Some(at(1.8))));
        assert_eq!(tree.latest_common_time("imu_link", "lidar_link"), Ok(None));
        let (pose, stamp) = tree.lookup_latest("map", "base_link").unwrap();
        assert_eq!(pose, tree.lookup("map", "base_link", stamp.unwrap()).unwrap());
    }

    #[test]
    fn a_fixed_frame_joins_two_times() {
        let tree = vehicle();
        let moved = tree.lookup_through(("base_link", at(1.0)), ("base_link", at(2.0)), "odom").unwrap();
        assert!((moved.translation() - Vector3::new(1.0, 1.0, 0.0)).norm() < 1e-12);
        // A point that the lidar saw at 1 s lies, at 2 s, where the motion took it.
        let then = tree.lookup_through(("lidar_link", at(2.0)), ("lidar_link", at(1.0)), "odom").unwrap();
        let back = tree.lookup_through(("lidar_link", at(1.0)), ("lidar_link", at(2.0)), "odom").unwrap();
        assert!(then.compose(&back).log().norm() < 1e-12);
    }

    #[test]
    fn failures_say_what_is_there() {
        let tree = vehicle();
        let name = str::to_owned;
        let unknown = FrameError::UnknownFrame { frame: name("camera") };
        assert_eq!(tree.lookup("map", "camera", at(1.5)), Err(unknown));
        let apart = FrameError::NotConnected { target: name("there"), source_frame: name("imu_link") };
        assert_eq!(tree.lookup("there", "imu_link", at(1.5)), Err(apart));
        for (seconds, frame, earliest, latest) in [(0.9, "base_footprint", 1.0, 2.0), (1.9, "odom", 0.5, 1.8)] {
            let extrapolation = FrameError::Extrapolation {
                frame: name(frame),
                wanted_ns: at(seconds).nanoseconds(),
                earliest_ns: at(earliest).nanoseconds(),
                latest_ns: at(latest).nanoseconds(),
            };
            assert_eq!(tree.lookup("map", "base_link", at(seconds)), Err(extrapolation));
        }
    }

    proptest! {
        /// Any way round a random tree gives the same pose: look-ups chain, and invert.
        #[test]
        fn lookups_chain(
            edges in prop::collection::vec((any::<prop::sample::Index>(), prop::array::uniform6(-1.5..1.5_f64)), 3..20),
            picks in prop::array::uniform3(any::<prop::sample::Index>()),
        ) {
            let mut tree = FrameTree::new(FrameTreeParams::default()).unwrap();
            for (i, (parent, tangent)) in edges.iter().enumerate() {
                let parent = parent.index(i + 1);
                let pose = Se3::exp(&Vector6::from(*tangent));
                tree.insert(&parent.to_string(), &(i + 1).to_string(), at(0.0), pose).unwrap();
            }
            let [a, b, c] = picks.map(|p| p.index(edges.len() + 1).to_string());
            let between = |x: &str, y: &str| tree.lookup(x, y, at(0.0)).unwrap();
            prop_assert!((between(&a, &b) * between(&b, &c)).minus(&between(&a, &c)).norm() < 1e-12);
            prop_assert!((between(&a, &b) * between(&b, &a)).log().norm() < 1e-12);
        }
    }
}
