//! Maps of map_server: the first byte is the length of the YAML; all of it is taken as an image, too.
#![no_main]

use agv_support::Input;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let cut = data.first().map_or(0, |&first| usize::from(first).min(data.len()));
    let _ = agv_support::map::MapMeta::parse(&Input::new("fuzz.yaml", &data[..cut]));
    let yaml = "image: a\nresolution: 1\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\n";
    if let Ok(meta) = agv_support::map::MapMeta::parse(&Input::new("good.yaml", yaml)) {
        let _ = agv_support::map::assemble(&meta, &Input::new("fuzz.pgm", data));
    }
});
