use super::*;
use agv_core::compute::Seed;
use agv_core::geometry::LieGroup;
use proptest::prelude::*;
use rand_distr::{Distribution, StandardNormal};

fn library() -> TemplateLibrary {
    TemplateLibrary::new(nine_codes(10, 0.3), TemplateParams::default()).unwrap()
}

/// These codes in the frame of a vehicle that stands at `library_from_vehicle`.
fn seen(library_from_vehicle: &Se2, ids: &[u32]) -> Vec<SightedCode> {
    let place = |id: &u32| library_from_vehicle.inverse() * library().place(*id).unwrap();
    ids.iter().map(|id| SightedCode { place: place(id), id: None }).collect()
}

fn identified(outcome: TemplateMatch) -> Identification {
    let TemplateMatch::Identified(found) = outcome else { panic!("{outcome:?}") };
    found
}

#[test]
fn nine_codes_have_84_triangles_that_differ() {
    let wide = TemplateParams { longest_side: 10.0, ..Default::default() };
    let library = TemplateLibrary::new(nine_codes(0, 1.0), wide).unwrap();
    assert_eq!(library.triangles(), 84);
    assert!((library.separation() - 0.1432).abs() < 1e-4, "{}", library.separation());
    // 9 codes: the default tolerances leave no two triangles alike at a pitch of 0.3 m.
    assert!(self::library().separation() > 4.0 * TemplateParams::default().tolerance);
}

proptest! {
    /// Any three or more codes, none of them read, in any order and from any side.
    #[test]
    fn codes_are_known_by_their_triangles(
        (x, y, yaw) in (-1.0..1.0_f64, -1.0..1.0_f64, -3.1..3.1_f64),
        ids in prop::sample::subsequence((10..19_u32).collect::<Vec<_>>(), 3..=9).prop_shuffle(),
    ) {
        let truth = Se2::new(x, y, yaw);
        // Three points that are nearly on a line are no triangle, and nothing is claimed of them.
        prop_assume!(ids.len() > 3 || library().identify(&seen(&truth, &ids)) != TemplateMatch::Unmatched);
        let found = identified(library().identify(&seen(&truth, &ids)));
        prop_assert_eq!(found.ids[..ids.len()].to_vec(), ids.iter().copied().map(Some).collect::<Vec<_>>());
        prop_assert!(found.library_from_sighted.mean().minus(&truth).norm() < 1e-9 && found.explained == ids.len());
    }

    /// A mirror image of the codes is not the codes.
    #[test]
    fn reflections_are_not_known(ids in prop::sample::subsequence((10..19_u32).collect::<Vec<_>>(), 4..=9)) {
        let mut mirrored = seen(&Se2::new(0.2, 0.1, 0.7), &ids);
        for code in &mut mirrored {
            code.place.y = -code.place.y;
        }
        if let TemplateMatch::Identified(found) = library().identify(&mirrored) {
            prop_assert!(found.explained < ids.len(), "{found:?}");
        }
    }
}

/// Every triple is either known right or not known, under noise of the stated size; NEES and residuals over all of them are
/// chi-square within 4.5 deviations.
#[test]
fn noise_leads_to_no_wrong_number() {
    let (library, mut stream) = (library(), Seed(8).stream(0, 0));
    let (truth, mut wrong, mut unknown, mut nees, mut residuals) = (Se2::new(0.2, -0.1, 2.0), 0, 0, 0.0, 0.0);
    let mut right = 0_u32;
    for _ in 0..20 {
        for (i, j, k) in (10..19).flat_map(|i| (i + 1..19).flat_map(move |j| (j + 1..19).map(move |k| (i, j, k)))) {
            let mut noisy = seen(&truth, &[i, j, k]);
            for code in &mut noisy {
                code.place += Vector2::from_fn(|_, _| {
                    let z: f64 = StandardNormal.sample(&mut stream);
                    0.002 * z
                });
            }
            match library.identify(&noisy) {
                TemplateMatch::Identified(found) if found.ids[..3] == [Some(i), Some(j), Some(k)] => {
                    right += 1;
                    let error = found.library_from_sighted.mean().minus(&truth);
                    let information = Se2::inverse_of(found.library_from_sighted.covariance()).unwrap();
                    nees += error.dot(&(information * error));
                    residuals += found.chi_square;
                }
                TemplateMatch::Identified(_) => wrong += 1,
                _ => unknown += 1,
            }
        }
    }
    // Those that are too thin to be told apart, and the few whose noise passes four deviations.
    let thin = 20 * (84 - library.triangles());
    assert!(wrong == 0 && unknown < thin + 40, "{wrong} {unknown} {thin}");
    let n = f64::from(right);
    assert!((nees - 3.0 * n).abs() < 4.5 * (6.0 * n).sqrt(), "{} {n}", nees / n);
    assert!((residuals - 3.0 * n).abs() < 4.5 * (6.0 * n).sqrt(), "{} {n}", residuals / n);
}

