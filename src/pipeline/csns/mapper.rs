//! The mapping drive: a map that grows while the vehicle localises in it.

use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se3, UncertainPose},
    grid::EvidenceGrid,
    nalgebra::Matrix6,
    odometry::MotionIncrement,
    roles::{Correct, Localizer, PoseBelief, PoseEstimate, StatusParams, UpdateOutcome},
    sensors::PointCloud,
};
use agv_ndt::{
    convert::{CloudToGrid, CloudToGridParams},
    ndt::{NdtLocalizer, NdtLocalizerParams, NdtMap, NdtParams},
};

/// Parameters of a [`SiteMapper`].
#[derive(Debug, Clone, PartialEq)]
pub struct SiteMapperParams {
    /// How clouds are matched with the map so far, whose voxels it states. A mapper looks for itself nowhere else, so that its
    /// [`search`](NdtLocalizerParams::search) does not count.
    pub localizer: NdtLocalizerParams,
    /// How clouds become the grid.
    pub grid: CloudToGridParams,
    /// Way after which a cloud becomes part of the map, in metres.
    pub key_distance: f64,
    /// Turn after which it does, in radians.
    pub key_turn: f64,
    /// Share of a cloud that the map explains below which a quarter of that way or turn is enough, from 0 to 1: around a corner the
    /// map has to grow before it is lost sight of.
    pub novelty: f64,
}

impl Default for SiteMapperParams {
    /// A cloud for every metre and every 20°: lines of a 16-line lidar sweep a voxel in about that, and a wall has a few hundred points
    /// in each. Where a vehicle comes around a corner most of what it sees is new: three tenths of a cloud are enough for a match, and
    /// below half of one, which a map that is there always explains, the map grows four times as fast. A vehicle is not looked for
    /// elsewhere, since it is the map that is missing.
    fn default() -> Self {
        let localizer = NdtLocalizerParams::default();
        let ndt = NdtParams { min_inlier_ratio: 0.3, ..localizer.ndt };
        let status = StatusParams { explained: 0.3, unexplained: 0.2, ..localizer.status };
        Self {
            localizer: NdtLocalizerParams { ndt, status, search: None, ..localizer },
            grid: CloudToGridParams::default(),
            key_distance: 1.0,
            key_turn: 20_f64.to_radians(),
            novelty: 0.5,
        }
    }
}

/// What the mapper made of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SiteMapperStep {
    /// Where the vehicle was.
    pub map_from_base: Se3,
    /// Whether the cloud has become part of the map.
    pub mapped: bool,
    /// How it met the map; none for the first.
    pub outcome: Option<UpdateOutcome>,
}

/// A mapped site.
#[derive(Debug, Clone, PartialEq)]
pub struct Site {
    /// What vehicles localise in.
    pub map: NdtMap,
    /// What they plan on.
    pub grid: EvidenceGrid,
    /// Where the mapping vehicle was: places to look for a vehicle that may be anywhere.
    pub places: Vec<Se3>,
}

/// Maps a site from one drive: each cloud is matched with the map of those before it, and becomes part of it every metre or so.
///
/// The frame of the map is that of the start pose. There is no loop closure: where the drive comes back, the old map holds it, which
/// is enough for a hall, whose far walls are in sight from nearly everywhere.
///
/// ```
/// use agv_nav::{pipeline::csns::*, prelude::*};
/// use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};
///
/// let factory = Factory::generate(FactoryParams { length: 24.0, width: 10.0, ..Default::default() }, Seed(1))?;
/// let mount = Se3::from_parts([0.0, 0.0, 1.5].into(), Default::default());
/// let mut lidar = Lidar::new(LidarParams { columns: 450, ..LidarParams::vlp16().with_mount(mount) }, Seed(1))?;
/// let start = factory.aisles()[0];
/// let mut mapper = SiteMapper::new(SiteMapperParams::default(), start.into())?;
/// for i in 0..3 {
///     let (truth, now) = (start * Se2::new(0.6 * f64::from(i), 0.0, 0.0), Stamp::from_seconds(f64::from(i)));
///     let cloud = lidar.scan(factory.world(), &truth.into(), &Default::default(), now);
///     if i > 0 {
///         let motion = Se3::from(Se2::new(0.6, 0.0, 0.0));
///         mapper.predict(&MotionIncrement::between(now + -1.0, &Se3::default(), now, &motion)?)?;
///     }
///     let step = mapper.insert(cloud?)?;
///     assert!((step.map_from_base.translation().xy() - truth.translation()).norm() < 0.2);
/// }
/// assert_eq!(mapper.finish().places.len(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct SiteMapper {
    params: SiteMapperParams,
    /// The map before the first cloud; then it is the localizer's.
    empty: NdtMap,
    grid: CloudToGrid,
    /// Where the vehicle is before the first cloud.
    start: Se3,
    localizer: Option<NdtLocalizer>,
    places: Vec<Se3>,
}

