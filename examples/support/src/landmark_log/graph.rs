//! Odometry and sightings as edges between numbered poses and landmarks.

use super::{LandmarkLog, LandmarkStep, Seen, SeenAs};
use crate::{Error, Input, fields::Fields};
use agv_core::{
    geometry::Se2,
    nalgebra::{Matrix2, Matrix3, Vector2},
    time::Stamp,
};
use std::collections::BTreeMap;

/// Variance of one step, in square metres, from which on the numbers beside it can only be an information.
const LEAST_INFORMATION: f64 = 1.0;

/// Reads `ODOMETRY i j dx dy dyaw` with the upper triangle of a 3x3 covariance, and `LANDMARK pose landmark dx dy` with that of a 2x2 one:
/// metres and radians, in the frame of the first pose. Steps are in the order of the odometry, which must be a chain.
///
/// In Victoria Park as it is passed around the numbers that are called information are covariances (a step of 0.4 m has 1e-4,
/// which as an information would be a hundred metres). Where the first step has a metre or more, they are taken for the
/// information that they are called.
///
/// # Errors
/// The first line that is not what it should be.
pub fn read_graph(input: &Input) -> Result<LandmarkLog, Error> {
    let (mut steps, mut places) = (Vec::new(), BTreeMap::new());
    let mut sightings = Vec::new();
    let mut inverse = None;
    for line in input.data_lines() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        match fields.text("kind of the edge")? {
            "ODOMETRY" => {
                let [from, to] = [node(&mut fields, "from")?, node(&mut fields, "to")?];
                let motion = fields.pose(["dx", "dy", "dyaw"])?;
                let [a, b, c, d, e, f] = fields.finite_array(["11", "12", "13", "22", "23", "33"])?;
                let mut covariance = Matrix3::new(a, b, c, b, d, e, c, e, f);
                if *inverse.get_or_insert(a >= LEAST_INFORMATION) {
                    covariance = covariance.try_inverse().ok_or_else(|| fields.error("a singular information"))?;
                }
                if steps.is_empty() {
                    steps.push(step(from, Se2::default(), Matrix3::zeros()));
                    places.insert(from, 0);
                }
                if places.get(&from) != Some(&(steps.len() - 1)) {
                    return Err(fields.error(format_args!("odometry goes on from {from}, which is not the last pose")));
                }
                places.insert(to, steps.len());
                steps.push(step(to, motion, covariance));
                fields.end()?;
            }
            "LANDMARK" => {
                let [pose, id] = [node(&mut fields, "pose")?, node(&mut fields, "landmark")?];
                let [x, y, a, b, d] = fields.finite_array(["dx", "dy", "11", "12", "22"])?;
                fields.end()?;
                sightings.push((number, pose, id, Vector2::new(x, y), Matrix2::new(a, b, b, d)));
            }
            other => {
                return Err(fields.error(format_args!("`{}`: ODOMETRY or LANDMARK", crate::fields::shorten(other))));
            }
        }
    }
    for (number, pose, id, place, stated) in sightings {
        let Some(&index) = places.get(&pose) else {
            return Err(input.line_error(number, format_args!("there is no pose {pose}")));
        };
        let covariance = if inverse == Some(true) { stated.try_inverse() } else { Some(stated) };
        let covariance = covariance.ok_or_else(|| input.line_error(number, "a singular information"))?;
        let measured = SeenAs::Place(place, covariance);
        steps[index].seen.push(Seen { id: Some(id), measured });
    }
    Ok(LandmarkLog { steps, ..LandmarkLog::default() })
}

fn node<'a, I: Iterator<Item = &'a str>>(fields: &mut Fields<'a, I>, name: &str) -> Result<u32, Error> {
    fields.count(name, u32::MAX as usize).map(|node| node as u32)
}

fn step(node: u32, motion: Se2, covariance: Matrix3<f64>) -> LandmarkStep {
    LandmarkStep { stamp: Stamp::from_seconds(f64::from(node)), motion, covariance, seen: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_become_steps() {
        let text = "ODOMETRY 0 1 1 0 0.1 1e-4 0 0 4e-6 0 4e-6\nLANDMARK 1 2 3 4 0.4 0.1 0.5\nODOMETRY 1 3 1 0 0 1e-4 0 0 4e-6 0 4e-6\n";
        let log = read_graph(&Input::new("g", text)).unwrap();
        assert_eq!(log.steps.len(), 3);
        assert_eq!(log.steps[2].stamp, Stamp::from_seconds(3.0));
        assert_eq!(log.steps[1].covariance[(2, 2)], 4e-6);
        let expected = SeenAs::Place(Vector2::new(3.0, 4.0), Matrix2::new(0.4, 0.1, 0.1, 0.5));
        assert_eq!(log.steps[1].seen, [Seen { id: Some(2), measured: expected }]);
    }

    #[test]
    fn informations_are_inverted() {
        let text = "ODOMETRY 0 1 1 0 0.1 100 0 0 100 0 400\nLANDMARK 0 2 3 4 4 0 4\n";
        let log = read_graph(&Input::new("g", text)).unwrap();
        assert_eq!(log.steps[1].covariance[(2, 2)], 0.0025);
        assert!(matches!(log.steps[0].seen[0].measured, SeenAs::Place(_, c) if c[(0, 0)] == 0.25));
    }

    #[test]
    fn what_does_not_hang_together_is_refused() {
        let error = |text: &str| read_graph(&Input::new("g", text)).unwrap_err().to_string();
        assert!(error("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nODOMETRY 0 2 1 0 0 1 0 0 1 0 1").contains("not the last pose"));
        assert!(error("LANDMARK 7 2 1 0 1 0 1").contains("no pose 7"));
        assert!(error("EDGE 1").contains("ODOMETRY or LANDMARK"));
    }
}
