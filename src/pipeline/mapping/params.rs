//! Parameters of a key frame mapper.

use crate::Error;
use agv_core::{check, geometry::PoseSigma};
use agv_ndt::places::ScanContextParams;

/// How far lidar odometry is believed: standard deviations that grow with the root of the way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LidarDrift {
    /// After a metre.
    pub per_metre: PoseSigma,
    /// After a radian.
    pub per_radian: PoseSigma,
    /// After a metre, along directions that the clouds do not fix, or of a cloud that fits nowhere.
    pub unobserved: PoseSigma,
    /// Between two key frames, besides.
    pub floor: PoseSigma,
}

impl Default for LidarDrift {
    /// Six centimetres and half a degree after ten metres: assumed, some times what this library's odometries drifted
    /// in `docs/experiments.md` (ends 3 to 4 cm off after 17 m of the recorded walk, 5 cm after 48 m among simulated
    /// racks, where these say 8 and 14 cm; about 0.04° after a metre of that walk, where these say 0.17°), since steps
    /// of one odometry share their errors, and a way that is believed too much keeps right loops from closing. Where a
    /// corridor hides the way, 0.3 m after the first metre and with the root of the way: assumed too.
    fn default() -> Self {
        Self {
            per_metre: PoseSigma { translation: 0.02, rotation: 0.003 },
            per_radian: PoseSigma { translation: 0.02, rotation: 0.005 },
            unobserved: PoseSigma { translation: 0.3, rotation: 0.1 },
            floor: PoseSigma { translation: 0.01, rotation: 0.001 },
        }
    }
}

impl LidarDrift {
    fn validate(&self) -> Result<(), agv_core::Error> {
        self.per_metre.checked()?;
        self.per_radian.checked()?;
        self.unobserved.checked()?;
        self.floor.checked()?;
        Ok(())
    }
}

/// Most neighbours and candidates: what one key frame may cost.
const MOST: f64 = 100.0;

/// How loops are sought, and what makes one.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LoopParams {
    /// Least way between two key frames that may close a loop, in metres.
    pub min_way: f64,
    /// How far from where it is expected a key frame is sought right after a closure, in metres.
    pub least_window: f64,
    /// By how much that grows, in metres per metre travelled. Along directions that the clouds do not fix the whole way
    /// counts.
    pub growth: f64,
    /// How far it is sought at most, in metres.
    pub window: f64,
    /// Key frames to either side of the one that is looked from, whose clouds make the target; at most 100.
    pub neighbours: usize,
    /// Groups of key frames around the expected place that are tried; at most 100.
    pub candidates: usize,
    /// Places that look alike which are tried if that finds nothing; at most 100.
    pub look_alikes: usize,
    /// Greatest distance of their descriptors, from 0 to 1.
    pub max_distance: f64,
    /// Least share of the points that must meet the target.
    pub min_inlier_ratio: f64,
    /// By how much that must be more than what another find has that contradicts it.
    pub margin: f64,
    /// How many finds must agree before one counts that the graph did not expect.
    pub confirmations: usize,
    /// How far finds may differ that agree, and how far one may be from where the graph expects it to count at once.
    pub agreement: PoseSigma,
    /// Greatest squared distance from what the graph expects, in standard deviations of that and of the find.
    pub gate: f64,
    /// Standard deviations of what no registration knows of itself: errors that neighbouring points share.
    pub floor: PoseSigma,
}

impl Default for LoopParams {
    /// Windows for odometry that drifts by some per cent; three finds that agree to a quarter of a metre; a gate that
    /// one in 10⁵ right finds fails (six degrees of freedom); centimetres that registrations of recorded pairs are off.
    /// Looks up to a distance beyond which hardly a place is recognised that was not before, but many are taken for one
    /// that nobody has seen (`docs/experiments.md`).
    fn default() -> Self {
        Self {
            min_way: 10.0,
            least_window: 1.0,
            growth: 0.03,
            window: 15.0,
            neighbours: 4,
            candidates: 2,
            look_alikes: 2,
            max_distance: 0.25,
            min_inlier_ratio: 0.6,
            margin: 0.1,
            confirmations: 3,
            agreement: PoseSigma { translation: 0.25, rotation: 0.06 },
            gate: 33.0,
            floor: PoseSigma { translation: 0.02, rotation: 0.003 },
        }
    }
}

