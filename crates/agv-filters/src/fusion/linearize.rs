//! What the state predicts of a measurement, and how the prediction moves with the errors.
//!
//! With `X` the pose, `A` the pose that the reading refers to (an anchor, or the map's origin), `l` the place of the sensor on
//! the vehicle and `δ = (ρ, θ)` right increments:
//!
//! ```text
//! place of the sensor from A   q = A⁻¹ X l         ∂q/∂δX = R [ I  l⊥ ]      ∂q/∂δA = -[ I  q⊥ ]     R = R_A⁻¹ R_X, (x, y)⊥ = (-y, x)
//! heading from A               θ_X - θ_A           1                         -1
//! velocity of the sensor       Ad(base_from_sensor)⁻¹ v
//! turn rate of the gyro        ω + b
//! force                        a + ω × v - ω² l
//! ```
//!
//! A source that is later than its stamps by τ saw the vehicle where it was then, `X exp(-τ v)`, as far as it kept its velocity.
//! Wheels misread ways and turns by a share each, `true = (1 + s) read`: their readings are stretched before they are compared.

use super::{
    Components, Reference,
    correct::Innovation,
    measurement::Reading,
    source::Source,
    state::{
        ACCELERATION, DIMENSION, DISTANCE_SCALE, GYRO_BIAS, LATENCY, POSE, Row, State, VELOCITY, YAW_SCALE, anchor_at,
    },
};
use agv_core::{
    geometry::{LieGroup, Se2, wrap_angle},
    time::Stamp,
};
use nalgebra::{Matrix2, Matrix3, RowVector3, SMatrix, Vector2, Vector3};

/// Stamps that differ by less, in seconds, are the same moment: clocks round.
pub(super) const SAME_MOMENT: f64 = 1e-3;

const NOTHING: Row = [0.0; DIMENSION];

/// The innovation of a reading; none where the pose that it refers to is not known (any more, or yet).
pub(super) fn linearize(state: &State, reading: &Reading, source: &Source) -> Option<Innovation> {
    let selected = reading.selected(source.params.components);
    let first = [selected[0], selected[1], selected[2]];
    let mut innovation = Innovation::empty();
    match reading {
        Reading::Motion { start, tangent, spread } => {
            let slot = usize::from(source.slot?);
            anchored_at(state, slot, *start)?;
            let scales = if source.params.scaled { stretch(state) } else { Vector3::repeat(1.0) };
            let stretched = tangent.component_mul(&scales);
            let motion = Se2::exp(&stretched);
            let (mut residual, mut rows) = compare(state, &state.map_from_base, Some(slot), &motion, &Se2::identity());
            let turn = Se2::rotation_adjoint(&motion);
            if source.params.scaled {
                // The reading itself moves with the scales.
                let by_scale = turn * Se2::right_jacobian(&stretched);
                let ways = by_scale * Vector3::new(tangent.x, tangent.y, 0.0);
                let turns = by_scale * Vector3::new(0.0, 0.0, tangent.z);
                for i in 0..3 {
                    rows[i][DISTANCE_SCALE] -= ways[i];
                    rows[i][YAW_SCALE] -= turns[i];
                }
            }
            residual[2] = wrap_angle(residual[2]);
            push(&mut innovation, &residual, &rows, &(turn * spread * turn.transpose()), first);
        }
        Reading::Place { own_from_sensor, spread, base_from_sensor, .. } => {
            let (slot, seen) = match source.params.reference {
                Reference::Map => (None, *own_from_sensor),
                // Seen from where the sensor was, on the vehicle as it was there.
                Reference::First | Reference::Previous => {
                    let slot = usize::from(source.slot?);
                    let before = state.anchors[slot].as_ref()?.own_from_sensor;
                    (Some(slot), *base_from_sensor * before.between(own_from_sensor))
                }
            };
            let late = if source.params.late { state.latency } else { 0.0 };
            let back = Vector3::from(state.twist) * -late;
            let then = state.map_from_base * Se2::exp(&back);
            let (mut residual, mut rows) = compare(state, &then, slot, &seen, base_from_sensor);
            if source.params.late {
                for row in &mut rows {
                    carry(row, state, &back);
                }
            }
            residual[2] = wrap_angle(residual[2]);
            let turn = Se2::rotation_adjoint(&seen);
            let spread = match source.params.reference {
                Reference::Map | Reference::First => *spread,
                Reference::Previous => {
                    let way = (base_from_sensor.inverse() * seen).log();
                    super::measurement::growth(&source.params.motion, &way) + floor(source)
                }
            };
            push(&mut innovation, &residual, &rows, &(turn * spread * turn.transpose()), first);
        }
        Reading::Velocity { velocity, spread, base_from_sensor } => {
            let to_sensor = base_from_sensor.inverse().adjoint();
            let scales = if source.params.scaled { stretch(state) } else { Vector3::repeat(1.0) };
            let residual = velocity.component_mul(&scales) - to_sensor * Vector3::from(state.twist);
            let mut rows = [NOTHING; 3];
            for i in 0..3 {
                for j in 0..3 {
                    rows[i][VELOCITY + j] = to_sensor[(i, j)];
                }
                if source.params.scaled {
                    rows[i][if i < 2 { DISTANCE_SCALE } else { YAW_SCALE }] = -velocity[i];
                }
            }
            push(&mut innovation, &residual, &rows, spread, first);
        }
        Reading::Inertial { yaw, rate, acceleration, lever } => {
            if let Some([yaw, variance]) = yaw.filter(|_| selected[0]) {
                let mut row = NOTHING;
                row[POSE + 2] = 1.0;
                let (mut seen, mut expected) = (yaw, state.map_from_base.yaw());
                if source.params.reference != Reference::Map {
                    let slot = usize::from(source.slot?);
                    let anchor = state.anchors[slot].as_ref()?;
                    seen -= anchor.own_from_sensor.yaw();
                    expected -= anchor.map_from_base.yaw();
                    row[anchor_at(slot) + 2] = -1.0;
                }
                innovation.push(wrap_angle(seen - expected), row, &[variance]);
            }
            if let Some([rate, variance]) = rate.filter(|_| selected[1]) {
                let mut row = NOTHING;
                (row[VELOCITY + 2], row[GYRO_BIAS]) = (1.0, 1.0);
                let residual = rate - state.twist.yaw_rate - state.gyro_bias;
                push(&mut innovation, &[residual].into(), &[row], &SMatrix::<f64, 1, 1>::new(variance), [true]);
            }
            if let Some((force, spread)) = acceleration {
                let (residual, rows) = accelerated(state, force, lever);
                push(&mut innovation, &residual, &rows, spread, [selected[2], selected[3]]);
            }
        }
    }
    Some(innovation)
}

