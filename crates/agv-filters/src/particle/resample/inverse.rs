//! Points on the cumulative weights, turned into indices.

/// Fills `ancestors` with the indices of the particles whose shares of the cumulative weights hold the points, which come in
/// increasing order, counted from 0 to `total`.
///
/// An index of weight zero never appears: a share without length holds no point, and what rounding moves beyond the last
/// share belongs to the last one with a length.
pub(super) fn assign(weights: &[f64], ancestors: &mut [u32], mut next_point: impl FnMut() -> f64) {
    let last = weights.iter().rposition(|&weight| weight > 0.0).unwrap_or(0);
    let (mut index, mut end) = (0, weights.first().copied().unwrap_or(0.0));
    for ancestor in ancestors {
        let point = next_point();
        while end <= point && index < last {
            index += 1;
            end += weights[index];
        }
        *ancestor = index as u32;
    }
}
