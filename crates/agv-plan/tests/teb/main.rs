//! The elastic band drives ideal vehicles through worlds, keeping the laws of its role.

mod input;
mod laws;
mod scenes;
mod sides;
mod worlds;
