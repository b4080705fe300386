//! The simulator's scans: a planar laser among exact shapes and in an occupancy map, a spinning lidar in the factory.

use agv_core::compute::{Par, Seed};
use agv_core::geometry::{Se2, Se3, So3, Twist2, Twist3};
use agv_core::nalgebra::{Vector2, Vector3};
use agv_core::time::Stamp;
use agv_sim::{Factory, FactoryParams, GridWorld, Laser, LaserParams, Lidar, LidarParams, PlanarWorld, Shape, World2d};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// A 40 x 40 m hall with `count` small boxes on a lattice, each turned its own way; the middle stays free.
fn boxes(count: u32) -> World2d {
    let mut shapes = Shape::room(Vector2::repeat(-20.0), Vector2::repeat(20.0)).to_vec();
    let side = f64::from(count).sqrt().ceil() as u32;
    let pitch = 38.0 / f64::from(side);
    for i in 0..count {
        let (x, y) = (f64::from(i % side) * pitch - 19.0, f64::from(i / side) * pitch - 19.0);
        if x.abs() > 1.0 || y.abs() > 1.0 {
            shapes.push(Shape::rectangle(Se2::new(x, y, f64::from(i) * 0.37), 0.3 * pitch, 0.2 * pitch));
        }
    }
    World2d::new(shapes).expect("the shapes are plain")
}

fn planar(c: &mut Criterion) {
    let mut group = c.benchmark_group("sim/laser");
    let factory = Factory::generate(FactoryParams::default(), Seed(7)).expect("the default factory fits");
    let map = factory.map(0.05, 0.2, 0.6).expect("the band is in order");
    let aisle = factory.aisles()[3];
    let start = aisle * Se2::new(10.0, 0.2, 0.3);

    for beams in [181, 1081, 1440] {
        let params = LaserParams::default().with_beams(beams, 270_f64.to_radians());
        group.throughput(Throughput::Elements(beams as u64));
        let mut bench = |name: &str, world: &dyn PlanarWorld, pose: Se2| {
            let mut laser = Laser::new(params, Seed(1)).expect("the parameters are plain");
            let scan = laser.scan(world, &pose, &Twist2::ZERO, Stamp::default()).expect("the pose is finite");
            assert!(scan.ranges().iter().any(|r| r.is_finite()));
            group.bench_function(format!("{name}/{beams}"), |b| {
                b.iter(|| {
                    laser
                        .scan(world, black_box(&pose), &Twist2::ZERO, Stamp::default())
                        .map(agv_core::sensors::LaserScan::len)
                });
            });
        };
        bench("shapes_40", &boxes(40), Se2::default());
        bench("shapes_1000", &boxes(1000), Se2::default());
        bench("factory_section", &factory.section(0.4).expect("the height is finite"), start);
        bench("grid_1212x812", &GridWorld::new(&map), start);
    }
    group.finish();
}

fn spatial(c: &mut Criterion) {
    let mut group = c.benchmark_group("sim/lidar");
    let factory = Factory::generate(FactoryParams::default(), Seed(7)).expect("the default factory fits");
    let pose = Se3::from_parts(Vector3::new(20.0, factory.aisles()[3].y(), 1.8), So3::default());
    let driving = Twist3 { linear: Vector3::x(), angular: Vector3::z() * 0.2 };
    for (name, params) in
        [("vlp16", LidarParams::vlp16()), ("hdl32", LidarParams::hdl32()), ("uniform64", LidarParams::uniform64())]
    {
        group.throughput(Throughput::Elements((params.elevations.len() * params.columns) as u64));
        for (how, params, twist, par) in [
            ("ideal", params.clone().ideal(), Twist3::default(), Par::Seq),
            ("noisy_moving", params.clone(), driving, Par::Seq),
            ("noisy_moving_2_threads", params.clone(), driving, Par::threads(2)),
        ] {
            let mut lidar = Lidar::new(params, Seed(1)).expect("the parameters are plain").with_parallelism(par);
            let cloud = lidar.scan(factory.world(), &pose, &twist, Stamp::default()).expect("the pose is finite");
            assert!(cloud.len() > 25_000);
            group.bench_function(format!("factory/{name}/{how}"), |b| {
                b.iter(|| {
                    lidar
                        .scan(factory.world(), black_box(&pose), &twist, Stamp::default())
                        .map(agv_core::sensors::PointCloud::len)
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, planar, spatial);
criterion_main!(benches);
