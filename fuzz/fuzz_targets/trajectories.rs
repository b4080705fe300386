//! Trajectories and relations.
#![no_main]

use agv_support::Input;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = agv_support::trajectory::parse_tum(&Input::new("fuzz", data));
    let _ = agv_support::trajectory::parse_kitti(&Input::new("fuzz", data));
    let _ = agv_support::relations::parse(&Input::new("fuzz", data));
});
