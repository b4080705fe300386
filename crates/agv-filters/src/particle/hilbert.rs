//! The order of a Hilbert curve through the cells of a grid (Hilbert 1891, *Über die stetige Abbildung einer Linie auf ein
//! Flächenstück*).
//!
//! Cells that follow each other touch, and equal parts of the curve are compact patches at every scale, where equal parts of the
//! rows one after the other are strips as thin as a cell.

/// Ways through the four quarters of a square: right or not, up or not, and the way through that quarter. Each ends beside the begin
/// of the next.
const WAYS: [[(usize, usize, usize); 4]; 4] = [
    [(0, 0, 1), (0, 1, 0), (1, 1, 0), (1, 0, 2)],
    [(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 3)],
    [(1, 1, 3), (0, 1, 2), (0, 0, 2), (1, 0, 0)],
    [(1, 1, 2), (1, 0, 3), (0, 0, 3), (0, 1, 1)],
];

/// Visits the indices of all cells of a grid of `width` by `height` cells, row by row, in the order of the curve through the
/// least square of a power of two that holds it. O(width x height): quarters off the grid are left out whole.
pub(super) fn along_hilbert_curve(width: usize, height: usize, mut visit: impl FnMut(usize)) {
    let side = width.max(height).next_power_of_two();
    through(0, (0, 0), side, (width, height), &mut visit);
}

fn through(way: usize, (x, y): (usize, usize), side: usize, size: (usize, usize), visit: &mut impl FnMut(usize)) {
    if x >= size.0 || y >= size.1 {
        return;
    }
    if side == 1 {
        return visit(y * size.0 + x);
    }
    let half = side / 2;
    for (right, up, way) in WAYS[way] {
        through(way, (x + right * half, y + up * half), half, size, visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(width: usize, height: usize) -> Vec<(usize, usize)> {
        let mut cells = vec![];
        along_hilbert_curve(width, height, |index| cells.push((index % width, index / width)));
        cells
    }

    #[test]
    fn each_cell_of_a_square_touches_the_one_before() {
        let cells = cells(32, 32);
        assert!(cells.windows(2).all(|pair| pair[0].0.abs_diff(pair[1].0) + pair[0].1.abs_diff(pair[1].1) == 1));
    }

    #[test]
    fn every_cell_of_any_grid_is_visited_once() {
        for (width, height) in [(1, 1), (7, 3), (3, 40), (33, 31)] {
            let mut cells = cells(width, height);
            cells.sort_unstable();
            cells.dedup();
            assert_eq!(cells.len(), width * height);
        }
    }

    /// A sixty-fourth of the curve is a square of an eighth of the side.
    #[test]
    fn equal_parts_are_compact() {
        for part in cells(64, 64).chunks(64) {
            let spread = |of: fn(&(usize, usize)) -> usize| {
                let values = part.iter().map(of);
                values.clone().max().unwrap() - values.min().unwrap()
            };
            assert_eq!((spread(|cell| cell.0), spread(|cell| cell.1)), (7, 7));
        }
    }
}
