//! The elastic band drives ideal vehicles through worlds, keeping the laws of its role.

mod input;
mod laws;
mod random;
mod scenes;
mod sides;
mod wishes;
mod worlds;
