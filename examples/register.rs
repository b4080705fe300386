//! Where was this cloud taken? Two clouds are aligned, and the pose is compared with a reference.
//!
//! ```text
//! cargo run --release --example register                                              # two simulated revolutions in a factory
//! cargo run --release --example register -- --target a.ply --source b.pcd
//! cargo run --release --example register -- --target t.xyz.f32.gz --source s.xyz.f32.gz --truth pair_references.csv --pair hdl32
//! cargo run --release --example register -- --target a.ply --source b.ply --basin 200 --truth pairs.csv --pair yard
//! ```
//!
//! Clouds are PLY, PCD, KITTI's `.bin`, or raw rows as `agv_support::cloud` says. `align_ms` is that of the call alone, the fastest of
//! `--repeats`; down-sampling is not in it, and the target's map is `build_ms`.
//!
//! You will see the pose, its distance from the reference, and why the search ended; with `--basin` how often it is found from
//! random guesses around the reference, and how often a wrong pose was taken for right. It takes a second, the basin minutes.

#[path = "register/basin.rs"]
mod basin;
#[path = "register/load.rs"]
mod load;
#[path = "register/methods.rs"]
mod methods;

use agv_nav::core::{
    geometry::{LieGroup, Se3, So3},
    metrics::TrajectoryPose,
    nalgebra::Vector3,
    roles::Registration,
};
use agv_nav::ndt::ndt::NdtParams;
use agv_support::{
    cli::{CommonArgs, Report},
    timing::Timings,
};
use clap::Parser;
use methods::Method;
use std::{path::PathBuf, process::ExitCode};

/// Align two clouds.
#[derive(Parser)]
struct Args {
    /// Cloud whose pose is sought [default: a simulated one]
    #[arg(long, requires = "target")]
    source: Option<PathBuf>,
    /// Cloud that it is aligned with
    #[arg(long, requires = "source")]
    target: Option<PathBuf>,
    /// First guess, as x,y,z,roll,pitch,yaw in metres and radians [default: the identity]
    #[arg(long, value_parser = guess, allow_hyphen_values = true)]
    guess: Option<Se3>,
    /// File of reference poses
    #[arg(long, requires = "pair")]
    truth: Option<PathBuf>,
    /// Name of the pair in the file of reference poses
    #[arg(long, requires = "truth")]
    pair: Option<String>,
    /// Kind of the reference
    #[arg(long, default_value = "consensus")]
    kind: String,
    /// Who aligns
    #[arg(long, value_enum, default_value_t = Method::Ndt)]
    method: Method,
    /// Edge of the cubes that the source is thinned out by, in metres; zero for none [default: 0.25; 0.1 for d2d]
    #[arg(long, value_parser = leaf)]
    source_leaf: Option<f32>,
    /// Edge of the cubes that the target is thinned out by, in metres; zero for none [default: 0.1; 0.25 for methods that pair points]
    #[arg(long, value_parser = leaf)]
    target_leaf: Option<f32>,
    /// Edge of the voxels, in metres
    #[arg(long, default_value_t = 1.0)]
    resolution: f64,
    /// Share of points without a surface, for normal distributions
    #[arg(long, default_value_t = NdtParams::default().outlier_ratio)]
    outlier_ratio: f64,
    /// How often the alignment is timed; the fastest counts
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u16).range(1..=1000))]
    repeats: u16,
    /// So many random guesses around the reference, at each of three magnitudes, instead of one alignment
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    basin: Option<u32>,
    #[command(flatten)]
    common: CommonArgs,
}

impl Args {
    fn source_leaf(&self) -> f32 {
        self.source_leaf.unwrap_or_else(|| self.method.source_leaf())
    }

    fn target_leaf(&self) -> f32 {
        self.target_leaf.unwrap_or_else(|| self.method.target_leaf())
    }
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    // In a pool of its own: a call from outside of any wakes a thread up for each loop.
    let threads = usize::from(args.common.threads);
    agv_support::run(|| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(pool.install(|| run(&args).map_err(|error| error.to_string()))?) as Result<()>
    })
}

fn run(args: &Args) -> Result<()> {
    let pair = load::load(args)?;
    let mut method = args.method.build(args)?;
    let mut build = Timings::default();
    for _ in 0..args.repeats {
        build.time(|| method.set_target(&pair.target))?;
    }
    let mut report = Report::new("Alignment of two clouds");
    report.text("method", args.method.name());
    report.count("target_points", pair.target.len()).count("source_points", pair.source.len());
    match args.basin {
        Some(trials) => basin::run(args, trials, &pair, method.as_mut(), &mut report)?,
        None => once(args, &pair, method.as_mut(), &mut report)?,
    }
    report.number("build_ms", build.milliseconds(0.0));
    report.print(args.common.json)?;
    Ok(())
}

fn once(args: &Args, pair: &load::Pair, method: &mut dyn Registration, report: &mut Report) -> Result<()> {
    let guess = args.guess.unwrap_or_default();
    let mut times = Timings::default();
    let mut found = method.align(&pair.source, &guess)?;
    for _ in 0..args.repeats {
        found = times.time(|| method.align(&pair.source, &guess))?;
    }
    let error = pair.truth.map(|truth| truth.between(&found.target_from_source));
    let pose = &found.target_from_source;
    let (t, (roll, pitch, yaw)) = (pose.translation(), pose.rotation().roll_pitch_yaw());
    report
        .flag("converged", found.converged())
        .text("termination", format!("{:?}", found.termination))
        .count("iterations", found.iterations)
        .number("translation_error_m", error.map_or(f64::NAN, |error| error.distance()))
        .number("rotation_error_deg", error.map_or(f64::NAN, |error| error.angle().to_degrees()))
        .number("align_ms", times.milliseconds(0.0))
        .number("score", found.score)
        .number("inlier_ratio", found.inlier_ratio)
        .number("unobserved_directions", found.unobserved.trace())
        .numbers("pose", &[t.x, t.y, t.z, roll, pitch, yaw]);
    Ok(())
}

fn guess(text: &str) -> std::result::Result<Se3, String> {
    let values = text.split(',').map(|field| field.trim().parse().map_err(|_| format!("`{field}` is not a number")));
    let values = values.collect::<std::result::Result<Vec<f64>, _>>()?;
    let [x, y, z, roll, pitch, yaw] = values[..] else { return Err("six numbers are needed".into()) };
    let pose = Se3::from_parts(Vector3::new(x, y, z), So3::from_roll_pitch_yaw(roll, pitch, yaw));
    pose.is_finite().then_some(pose).ok_or_else(|| "the numbers must be finite".into())
}

fn leaf(text: &str) -> std::result::Result<f32, String> {
    let leaf: f32 = text.parse().map_err(|_| "not a number".to_owned())?;
    (leaf == 0.0 || (0.001..=1000.0).contains(&leaf)).then_some(leaf).ok_or_else(|| "0, or from 0.001 to 1000".into())
}
