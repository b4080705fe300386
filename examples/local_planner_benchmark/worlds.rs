//! Where the vehicle drives: worlds of the three sets, and generated ones.

use crate::Result;
use agv_nav::{
    nalgebra::Vector2,
    prelude::{CellState, Grid, Se2, Seed},
};
use agv_sim::{Clutter, ClutterParams, GridWorld, KeyFrame, MovingDisc, MovingDiscs, PlanarWorld, Shape, World2d};
use agv_support::localplan::{
    BarnWorld, DynabarnDisc, DynabarnWorld, read_barn, read_dynabarn, read_mrpb_map, read_mrpb_tests,
};
use std::path::{Path, PathBuf};

/// A drive from a start to a goal.
pub(crate) struct Trial {
    /// What it is called in tables and file names.
    pub(crate) name: String,
    /// Its number in the set: what its noise is drawn by, whichever worlds are run with it.
    pub(crate) number: u64,
    /// Worlds of one class are counted together.
    pub(crate) class: String,
    /// What does not move.
    pub(crate) world: Box<dyn PlanarWorld + Send + Sync>,
    /// What the picture shows of it: discs, or a map.
    pub(crate) discs: Vec<Vector2<f64>>,
    pub(crate) map: Option<Grid<CellState>>,
    /// What moves.
    pub(crate) moving: MovingDiscs,
    pub(crate) start: Se2,
    pub(crate) goal: Se2,
    /// Time that the score refers to, in seconds.
    pub(crate) optimal_time: f64,
    /// A way that the set gives; for pictures.
    pub(crate) reference: Vec<Vector2<f64>>,
    /// Edge of the square that the vehicle remembers, in metres.
    pub(crate) window: f64,
}

#[derive(clap::Args)]
pub(crate) struct WorldArgs {
    /// BARN: table of worlds
    #[arg(long, requires = "cylinders", conflicts_with_all = ["keyframes", "map"])]
    worlds: Option<PathBuf>,
    /// BARN: their cylinders
    #[arg(long, requires = "worlds")]
    cylinders: Option<PathBuf>,
    /// BARN: the set's own paths
    #[arg(long, requires = "worlds")]
    paths: Option<PathBuf>,
    /// So many generated worlds of BARN's kind, by the seed
    #[arg(long, conflicts_with_all = ["worlds", "keyframes", "map"])]
    generated: Option<usize>,
    /// `DynaBARN`: key frames of the moving discs
    #[arg(long, conflicts_with = "map")]
    keyframes: Option<PathBuf>,
    /// MRPB: image of a map
    #[arg(long, requires = "tests")]
    map: Option<PathBuf>,
    /// MRPB: table of starts and goals
    #[arg(long, requires = "map")]
    tests: Option<PathBuf>,
    /// MRPB: the vehicle knows the map, and where it is on it, as in the set's own tests
    #[arg(long, requires = "map")]
    pub(crate) known_map: bool,
}

impl WorldArgs {
    /// The worlds that the arguments name, or those of the repository.
    pub(crate) fn load(&self, seed: Seed) -> Result<Vec<Trial>> {
        if let (Some(worlds), Some(cylinders)) = (&self.worlds, &self.cylinders) {
            return read_barn(worlds, cylinders, self.paths.as_deref())?.into_iter().map(barn).collect();
        }
        if let Some(keyframes) = &self.keyframes {
            return read_dynabarn(keyframes)?.into_iter().map(dynabarn).collect();
        }
        if let (Some(map), Some(tests)) = (&self.map, &self.tests) {
            return mrpb(map, tests);
        }
        if let Some(count) = self.generated {
            return (0..count).map(|index| generated(index, seed)).collect();
        }
        let [worlds, cylinders, paths] =
            ["worlds.csv", "cylinders.csv.gz", "paths.csv.gz"].map(|file| Path::new("data/barn").join(file));
        read_barn(&worlds, &cylinders, Some(&paths))?.into_iter().map(barn).collect()
    }
}