/// Whether the anchor is where a motion that began then began.
pub(super) fn anchored_at(state: &State, slot: usize, start: Stamp) -> Option<()> {
    let anchor = state.anchors.get(slot)?.as_ref()?;
    ((anchor.stamp - start).abs() <= SAME_MOMENT).then_some(())
}

/// Whether a motion that began then began before the anchor: a part of it has been taken in.
pub(super) fn overlaps(state: &State, slot: usize, start: Stamp) -> bool {
    let anchor = state.anchors.get(slot).and_then(Option::as_ref);
    anchor.is_some_and(|anchor| anchor.stamp - start > SAME_MOMENT)
}

/// What the source adds to noise that it does not state.
fn floor(source: &Source) -> Matrix3<f64> {
    let floor = &source.params.floor;
    let (position, yaw) = (floor.position * floor.position, floor.yaw * floor.yaw);
    Matrix3::from_diagonal(&Vector3::new(position, position, yaw))
}

/// How many times longer ways and turns are than wheels say.
fn stretch(state: &State) -> Vector3<f64> {
    let way = 1.0 + state.distance_scale;
    Vector3::new(way, way, 1.0 + state.yaw_scale)
}

/// A row on the errors of `X exp(back)`, where the vehicle was, as one on those of the state: `back = -τ v` moves it by
/// `Ad(exp(back))⁻¹ δX - τ Jr(back) δv - v δτ`.
fn carry(row: &mut Row, state: &State, back: &Vector3<f64>) {
    let slopes = RowVector3::new(row[POSE], row[POSE + 1], row[POSE + 2]);
    let by_pose = slopes * Se2::exp(back).inverse().adjoint();
    let by_velocity = slopes * Se2::right_jacobian(back) * -state.latency;
    for i in 0..3 {
        row[POSE + i] = by_pose[i];
        row[VELOCITY + i] += by_velocity[i];
    }
    row[LATENCY] = -(slopes * Vector3::from(state.twist)).x;
}

