//! Which way around obstacles a band goes: its H-signature (Bhattacharya, Kumar and Likhachev 2010).
//!
//! Two ways with the same ends belong to the same homology class if the closed curve of one and the other backwards winds around no
//! obstacle. That is told by a point `ζ` in each obstacle:
//!
//! ```text
//! H(γ) = 1/(2πi) ∫ dz / (z - ζ)          H(γ₁) - H(γ₂) = turns of γ₁ γ₂⁻¹ around ζ
//!      γ
//! ```
//!
//! The turns of a closed curve are the times that it crosses a ray from `ζ`, signed by the side that it comes from. So each way is
//! given whole numbers, its own signed crossings: ways whose ends are the same have the same class exactly if their numbers are, and
//! nothing is rounded.

use nalgebra::Vector2;

/// Signed crossings of the ray from each of the obstacles' points along the map's x axis.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Signature(Vec<i32>);

impl Signature {
    /// Takes the signature of a way through some nodes and on to `end`; time is proportional to nodes times obstacles.
    pub(super) fn set(&mut self, nodes: &[[f64; 4]], end: &Vector2<f64>, obstacles: &[Vector2<f64>]) {
        self.0.clear();
        self.0.extend(obstacles.iter().map(|point| {
            let ahead = nodes.iter().skip(1).map(|node| [node[0], node[1]]).chain([[end.x, end.y]]);
            nodes.iter().zip(ahead).map(|(a, b)| crossing([a[0], a[1]], b, point)).sum::<i32>()
        }));
    }
}

/// 1 if a line crosses the ray to greater y, -1 if to smaller y. An end on the ray belongs below it.
fn crossing(a: [f64; 2], b: [f64; 2], point: &Vector2<f64>) -> i32 {
    let (from, to) = (a[1] > point.y, b[1] > point.y);
    if from == to {
        return 0;
    }
    let x = a[0] + (b[0] - a[0]) * (point.y - a[1]) / (b[1] - a[1]);
    if x <= point.x {
        0
    } else if to {
        1
    } else {
        -1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn signature(way: &[[f64; 4]], end: &Vector2<f64>, points: &[Vector2<f64>]) -> Signature {
        let mut signature = Signature::default();
        signature.set(way, end, points);
        signature
    }

    /// The angle around a point that a curve sweeps, in turns: the integral itself.
    fn turns(curve: &[Vector2<f64>], point: &Vector2<f64>) -> f64 {
        let angle = |w: &[Vector2<f64>]| {
            let (a, b) = (w[0] - point, w[1] - point);
            a.perp(&b).atan2(a.dot(&b))
        };
        curve.windows(2).map(angle).sum::<f64>() / std::f64::consts::TAU
    }

    fn points(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Vector2<f64>>> {
        prop::collection::vec((-2.0..2.0_f64, -2.0..2.0_f64).prop_map(|(x, y)| Vector2::new(x, y)), count)
    }

    proptest! {
        /// The difference of two ways' numbers is the integral of the one and the other backwards, for each obstacle.
        #[test]
        fn differences_are_turns_around_obstacles(a in points(0..12), b in points(0..12), obstacles in points(1..6)) {
            let (start, end) = (Vector2::new(-3.0, 0.1), Vector2::new(3.0, -0.2));
            let nodes = |way: &[Vector2<f64>]| -> Vec<_> {
                std::iter::once(&start).chain(way).map(|p| [p.x, p.y, 0.0, 0.1]).collect()
            };
            let (first, second) =
                (signature(&nodes(&a), &end, &obstacles), signature(&nodes(&b), &end, &obstacles));
            let there = std::iter::once(start).chain(a).chain([end]);
            let closed: Vec<_> = there.chain(b.into_iter().rev()).chain([start]).collect();
            for (i, point) in obstacles.iter().enumerate() {
                let turned = turns(&closed, point);
                prop_assert!((turned - f64::from(first.0[i] - second.0[i])).abs() < 1e-9, "{turned} {first:?} {second:?}");
            }
        }
    }

    #[test]
    fn sides_of_a_post_differ_and_bows_do_not() {
        let bow = |height: f64, step: f64| -> Vec<_> {
            (0..(4.0 / step) as usize)
                .map(|i| step * i as f64)
                .map(|x| [x, height * (0.785 * x).sin(), 0.0, 0.1])
                .collect()
        };
        let (end, post) = (Vector2::new(4.0, 0.0), [Vector2::new(2.0, 0.0)]);
        let of = |height, step| signature(&bow(height, step), &end, &post);
        assert_eq!(of(0.6, 0.1), of(1.5, 0.16));
        assert_ne!(of(0.6, 0.1), of(-0.6, 0.1));
        assert_eq!(of(-0.3, 0.1), of(-0.6, 0.2));
    }
}
