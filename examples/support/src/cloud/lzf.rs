//! LZF, the compression of `DATA binary_compressed` in PCD files (M. Lehmann's `LibLZF`).
//!
//! A control byte below 32 is followed by that many literals plus one; else its upper three bits plus two are the length
//! of a copy (7 means that another byte adds to it) and its lower five bits with the next byte the distance minus one.

/// Decompresses to exactly `size` bytes; none if the data are damaged.
pub(super) fn decompress(data: &[u8], size: usize) -> Option<Vec<u8>> {
    // A copy of 264 bytes takes 3: a larger claim is false, and would only cost memory.
    if size > data.len().saturating_mul(264) {
        return None;
    }
    let mut out = Vec::with_capacity(size);
    let mut input = data.iter().copied();
    while let Some(control) = input.next() {
        let control = usize::from(control);
        if control < 32 {
            for _ in 0..=control {
                out.push(input.next()?);
            }
        } else {
            let mut length = control >> 5;
            if length == 7 {
                length += usize::from(input.next()?);
            }
            let distance = ((control & 31) << 8) + usize::from(input.next()?) + 1;
            let start = out.len().checked_sub(distance)?;
            // The copy may overlap what it writes: byte by byte.
            for at in start..start + length + 2 {
                out.push(*out.get(at)?);
            }
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_copies_and_overlaps() {
        assert_eq!(decompress(&[2, b'a', b'b', b'c'], 3).unwrap(), b"abc");
        assert_eq!(decompress(&[1, b'a', b'b', 0x60, 1], 7).unwrap(), b"abababa");
        assert_eq!(decompress(&[0, b'z', 0xe0, 10, 0], 20).unwrap(), [b'z'; 20]);
    }

    #[test]
    fn damage_is_refused() {
        for (data, size) in [(&[5, 1][..], 6), (&[0x20, 9], 3), (&[0, 1], 2), (&[1, 1, 2], 1), (&[0xe0], 9), (&[], 9)] {
            assert_eq!(decompress(data, size), None, "{data:?}");
        }
        assert_eq!(decompress(&[0, 1], usize::MAX), None);
    }
}
