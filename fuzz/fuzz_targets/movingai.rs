//! MovingAI maps and scenarios.
#![no_main]

use agv_support::Input;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = agv_support::movingai::parse_map(&Input::new("fuzz", data));
    let _ = agv_support::movingai::parse_scenario(&Input::new("fuzz", data));
});
