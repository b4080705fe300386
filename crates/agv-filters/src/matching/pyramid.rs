//! Greatest values of a grid over squares of cells: bounds for a search by halves.
//!
//! Level `k` holds for every cell the greatest value of the `2^k` by `2^k` cells of which it is the lower-left one (Hess et al. 2016,
//! Eq. 12), for cells left of and below the grid too, whose squares reach into it. Each level is made of the one before by two
//! maxima per direction, O(cells).

/// A grid of small whole numbers, and its maxima.
#[derive(Debug, Clone, Default)]
pub(super) struct Pyramid {
    levels: Vec<Level>,
    /// How many of these are made; the others are memory.
    made: usize,
}

#[derive(Debug, Clone, Default)]
struct Level {
    width: usize,
    height: usize,
    /// How many columns and rows come before those of the grid.
    before: i32,
    values: Vec<u8>,
}

impl Pyramid {
    /// The finest level alone, its cells row by row.
    pub(super) fn renew(&mut self, width: usize, values: impl Iterator<Item = u8>) {
        if self.levels.is_empty() {
            self.levels.push(Level::default());
        }
        // There is one now.
        let finest = &mut self.levels[0];
        finest.values.clear();
        finest.values.extend(values);
        (finest.width, finest.height, finest.before) = (width, finest.values.len() / width.max(1), 0);
        self.made = 1;
    }

    /// Whether not even the finest level is made.
    pub(super) const fn is_empty(&self) -> bool {
        self.made == 0
    }

    /// Bytes of its memory.
    pub(super) fn memory(&self) -> usize {
        self.levels.iter().map(|level| level.values.capacity()).sum()
    }

    /// Nothing is made any more; the memory stays.
    pub(super) const fn clear(&mut self) {
        self.made = 0;
    }

    /// Makes the levels up to this one, unless they are there.
    pub(super) fn grow(&mut self, level: usize) {
        while self.made <= level {
            if self.levels.len() == self.made {
                self.levels.push(Level::default());
            }
            let (finer, coarser) = self.levels.split_at_mut(self.made);
            let (Some(finer), Some(coarser)) = (finer.last(), coarser.first_mut()) else { return };
            finer.double_into(1 << (self.made - 1), coarser);
            self.made += 1;
        }
    }

    /// Greatest value of the square whose lower-left cell this is; zero where it meets nothing. The level must have been made.
    #[inline]
    pub(super) fn at(&self, level: usize, x: i32, y: i32) -> u8 {
        let level = &self.levels[level];
        let (x, y) = ((x + level.before) as u32 as usize, (y + level.before) as u32 as usize);
        if x < level.width && y < level.height { level.values[y * level.width + x] } else { 0 }
    }
}

impl Level {
    /// Makes the level of squares twice as wide, by half of their width.
    fn double_into(&self, half: usize, double: &mut Self) {
        let (width, height) = (self.width + half, self.height + half);
        double.values.clear();
        double.values.resize(width * height, 0);
        for (y, row) in self.values.chunks_exact(self.width).enumerate() {
            for start in [y, y + half].map(|y| y * width) {
                for shift in [0, half] {
                    raise(&mut double.values[start + shift..start + shift + self.width], row);
                }
            }
        }
        (double.width, double.height, double.before) = (width, height, self.before + half as i32);
    }
}

#[inline]
fn raise(values: &mut [u8], others: &[u8]) {
    values.iter_mut().zip(others).for_each(|(value, other)| *value = (*value).max(*other));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_the_maxima_of_their_squares() {
        let mut pyramid = Pyramid::default();
        // The second in the memory of the first.
        for (width, height) in [(15_i32, 9_i32), (11, 7)] {
            let value = |x: i32, y: i32| {
                if (0..width).contains(&x) && (0..height).contains(&y) { ((x * 37 + y * 101) % 251) as u8 } else { 0 }
            };
            pyramid.renew(width as usize, (0..width * height).map(|i| value(i % width, i / width)));
            pyramid.grow(3);
            for level in 0..4 {
                let span = 1 << level;
                for (x, y) in (-12..16).flat_map(|x| (-12..12).map(move |y| (x, y))) {
                    let square = (x..x + span).flat_map(|x| (y..y + span).map(move |y| (x, y)));
                    let expected = square.map(|(x, y)| value(x, y)).max().unwrap();
                    assert_eq!(pyramid.at(level, x, y), expected, "level {level} ({x}, {y})");
                }
            }
        }
    }
}
