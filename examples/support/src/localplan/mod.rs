//! Worlds of local-planning benchmarks: BARN, `DynaBARN` and MRPB, in the formats of `data/localplan/README.md`.

mod barn;
mod dynabarn;
mod mrpb;

pub use barn::{BarnWorld, read_barn};
pub use dynabarn::{DynabarnDisc, DynabarnWorld, read_dynabarn};
pub use mrpb::{MrpbTest, read_mrpb_map, read_mrpb_tests};

/// Greatest number of a world or an obstacle.
const MAX_INDEX: usize = 1 << 24;
