//! A digest of all bits of an output, and the comparison over threads.

use agv_nav::core::{compute::Par, geometry::Se2};

/// FNV-1a over bytes (Fowler, Noll and Vo; 64 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Digest {
    hash: u64,
    words: usize,
}

impl Digest {
    pub(crate) fn new() -> Self {
        Self { hash: 0xcbf2_9ce4_8422_2325, words: 0 }
    }

    fn word(mut self, bytes: impl IntoIterator<Item = u8>) -> Self {
        for byte in bytes {
            self.hash = (self.hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        self.words += 1;
        self
    }

    pub(crate) fn integers<T: Into<i64>>(self, values: impl IntoIterator<Item = T>) -> Self {
        values.into_iter().fold(self, |digest, value| digest.word(value.into().to_le_bytes()))
    }

    pub(crate) fn bits(self, values: impl IntoIterator<Item = u64>) -> Self {
        values.into_iter().fold(self, |digest, value| digest.word(value.to_le_bytes()))
    }

    pub(crate) fn singles(self, values: &[f32]) -> Self {
        values.iter().fold(self, |digest, value| digest.word(value.to_bits().to_le_bytes()))
    }

    pub(crate) fn poses<'a>(self, poses: impl IntoIterator<Item = &'a Se2>) -> Self {
        let numbers = |p: &Se2| [p.x(), p.y(), p.rotation().cos(), p.rotation().sin()].map(f64::to_bits);
        self.bits(poses.into_iter().flat_map(numbers))
    }

    /// Prints the digest for the comparison of builds.
    pub(crate) fn report(self, name: &str) -> u64 {
        assert!(self.words > 0, "{name} says nothing");
        println!("digest of {name}: {:016x}", self.hash);
        self.hash
    }
}

/// Runs `component` with one, two and four threads, outside of any pool of ours and inside pools of one, two and three,
/// and compares.
pub(crate) fn assert_same_bits(name: &str, component: impl Fn(Par) -> Digest + Sync) -> u64 {
    let reference = component(Par::Seq);
    for pool_threads in [1, 2, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(pool_threads).build().unwrap();
        for par in [Par::Seq, Par::threads(2), Par::threads(4)] {
            let digest = pool.install(|| component(par));
            assert_eq!(digest, reference, "{name} differs with {par:?} in a pool of {pool_threads}");
        }
    }
    assert_eq!(component(Par::threads(2)), reference, "{name} differs from outside of a pool");
    reference.report(name)
}

#[test]
fn a_digest_sees_every_bit_and_the_order() {
    let of = |values: &[f32]| Digest::new().singles(values);
    assert_ne!(of(&[0.0]), of(&[-0.0]));
    assert_ne!(of(&[1.0, 2.0]), of(&[2.0, 1.0]));
    assert_ne!(of(&[1.0]), of(&[1.0_f32.next_up()]));
    // FNV's own test vector: the hash of "foobar".
    assert_eq!(Digest::new().word(*b"foobar").hash, 0x8594_4171_f739_67e8);
}
