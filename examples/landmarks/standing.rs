//! Where does a vehicle stand that was just switched on? By one image, without a guess.
//!
//! Nine codes on the floor of which not one can be read are told apart by their places alone ([`TemplateLibrary`]); the corners of a
//! single tag on a wall give the pose by their pixels ([`resect`]). Half a pixel hardly tells from which side a small tag is seen far off:
//! along the circle around it the place is open to decimetres and more, which the covariance says; several tags, or one that is near, fix it.

use super::Result;
use agv_nav::{
    core::{
        compute::Stream,
        metrics::Statistics,
        sensors::{PinholeCamera, PinholeParams},
    },
    filters::marker::{PixelOf, SightedCode, TemplateLibrary, TemplateMatch, TemplateParams, nine_codes, resect},
    nalgebra::{Vector2, Vector3},
    prelude::*,
};
use agv_support::cli::Report;
use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{FRAC_PI_2, PI};

/// Places at which the vehicle is switched on.
const TRIALS: usize = 200;
/// How far the floor camera sees, in metres, and how well it places a code.
const FLOOR: (f64, f64) = (0.45, 0.002);
/// Deviation of a corner, in pixels.
const PIXEL_SIGMA: f64 = 0.5;

/// Reports how often the codes are known, and how well the vehicle is placed by codes and by a tag.
pub(crate) fn report(seed: Seed, report: &mut Report) -> Result<()> {
    let mut stream = seed.stream(1, 0);
    let library = TemplateLibrary::new(nine_codes(0, 0.3), TemplateParams::default())?;
    let (mut known, mut wrong, mut by_codes, mut by_tag) = (0, 0, Vec::new(), Vec::new());
    for _ in 0..TRIALS {
        let truth =
            Se2::new(stream.random_range(0.1..0.5), stream.random_range(0.1..0.5), stream.random_range(-PI..PI));
        let (ids, seen) = above(&library, &truth, &mut stream);
        if let TemplateMatch::Identified(found) = library.identify(&seen) {
            known += 1;
            wrong += usize::from(found.ids.iter().zip(&ids).any(|(found, id)| found.is_some_and(|found| found != *id)));
            by_codes.push((found.library_from_sighted.mean().translation() - truth.translation()).norm());
        }
        by_tag.push(before_a_tag(&mut stream)?);
    }
    let (by_codes, by_tag) = (Statistics::new(by_codes)?, Statistics::new(by_tag)?);
    report
        .count("codes_known", known)
        .count("codes_wrong", wrong)
        .number("codes_rmse_m", by_codes.rmse())
        .number("tag_median_m", by_tag.median())
        .number("tag_max_m", by_tag.max());
    Ok(())
}

/// The codes under a vehicle, none of them readable, and what their numbers are.
fn above(library: &TemplateLibrary, truth: &Se2, stream: &mut Stream) -> (Vec<u32>, Vec<SightedCode>) {
    let there = (0..9).filter_map(|id| Some((id, truth.inverse().act(&library.place(id)?))));
    let seen = there.filter(|(_, place)| place.norm() < FLOOR.0).map(|(id, place)| {
        let noise = Vector2::new(normal(stream), normal(stream)) * FLOOR.1;
        (id, SightedCode { place: place + noise, id: None })
    });
    seen.unzip()
}

/// The error, in metres, of the pose by the four corners of a tag of 20 cm that hangs 1 to 3 m ahead.
fn before_a_tag(stream: &mut Stream) -> Result<f64> {
    let camera = PinholeCamera::new(PinholeParams::default())?;
    let ahead = So3::from_roll_pitch_yaw(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 0.5), ahead);
    let place = Vector2::new(stream.random_range(1.7..3.7), stream.random_range(-1.0..1.0));
    let truth = Se2::new(place.x, place.y, (-place.y).atan2(5.0 - place.x) + stream.random_range(-0.1..0.1));
    let camera_from_map = (Se3::from(truth) * mount).inverse();
    let corners = [(-0.1, 0.4), (0.1, 0.4), (0.1, 0.6), (-0.1, 0.6)].map(|(y, z)| Vector3::new(5.0, y, z));
    let mut seen = Vec::new();
    for point in corners {
        let pixel = camera.project(&camera_from_map.act(&point)).ok_or("the tag is out of sight")?;
        seen.push(PixelOf { point, pixel: pixel + Vector2::new(normal(stream), normal(stream)) * PIXEL_SIGMA });
    }
    let found = resect(&camera, &mount, &seen, PIXEL_SIGMA)?;
    Ok((found.map_from_base.mean().translation() - truth.translation()).norm())
}

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}
