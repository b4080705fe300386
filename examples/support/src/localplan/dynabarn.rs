//! `DynaBARN`: discs that follow key frames in an open arena.

use super::MAX_INDEX;
use crate::{Error, Input, table::Table};
use agv_core::nalgebra::Vector2;
use std::{collections::BTreeMap, path::Path};

/// A disc of a [`DynabarnWorld`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DynabarnDisc {
    /// Time after which it starts over, in seconds.
    pub period: f64,
    /// Times, in seconds, and positions, in metres.
    pub frames: Vec<(f64, Vector2<f64>)>,
}

impl DynabarnDisc {
    /// Radius of all discs, in metres.
    pub const RADIUS: f64 = 0.5;
}

/// A world of `DynaBARN`.
#[derive(Debug, Clone, PartialEq)]
pub struct DynabarnWorld {
    /// Its number in the set.
    pub index: usize,
    /// Its class: easy, medium or hard.
    pub difficulty: String,
    /// Its obstacles.
    pub discs: Vec<DynabarnDisc>,
}

/// Reads a table of key frames (`world, difficulty, obstacle, period_s, t_s, x_m, y_m`); worlds by their numbers.
///
/// # Errors
/// A file that cannot be read, or a line that is none.
pub fn read_dynabarn(keyframes: impl AsRef<Path>) -> Result<Vec<DynabarnWorld>, Error> {
    parse(&Input::read(keyframes)?)
}

fn parse(input: &Input) -> Result<Vec<DynabarnWorld>, Error> {
    let mut worlds: BTreeMap<usize, (String, BTreeMap<usize, DynabarnDisc>)> = BTreeMap::new();
    let columns = ["world", "difficulty", "obstacle", "period_s", "t_s", "x_m", "y_m"];
    for row in Table::new(input, &columns)?.rows() {
        let row = row?;
        let difficulty = row.text("difficulty")?;
        let world =
            worlds.entry(row.count("world", MAX_INDEX)?).or_insert_with(|| (difficulty.into(), BTreeMap::new()));
        let disc = world.1.entry(row.count("obstacle", MAX_INDEX)?).or_default();
        disc.period = row.number("period_s")?;
        disc.frames.push((row.number("t_s")?, Vector2::new(row.number("x_m")?, row.number("y_m")?)));
    }
    let world = |(index, (difficulty, discs)): (_, (_, BTreeMap<_, _>))| DynabarnWorld {
        index,
        difficulty,
        discs: discs.into_values().collect(),
    };
    Ok(worlds.into_iter().map(world).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_gathered_by_obstacle() {
        let text = "world,difficulty,obstacle,traj_id,period_s,k,t_s,x_m,y_m\n\
                    2,hard,0,5,9.5,0,0,1,2\n0,easy,0,51,33.5,0,0,3,4\n2,hard,0,5,9.5,1,1.5,2,2\n2,hard,1,5,8,0,0,1,1\n";
        let worlds = parse(&Input::new("k", text)).unwrap();
        assert_eq!(
            worlds.iter().map(|w| (w.index, w.difficulty.as_str())).collect::<Vec<_>>(),
            [(0, "easy"), (2, "hard")]
        );
        let disc = &worlds[1].discs[0];
        assert_eq!((disc.period, disc.frames.len(), disc.frames[1]), (9.5, 2, (1.5, Vector2::new(2.0, 2.0))));
        assert!(parse(&Input::new("k", "world,difficulty\n")).is_err());
    }
}
