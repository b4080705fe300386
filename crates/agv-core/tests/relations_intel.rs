//! The relations metric against figures that were measured independently, on the Intel Research Lab log.
//!
//! The data are not part of the repository: they are looked for beside it, and the test says so where they are not.

use agv_core::geometry::Se2;
use agv_core::metrics::{Relation, RelationErrors, relation_errors};
use agv_core::time::Stamp;
use std::{io::Read, path::PathBuf};

fn read(name: &str) -> Option<String> {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "../../../shared/data/localization", name].iter().collect();
    let mut text = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).ok()?).read_to_string(&mut text).ok()?;
    Some(text)
}

/// A stamp from decimal seconds, to the microsecond that the log has: as `f64` it would lose some.
fn stamp(text: &str) -> Stamp {
    let (whole, fraction) = text.split_once('.').unwrap();
    let microseconds: i64 = format!("{fraction:0<6}")[..6].parse().unwrap();
    Stamp::from_nanoseconds(whole.parse::<i64>().unwrap() * 1_000_000_000 + microseconds * 1000)
}

fn trajectory(csv: &str) -> Vec<(Stamp, Se2)> {
    let pose = |line: &str| {
        let fields: Vec<&str> = line.splitn(5, ',').collect();
        let number = |i: usize| fields[i].parse::<f64>().unwrap();
        (stamp(fields[0]), Se2::new(number(1), number(2), number(3)))
    };
    csv.lines().skip(1).map(pose).collect()
}

fn relation(line: &str) -> Relation<Se2> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let number = |i: usize| fields[i].parse::<f64>().unwrap();
    Relation { from: stamp(fields[0]), to: stamp(fields[1]), from_from_to: Se2::new(number(2), number(3), number(7)) }
}

#[test]
fn intel_s_errors_are_the_known_ones() {
    let files =
        ["intel.relations.gz", "intel_scans.csv.gz", "intel_reference.csv.gz", "intel_relations_reference.csv.gz"];
    let Some(texts) = files.iter().map(|name| read(name)).collect::<Option<Vec<_>>>() else {
        println!("skipped: the Intel log is not beside the repository");
        return;
    };
    let relations: Vec<_> = texts[0].lines().filter(|l| !l.trim().is_empty()).map(relation).collect();
    let errors = |text: &str| -> RelationErrors { relation_errors(&trajectory(text), &relations, 0.0).unwrap() };
    // File, mean and standard deviation in metres, mean and standard deviation in degrees; as stated with the data.
    for (text, figures) in [
        (&texts[1], [7.37, 14.35, 39.2, 53.8]),
        (&texts[2], [0.028, 0.020, 1.05, 1.00]),
        (&texts[3], [0.017, f64::NAN, 0.20, f64::NAN]),
    ] {
        let found = errors(text);
        assert_eq!((found.translation.count(), found.missing), (2984, 0));
        let (t, r) = (&found.translation, &found.rotation);
        let measured = [t.mean(), t.standard_deviation(), r.mean().to_degrees(), r.standard_deviation().to_degrees()];
        println!("{measured:.4?}");
        for (measured, stated) in measured.iter().zip(figures) {
            // Stated to two or three figures; a NaN stands for one that is not stated.
            assert!(stated.is_nan() || (measured / stated - 1.0).abs() < 0.03, "{measured} {stated}");
        }
    }
}
