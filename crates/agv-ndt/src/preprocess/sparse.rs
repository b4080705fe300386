//! One of every few points of a cloud, in no step with its order.
//!
//! Clouds come in rows, sheet after sheet or line by line: every sixth point of three lines that take turns is of one line alone. The
//! place within each group of points therefore follows the multiples of the golden ratio, which are spread evenly and keep step with no period
//! (Weyl 1916).

/// 2³² divided by the golden ratio, odd.
const GOLDEN: u32 = 0x9E37_79B9;

/// An index out of each group of `stride`, below `len`, in rising order; an incomplete last group may have none.
///
/// ```
/// let few: Vec<usize> = agv_ndt::preprocess::one_of_every(4, 16).collect();
/// assert_eq!(few, [0, 6, 8, 15]);
/// ```
pub fn one_of_every(stride: usize, len: usize) -> impl Iterator<Item = usize> {
    let stride = stride.max(1);
    (0..len.div_ceil(stride)).map(move |group| group * stride + place(group, stride)).filter(move |&index| index < len)
}

/// Whether [`one_of_every`] gives this index.
pub(crate) fn is_one_of_every(stride: usize, index: usize) -> bool {
    index % stride == place(index / stride, stride)
}

/// The place within the group of that number.
fn place(group: usize, stride: usize) -> usize {
    let share = (group as u32).wrapping_mul(GOLDEN);
    ((u64::from(share) * stride as u64) >> 32) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_group_gives_one_and_no_period_of_the_cloud_is_missed() {
        for stride in [1, 2, 3, 4, 6, 8] {
            let indices: Vec<_> = one_of_every(stride, 4800).collect();
            assert!(indices.iter().enumerate().all(|(group, index)| index / stride == group), "{stride}");
            assert_eq!(indices.len(), 4800 / stride);
            assert!((0..4800).filter(|&index| is_one_of_every(stride, index)).eq(indices.iter().copied()));
            for period in 2..=12 {
                for phase in 0..period {
                    let share = indices.iter().filter(|&index| index % period == phase).count() as f64;
                    let fair = indices.len() as f64 / period as f64;
                    assert!(share > 0.7 * fair && share < 1.3 * fair, "{stride} {period} {phase}: {share} of {fair}");
                }
            }
        }
        assert_eq!(one_of_every(0, 3).count(), 3);
        assert_eq!(one_of_every(4, 0).count(), 0);
        assert!(one_of_every(8, 3).all(|index| index < 3));
    }
}
