//! The six functions of the paper's section 5, and its tables of evaluations and steps.

use super::*;
use std::f64::consts::PI;

/// Value and slope.
type Function = fn(f64) -> (f64, f64);

/// Name, function, `μ`, `η`, and evaluations and step from each first step.
type Table = (&'static str, Function, f64, f64, [(usize, f64); 4]);

/// 5.1 with β = 2.
fn rational(a: f64) -> (f64, f64) {
    (-a / (a * a + 2.0), (a * a - 2.0) / (a * a + 2.0).powi(2))
}

/// 5.2 with β = 0.004.
fn quintic(a: f64) -> (f64, f64) {
    let t = a + 0.004;
    (t.powi(5) - 2.0 * t.powi(4), 5.0 * t.powi(4) - 8.0 * t.powi(3))
}

/// 5.3 with β = 0.01 and l = 39.
fn wavy(a: f64) -> (f64, f64) {
    let (beta, l) = (0.01, 39.0);
    let (value, slope) = if a <= 1.0 - beta {
        (1.0 - a, -1.0)
    } else if a >= 1.0 + beta {
        (a - 1.0, 1.0)
    } else {
        ((a - 1.0).powi(2) / (2.0 * beta) + 0.5 * beta, (a - 1.0) / beta)
    };
    let angle = 0.5 * l * PI * a;
    (value + 2.0 * (1.0 - beta) / (l * PI) * angle.sin(), slope + (1.0 - beta) * angle.cos())
}

/// 5.4.
fn yanai(a: f64, first: f64, second: f64) -> (f64, f64) {
    let gamma = |b: f64| (1.0 + b * b).sqrt() - b;
    let (left, right) = (((1.0 - a).powi(2) + second * second).sqrt(), (a * a + first * first).sqrt());
    (gamma(first) * left + gamma(second) * right, gamma(first) * (a - 1.0) / left + gamma(second) * a / right)
}

/// Tables I to VI: `μ`, `η`, and evaluations and step, printed to one or two digits, from each first step.
#[test]
fn the_published_tables_are_reproduced() {
    let tables: [Table; 6] = [
        ("I", rational, 0.001, 0.1, [(6, 1.4), (3, 1.4), (1, 10.0), (4, 37.0)]),
        ("II", quintic, 0.1, 0.1, [(12, 1.6), (8, 1.6), (8, 1.6), (11, 1.6)]),
        ("III", wavy, 0.1, 0.1, [(12, 1.0), (12, 1.0), (10, 1.0), (13, 1.0)]),
        ("IV", |a| yanai(a, 0.001, 0.001), 0.001, 0.001, [(4, 0.08), (1, 0.10), (3, 0.35), (4, 0.83)]),
        ("V", |a| yanai(a, 0.01, 0.001), 0.001, 0.001, [(6, 0.075), (3, 0.078), (7, 0.073), (8, 0.076)]),
        ("VI", |a| yanai(a, 0.001, 0.01), 0.001, 0.001, [(13, 0.93), (11, 0.93), (8, 0.92), (11, 0.92)]),
    ];
    for (name, function, sufficient_decrease, curvature, expected) in tables {
        let params = LineSearchParams {
            sufficient_decrease,
            curvature,
            interval_tolerance: 0.0,
            min_step: 0.0,
            max_step: 4e3,
            max_evaluations: 50,
        };
        let search = MoreThuente::new(params).unwrap();
        let at = |step: f64| {
            let (value, slope) = function(step);
            LinePoint { step, value, slope }
        };
        for (first, (evaluations, step)) in [1e-3, 1e-1, 1e1, 1e3].into_iter().zip(expected) {
            let (found, end, count) = search.search(&at(0.0), first, at);
            assert_eq!((end, count), (LineSearchEnd::Satisfied, evaluations), "table {name} from {first}: {found:?}");
            assert!((found.step - step).abs() < 0.07 * step, "table {name} from {first}: {found:?}");
        }
    }
}

#[test]
fn ends_are_told_apart() {
    let params = LineSearchParams { curvature: 0.1, max_step: 4.0, ..LineSearchParams::default() };
    let search = MoreThuente::new(params).unwrap();
    let along = |f: Function| move |step: f64| LinePoint { step, value: f(step).0, slope: f(step).1 };
    let end = |f: Function| search.search(&along(f)(0.0), 1.0, along(f)).1;
    assert_eq!(end(|a| (-a, -1.0)), LineSearchEnd::AtMaximum);
    assert_eq!(end(|a| (a, 1.0)), LineSearchEnd::NotDownhill);
    assert_eq!(end(|a| (if a > 0.0 { f64::NAN } else { 0.0 }, -1.0)), LineSearchEnd::NotDownhill);
    // A slope that lies: the value rises wherever one looks.
    assert!(matches!(
        end(|a| (a, -1.0)),
        LineSearchEnd::AtMinimum | LineSearchEnd::EvaluationLimit | LineSearchEnd::Narrow
    ));
}

#[test]
fn bad_parameters_are_named() {
    let good = LineSearchParams::default();
    for bad in [
        LineSearchParams { sufficient_decrease: 0.0, ..good },
        LineSearchParams { curvature: 1.0, ..good },
        LineSearchParams { interval_tolerance: -1.0, ..good },
        LineSearchParams { min_step: f64::NAN, ..good },
        LineSearchParams { min_step: 4.0, max_step: 4.0, ..good },
        LineSearchParams { max_step: f64::INFINITY, ..good },
        LineSearchParams { max_evaluations: 0, ..good },
    ] {
        assert!(MoreThuente::new(bad).is_err(), "{bad:?}");
    }
}