/// A sensor seen at `seen` from the anchor's base (or the map), less where it is on a vehicle at `map_from_base`.
fn compare(
    state: &State,
    map_from_base: &Se2,
    slot: Option<usize>,
    seen: &Se2,
    base_from_sensor: &Se2,
) -> (Vector3<f64>, [Row; 3]) {
    let anchor = slot.and_then(|slot| state.anchors[slot].as_ref()).map(|anchor| anchor.map_from_base);
    let from_anchor = anchor.map_or(*map_from_base, |anchor| anchor.between(map_from_base));
    let lever = base_from_sensor.translation();
    let place = from_anchor.act(&lever);
    let ((c, s), away) = ((from_anchor.rotation().cos(), from_anchor.rotation().sin()), seen.translation() - place);
    let turn = Matrix2::new(c, -s, s, c);
    let swing = turn * Vector2::new(-lever.y, lever.x);
    let mut rows = [NOTHING; 3];
    for i in 0..2 {
        (rows[i][POSE], rows[i][POSE + 1], rows[i][POSE + 2]) = (turn[(i, 0)], turn[(i, 1)], swing[i]);
    }
    rows[2][POSE + 2] = 1.0;
    if let (Some(slot), Some(_)) = (slot, anchor) {
        let at = anchor_at(slot);
        (rows[0][at], rows[0][at + 2]) = (-1.0, place.y);
        (rows[1][at + 1], rows[1][at + 2]) = (-1.0, -place.x);
        rows[2][at + 2] = -1.0;
    }
    let yaw = seen.yaw() - base_from_sensor.yaw() - from_anchor.yaw();
    (Vector3::new(away.x, away.y, yaw), rows)
}

/// Horizontal force of a unit at `lever`, less what the state says; how fast the turn rate changes is not known.
fn accelerated(state: &State, force: &Vector2<f64>, lever: &Vector2<f64>) -> (Vector2<f64>, [Row; 2]) {
    let (vx, vy, rate) = (state.twist.vx, state.twist.vy, state.twist.yaw_rate);
    let turning = Vector2::new(-rate * vy - rate * rate * lever.x, rate * vx - rate * rate * lever.y);
    let mut rows = [NOTHING; 2];
    (rows[0][ACCELERATION], rows[1][ACCELERATION + 1]) = (1.0, 1.0);
    (rows[0][VELOCITY + 1], rows[1][VELOCITY]) = (-rate, rate);
    rows[0][VELOCITY + 2] = -vy - 2.0 * rate * lever.x;
    rows[1][VELOCITY + 2] = vx - 2.0 * rate * lever.y;
    (force - state.acceleration - turning, rows)
}

/// Adds those of some numbers that count, which err together.
fn push<const K: usize>(
    innovation: &mut Innovation,
    residual: &SMatrix<f64, K, 1>,
    rows: &[Row; K],
    noise: &SMatrix<f64, K, K>,
    selected: [bool; K],
) {
    let before = innovation.rows();
    let mut covariances = [0.0; super::correct::MOST_ROWS];
    for i in (0..K).filter(|&i| selected[i]) {
        let mut place = before;
        for j in (0..=i).filter(|&j| selected[j]) {
            covariances[place] = noise[(i, j)];
            place += 1;
        }
        innovation.push(residual[i], rows[i], &covariances[..place]);
    }
}

