//! Parameters: every `Default` comes back, and a number that is missing is refused.

use crate::table::{assert_kept, restored};
use agv_nav::{control, core, filters, ndt, plan};
use serde_json::Value;

/// Each pointer to a number in a value.
fn numbers(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(at.to_owned()),
        Value::Object(entries) => {
            for (name, entry) in entries {
                numbers(entry, &format!("{at}/{name}"), found);
            }
        }
        Value::Array(entries) => {
            for (index, entry) in entries.iter().enumerate() {
                numbers(entry, &format!("{at}/{index}"), found);
            }
        }
        _ => {}
    }
}

macro_rules! table {
    ($($params:ty),+ $(,)?) => {
        #[test]
        fn defaults_come_back_and_a_missing_number_is_seen() {
            $({
                let (name, params) = (stringify!($params), <$params>::default());
                assert_kept(name, &params);
                assert_eq!(restored(&params), params);
                let good = serde_json::to_value(&params).unwrap();
                let mut pointers = Vec::new();
                numbers(&good, "", &mut pointers);
                // `null` in place of a number: NaN, as JSON writes it.
                for pointer in pointers {
                    let mut bad = good.clone();
                    *bad.pointer_mut(&pointer).unwrap() = Value::Null;
                    let read = serde_json::from_value::<$params>(bad);
                    assert!(!read.is_ok_and(|read| read == params), "{name} without {pointer}");
                }
            })+
        }
    };
}

table! {
    core::frames::FrameTreeParams,
    core::geometry::PoseSigma,
    core::grid::CollisionParams,
    core::grid::DistanceParams,
    core::grid::GaussianParams,
    core::grid::InflationParams,
    core::grid::InverseModelParams,
    core::grid::LikelihoodFieldParams,
    core::grid::LocalMapParams,
    core::grid::OccupancyParams,
    core::grid::RayCastParams,
    core::kinematics::AckermannParams,
    core::kinematics::DifferentialParams,
    core::kinematics::DoubleAckermannParams,
    core::kinematics::MecanumParams,
    core::kinematics::TricycleParams,
    core::kinematics::TwistLimits,
    core::kinematics::MotionLimits,
    core::kinematics::SteeringLimits,
    core::odometry::EncoderParams,
    core::odometry::WheelNoise,
    core::sensors::PhaseShiftParams,
    core::sensors::PulsedTimeOfFlightParams,
    core::sensors::RangeImageParams,
    core::sensors::ScanGeometry,
    core::sensors::TriangulationParams,
    core::solve::LevenbergMarquardtParams,
    core::solve::QuadraticParams,
    core::solve::RobustKernel,
    control::evolution::CmaEsParams,
    control::evolution::DifferentialEvolutionParams,
    control::optimize::Stopping,
    control::pid::PidParams,
    control::plant::ActuatorLimits,
    control::plant::CrossTrackParams,
    control::plant::DriveParams,
    control::step_response::PidGains,
    control::step_response::StepMetricsParams,
    control::step_response::StepTestParams,
    control::pso::MovingPeaksParams,
    control::pso::Sensing,
    control::pso::SwarmParams,
    control::track::FollowerParams,
    control::track::PidTrackerParams,
    control::track::PurePursuitParams,
    control::track::LqrParams,
    control::track::MpcParams,
    control::track::StanleyParams,
    control::tune::OnlineTunerParams,
    control::tune::StepCostParams,
    filters::fusion::FusionParams,
    filters::kalman::PoseFilterParams,
    filters::matching::CorrelativeParams,
    filters::matching::FieldMatcherParams,
    filters::particle::AckermannOdometryParams,
    filters::particle::BeamModelParams,
    filters::particle::BeamSkippingParams,
    filters::particle::LandmarkModelParams,
    filters::particle::LikelihoodFieldModelParams,
    filters::particle::MarkerModelParams,
    filters::particle::MclParams,
    filters::particle::NdtMapModelParams,
    filters::particle::OdometryNoise,
    filters::particle::OmnidirectionalNoise,
    filters::particle::PriorNoise,
    filters::particle::VelocityNoise,
    core::roles::StatusParams,
    filters::slam::graph::GraphSlamParams,
    ndt::convert::CloudToScanParams,
    ndt::gicp::PointParams,
    ndt::ndt::NdtParams,
    ndt::ndt::VoxelParams,
    ndt::preprocess::NormalParams,
    ndt::registration::DescentParams,
    ndt::registration::LineSearchParams,
    plan::aco::ColonyParams,
    plan::aco::SparrowParams,
    plan::grid::AStarParams,
    plan::grid::GridPlannerParams,
    plan::hybrid::HybridAStarParams,
    plan::smooth::CurvatureSmootherParams,
    plan::smooth::LineOfSightParams,
}