impl LoopParams {
    fn validate(&self) -> Result<(), agv_core::Error> {
        check::non_negative("min_way", self.min_way)?;
        check::non_negative("least_window", self.least_window)?;
        check::non_negative("growth", self.growth)?;
        check::in_range("window", self.window, self.least_window, f64::MAX)?;
        check::in_range("max_distance", self.max_distance, 0.0, 1.0)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        check::in_range("margin", self.margin, 0.0, 1.0)?;
        for (name, count) in
            [("neighbours", self.neighbours), ("candidates", self.candidates), ("look_alikes", self.look_alikes)]
        {
            check::in_range(name, count as f64, 0.0, MOST)?;
        }
        check::at_least("confirmations", self.confirmations, 1)?;
        self.agreement.checked()?;
        check::positive("gate", self.gate)?;
        self.floor.checked()?;
        Ok(())
    }
}

/// Parameters of a [`KeyFrameMapper`](super::KeyFrameMapper).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct KeyFrameParams {
    /// Way after which a cloud becomes a key frame, in metres.
    pub distance: f64,
    /// Turn after which it does, in radians.
    pub turn: f64,
    /// Time after which it does if the vehicle has moved by a tenth of that, in seconds; never for none.
    pub time: Option<f64>,
    /// A cloud becomes no key frame where a loop closure finds it as near to an older one as this; none to keep all.
    pub reach: Option<PoseSigma>,
    /// Points nearer than this are the vehicle's own, in metres.
    pub min_range: f64,
    /// Points farther than this are left out, in metres.
    pub max_range: f64,
    /// Edge of the cubes of which a key frame keeps one point, in metres.
    pub leaf: f64,
    /// Edge of the cubes of which a registration gets one point, in metres.
    pub source_leaf: f64,
    /// Fewest points of a key frame.
    pub min_points: usize,
    /// Most points that a key frame keeps: 12 bytes each, and room for up to as many again.
    pub max_points: usize,
    /// How far odometry is believed.
    pub drift: LidarDrift,
    /// How places are recognised.
    pub places: ScanContextParams,
    /// How loops are closed.
    pub loops: LoopParams,
}

impl Default for KeyFrameParams {
    /// A key frame for every metre and every 20°, and none where one is within 0.7 m and 20°, which half a metre ahead
    /// and half a metre aside is: a vehicle that comes by again in the same lane adds none. A point per decimetre for
    /// maps of normal distributions and one per quarter of a metre to align; 400 kB a key frame at most.
    fn default() -> Self {
        Self {
            distance: 1.0,
            turn: 20_f64.to_radians(),
            time: None,
            reach: Some(PoseSigma { translation: 0.7, rotation: 20_f64.to_radians() }),
            min_range: 0.5,
            max_range: 60.0,
            leaf: 0.1,
            source_leaf: 0.25,
            min_points: 100,
            max_points: 20_000,
            drift: LidarDrift::default(),
            places: ScanContextParams::default(),
            loops: LoopParams::default(),
        }
    }
}

impl KeyFrameParams {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("distance", self.distance)?;
        check::positive("turn", self.turn)?;
        if let Some(time) = self.time {
            check::positive("time", time)?;
        }
        if let Some(reach) = self.reach {
            reach.checked()?;
        }
        check::positive("max_range", self.max_range)?;
        check::in_range("min_range", self.min_range, 0.0, self.max_range)?;
        check::in_range("leaf", self.leaf, 0.01, 10.0)?;
        check::in_range("source_leaf", self.source_leaf, self.leaf, 10.0)?;
        check::at_least("min_points", self.min_points, 10)?;
        check::at_least("max_points", self.max_points, self.min_points)?;
        self.drift.validate()?;
        self.places.validate()?;
        self.loops.validate()?;
        Ok(())
    }
}
