//! From how far is the pose found? Random guesses around the reference.

use crate::{Args, Result, load::Pair};
use agv_nav::core::{
    geometry::{LieGroup, Se3, So3},
    metrics::TrajectoryPose,
    nalgebra::Vector3,
    roles::Registration,
};
use agv_support::{cli::Report, progress::Progress, timing::Timings};
use rand::RngExt;

/// Greatest offsets, in metres and degrees.
const MAGNITUDES: [(f64, f64); 3] = [(0.5, 5.0), (1.0, 10.0), (2.0, 20.0)];

/// Guesses off the reference by up to each magnitude, evenly, in a random direction and about a random axis; found is within 5 cm
/// and 0.5°.
pub(crate) fn run(
    args: &Args,
    trials: u32,
    pair: &Pair,
    method: &mut dyn Registration,
    report: &mut Report,
) -> Result<()> {
    let truth = pair.truth.ok_or("the basin needs a reference: --truth and --pair")?;
    let mut cases = Vec::new();
    for (index, (metres, degrees)) in MAGNITUDES.into_iter().enumerate() {
        let mut stream = args.common.seed().stream(index as u64, 0);
        let (mut found, mut wrong, mut missed, mut times) = (0, 0, 0, Timings::default());
        let progress = Progress::new(trials as usize, "aligning");
        for _ in progress.over(0..trials) {
            let mut direction = || loop {
                let v = Vector3::from_fn(|_, _| stream.random_range(-1.0..1.0_f64));
                if (0.01..1.0).contains(&v.norm()) {
                    return v.normalize();
                }
            };
            let (along, about) = (direction(), direction());
            let (length, angle) = (metres * stream.random::<f64>(), degrees.to_radians() * stream.random::<f64>());
            let offset = Se3::from_parts(along * length, So3::exp(&(about * angle)));
            let guess = truth * offset;
            let result = times.time(|| method.align(&pair.source, &guess))?;
            let error = truth.between(&result.target_from_source);
            let right = error.distance() < 0.05 && error.angle() < 0.5_f64.to_radians();
            found += usize::from(right);
            wrong += usize::from(!right && result.converged());
            missed += usize::from(right && !result.converged());
        }
        let mut case = Report::new(format!("{metres} m, {degrees} deg"));
        let share = |count: usize| count as f64 / f64::from(trials);
        case.number("offset_m", metres)
            .number("offset_deg", degrees)
            .number("found", share(found))
            .number("false_convergence", share(wrong))
            .number("false_alarm", share(missed))
            .number("align_ms_p50", times.milliseconds(50.0));
        cases.push(case);
    }
    report.reports("basin", cases);
    Ok(())
}
