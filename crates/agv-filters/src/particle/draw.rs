//! Drawing many poses, in chunks with random streams of their own.

use agv_core::{
    compute::{CHUNK, Stream},
    geometry::Se2,
};

/// Writes the poses of a chunk with `draw(index of the pose, stream)`.
pub(super) fn draw_chunk(
    chunk: usize,
    poses: &mut [Se2],
    mut stream: Stream,
    draw: impl Fn(usize, &mut Stream) -> Se2,
) {
    for (index, pose) in (chunk * CHUNK..).zip(poses) {
        *pose = draw(index, &mut stream);
    }
}
