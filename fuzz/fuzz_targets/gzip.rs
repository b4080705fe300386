//! Archives.
#![no_main]

use agv_support::Input;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = Input::decompress("fuzz", data.to_vec());
});
