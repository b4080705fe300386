//! Odometry, ranges and bearings, as text of MRPT's simulated logs.

use super::{LandmarkLog, LandmarkStep, Seen, SeenAs, is_data};
use crate::{Error, Input, fields::Fields};
use agv_core::{
    geometry::{LieGroup, Se2},
    nalgebra::Matrix3,
    time::Stamp,
};

/// Reads `RB step time x y yaw landmark range bearing pitch`: x, y and yaw are the pose by odometry at the step; a landmark below zero
/// is not known. Ranges are taken to the floor by their pitch. Lines of one step are together.
///
/// Stamps are the numbers of the steps, as the reference counts.
///
/// # Errors
/// The first line that is not what it should be, or steps that do not rise.
pub fn read_sightings(input: &Input) -> Result<LandmarkLog, Error> {
    let mut log = LandmarkLog::default();
    let (mut last, mut odometry) = (None, Se2::default());
    for line in input.data_lines() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        if fields.text("RB")? != "RB" {
            return Err(fields.error("a line begins with RB"));
        }
        let step = fields.count("step", u32::MAX as usize)?;
        fields.finite("time")?;
        let pose = fields.pose(["x", "y", "yaw"])?;
        let landmark = fields.finite("landmark")?;
        let [range, bearing, pitch] = fields.finite_array(["range", "bearing", "pitch"])?;
        if range < 0.0 {
            return Err(fields.error("a range below zero"));
        }
        fields.end()?;
        if last != Some(step) {
            if last.is_some_and(|last| step < last) {
                return Err(input.line_error(number, "steps do not rise"));
            }
            // The map begins where the first step is.
            let motion = if last.is_some() { odometry.between(&pose) } else { Se2::default() };
            let stamp = Stamp::from_seconds(step as f64);
            log.steps.push(LandmarkStep { stamp, motion, covariance: Matrix3::zeros(), seen: Vec::new() });
            (last, odometry) = (Some(step), pose);
        }
        let id = (landmark >= 0.0 && landmark <= f64::from(u32::MAX)).then_some(landmark as u32);
        if let Some(step) = log.steps.last_mut() {
            step.seen.push(Seen { id, measured: SeenAs::RangeBearing(range * pitch.cos(), bearing) });
        }
    }
    Ok(log)
}

/// Reads `x y z yaw pitch roll` of every step, from step 0 on.
///
/// # Errors
/// The first line that is not what it should be.
pub(super) fn read_path(input: &Input, log: &mut LandmarkLog) -> Result<(), Error> {
    for (step, line) in input.data_lines().filter(is_data).enumerate() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        let [x, y, _, yaw, _, _] = fields.finite_array(["x", "y", "z", "yaw", "pitch", "roll"])?;
        fields.end()?;
        log.reference.push((Stamp::from_seconds(step as f64), Se2::new(x, y, yaw)));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_become_steps() {
        let text = "RB 3 1.5 1 0 0 7 3.5 0.1 0\nRB 3 1.5 1 0 0 -1 2 0 0\nRB 4 1.6 1.5 0 0.5 7 3 0 0\n";
        let mut log = read_sightings(&Input::new("s", text)).unwrap();
        assert_eq!(log.steps.len(), 2);
        assert_eq!(log.steps[0].motion, Se2::default());
        assert!(log.steps[1].motion.minus(&Se2::new(0.5, 0.0, 0.5)).norm() < 1e-12);
        assert_eq!(log.steps[0].seen[0], Seen { id: Some(7), measured: SeenAs::RangeBearing(3.5, 0.1) });
        assert_eq!(log.steps[0].seen[1].id, None);
        read_path(&Input::new("p", "% c\n\n1 2 0 0.5 0 0\n"), &mut log).unwrap();
        assert_eq!(log.reference, [(Stamp::from_seconds(0.0), Se2::new(1.0, 2.0, 0.5))]);
        assert!(read_sightings(&Input::new("s", "RB 3 1 0 0 0 7 1 0 0\nRB 2 1 0 0 0 7 1 0 0\n")).is_err());
    }
}
