//! What turns a path of cells into one that a vehicle likes to follow.
