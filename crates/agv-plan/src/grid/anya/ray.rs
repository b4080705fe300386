//! Points, rays and cones in whole numbers: what is seen is decided exactly.

/// A point, in half cells: corners of cells are even, centres odd.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Point {
    pub(super) x: i32,
    pub(super) y: i32,
}

impl Point {
    pub(super) fn distance(self, other: Self) -> f64 {
        f64::from(self.x - other.x).hypot(f64::from(self.y - other.y))
    }

    /// From here to `other`.
    pub(super) fn to(self, other: Self) -> [i64; 2] {
        [i64::from(other.x - self.x), i64::from(other.y - self.y)]
    }
}

/// Twice the area between two vectors, positive if the second lies to the left of the first.
pub(super) fn cross(a: [i64; 2], b: [i64; 2]) -> i64 {
    a[0] * b[1] - a[1] * b[0]
}

/// A direction from the root of a cone: to the side, and ahead, which is never negative.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ray {
    pub(super) aside: i64,
    pub(super) ahead: i64,
}

impl Ray {
    pub(super) const LEFT: Self = Self { aside: -1, ahead: 0 };
    pub(super) const RIGHT: Self = Self { aside: 1, ahead: 0 };
    pub(super) const AHEAD: Self = Self { aside: 0, ahead: 1 };

    /// The ray through a point; `direction` is the sign of y ahead.
    pub(super) fn through(root: Point, point: Point, direction: i32) -> Self {
        let [aside, ahead] = root.to(point);
        Self { aside, ahead: ahead * i64::from(direction) }
    }

    /// Whether it passes to the left of another (negative), along it (zero) or to the right.
    #[inline]
    pub(super) fn compare(self, other: Self) -> i64 {
        self.aside * other.ahead - other.aside * self.ahead
    }

    /// The one that is farther to the right.
    #[inline]
    pub(super) fn right_of(self, other: Self) -> Self {
        if self.compare(other) < 0 { other } else { self }
    }

    /// The one that is farther to the left.
    #[inline]
    pub(super) fn left_of(self, other: Self) -> Self {
        if self.compare(other) > 0 { other } else { self }
    }

    /// Where it meets the line that lies `distance` ahead of a root at `x`.
    #[inline]
    pub(super) fn meets(self, x: i32, distance: i64) -> f64 {
        f64::from(x) + self.aside as f64 * distance as f64 / self.ahead as f64
    }

    /// The column of cells in which it meets that line, the cells' edges belonging to the cell on their right.
    #[inline]
    pub(super) fn column(self, x: i32, distance: i64) -> i32 {
        (i64::from(x) * self.ahead + self.aside * distance).div_euclid(2 * self.ahead) as i32
    }
}

/// What is seen from a root between two rays.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cone {
    pub(super) left: Ray,
    pub(super) right: Ray,
}

impl Cone {
    /// Whether the ray lies in it, its edges included.
    #[inline]
    pub(super) fn holds(self, ray: Ray) -> bool {
        self.left.compare(ray) <= 0 && ray.compare(self.right) <= 0
    }

    /// Its part between two rays, if that is more than a line.
    #[inline]
    pub(super) fn between(self, left: Ray, right: Ray) -> Option<Self> {
        let part = Self { left: self.left.right_of(left), right: self.right.left_of(right) };
        (part.left.compare(part.right) < 0).then_some(part)
    }
}
