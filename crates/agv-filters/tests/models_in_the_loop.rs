//! Every sensor and motion model on a drive, in the filter that it is made for; several sensors on one filter.

mod room;

use agv_core::{
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    grid::{GaussianGrid, GaussianParams, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, SkipReason, UpdateOutcome},
    sensors::{LandmarkObservation, LaserScan, MarkerObservation, Observation, SensorId},
    time::Stamp,
};
use agv_filters::particle::{
    AckermannOdometryModel, AckermannOdometryParams, BeamModel, BeamModelParams, BeamSkipping, BeamSkippingParams,
    DifferentialOdometryModel, LandmarkModel, LandmarkModelParams, LikelihoodFieldModel, LikelihoodFieldModelParams,
    MarkerModel, MarkerModelParams, Mcl, MotionModel, NdtMapModel, NdtMapModelParams, OdometryNoise,
    OmnidirectionalNoise, OmnidirectionalOdometryModel, PriorMotionModel, PriorNoise, ScanForm, Sensors, VelocityModel,
    VelocityNoise, WeighParticles,
};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use room::{Errors, Laser, drive, filter, room};

const ALPHA: f64 = 0.02;

/// A circle of 1.25 m radius, 0.25 m at a time.
const CIRCLE: (f64, f64) = (0.25, 0.2);

fn circle() -> (Se2, Twist2) {
    (Se2::new(4.0, 1.2, 0.0), Twist2::new(CIRCLE.0, 0.0, CIRCLE.1))
}

fn slipping() -> DifferentialOdometryModel {
    DifferentialOdometryModel::new(OdometryNoise::uniform(ALPHA)).unwrap()
}

fn field(params: LikelihoodFieldModelParams) -> LikelihoodFieldModel {
    LikelihoodFieldModel::new(&LikelihoodField::new(&room(), LikelihoodFieldParams::default()).unwrap(), params)
        .unwrap()
}

fn is_applied<Z: Observation + ?Sized>(mcl: &mut impl Correct<Z>, observation: &Z) {
    let outcome = mcl.update(observation);
    assert!(matches!(outcome, Ok(UpdateOutcome::Applied(_))), "{outcome:?}");
}

