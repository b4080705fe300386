//! Stage 2, once more, with the feature `serde`: the map lies in files, one for each tile, and a lap is localised with only those in
//! memory that are around the vehicle.

use crate::{Args, Result, drive, hall::Hall, localization::Errors, mapping::Mapped};
use agv_nav::{
    core::metrics::Statistics,
    nalgebra::{Matrix6, Vector2},
    ndt::ndt::{NdtLocalizer, NdtLocalizerParams, NdtMap, NdtTile, NdtTiles},
    prelude::{Correct as _, Localizer as _, PointCloud, PoseBelief, Se3},
};
use agv_support::{cli::Report, timing::Timings};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Voxels along the edge of a tile, of a metre each.
const TILE: usize = 4;

/// Tiles as near as this are in memory, in metres; those beyond are let go.
const NEAR: f64 = 12.0;

/// Way after which tiles are exchanged, in metres.
const EXCHANGE: f64 = 2.0;

/// A map whose tiles are files.
struct Shelf {
    folder: PathBuf,
    tiles: NdtTiles,
}

/// The file of one tile.
fn file(folder: &Path, [i, j]: [i32; 2]) -> PathBuf {
    folder.join(format!("tile_{i}_{j}.json"))
}

impl Shelf {
    /// Writes a map as files, and says how many bytes they have; the file `index.json` knows which tiles there are.
    fn write(folder: &Path, map: &NdtMap) -> Result<u64> {
        fs::create_dir_all(folder)?;
        let mut tiles = NdtTiles::new(*map.params(), TILE)?;
        tiles.merge(map)?;
        let (indices, mut bytes): (Vec<_>, u64) = (tiles.loaded().map(|(index, _)| index).collect(), 0);
        for index in indices {
            let text = serde_json::to_vec(&tiles.unload(index).ok_or("a tile that was just there")?)?;
            bytes += text.len() as u64;
            fs::write(file(folder, index), text)?;
        }
        fs::write(folder.join("index.json"), serde_json::to_vec(&tiles)?)?;
        Ok(bytes)
    }

    /// The map as it was written, with all of it away.
    fn open(folder: &Path) -> Result<Self> {
        let tiles = serde_json::from_slice(&fs::read(folder.join("index.json"))?)?;
        Ok(Self { folder: folder.to_owned(), tiles })
    }

    /// Lets go of what is far from a place, which is as it lies in its file, and reads what is near it.
    fn go_to(&mut self, center: &Vector2<f64>) -> Result<()> {
        drop(self.tiles.unload_beyond(center, NEAR));
        for index in self.tiles.missing_within(center, NEAR) {
            let tile: NdtTile = serde_json::from_slice(&fs::read(file(&self.folder, index))?)?;
            self.tiles.load(&tile)?;
        }
        Ok(())
    }
}

/// Writes the map, and localises a lap from the files.
pub(crate) fn run(args: &Args, hall: &Hall, mapped: &Mapped, out: &Path, report: &mut Report) -> Result<()> {
    let folder = out.join("tiles");
    let bytes = Shelf::write(&folder, &mapped.site.map)?;
    let mut shelf = Shelf::open(&folder)?;
    let all = shelf.tiles.away().count();

    let start = hall.lap.points().first().ok_or("an empty lap")?.pose;
    shelf.go_to(&start.translation())?;
    // What is away is no place to look for a vehicle that is lost.
    let params = NdtLocalizerParams { search: None, ..NdtLocalizerParams::default() };
    let mut localizer = NdtLocalizer::new(&shelf.tiles.assembled(), params)?.with_parallelism(args.common.par());
    localizer.initialize(&PoseBelief::around(Se3::from(start), Matrix6::identity() * 4e-4)?)?;

    let speed = args.speeds.first().copied().ok_or("no speed")?;
    let (mut odometry, mut center, mut seen_near) = (drive::odometry()?, start.translation(), PointCloud::default());
    let (mut errors, mut times) = (Errors::default(), Timings::default());
    let (mut most_tiles, mut most_voxels) = (shelf.tiles.loaded().count(), shelf.tiles.len());
    drive::along(args, hall.factory.world(), &hall.lap, speed, args.common.seed().derive(1000), |seen| {
        if let Some(motion) = odometry.update(&seen.odometry, seen.imu_samples())? {
            localizer.predict(&motion)?;
        }
        for (cloud, _) in seen.clouds() {
            let here = localizer.estimate().ok_or("initialised above")?.map_from_base().to_planar();
            if (here.translation() - center).norm() >= EXCHANGE {
                center = here.translation();
                times.time(|| -> Result<()> {
                    shelf.go_to(&center)?;
                    Ok(localizer.set_map(&shelf.tiles.assembled())?)
                })?;
                most_tiles = most_tiles.max(shelf.tiles.loaded().count());
                most_voxels = most_voxels.max(shelf.tiles.len());
            }
            // What is farther may be in no tile that is here.
            seen_near.copy_from(cloud);
            seen_near.crop_range(0.0, (NEAR - EXCHANGE) as f32)?;
            localizer.update(&seen_near)?;
            let estimate = localizer.estimate().ok_or("initialised above")?;
            errors.add(&estimate.map_from_base().to_planar(), &seen.truth.map_from_base);
        }
        Ok(())
    })?;
    let off = Statistics::new(errors.distances().collect())?;
    report
        .count("tiles", all)
        .count("tiles_most_in_memory", most_tiles)
        .count("tiles_voxels_most_in_memory", most_voxels)
        .number("tiles_files_kb", bytes as f64 / 1000.0)
        .number("tiles_exchange_ms_p50", times.milliseconds(50.0))
        .number("tiles_exchange_ms_p99", times.milliseconds(99.0))
        .number("tiles_localization_mean_m", off.mean())
        .number("tiles_localization_max_m", off.max());
    Ok(())
}
