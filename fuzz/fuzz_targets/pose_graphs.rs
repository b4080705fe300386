//! Pose graphs of g2o, in the plane and in space.
#![no_main]

use agv_core::geometry::{Se2, Se3};
use agv_support::{Input, g2o};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = g2o::parse::<Se2>(&Input::new("fuzz", data));
    let _ = g2o::parse::<Se3>(&Input::new("fuzz", data));
});
