//! Scan logs of every format.
#![no_main]

use agv_support::Input;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = agv_support::log::ScanLog::parse(&Input::new("fuzz", data));
    let _ = agv_support::log::carmen::parse(&Input::new("fuzz", data));
    let _ = agv_support::log::csv::parse_reference(&Input::new("fuzz", data));
});
