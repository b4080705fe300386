//! Laps through paper 001's ring of codes.

#[path = "../../examples/qr_navigation/laps.rs"]
#[allow(dead_code, reason = "the example measures more")]
mod laps;
#[path = "../../examples/qr_navigation/pilot.rs"]
#[allow(dead_code, reason = "the example names its variants")]
mod pilot;
#[path = "../../examples/qr_navigation/site.rs"]
#[allow(dead_code, reason = "the example draws it")]
mod site;

use agv_nav::core::compute::{Par, Seed};
use laps::{Run, Runs};
use pilot::Variant;
use site::Site;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

#[test]
fn laps_arrive_and_codes_bring_them_nearer() {
    let site = Site::new(0.5).unwrap();
    let runs = Runs { laps: 6, damaged: 0.0, yaw_offset: 60_f64.to_radians(), uses_unread: true, par: Par::Seq };
    let mut stops = [f64::NAN; 2];
    for (variant, stop) in [Variant::Laser, Variant::Both].into_iter().zip(&mut stops) {
        let run = Run::new(&site, runs, variant, Seed(1)).unwrap();
        assert!(run.laps.len() == 6 && run.contacts == 0, "{}", variant.name());
        for lap in &run.laps {
            let offset = lap.offset.1.max(-lap.offset.0);
            eprintln!("{}: stops {:.4} m off, centred {:?}", variant.name(), lap.stop_error, lap.centred_error);
            assert!(lap.arrived && offset < 0.2 && lap.stop_error < 0.03, "{}: {offset}", variant.name());
            let error = match variant {
                Variant::Both => lap.centred_error.expect("the station has a code"),
                _ => lap.stop_error,
            };
            assert!(variant != Variant::Both || error < 0.004, "{error}");
            *stop = stop.max(error);
        }
    }
    // Paper 001's ratio at the target, by the worst stop of each.
    assert!(stops[1] < (1.0 - 0.6427) * stops[0], "{stops:?}");
}
