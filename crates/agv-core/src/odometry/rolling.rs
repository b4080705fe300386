//! How far a vehicle moves as its wheels roll: forward kinematics as a matrix, with its slopes over the steering angles.

use crate::kinematics::{
    Ackermann, AckermannWheels, DifferentialDrive, DifferentialWheels, DoubleAckermann, DoubleAckermannParams,
    DoubleAckermannWheels, Kinematics, Mecanum, MecanumWheels, Tricycle, TricycleWheels,
};
use nalgebra::{SMatrix, Vector3};

/// A vehicle whose motion is linear in `N` wheel angles, at given angles of its `S` steered axles.
pub trait RollingModel<const N: usize, const S: usize = 0> {
    /// Motion of the base, as a tangent `(x, y, yaw)`, per radian of each wheel; `steering` in radians. Its columns are
    /// what [`Kinematics::forward`] says of one wheel alone.
    fn rolling_matrix(&self, steering: &[f64; S]) -> SMatrix<f64, 3, N>;

    /// Derivative of [`rolling_matrix`](Self::rolling_matrix) with respect to the steering angle of `axle`, below `S`.
    fn rolling_matrix_slope(&self, _steering: &[f64; S], _axle: usize) -> SMatrix<f64, 3, N> {
        SMatrix::zeros()
    }
}

/// Wheels in the order left, right.
impl RollingModel<2> for DifferentialDrive {
    fn rolling_matrix(&self, _: &[f64; 0]) -> SMatrix<f64, 3, 2> {
        let column = |left, right| self.forward(&DifferentialWheels { left, right }).into();
        SMatrix::from_columns(&[column(1.0, 0.0), column(0.0, 1.0)])
    }
}

/// The mean angle of the driven rear wheels, at the front axle's steering angle.
impl RollingModel<1, 1> for Ackermann {
    fn rolling_matrix(&self, &[steering]: &[f64; 1]) -> Vector3<f64> {
        self.forward(&AckermannWheels { drive: 1.0, steering }).into()
    }

    fn rolling_matrix_slope(&self, &[steering]: &[f64; 1], _: usize) -> Vector3<f64> {
        let (p, cos) = (self.params(), steering.cos());
        Vector3::new(0.0, 0.0, p.wheel_radius / (p.wheelbase * cos * cos))
    }
}

/// The mean angle of the driven rear wheels along their own heading, at the steering angles of the front and the rear
/// axle, in this order.
impl RollingModel<1, 2> for DoubleAckermann {
    fn rolling_matrix(&self, &[front_steering, rear_steering]: &[f64; 2]) -> Vector3<f64> {
        self.forward(&DoubleAckermannWheels { drive: 1.0, front_steering, rear_steering }).into()
    }

    fn rolling_matrix_slope(&self, &[front, rear]: &[f64; 2], axle: usize) -> Vector3<f64> {
        let DoubleAckermannParams { front: a, rear: b, wheel_radius: r, .. } = *self.params();
        let (sin, cos) = rear.sin_cos();
        if axle == 0 {
            let slope = r * cos / (front.cos() * front.cos() * (a + b));
            Vector3::new(0.0, b * slope, slope)
        } else {
            let (tan, share) = (front.tan(), r / (a + b));
            Vector3::new(-r * sin, share * (a * cos - b * tan * sin), -share * (tan * sin + cos))
        }
    }
}

/// The front wheel, at its steering angle.
impl RollingModel<1, 1> for Tricycle {
    fn rolling_matrix(&self, &[steering]: &[f64; 1]) -> Vector3<f64> {
        self.forward(&TricycleWheels { drive: 1.0, steering }).into()
    }

    fn rolling_matrix_slope(&self, &[steering]: &[f64; 1], _: usize) -> Vector3<f64> {
        let (p, (sin, cos)) = (self.params(), steering.sin_cos());
        Vector3::new(-p.wheel_radius * sin, 0.0, p.wheel_radius * cos / p.wheelbase)
    }
}

/// Wheels in the order front left, front right, rear left, rear right.
impl RollingModel<4> for Mecanum {
    fn rolling_matrix(&self, _: &[f64; 0]) -> SMatrix<f64, 3, 4> {
        let column = |front_left, front_right, rear_left, rear_right| {
            self.forward(&MecanumWheels { front_left, front_right, rear_left, rear_right }).into()
        };
        SMatrix::from_columns(&[
            column(1.0, 0.0, 0.0, 0.0),
            column(0.0, 1.0, 0.0, 0.0),
            column(0.0, 0.0, 1.0, 0.0),
            column(0.0, 0.0, 0.0, 1.0),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::{AckermannParams, DifferentialParams, MecanumParams, TricycleParams};

    fn close(a: Vector3<f64>, b: Vector3<f64>) {
        assert!((a - b).norm() < 1e-9, "{a} {b}");
    }

    /// Every slope is the numeric derivative of the matrix.
    fn slopes_agree<const S: usize>(vehicle: &impl RollingModel<1, S>, steering: [f64; S]) {
        let h = 1e-6;
        for axle in 0..S {
            let (mut more, mut less) = (steering, steering);
            (more[axle], less[axle]) = (more[axle] + h, less[axle] - h);
            let numeric = (vehicle.rolling_matrix(&more) - vehicle.rolling_matrix(&less)) / (2.0 * h);
            close(vehicle.rolling_matrix_slope(&steering, axle), numeric);
        }
    }

    /// Forward kinematics is linear in all wheels at once, as the columns for each alone say.
    #[test]
    fn rolling_matrices_agree_with_the_kinematics() {
        let drive = DifferentialDrive::new(DifferentialParams { left_radius: 0.09, ..Default::default() }).unwrap();
        let carrier = Mecanum::new(MecanumParams::default()).unwrap();
        close(
            drive.rolling_matrix(&[]) * nalgebra::Vector2::new(1.0, 3.0),
            drive.forward(&DifferentialWheels { left: 1.0, right: 3.0 }).into(),
        );
        let wheels = MecanumWheels { front_left: 1.0, front_right: -2.0, rear_left: 3.0, rear_right: 0.5 };
        close(
            carrier.rolling_matrix(&[]) * nalgebra::Vector4::new(1.0, -2.0, 3.0, 0.5),
            carrier.forward(&wheels).into(),
        );
    }

    #[test]
    fn slopes_are_numeric_derivatives() {
        let truck = Ackermann::new(AckermannParams::default()).unwrap();
        let tricycle = Tricycle::new(TricycleParams::default()).unwrap();
        let double = DoubleAckermannParams { front: 0.8, rear: 0.5, ..Default::default() };
        let double = DoubleAckermann::new(double).unwrap();
        for steering in [-0.5, 0.0, 0.4] {
            slopes_agree(&truck, [steering]);
            slopes_agree(&tricycle, [steering]);
            slopes_agree(&double, [steering, -0.3]);
            slopes_agree(&double, [0.2, steering]);
        }
    }
}
