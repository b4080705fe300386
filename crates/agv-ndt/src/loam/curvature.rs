//! How sharply the surface bends along a laser line, and which points not to trust.
//!
//! Paper 003, Eq. 3 (as LeGO-LOAM): with the ranges `r` of the `S` neighbours, half of them to each side,
//!
//! ```text
//! c = |Σ (r_j - r_i)| / (|S| r_i)
//! ```
//!
//! A corner of 90° that is seen evenly has `c` of about `3 δ` with the angle `δ` between neighbours and five of them to a side: `c / δ`
//! is a number of the shape, the same for every sensor and range. Noise of `σ` in the ranges makes the sum one of `σ √(|S| (|S| + 1))`.

/// Neighbours to each side (LOAM and LeGO-LOAM).
pub(super) const SIDE: usize = 5;

/// Widest angle that a point's neighbours may span, in radians: lines with holes have no shape there.
const WIDEST: f32 = 0.12;

/// Points of a line as one looks at them: in the order of their azimuth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LinePoint {
    pub(super) azimuth: f32,
    pub(super) range: f32,
}

/// What a point is good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    /// Bends enough for an edge.
    Sharp,
    /// As flat as the noise lets one see.
    Flat,
    /// In between, at the rim of what hides it, or along the beam.
    None,
}

/// Bends and trust of the points of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CurvatureParams {
    /// Least `c / δ` of an edge.
    pub(super) edge_bend: f32,
    /// Standard deviation of a range, in metres.
    pub(super) range_sigma: f32,
}

/// Writes `c / δ` and shape of each point of a line; linear in the points.
pub(super) fn shapes_into(line: &[LinePoint], params: CurvatureParams, out: &mut Vec<(f32, Shape)>) {
    out.clear();
    out.resize(line.len(), (0.0, Shape::None));
    let count = 2.0 * SIDE as f32;
    let noise = params.range_sigma * (count * (count + 1.0)).sqrt();
    for at in SIDE..line.len().saturating_sub(SIDE) {
        // There are SIDE points to each side.
        let (here, around) = (line[at], &line[at - SIDE..=at + SIDE]);
        let span = around[2 * SIDE].azimuth - around[0].azimuth;
        if !(span > 0.0 && span <= WIDEST) {
            continue;
        }
        let sum = around.iter().map(|point| point.range).sum::<f32>() - (count + 1.0) * here.range;
        let bend = sum.abs() / (count * here.range) * (count / span);
        let shape = if sum.abs() > 2.0 * noise && bend >= params.edge_bend {
            Shape::Sharp
        } else if sum.abs() <= noise || bend < 0.25 * params.edge_bend {
            Shape::Flat
        } else {
            Shape::None
        };
        out[at] = (bend, shape);
    }
    reject(line, params.range_sigma, out);
}

/// LOAM's rules (Zhang and Singh 2014, section V-A): what is behind a nearer surface's rim may be hidden from the next place, and what
/// lies along the beam has no range to speak of.
fn reject(line: &[LinePoint], range_sigma: f32, out: &mut [(f32, Shape)]) {
    for at in 1..line.len().saturating_sub(1) {
        let (before, here, after) = (line[at - 1], line[at], line[at + 1]);
        // A jump of the range between neighbours that are close in angle: the farther side is not to be trusted.
        let jump = after.range - here.range;
        if after.azimuth - here.azimuth < WIDEST && jump.abs() > 0.3_f32.max(0.1 * here.range.min(after.range)) {
            let hidden = if jump > 0.0 { at + 1..=at + 1 + SIDE } else { (at + 1).saturating_sub(SIDE)..=at };
            let hidden = *hidden.start()..(hidden.end() + 1).min(line.len());
            // The range ends within the line. The first point is the rim's shadow, the others its neighbourhood.
            out[hidden].iter_mut().for_each(|(_, shape)| *shape = Shape::None);
            // And a flat neighbourhood does not reach across the rim.
            let near = if jump > 0.0 {
                (at + 1).saturating_sub(SIDE)..at + 1
            } else {
                at + 1..(at + 1 + SIDE).min(line.len())
            };
            for (_, shape) in &mut out[near] {
                if *shape == Shape::Flat {
                    *shape = Shape::None;
                }
            }
        }
        // Both neighbours at quite another range, to opposite sides: along the beam.
        let (to_before, to_after) = (before.range - here.range, after.range - here.range);
        let along = 0.02 * here.range + 2.0 * range_sigma;
        if to_before.abs() > along && to_after.abs() > along {
            out[at].1 = Shape::None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARAMS: CurvatureParams = CurvatureParams { edge_bend: 1.2, range_sigma: 0.02 };

    /// A line that looks from the origin at what has this range at an azimuth.
    fn look(step: f32, range: impl Fn(f32) -> f32) -> Vec<LinePoint> {
        (-100..=100_i16)
            .map(|i| f32::from(i) * step)
            .map(|azimuth| LinePoint { azimuth, range: range(azimuth) })
            .collect()
    }

    fn shapes(line: &[LinePoint]) -> Vec<(f32, Shape)> {
        let mut out = Vec::new();
        shapes_into(line, PARAMS, &mut out);
        out
    }

    #[test]
    fn a_corner_bends_three_steps_of_the_angle_at_any_range_and_resolution() {
        for (step, distance) in [(0.0035, 8.0), (0.0035, 20.0), (0.007, 8.0)] {
            // Two walls that meet in a right angle straight ahead.
            let line = look(step, |a| distance / (a.cos() + a.sin().abs()));
            let found = shapes(&line);
            assert!((found[100].0 - 3.0).abs() < 0.3, "{step} {distance}: {:?}", found[100]);
            assert_eq!(found[100].1, Shape::Sharp);
            assert!(found[10..90].iter().all(|(_, shape)| *shape == Shape::Flat));
        }
    }

    #[test]
    fn what_a_near_surface_hides_is_not_trusted_and_its_rim_is() {
        // A post half a metre wide, 4 m ahead, before a wall at 10 m.
        let line = look(0.0035, |a| if a.abs() < 0.06 { 4.0 } else { 10.0 / a.cos() });
        let found = shapes(&line);
        let rim = 100 + (0.06_f32 / 0.0035) as usize;
        assert_eq!(found[rim].1, Shape::Sharp);
        assert!(found[rim + 1..=rim + SIDE].iter().all(|(_, shape)| *shape == Shape::None));
        assert_eq!(found[rim + 3 * SIDE].1, Shape::Flat);
    }

    #[test]
    fn a_surface_along_the_beam_and_short_lines_have_no_shape() {
        // A wall that recedes by 20 cm and more from beam to beam.
        let line = look(0.0035, |a| 10.0 / (1.0 - 8.0 * (a + 0.36)).abs().max(0.05));
        assert!(shapes(&line).iter().filter(|(bend, _)| *bend > 1.0).all(|(_, shape)| *shape != Shape::Flat));
        assert!(shapes(&line[..2 * SIDE]).iter().all(|(_, shape)| *shape == Shape::None));
        assert!(shapes(&[]).is_empty());
    }
}
