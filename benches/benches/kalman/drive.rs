//! The drives that all filters go through: a vehicle on a circle that crosses the cut of the heading, whose pose is measured.

use agv_core::{
    compute::{Seed, Stream},
    geometry::{Se2, Twist2},
    nalgebra::{Matrix3, SMatrix, SVector, Vector3},
};
use agv_filters::kalman::{
    ConstantTurn, ConstantTurnParams, PlanarPose, PlanarState, PoseReading, ProcessModel, TurningState, Unicycle,
    UnicycleParams,
};
use rand_distr::{Distribution, StandardNormal};

/// Seconds between two readings.
pub(crate) const DT: f64 = 0.1;
/// Standard deviations of a reading, in metres and radians.
pub(crate) const SIGMAS: [f64; 3] = [0.05, 0.05, 0.01];
/// Cycles of a drive.
const CYCLES: usize = 256;

/// A drive for a filter of `N` states.
pub(crate) trait Problem<const N: usize> {
    type State: PlanarState<N>;
    type Control;
    type Process: ProcessModel<Self::State, N, Control = Self::Control>;

    fn new() -> Self;
    fn start(&self) -> Self::State;
    fn process(&self) -> &Self::Process;
    fn sensor(&self) -> &PoseReading;
    fn cycles(&self) -> &[(Self::Control, PlanarPose)];
    fn vector(state: &Self::State) -> [f64; N];

    fn spread() -> SMatrix<f64, N, N> {
        SMatrix::identity() * 0.01
    }
}

fn sensor() -> PoseReading {
    PoseReading::new(Matrix3::from_diagonal(&Vector3::from(SIGMAS).map(|sigma| sigma * sigma))).expect("a covariance")
}

fn reading(truth: &Se2, stream: &mut Stream) -> PlanarPose {
    let [x, y, yaw] =
        SIGMAS.map(|sigma| sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, stream));
    Vector3::new(truth.x() + x, truth.y() + y, truth.yaw() + yaw).into()
}

pub(crate) struct ThreeStates {
    process: Unicycle,
    sensor: PoseReading,
    cycles: Vec<(Twist2, PlanarPose)>,
}

impl Problem<3> for ThreeStates {
    type State = PlanarPose;
    type Control = Twist2;
    type Process = Unicycle;

    fn new() -> Self {
        let process = Unicycle::new(UnicycleParams {
            forward_density: 0.02,
            left_density: 0.01,
            yaw_density: 0.02,
            ..UnicycleParams::default()
        })
        .expect("densities");
        let (mut stream, twist) = (Seed(1).stream(0, 0), Twist2::new(0.8, 0.0, 0.6));
        let mut truth = PlanarPose::from(Vector3::zeros());
        let cycles = (0..CYCLES).map(|_| {
            truth = process.sample(&truth, &twist, DT, &mut stream);
            (twist, reading(&truth.pose(), &mut stream))
        });
        Self { process, sensor: sensor(), cycles: cycles.collect() }
    }

    fn start(&self) -> PlanarPose {
        PlanarPose::from(Vector3::zeros())
    }

    fn process(&self) -> &Unicycle {
        &self.process
    }

    fn sensor(&self) -> &PoseReading {
        &self.sensor
    }

    fn cycles(&self) -> &[(Twist2, PlanarPose)] {
        &self.cycles
    }

    fn vector(state: &PlanarPose) -> [f64; 3] {
        (*state.vector()).into()
    }
}

pub(crate) struct FiveStates {
    process: ConstantTurn,
    sensor: PoseReading,
    cycles: Vec<((), PlanarPose)>,
}

impl Problem<5> for FiveStates {
    type State = TurningState;
    type Control = ();
    type Process = ConstantTurn;

    fn new() -> Self {
        let process = ConstantTurn::new(ConstantTurnParams::default()).expect("densities");
        let mut stream = Seed(1).stream(0, 0);
        let mut truth = TurningState::from(SVector::<f64, 5>::new(0.0, 0.0, 0.8, 0.0, 0.6));
        let quiet =
            ConstantTurn::new(ConstantTurnParams { acceleration_density: 0.02, yaw_acceleration_density: 0.02 })
                .expect("densities");
        let cycles = (0..CYCLES).map(|_| {
            truth = quiet.sample(&truth, &(), DT, &mut stream);
            ((), reading(&truth.pose(), &mut stream))
        });
        Self { process, sensor: sensor(), cycles: cycles.collect() }
    }

    fn start(&self) -> TurningState {
        TurningState::from(SVector::<f64, 5>::new(0.0, 0.0, 0.8, 0.0, 0.6))
    }

    fn process(&self) -> &ConstantTurn {
        &self.process
    }

    fn sensor(&self) -> &PoseReading {
        &self.sensor
    }

    fn cycles(&self) -> &[((), PlanarPose)] {
        &self.cycles
    }

    fn vector(state: &TurningState) -> [f64; 5] {
        (*state.vector()).into()
    }
}
