use super::*;
use crate::{
    Error,
    pipeline::{Navigation, NavigationParams, NavigationStatus},
};
use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Se3, So3, Twist2, UncertainVector},
    grid::{Footprint, LocalMapParams, OccupancyThresholds, RollingCostmap, RollingParams},
    kinematics::{Motion, MotionLimits},
    nalgebra::Vector3,
    odometry::{MotionIncrement, OdometryIncrement},
    roles::{
        GlobalPlanner, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner,
        LocalizationError, PlanError, PlanOutcome, PoseBelief, UpdateOutcome,
    },
    sensors::{ImuSample, LaserScan, PointCloud, ScanGeometry},
    time::Stamp,
};
use agv_filters::fusion::{FusionParams, SourceParams};
use agv_ndt::{
    convert::{CloudToScan, CloudToScanParams},
    ndt::{NdtLocalizer, NdtLocalizerParams},
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams, Simulator3d, Vehicle, VehicleParams};

/// Leads straight to the goal.
struct Straight;

impl GlobalPlanner for Straight {
    fn plan_with_cancel(
        &mut self,
        _: &agv_core::grid::Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut agv_core::path::Path,
        _: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        *path = agv_core::path::Path::from_positions(&[start.translation(), goal.translation()])?;
        Ok(PlanOutcome::Found { cost: path.length(), expansions: 0 })
    }
}

/// Drives ahead.
struct Ahead;

impl LocalPlanner for Ahead {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        let twist = request.limits.twist.step(&request.state.twist, &Twist2::new(1.0, 0.0, 0.0), request.dt)?;
        Ok(LocalCommand { motion: Motion { twist, steering: None }, status: LocalPlanStatus::Following })
    }
}

fn hall() -> Factory {
    Factory::generate(FactoryParams { length: 24.0, width: 10.0, ..FactoryParams::default() }, Seed(1)).unwrap()
}

fn lidar() -> Lidar {
    let mount = Se3::from_parts(Vector3::new(0.1, 0.0, 1.3), So3::default());
    Lidar::new(LidarParams { columns: 450, ..LidarParams::vlp16().with_mount(mount) }, Seed(2)).unwrap()
}

fn odometry() -> InertialOdometry {
    InertialOdometry::new(FusionParams::default(), SourceParams::wheels(), SourceParams::imu()).unwrap()
}

/// Twelve metres of an aisle, mapped, and where the mapper ended beside the truth.
fn mapped(factory: &Factory) -> (Site, f64) {
    let start = factory.aisles()[0];
    let vehicle = Vehicle::new(VehicleParams::default(), start, Seed(1)).unwrap();
    let mut simulator = Simulator3d::new(factory.world(), vehicle, 0.05).unwrap().with_lidar(lidar()).unwrap();
    let mut mapper = SiteMapper::new(SiteMapperParams::default(), start.into()).unwrap();
    let (mut odometry, mut last) = (odometry(), Se2::default());
    for step in 0..260 {
        let ahead = Twist2::new(if step < 10 { 0.0 } else { 1.0 }, 0.0, 0.0);
        let seen = simulator.step(&ahead).unwrap();
        let motion = odometry.update(&seen.odometry, seen.imu_samples()).unwrap();
        if let Some(motion) = &motion {
            mapper.predict(motion).unwrap();
        }
        seen.clouds().for_each(|(cloud, _)| assert!(mapper.insert(cloud).is_ok()));
        last = seen.truth.map_from_base;
    }
    let end = mapper.estimate().unwrap();
    let error = (end.map_from_base().to_planar().translation() - last.translation()).norm();
    (mapper.finish(), error)
}

fn system(site: &Site) -> Csns {
    let footprint = Footprint::circle(0.3).unwrap();
    let localizer = NdtLocalizer::new(&site.map, NdtLocalizerParams::default()).unwrap();
    let localizer = localizer.with_places(site.places.iter().copied()).unwrap();
    let grid = site.grid.states(&OccupancyThresholds::default());
    let costmap = RollingCostmap::new(RollingParams::default()).unwrap().with_static_map(grid).unwrap();
    let geometry = ScanGeometry { angle_min: -3.1, angle_increment: 0.02, ..ScanGeometry::default() };
    let scan = LaserScan::new(Stamp::default(), geometry, vec![f32::NAN; 310]).unwrap();
    let to_scan = CloudToScan::new(CloudToScanParams { empty_is_free: false, ..CloudToScanParams::default() }).unwrap();
    let sight = CsnsSight { to_scan, scan, costmap };
    let navigation =
        Navigation::new(Box::new(Straight), Box::new(Ahead), footprint, NavigationParams::default()).unwrap();
    let local = LocalMapParams::default();
    Csns::new(odometry(), localizer, sight, local, navigation, MotionLimits::default()).unwrap()
}