/// Root mean square over the seeds.
fn mean(errors: &[Errors], of: impl Fn(&Errors) -> f64) -> f64 {
    (errors.iter().map(|e| of(e).powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
}

fn with_scans<S: WeighParticles<LaserScan> + Clone>(sensor: &S, particles: usize, seeds: u64) -> Vec<Errors> {
    (0..seeds)
        .map(|seed| {
            let mut mcl = filter(slipping(), sensor.clone(), particles, seed);
            drive(&mut mcl, &slipping(), circle(), Matrix3::zeros(), seed, |mcl, truth, world| {
                is_applied(mcl, &Laser::ahead(60).scan(truth, &[], world));
            })
        })
        .collect()
}

/// Walls are drawn to a cell of 5 cm, whose middle is 2.5 cm behind the face that is seen, and ranges err by 2 cm: 3.5 cm per
/// beam and axis if all beams erred alike (as `mcl_tracking.rs` argues), and 5 cm with the particles' own spread. The heading
/// is known from walls of metres by such errors: 2°.
fn assert_tracks(name: &str, errors: &[Errors]) {
    let (position, heading) = (mean(errors, |e| e.position), mean(errors, |e| e.heading));
    eprintln!("{name}: {position:.4} m, {:.2}°, {:?}", heading.to_degrees(), errors[0]);
    assert!(position < 0.05 * 2_f64.sqrt() && heading < 2_f64.to_radians(), "{name}: {position} m, {heading} rad");
    assert!(errors.iter().all(|e| e.position < 0.1), "{name}: {errors:?}");
}

#[test]
fn the_beam_model_tracks() {
    for unknown in [agv_core::grid::UnknownSpace::Free, agv_core::grid::UnknownSpace::Uniform] {
        let params = BeamModelParams { max_beams: 30, unknown, ..Default::default() };
        assert_tracks("beams", &with_scans(&BeamModel::new(&room(), params).unwrap(), 300, 3));
    }
    let params = BeamModelParams { max_beams: 30, form: ScanForm::SumOfCubes, ..Default::default() };
    let errors = with_scans(&BeamModel::new(&room(), params).unwrap(), 300, 2);
    assert!(mean(&errors, |e| e.position) < 0.15, "the blunt form is blunt: {errors:?}");
}

#[test]
fn the_ndt_map_tracks() {
    for resolution in [0.3, 0.5, 1.0] {
        let map = GaussianGrid::from_map(&room(), resolution, GaussianParams::default()).unwrap();
        let model = NdtMapModel::new(&map, NdtMapModelParams::default()).unwrap();
        assert_tracks("distributions", &with_scans(&model, 1000, 4));
    }
}

/// People around the vehicle stop a third of the beams. Skipped, they do not move the estimate; taken in, each pulls by the
/// floor of its mixture only, but all of the time.
#[test]
fn skipped_beams_of_people_do_no_harm() {
    let form = ScanForm::Product { independent_beams: 60.0 };
    let all_beams = field(LikelihoodFieldModelParams { form, ..Default::default() });
    let skipping = BeamSkipping::new(all_beams, &room(), BeamSkippingParams::default()).unwrap();
    let mut errors = Vec::new();
    let (mut updates, mut skipped) = (0, 0);
    for seed in 0..8 {
        let mut mcl = filter(slipping(), skipping.clone(), 2000, seed);
        errors.push(drive(&mut mcl, &slipping(), circle(), Matrix3::zeros(), seed, |mcl, truth, world| {
            // At 0.9 m, and in nobody's map: that is more than the skipping distance from the walls, most of the time.
            let people =
                [-1.2, -0.1, 1.0_f64].map(|angle| (truth.act(&(Vector2::new(angle.cos(), angle.sin()) * 0.9)), 0.2));
            is_applied(mcl, &Laser::ahead(60).scan(truth, &people, world));
            updates += 1;
            skipped += mcl.sensor().skipped();
        }));
    }
    assert_tracks("among people", &errors);
    // Each covers 2 asin(0.2 / 0.9) = 0.45 rad of 4: 20 beams of 60 in all; half of them at least are far from any wall. Of the
    // walls' beams hardly one is skipped.
    assert!(skipped > 10 * updates && skipped <= 21 * updates, "{skipped} in {updates} updates");
}

/// Reflectors along the walls.
fn tubes() -> Vec<(u32, Vector2<f64>)> {
    [(0.5, 0.0), (3.0, 0.0), (6.5, 0.0), (8.0, 2.0), (7.0, 5.0), (3.5, 5.0), (0.0, 4.0), (0.0, 1.5)]
        .iter()
        .zip(1..)
        .map(|(&(x, y), id)| (id, Vector2::new(x, y)))
        .collect()
}

/// Range by 5 cm and bearing by a degree; one reading in ten is of something else.
fn with_landmarks(named: bool, seed: u64) -> Errors {
    let model = LandmarkModel::new(tubes(), LandmarkModelParams::default()).unwrap();
    let mut mcl = filter(slipping(), model, 2000, seed);
    let sigmas = Vector2::new(0.05, 1_f64.to_radians());
    let mount = Se2::new(0.3, 0.1, 0.5);
    drive(&mut mcl, &slipping(), circle(), Matrix3::zeros(), seed, |mcl, truth, world| {
        let seen: Vec<LandmarkObservation> = tubes()
            .iter()
            .filter_map(|(id, place)| {
                let towards = (*truth * mount).inverse().act(place);
                let noise: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(world));
                let bearing = towards.y.atan2(towards.x);
                let mut reading = Vector2::new(towards.norm(), bearing) + sigmas.component_mul(&Vector2::from(noise));
                if world.random::<f64>() < 0.1 {
                    reading = Vector2::new(8.0 * world.random::<f64>(), 6.0 * world.random::<f64>() - 3.0);
                }
                let measured = UncertainVector::from_sigmas(Vector2::new(reading.x.abs(), reading.y), &sigmas);
                let seen = LandmarkObservation::new(Stamp::default(), named.then_some(*id), measured.unwrap());
                (bearing.abs() < 2.0).then(|| seen.unwrap().with_mount(mount).unwrap())
            })
            .collect();
        assert!(seen.len() >= 2);
        is_applied(mcl, seen.as_slice());
    })
}

/// A reading places the vehicle along its direction to 7 cm (its own 5 cm and the model's 5 cm for the landmark), and there are
/// four in view in the mean: √2 · 7 cm / √(4 / 2) = 7 cm for both axes from a single look, and less with the odometry between
/// the looks.
#[test]
fn landmarks_localise_with_numbers_and_without() {
    for named in [true, false] {
        let errors: Vec<Errors> = (0..8).map(|seed| with_landmarks(named, seed)).collect();
        let (position, nees) = (mean(&errors, |e| e.position), mean(&errors, |e| e.median_nees));
        eprintln!("landmarks, {named}: {position:.4} m, {nees}");
        assert!(position < 0.07 && errors.iter().all(|e| e.position < 0.1), "{named}: {errors:?}");
        // The median of chi-square with three degrees of freedom is 2.37.
        assert!(nees < 3.5, "{named}: {nees}");
    }
}

/// What a camera at the vehicle's middle reads of a code that lies under it: 5 mm and half a degree.
fn code_under(
    truth: &Se2,
    id: u32,
    offset: Se2,
    world: &mut agv_core::compute::Stream,
) -> (MarkerObservation<Se2>, Se2) {
    let sigmas = Vector3::new(0.005, 0.005, 0.5_f64.to_radians());
    let noise = Vector3::from_fn(|_, _| StandardNormal.sample(world)).component_mul(&sigmas);
    let spread = Matrix3::from_diagonal(&sigmas.component_mul(&sigmas));
    let seen = UncertainPose::new(offset.plus(&noise), spread).unwrap();
    (MarkerObservation::new(Stamp::default(), id, seen), *truth * offset)
}

/// The code's 5 mm, the 2 cm that the model adds, and for one axis as for the other.
#[test]
fn codes_localise_and_false_ones_do_no_harm() {
    let home = Se2::new(4.0, 2.45, 0.0);
    let codes = (0..8).map(|k| (k, home * Se2::new(0.0, 0.0, 0.785 * f64::from(k)) * Se2::new(1.25, 0.0, 1.0)));
    let codes: Vec<(u32, Se2)> = codes.collect();
    let mut errors = Vec::new();
    for seed in 0..8 {
        let known = codes.iter().map(|(id, pose)| (*id, UncertainPose::exact(*pose)));
        let mut mcl = filter(slipping(), MarkerModel::new(known, MarkerModelParams::default()).unwrap(), 2000, seed);
        errors.push(drive(&mut mcl, &slipping(), circle(), Matrix3::zeros(), seed, |mcl, truth, world| {
            // The nearest code, wherever it lies under the camera; one number in ten is misread.
            let offset = |code: &(u32, Se2)| truth.between(&code.1).translation().norm();
            let nearest = codes.iter().min_by(|a, b| offset(a).total_cmp(&offset(b))).unwrap();
            let id = if world.random::<f64>() < 0.1 { (nearest.0 + 3) % 8 } else { nearest.0 };
            let (seen, _) = code_under(truth, id, truth.between(&nearest.1), world);
            let _ = mcl.update(&[seen][..]).unwrap();
        }));
    }
    let (position, heading) = (mean(&errors, |e| e.position), mean(&errors, |e| e.heading));
    eprintln!("codes: {position:.4} m, {:.2}°", heading.to_degrees());
    // A step turns by 0.054 rad more or less than told, and after one code in ten that is all there is: with what is left after the
    // others, 0.01 rad, 0.0198 rad in the mean; three deviations of a mean square over 48 such steps more.
    assert!(position < 0.0206 * 2_f64.sqrt() && heading < 1.3 * 0.0198, "{position} {heading}");
}

/// Two lasers, one ahead on the left and one behind, upside down, and codes: all on one filter, each by its own mount.
#[test]
fn several_sensors_go_together() {
    let lasers = [(0, Se2::new(0.4, 0.2, 0.5)), (1, Se2::new(-0.5, -0.1, 3.0))]
        .map(|(sensor, base_from_sensor)| Laser { beams: 60, base_from_sensor, sensor: SensorId(sensor) });
    let code = Se2::new(5.25, 2.45, 0.7);
    let sensors = || Sensors {
        scans: field(LikelihoodFieldModelParams::default()),
        markers: MarkerModel::new([(7, UncertainPose::exact(code))], MarkerModelParams::default()).unwrap(),
        landmarks: (),
    };
    let run = |used: &[usize], with_code: bool, seed: u64| {
        let mut mcl: Mcl<_, Sensors<_, _>> = filter(slipping(), sensors(), 2000, seed);
        drive(&mut mcl, &slipping(), circle(), Matrix3::zeros(), seed, |mcl, truth, world| {
            for &laser in used {
                is_applied(mcl, &lasers[laser].scan(truth, &[], world));
            }
            let offset = truth.between(&code);
            if with_code && offset.translation().norm() < 0.3 {
                let (seen, _) = code_under(truth, 7, offset, world);
                is_applied(mcl, &seen);
            }
            // What was taken in is not taken in again from the same place.
            let again = mcl.update(&lasers[used[0]].scan(truth, &[], world));
            assert_eq!(again, Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion)));
        })
    };
    let all = |used: &[usize], with_code| -> Vec<Errors> { (0..6).map(|seed| run(used, with_code, seed)).collect() };
    let (one, two, with_code) = (all(&[0], false), all(&[0, 1], false), all(&[0, 1], true));
    assert_tracks("one laser", &one);
    assert_tracks("two lasers", &two);
    assert_tracks("two lasers and a code", &with_code);
    // The walls' bias of 2.5 cm pulls one laser ahead; the one behind pulls it back.
    assert!(mean(&two, |e| e.position) < mean(&one, |e| e.position));
}

