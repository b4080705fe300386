//! What nearly every pipeline names: `use agv_nav::prelude::*;`.

pub use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Se3, So2, So3, Twist2, Twist3},
    grid::{Cell, CellState, Costmap, Grid, GridLayout, LocalMap},
    kinematics::{Motion, MotionLimits, TwistLimits},
    odometry::{MotionIncrement, OdometryIncrement},
    path::Path,
    roles::{
        Controller, Correct, GlobalPlanner, LidarOdometry, LocalPlanRequest, LocalPlanner, LocalizationStatus,
        Localizer, PathTracker, PlanOutcome, PoseBelief, PoseEstimate, Registration, ScanMatcher, TrackStatus,
        UpdateOutcome, VehicleState,
    },
    sensors::{LaserScan, PointCloud, ScanGeometry, SensorId},
    time::Stamp,
};