/// A mapped aisle, a vehicle that is put down in it somewhere, finds out where, and drives.
#[test]
fn a_mapped_site_is_driven_in() {
    let factory = hall();
    let (site, error) = mapped(&factory);
    assert!(error < 0.03 && site.places.len() >= 10, "{error} m, {} places", site.places.len());

    let mut system = system(&site);
    let start = factory.aisles()[0] * Se2::new(4.0, 0.1, 0.05);
    let vehicle = Vehicle::new(VehicleParams::default(), start, Seed(5)).unwrap();
    let mut simulator = Simulator3d::new(factory.world(), vehicle, 0.05).unwrap().with_lidar(lidar()).unwrap();
    assert_eq!(system.command(Motion::REST, 0.05).unwrap(), CsnsCommand { motion: Motion::REST, status: None });
    system.start(&PoseBelief::Anywhere).unwrap();
    system.go_to(&(start * Se2::new(5.0, 0.0, 0.0))).unwrap();
    // It has an estimate, the mean of all places, but does not know: a vehicle that moves brakes.
    let moving = Motion { twist: Twist2::new(1.0, 0.0, 0.0), steering: None };
    let command = system.command(moving, 0.05).unwrap();
    assert!(command.status.is_none() && command.motion.twist.vx < 1.0, "{command:?}");
    let (mut motion, mut driven) = (Motion::REST, 0);
    for step in 0..60 {
        let seen = simulator.step(&motion.twist).unwrap();
        let cloud = seen.clouds().next().map(|(cloud, _)| cloud);
        let outcome = system.sense(&seen.odometry, seen.imu_samples(), cloud).unwrap();
        assert!(outcome.is_none_or(|outcome| matches!(outcome, UpdateOutcome::Applied(_))), "{outcome:?}");
        if step < 4 {
            continue;
        }
        let estimate = system.estimate().unwrap().map_from_base().to_planar();
        let off = estimate.minus(&seen.truth.map_from_base);
        assert!(off.xy().norm() < 0.05 && off.z.abs() < 0.01, "{off}");
        let command = system.command(motion, 0.05).unwrap();
        motion = command.motion;
        driven += usize::from(command.status == Some(NavigationStatus::Following));
    }
    assert!(driven > 40 && (simulator.vehicle().map_from_base().x() - start.x()) > 1.0, "{driven}");
}

fn wheels(from: f64, to: f64) -> OdometryIncrement {
    let at = |x: f64| Se2::new(x, 0.0, 0.0);
    OdometryIncrement::between(Stamp::from_seconds(from), &at(from), Stamp::from_seconds(to), &at(to)).unwrap()
}

/// At 1 m/s: a reading that comes twice moves the vehicle once, and an inertial unit that is ahead adds no way.
#[test]
fn no_way_is_counted_twice() {
    let mut twice = odometry();
    let first = twice.update(&wheels(0.0, 0.1), []).unwrap().unwrap();
    assert!((first.start_from_end.translation().x - 0.1).abs() < 1e-9);
    assert_eq!(twice.update(&wheels(0.0, 0.1), []).unwrap(), None);

    let (mut ahead, mut way, mut end) = (odometry(), 0.0, Stamp::default());
    for i in 0..40 {
        let (from, to) = (0.05 * f64::from(i), 0.05 * f64::from(i + 1));
        let straight = UncertainVector::from_sigmas(Vector3::zeros(), &Vector3::repeat(1e-3)).unwrap();
        let imu = ImuSample::new(Stamp::from_seconds(to + 0.03)).with_angular_velocity(straight);
        if let Some(motion) = ahead.update(&wheels(from, to), [&imu]).unwrap() {
            assert_eq!(motion.start, end);
            (way, end) = (way + motion.start_from_end.translation().x, motion.end);
        }
    }
    assert!((end.seconds() - 2.03).abs() < 1e-9 && (way - 2.03).abs() < 0.04, "{way} m until {end:?}");
}

/// Around a corner most of a cloud is new, and the map grows before the vehicle has come a metre.
#[test]
fn what_is_new_is_mapped_sooner() {
    let factory = hall();
    let mapped = |novelty: f64| {
        let mut lidar = lidar();
        let params = SiteMapperParams { novelty, ..SiteMapperParams::default() };
        let start = factory.aisles()[0] * Se2::new(4.0, 0.0, 0.0);
        let mut mapper = SiteMapper::new(params, start.into()).unwrap();
        for i in 0..5 {
            let (truth, now) = (start * Se2::new(0.3 * f64::from(i), 0.0, 0.0), Stamp::from_seconds(f64::from(i)));
            let cloud =
                lidar.scan(factory.world(), &truth.into(), &agv_core::geometry::Twist3::default(), now).unwrap();
            if i > 0 {
                let motion = Se3::from(Se2::new(0.3, 0.0, 0.0));
                mapper.predict(&MotionIncrement::between(now + -1.0, &Se3::default(), now, &motion).unwrap()).unwrap();
            }
            mapper.insert(cloud).unwrap();
        }
        mapper.finish().places.len()
    };
    assert_eq!((mapped(0.0), mapped(1.0)), (2, 5));
}

