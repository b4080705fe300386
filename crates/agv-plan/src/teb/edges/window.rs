//! Some unknowns in a row, with the directions that they make.

/// Sine and cosine of an angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction {
    /// Its sine.
    pub sin: f64,
    /// Its cosine.
    pub cos: f64,
}

impl Direction {
    /// The direction of an angle in radians.
    #[inline]
    pub fn of(angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { sin, cos }
    }

    /// The direction half-way between those of two angles: their bisector, but for wide turns.
    #[inline]
    pub fn between(from: (f64, Self), to: (f64, Self)) -> Self {
        if (to.0 - from.0).abs() > 2.0 {
            return Self::of(0.5 * (from.0 + to.0));
        }
        let (sin, cos) = (from.1.sin + to.1.sin, from.1.cos + to.1.cos);
        let per = 1.0 / (sin * sin + cos * cos).sqrt();
        Self { sin: per * sin, cos: per * cos }
    }
}

/// Unknowns of one, two or three poses and the times between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window<const K: usize> {
    /// The unknowns.
    pub unknowns: [f64; K],
    /// Directions of the headings of the first pose and the second.
    pub headings: [Direction; 2],
    /// Directions half-way between the headings of the first and the second pose, and of the second and the third.
    pub middles: [Direction; 2],
}

impl<const K: usize> Window<K> {
    /// The window of some unknowns; directions of poses that it does not have are those of the last one that it has.
    pub fn new(unknowns: &[f64; K]) -> Self {
        let yaw = |i: usize| unknowns.get(4 * i + 2).or(unknowns.get(2)).copied().unwrap_or(0.0);
        let [a, b, c] = [0, 1, 2].map(|i| (yaw(i), Direction::of(yaw(i))));
        let middles = [Direction::between(a, b), Direction::between(b, c)];
        Self { unknowns: *unknowns, headings: [a.1, b.1], middles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bisectors_are_half_way(a in -7.0..7.0_f64, turn in -5.0..5.0_f64) {
            let middle = Direction::between((a, Direction::of(a)), (a + turn, Direction::of(a + turn)));
            let expected = Direction::of(a + 0.5 * turn);
            prop_assert!((middle.sin - expected.sin).abs() < 1e-12 && (middle.cos - expected.cos).abs() < 1e-12);
        }
    }
}