#[test]
fn damaged_missing_and_foreign_codes_are_coped_with() {
    let (library, truth) = (library(), Se2::new(0.2, -0.1, 2.0));
    // Two cannot be read, three were read, one thing is no code, one place is not a number.
    let mut sighted = seen(&truth, &[11, 14, 16, 17, 12]);
    sighted[2].id = Some(16);
    sighted[3].id = Some(17);
    sighted[4].id = Some(12);
    sighted.push(SightedCode { place: Vector2::new(0.05, 0.9), id: None });
    sighted.push(SightedCode { place: Vector2::repeat(f64::NAN), id: None });
    let found = identified(library.identify(&sighted));
    assert_eq!(found.ids[..7], [Some(11), Some(14), Some(16), Some(17), Some(12), None, None]);
    // A number that was read and contradicts the pattern: nothing is believed.
    sighted[2].id = Some(13);
    assert_eq!(library.identify(&sighted), TemplateMatch::Unmatched);
    // A number of another library does not matter.
    sighted[2].id = Some(99);
    assert_eq!(identified(library.identify(&sighted)).ids[2], Some(16));
}

#[test]
fn a_lattice_is_ambiguous_and_said_to_be() {
    let lattice = (0..9_u32).map(|i| (i, Vector2::new(f64::from(i % 3), f64::from(i / 3)) * 0.3));
    let library = TemplateLibrary::new(lattice, TemplateParams::default()).unwrap();
    assert!(library.separation() < 1e-9);
    let corner = [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)].map(|(x, y)| SightedCode { place: Vector2::new(x, y), id: None });
    assert_eq!(library.identify(&corner), TemplateMatch::Ambiguous { explained: 3 });
    // Two numbers that were read settle it.
    let mut read = corner;
    (read[0].id, read[1].id) = (Some(4), Some(5));
    assert_eq!(identified(library.identify(&read)).ids[..3], [Some(4), Some(5), Some(7)]);
}

#[test]
fn too_few_or_bad_codes_are_refused() {
    let library = library();
    assert_eq!(library.identify(&[]), TemplateMatch::Unmatched);
    assert_eq!(library.identify(&seen(&Se2::default(), &[10, 11])), TemplateMatch::Unmatched);
    let good = TemplateParams::default();
    for bad in [
        TemplateParams { place_sigma: 0.0, ..good },
        TemplateParams { tolerance: 0.001, ..good },
        TemplateParams { tolerance: f64::NAN, ..good },
        TemplateParams { longest_side: 0.0, ..good },
    ] {
        assert!(TemplateLibrary::new(nine_codes(0, 0.3), bad).is_err(), "{bad:?}");
    }
    let place = Vector2::new(1.0, 1.0);
    assert!(matches!(TemplateLibrary::new([(0, place), (1, place)], good), Err(Error::TooFew { .. })));
    assert!(matches!(TemplateLibrary::new((0..999).map(|i| (i, place)), good), Err(Error::TooMany { .. })));
    assert!(matches!(TemplateLibrary::new([(0, place), (1, place), (0, place)], good), Err(Error::OutOfRange { .. })));
    let nan = Vector2::repeat(f64::NAN);
    assert!(matches!(TemplateLibrary::new([(0, place), (1, place), (2, nan)], good), Err(Error::NotFinite { .. })));
    // Three codes at one place have no triangle.
    assert_eq!(TemplateLibrary::new([(0, place), (1, place), (2, place)], good).unwrap().triangles(), 0);
    for pitch in [f64::NAN, 0.0] {
        assert!(TemplateLibrary::new(nine_codes(0, pitch), good).map_or(true, |library| library.triangles() == 0));
    }
}
