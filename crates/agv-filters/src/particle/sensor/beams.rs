//! Which beams of a scan a model reads.

/// The indices of `most` beams out of `count`, evenly spread: the middle of each of as many equal parts. All of them if there
/// are no more.
pub(super) fn evenly_spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let used = count.min(most);
    (0..used).map(move |k| (2 * k + 1) * count / (2 * used))
}

/// A model of scans that reads a limited number of their beams: what a wrapper around it must know.
pub trait MaxBeams {
    /// Most beams of a scan that are read, evenly spread.
    fn max_beams(&self) -> usize;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_are_spread_evenly_and_symmetrically() {
        for (count, most) in [(180, 60), (1081, 60), (7, 3), (5, 9), (0, 4), (1, 1), (65_536, 720)] {
            let chosen: Vec<usize> = evenly_spread(count, most).collect();
            assert_eq!(chosen.len(), count.min(most));
            assert!(chosen.iter().all(|&i| i < count) && chosen.is_sorted_by(|a, b| a < b));
            let gaps: Vec<usize> = chosen.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(gaps.iter().max().unwrap_or(&0) - gaps.iter().min().unwrap_or(&0) <= 1);
        }
    }
}