/// What is to be remembered of a reading at an anchor: the sensor's own pose there, and how uncertain it is, as an increment
/// of the base; none if it says nothing that others could refer to.
pub(super) fn remembered(
    reading: &Reading,
    reference: Reference,
    components: Components,
) -> Option<(Se2, Matrix3<f64>)> {
    let uncertain = reference == Reference::First;
    match reading {
        Reading::Place { own_from_sensor, spread, base_from_sensor, .. } => {
            let adjoint = base_from_sensor.adjoint();
            let spread = if uncertain { adjoint * spread * adjoint.transpose() } else { Matrix3::zeros() };
            Some((*own_from_sensor, spread))
        }
        Reading::Inertial { yaw: Some([yaw, variance]), .. } if components.contains(Components::YAW) => {
            let variance = if uncertain { *variance } else { 0.0 };
            Some((Se2::new(0.0, 0.0, *yaw), Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, variance))))
        }
        Reading::Motion { .. } => Some((Se2::identity(), Matrix3::zeros())),
        Reading::Inertial { .. } | Reading::Velocity { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::{FusionParams, MotionParams, SourceParams, Wander, state::ANCHORS};
    use agv_core::geometry::Twist2;

    fn state() -> State {
        let mut state = State::new(Stamp::default(), Se2::new(1.0, -2.0, 0.4), &Matrix3::identity(), &[0.1; ANCHORS]);
        state.drop_anchor(0, Se2::new(5.0, 4.0, -1.0), &Matrix3::zeros());
        state.map_from_base = Se2::new(1.6, -1.5, 0.9);
        (state.twist, state.acceleration) = (Twist2::new(0.8, -0.1, 0.6), Vector2::new(0.2, -0.3));
        (state.gyro_bias, state.distance_scale, state.yaw_scale, state.latency) = (0.02, 0.05, -0.04, 0.3);
        state
    }

    fn readings() -> Vec<(Reading, Reference)> {
        let (spread, mount) = (Matrix3::identity(), Se2::new(0.4, -0.3, 1.1));
        let place = |has_yaw| Reading::Place {
            own_from_sensor: Se2::new(5.5, 4.6, -0.4),
            spread,
            base_from_sensor: mount,
            has_yaw,
        };
        let inertial = Reading::Inertial {
            yaw: Some([1.4, 0.1]),
            rate: Some([0.7, 0.2]),
            acceleration: Some((Vector2::new(0.5, 0.6), Matrix2::identity())),
            lever: Vector2::new(0.3, 0.2),
        };
        let motion = Reading::Motion { start: Stamp::default(), tangent: Vector3::new(0.8, 0.1, 0.5), spread };
        let velocity = Reading::Velocity { velocity: Vector3::new(0.9, 0.2, 0.5), spread, base_from_sensor: mount };
        vec![
            (motion, Reference::Previous),
            (place(true), Reference::Map),
            (place(false), Reference::Map),
            (place(true), Reference::First),
            (place(true), Reference::Previous),
            (velocity, Reference::Map),
            (inertial, Reference::Map),
            (inertial, Reference::First),
        ]
    }

    /// Every Jacobian against central differences of the residual, over all errors and anchors.
    #[test]
    fn jacobians_are_the_slopes_of_the_residuals() {
        let acceleration = Some(Wander::new(1.0, 1.0));
        let motion = MotionParams { acceleration, ..MotionParams::omnidirectional() };
        let params = FusionParams { motion, ..FusionParams::default() };
        for (case, (reading, reference)) in readings().into_iter().enumerate() {
            let components = Components::KINEMATIC | Components::ACCELERATION;
            let late = reference == Reference::Map;
            let taken = SourceParams { components, reference, scaled: true, late, ..SourceParams::pose() };
            let source = Source::new(taken, Some(0), &params).unwrap();
            let residual = |k: usize, step: f64| {
                let (mut moved, mut error) = (state(), NOTHING);
                error[k] = step;
                moved.shift(&error);
                linearize(&moved, &reading, &source).unwrap().parts().0.to_vec()
            };
            let innovation = linearize(&state(), &reading, &source).unwrap();
            let (h, rows) = (1e-6, innovation.parts().1);
            for k in 0..DIMENSION {
                let (up, down) = (residual(k, h), residual(k, -h));
                for (i, row) in rows.iter().enumerate() {
                    let slope = (up[i] - down[i]) / (2.0 * h);
                    assert!((row[k] + slope).abs() < 1e-8, "case {case}, row {i}, error {k}: {} {slope}", row[k]);
                }
            }
        }
    }

    /// A mask takes rows out, and keeps what the remaining ones have in common.
    #[test]
    fn masks_take_rows_out() {
        let spread = Matrix3::new(1.0, 0.2, 0.3, 0.2, 2.0, 0.4, 0.3, 0.4, 3.0);
        let reading =
            Reading::Velocity { velocity: Vector3::new(1.0, 2.0, 3.0), spread, base_from_sensor: Se2::default() };
        let components = Components::VX | Components::YAW_RATE;
        let taken = SourceParams { components, ..SourceParams::velocity() };
        let source = Source::new(taken, None, &FusionParams::default()).unwrap();
        let innovation = linearize(&state(), &reading, &source).unwrap();
        let (residual, rows) = innovation.parts();
        assert_eq!(residual, [1.0 - 0.8, 3.0 - 0.6]);
        assert_eq!((rows[0][VELOCITY], rows[1][VELOCITY + 2]), (1.0, 1.0));
        assert_eq!(reading.selected(components), [true, false, true, false]);
    }
}