/// People around a lidar hide the map, and are obstacles.
#[test]
fn what_does_not_fit_the_map_is_seen_all_the_same() {
    let factory = hall();
    let (site, _) = mapped(&factory);
    let (mut system, mut lidar) = (system(&site), lidar());
    let here = factory.aisles()[0] * Se2::new(4.0, 0.0, 0.0);
    system.start(&PoseBelief::around(here.into(), agv_core::nalgebra::Matrix6::identity() * 1e-4).unwrap()).unwrap();
    let lethal = |system: &Csns| {
        let costs = system.costmap().costmap();
        costs.costs().iter().map(|&cost| usize::from(cost == agv_core::grid::cost::LETHAL)).sum::<usize>()
    };
    let mut cloud = PointCloud::default();
    for i in 0..6 {
        let now = Stamp::from_seconds(0.1 * f64::from(i + 1));
        let at_rest = OdometryIncrement::between(now + -0.1, &Se2::default(), now, &Se2::default()).unwrap();
        let twist = agv_core::geometry::Twist3::default();
        cloud.copy_from(lidar.scan(factory.world(), &here.into(), &twist, now).unwrap());
        let outcome = system.sense(&at_rest, [], Some(&cloud)).unwrap();
        assert!(matches!(outcome, Some(UpdateOutcome::Applied(_))), "{outcome:?}");
    }
    let (before, now) = (lethal(&system), Stamp::from_seconds(0.7));
    let at_rest = OdometryIncrement::between(now + -0.1, &Se2::default(), now, &Se2::default()).unwrap();
    // A ring of legs, a metre and a half around.
    let legs = (0..360).flat_map(|i| (4..9_u16).map(move |ring| (f64::from(i).to_radians(), ring)));
    let mount = cloud.base_from_sensor();
    let legs = legs.map(|(angle, ring)| agv_core::sensors::LidarReturn {
        position: Vector3::new(1.5 * angle.cos(), 1.5 * angle.sin(), 0.2 * f64::from(ring) - 1.7).cast(),
        intensity: 1.0,
        ring,
        time: 0.0,
    });
    let mut crowd = PointCloud::default().with_mount(mount).unwrap().with_ring(vec![]).unwrap();
    crowd.refill(now, legs);
    let outcome = system.sense(&at_rest, [], Some(&crowd)).unwrap();
    assert!(matches!(outcome, Some(UpdateOutcome::Skipped(_))), "{outcome:?}");
    assert!(lethal(&system) > before + 20, "{} after {before}", lethal(&system));
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let good = SiteMapperParams::default();
    for bad in [
        SiteMapperParams { key_distance: 0.0, ..good.clone() },
        SiteMapperParams { key_turn: f64::NAN, ..good.clone() },
        SiteMapperParams { novelty: -0.1, ..good.clone() },
        SiteMapperParams { localizer: NdtLocalizerParams { gate: -1.0, ..good.localizer }, ..good.clone() },
        SiteMapperParams {
            grid: agv_ndt::convert::CloudToGridParams { resolution: -1.0, ..good.grid.clone() },
            ..good.clone()
        },
    ] {
        assert!(SiteMapper::new(bad.clone(), Se3::default()).is_err(), "{bad:?}");
    }
    let nowhere = Se3::from_parts(Vector3::new(f64::NAN, 0.0, 0.0), So3::default());
    assert!(SiteMapper::new(good.clone(), nowhere).is_err());

    let mut mapper = SiteMapper::new(good, Se3::default()).unwrap();
    assert!(mapper.insert(&PointCloud::default()).is_err(), "nothing to begin a map with");
    assert!(mapper.map().is_empty() && mapper.estimate().is_none());
    let factory = hall();
    let mut lidar = lidar();
    let first = lidar.scan(
        factory.world(),
        &factory.aisles()[0].into(),
        &agv_core::geometry::Twist3::default(),
        Stamp::default(),
    );
    let first = first.unwrap().clone();
    assert!(mapper.insert(&first).unwrap().mapped);
    let before = mapper.map().clone();
    let bad = MotionIncrement {
        start: Stamp::default(),
        end: Stamp::default(),
        start_from_end: nowhere,
        covariance: agv_core::nalgebra::Matrix6::zeros(),
    };
    assert!(mapper.predict(&bad).is_err());
    let blind = PointCloud::default().with_stamp(Stamp::from_seconds(1.0));
    let step = mapper.insert(&blind).unwrap();
    assert!(!step.mapped && matches!(step.outcome, Some(UpdateOutcome::Skipped(_))), "{step:?}");
    assert_eq!(*mapper.map(), before);

    let (site, _) = mapped(&factory);
    let wheels =
        OdometryIncrement::between(Stamp::default(), &Se2::default(), Stamp::from_seconds(0.1), &Se2::default());
    let early = system(&site).sense(&wheels.unwrap(), [], None);
    assert_eq!(early, Err(Error::Localization(LocalizationError::NotInitialized)));
}
