//! The elastic band drives ideal vehicles through worlds, keeping the laws of its role.

mod laws;
mod scenes;
mod worlds;