/// Nothing comes of observations that no model is there for.
#[test]
fn a_kind_without_a_model_is_skipped() {
    let mut sensors = Sensors { scans: field(LikelihoodFieldModelParams::default()), markers: (), landmarks: () };
    let seen = MarkerObservation::new(Stamp::default(), 1, UncertainPose::exact(Se2::default()));
    let outcome = sensors.weigh(&seen, &[Se2::default()], &mut [0.0], agv_core::compute::Par::Seq);
    assert_eq!(outcome, Err(SkipReason::TooFewReadings { usable: 0, needed: 1 }));
}

fn with_motion<M: MotionModel<Motion = OdometryIncrement> + Clone>(
    name: &str,
    model: &M,
    slip: &M,
    path: (Se2, Twist2),
    covariance: Matrix3<f64>,
) {
    let errors: Vec<Errors> = (0..4)
        .map(|seed| {
            let mut mcl = filter(model.clone(), field(LikelihoodFieldModelParams::default()), 2000, seed);
            drive(&mut mcl, slip, path, covariance, seed, |mcl, truth, world| {
                is_applied(mcl, &Laser::ahead(60).scan(truth, &[], world));
            })
        })
        .collect();
    assert_tracks(name, &errors);
}

/// The vehicle slips as the model draws, and the filter follows, with the right noise and with the default one.
#[test]
fn every_motion_model_tracks() {
    let zero = Matrix3::zeros();
    let omni = |alpha| OmnidirectionalOdometryModel::new(OmnidirectionalNoise::uniform(alpha)).unwrap();
    // Sideways on the circle, looking at its middle.
    let sideways = (Se2::new(4.0, 1.2, 1.57), Twist2::new(0.0, -0.25, 0.2));
    let velocity = |alpha| VelocityModel::new(VelocityNoise::uniform(alpha)).unwrap();
    let steered = AckermannOdometryParams { steering_sigma: 0.05, run_per_run: ALPHA, ..Default::default() };
    let steering = |params| AckermannOdometryModel::new(params).unwrap();
    for alpha in [ALPHA, 0.2] {
        with_motion("omnidirectional", &omni(alpha), &omni(ALPHA), sideways, zero);
        with_motion("velocity", &velocity(alpha), &velocity(ALPHA), circle(), zero);
    }
    for params in [steered, AckermannOdometryParams::default()] {
        with_motion(
            "Ackermann",
            &steering(params),
            &steering(steered),
            (circle().0, Twist2::new(0.25, 0.0, 0.13)),
            zero,
        );
    }
    let prior = PriorMotionModel::new(PriorNoise::default()).unwrap();
    let spread = Matrix3::from_diagonal(&Vector3::new(4e-4, 1e-4, 1e-4));
    with_motion("prior", &prior, &prior, circle(), spread);
}