impl SiteMapper {
    /// A mapper without a cloud, of a vehicle at rest at `map_from_base`.
    ///
    /// # Errors
    /// The first parameter that is out of its range, or a pose that is not finite.
    pub fn new(params: SiteMapperParams, map_from_base: Se3) -> Result<Self, Error> {
        check::positive("key_distance", params.key_distance)?;
        check::positive("key_turn", params.key_turn)?;
        check::in_range("novelty", params.novelty, 0.0, 1.0)?;
        params.localizer.validate()?;
        let start = UncertainPose::new(map_from_base, Matrix6::zeros())?;
        Ok(Self {
            empty: NdtMap::new(params.localizer.ndt.voxels)?,
            grid: CloudToGrid::new(params.grid.clone())?,
            start: *start.mean(),
            localizer: None,
            places: Vec::new(),
            params,
        })
    }

    /// Moves the vehicle; before the first cloud it is taken to rest.
    ///
    /// # Errors
    /// A motion that is not finite.
    pub fn predict(&mut self, motion: &MotionIncrement<Se3>) -> Result<(), Error> {
        if let Some(localizer) = &mut self.localizer {
            localizer.predict(motion)?;
        }
        Ok(())
    }

    /// Matches a cloud with the map, and adds it if the vehicle has come far enough. A cloud that does not fit moves nothing and is
    /// not added.
    ///
    /// # Errors
    /// What the localizer or the grid refuse, and a first cloud with too few points for a map; the map is then as it was.
    pub fn insert(&mut self, cloud: &PointCloud) -> Result<SiteMapperStep, Error> {
        let Some(mut localizer) = self.localizer.take() else { return self.begin(cloud) };
        let step = self.follow(&mut localizer, cloud);
        self.localizer = Some(localizer);
        step
    }

    /// The first cloud makes the map that the next one is matched with.
    fn begin(&mut self, cloud: &PointCloud) -> Result<SiteMapperStep, Error> {
        let mut map = self.empty.clone();
        map.insert(cloud, &self.start.compose(&cloud.base_from_sensor()));
        let mut localizer = NdtLocalizer::new(&map, NdtLocalizerParams { search: None, ..self.params.localizer })?;
        localizer.initialize(&PoseBelief::Around(UncertainPose::exact(self.start)))?;
        self.grid.insert(cloud, &self.start)?;
        self.localizer = Some(localizer);
        self.places.push(self.start);
        Ok(SiteMapperStep { map_from_base: self.start, mapped: true, outcome: None })
    }

    fn follow(&mut self, localizer: &mut NdtLocalizer, cloud: &PointCloud) -> Result<SiteMapperStep, Error> {
        let outcome = localizer.update(cloud)?;
        let here = localizer.estimate().map_or(self.start, |estimate| *estimate.map_from_base());
        let last = self.places.last().unwrap_or(&self.start);
        let way = last.between(&here);
        let explained = match outcome {
            UpdateOutcome::Applied(report) => report.explained,
            _ => None,
        };
        let Some(share) = explained else {
            return Ok(SiteMapperStep { map_from_base: here, mapped: false, outcome: Some(outcome) });
        };
        let enough = if share < self.params.novelty { 0.25 } else { 1.0 };
        let mapped = way.translation().norm() >= enough * self.params.key_distance
            || way.rotation().log().norm() >= enough * self.params.key_turn;
        if mapped {
            self.grid.insert(localizer.straightened(), &here)?;
            localizer.insert_straightened(&here)?;
            self.places.push(here);
        }
        Ok(SiteMapperStep { map_from_base: here, mapped, outcome: Some(outcome) })
    }

    /// Where the vehicle is; none before the first cloud.
    pub fn estimate(&self) -> Option<PoseEstimate<Se3>> {
        self.localizer.as_ref().and_then(Localizer::estimate)
    }

    /// The map so far.
    pub fn map(&self) -> &NdtMap {
        self.localizer.as_ref().map_or(&self.empty, NdtLocalizer::map)
    }

    /// The grid so far.
    pub const fn grid(&self) -> &CloudToGrid {
        &self.grid
    }

    /// The site as it was mapped.
    pub fn finish(self) -> Site {
        let map = self.localizer.map_or(self.empty, NdtLocalizer::into_map);
        Site { map, grid: self.grid.evidence().clone(), places: self.places }
    }
}
