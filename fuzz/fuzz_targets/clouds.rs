//! Point clouds: PLY and PCD by content, raw rows by name.
#![no_main]

use agv_support::Input;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    for name in ["fuzz.xyz.f32", "fuzz.bin", "fuzz.xyz.i16mm2", "fuzz.rec12"] {
        let _ = agv_support::cloud::parse(&Input::new(name, data));
    }
});