/// At most so many, spread over all.
pub(crate) fn some_of(trials: Vec<Trial>, limit: Option<usize>) -> Vec<Trial> {
    let (all, limit) = (trials.len(), limit.unwrap_or(usize::MAX).min(trials.len()));
    let is_chosen = |index: usize| (index + 1) * limit / all > index * limit / all;
    trials.into_iter().enumerate().filter(|(index, _)| is_chosen(*index)).map(|(_, trial)| trial).collect()
}

fn barn(world: BarnWorld) -> Result<Trial> {
    let shape = |&center| Shape::Circle { center, radius: BarnWorld::CYLINDER_RADIUS };
    Ok(Trial {
        name: format!("barn_{:03}", world.index),
        number: world.index as u64,
        class: "barn".into(),
        world: Box::new(World2d::new(world.cylinders.iter().map(shape).collect())?),
        discs: world.cylinders,
        map: None,
        moving: MovingDiscs::default(),
        start: Clutter::start(),
        goal: Clutter::goal(),
        optimal_time: world.optimal_time,
        reference: world.path,
        window: 14.0,
    })
}

/// A world of BARN's kind, of three of its twelve classes.
fn generated(index: usize, seed: Seed) -> Result<Trial> {
    let params = ClutterParams { fill: 0.15 + 0.05 * (index % 3) as f64, smoothing: 2 + index % 3 };
    let clutter = Clutter::generate(params, seed.derive(index as u64))?;
    Ok(Trial {
        name: format!("generated_{index:03}"),
        number: index as u64,
        class: "generated".into(),
        world: Box::new(World2d::new(clutter.shapes())?),
        discs: clutter.cylinders().to_vec(),
        map: None,
        moving: MovingDiscs::default(),
        start: Clutter::start(),
        goal: Clutter::goal(),
        optimal_time: clutter.way_length() / 2.0,
        reference: clutter.way().to_vec(),
        window: 14.0,
    })
}

fn dynabarn(world: DynabarnWorld) -> Result<Trial> {
    let frame = |&(time, position): &(f64, Vector2<f64>)| KeyFrame { time, position };
    let disc = |d: &DynabarnDisc| MovingDisc::new(DynabarnDisc::RADIUS, d.period, d.frames.iter().map(frame).collect());
    let discs = world.discs.iter().map(disc).collect::<std::result::Result<_, _>>()?;
    Ok(Trial {
        name: format!("dynabarn_{:02}_{}", world.index, world.difficulty),
        number: world.index as u64,
        class: world.difficulty,
        world: Box::new(World2d::new(Vec::new())?),
        discs: Vec::new(),
        map: None,
        moving: MovingDiscs::new(discs),
        start: Se2::new(11.0, 0.0, std::f64::consts::PI),
        goal: Se2::new(-9.0, 0.0, std::f64::consts::PI),
        // The official scorer has a slip here; the length is 20 m.
        optimal_time: 10.0,
        reference: Vec::new(),
        window: 14.0,
    })
}

/// The tests of one map.
fn mrpb(image: &PathBuf, tests: &PathBuf) -> Result<Vec<Trial>> {
    let name = image.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let name = name.split('.').next().unwrap_or_default();
    let tests: Vec<_> = read_mrpb_tests(tests)?.into_iter().filter(|test| test.map == name).collect();
    if tests.is_empty() {
        return Err(format!("{}: the table has no test of `{name}`", image.display()).into());
    }
    tests
        .into_iter()
        .map(|test| {
            let map = read_mrpb_map(image, &test)?;
            let edge = map.layout().width().max(map.layout().height()) as f64 * map.layout().resolution();
            let way = (test.goal.translation() - test.start.translation()).norm();
            Ok(Trial {
                name: format!("{name}_{}", test.number),
                number: test.number as u64,
                class: name.into(),
                world: Box::new(GridWorld::new(&map)),
                discs: Vec::new(),
                map: Some(map),
                moving: MovingDiscs::default(),
                start: test.start,
                goal: test.goal,
                optimal_time: way / 2.0,
                reference: Vec::new(),
                // All of it, wherever the vehicle is: what was seen is needed again.
                window: (2.0 * edge).min(40.0),
            })
        })
        .collect()
}
