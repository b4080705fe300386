//! Whatever claims `serde` comes back from a text with the same bits, and a spoilt text is refused.

mod localization;
#[path = "../scenes/mod.rs"]
mod scenes;
