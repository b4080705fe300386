//! Random streams and parallel loops whose results do not depend on the number of threads.

mod par;
mod split;
mod stream;

pub use par::Par;
pub use split::Split;
pub use stream::{Seed, Stream};

/// Entries per chunk of the parallel loops and of the random streams. Fixed, so that neither the number of threads
/// nor the machine reaches a result.
pub const CHUNK: usize = 256;
