//! The row part of the distance transform: the lower envelope of one parabola per column.
//!
//! With `F(i) = g²(i) + i²` the value at `x` is `x² + min_i (F(i) - 2 i x)`: a minimum over lines, so the parabolas that
//! matter are the corners of the lower convex hull of the points `(i, F(i))`. A monotone chain finds them with integer
//! products alone; one division per corner says where it hands over to the next.

use super::{BAND, DistanceTransform, columns::Columns};
use crate::compute::Split;

/// A corner of the hull: column `i`, and `F(i)`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Site {
    column: i32,
    height: i32,
}

/// Rows of the result with a row of scratch per band, cut between bands.
pub(super) struct Bands<'a, T> {
    width: usize,
    out: &'a mut [T],
    sites: &'a mut [Site],
    squared: &'a mut [i32],
}

impl<'a, T> Bands<'a, T> {
    pub(super) fn new(width: usize, out: &'a mut [T], sites: &'a mut [Site], squared: &'a mut [i32]) -> Self {
        Self { width, out, sites, squared }
    }
}

impl<T: Send> Split for Bands<'_, T> {
    fn len(&self) -> usize {
        self.out.len() / self.width
    }

    /// `mid` is a multiple of [`BAND`]: the loop over chunks of `BAND` rows cuts nowhere else.
    fn split_at(self, mid: usize) -> (Self, Self) {
        let scratch = mid / BAND * self.width;
        let (out_a, out_b) = self.out.split_at_mut(mid * self.width);
        let (sites_a, sites_b) = self.sites.split_at_mut(scratch);
        let (squared_a, squared_b) = self.squared.split_at_mut(scratch);
        (
            Self { width: self.width, out: out_a, sites: sites_a, squared: squared_a },
            Self { width: self.width, out: out_b, sites: sites_b, squared: squared_b },
        )
    }
}

impl<T: Copy> Bands<'_, T> {
    /// Computes the rows of band `band`; parabolas farther than `reach` cells are left out.
    pub(super) fn run(self, band: usize, columns: &Columns, reach: i16, finish: &impl Fn(i32) -> T) {
        for (row, out) in self.out.chunks_exact_mut(self.width).enumerate() {
            let squared = &mut self.squared[..self.width];
            columns.row_into(band, row, squared);
            let corners = hull(squared, reach, &mut self.sites[..self.width]);
            fill(&self.sites[..corners], squared);
            for (value, &squared) in out.iter_mut().zip(squared.iter()) {
                *value = finish(squared);
            }
        }
    }
}

/// Lower convex hull of `(i, g²(i) + i²)` over the columns with `g(i) <= reach`; returns its number of corners.
fn hull(column_distances: &[i32], reach: i16, sites: &mut [Site]) -> usize {
    let mut len = 0;
    // The two last corners, `a` before `b`, are kept at hand. Sites below `len` hold the corners up to `a`.
    let (mut a, mut b) = (Site::default(), Site::default());
    for (i, &g) in column_distances.iter().enumerate() {
        if g > i32::from(reach) {
            continue;
        }
        let column = i as i32;
        let c = Site { column, height: g * g + column * column };
        // `b` stays while the chain turns left in it.
        while len >= 2 && !turns_left(a, b, c) {
            len -= 1;
            b = a;
            a = if len >= 2 { sites[len - 2] } else { a };
        }
        if let Some(slot) = sites.get_mut(len) {
            *slot = c;
        }
        len += 1;
        (a, b) = (b, c);
    }
    len
}

/// Differences of heights are below 2^31 and of columns below 2^15, so their products fit.
#[inline]
fn turns_left(a: Site, b: Site, c: Site) -> bool {
    i64::from(b.height - a.height) * i64::from(c.column - b.column)
        < i64::from(c.height - b.height) * i64::from(b.column - a.column)
}

/// Evaluates the envelope in every column.
fn fill(sites: &[Site], squared: &mut [i32]) {
    let Some(&(mut site)) = sites.first() else {
        return squared.fill(DistanceTransform::NO_OBSTACLE);
    };
    let end = squared.len() as i32;
    let mut start = 0;
    for &next in sites.iter().skip(1) {
        // The next corner is the nearer one beyond the crossing of the two lines; at the crossing both are equal. The
        // quotient of two such integers is never rounded across an integer in f64, and a negative one cuts to 0.
        let crossing = f64::from(next.height - site.height) / f64::from(2 * (next.column - site.column));
        let stop = ((crossing + 1.0) as i32).min(end);
        site.fill(start, stop, squared);
        (start, site) = (start.max(stop), next);
    }
    site.fill(start, end, squared);
}

impl Site {
    /// Squared distances to this site for the columns from `start` to before `stop`.
    #[inline]
    fn fill(self, start: i32, stop: i32, squared: &mut [i32]) {
        let base = self.height - self.column * self.column;
        if start < stop {
            for (dx, squared) in (start - self.column..).zip(&mut squared[start as usize..stop as usize]) {
                *squared = dx * dx + base;
            }
        }
    }
}
