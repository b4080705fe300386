//! Dead reckoning and ranges to radio beacons, each with its own clock ticks.

use super::{LandmarkLog, LandmarkStep, Seen, SeenAs};
use crate::{Error, Input, fields::Fields};
use agv_core::{
    geometry::{LieGroup, Se2},
    nalgebra::{Matrix3, Vector3},
    time::Stamp,
};

/// Reads `time distance turn` (motion since the line before, in metres and radians) and `time sender beacon range`. There is a step for
/// each line of either; a motion that a range falls into is divided by time. Ranges before the first motion are of the start.
///
/// # Errors
/// The first line that is not what it should be, or motions whose times run backwards.
pub fn read_ranges(dead_reckoning: &Input, ranges: &Input) -> Result<LandmarkLog, Error> {
    let motions = rows(dead_reckoning, ["time", "distance", "turn"])?;
    let mut readings = rows(ranges, ["time", "sender", "beacon", "range"])?;
    if let Some(pair) = motions.windows(2).find(|pair| pair[1].1[0] < pair[0].1[0]) {
        return Err(dead_reckoning.line_error(pair[1].0, "time runs backwards"));
    }
    readings.sort_by(|a, b| a.1[0].total_cmp(&b.1[0]));
    let mut log = LandmarkLog::default();
    let Some(first) = motions.first() else { return Ok(log) };
    let mut now = first.1[0];
    let mut next = readings.iter().peekable();
    let last = motions.len() - 1;
    for (i, (_, [end, distance, turn])) in motions.iter().enumerate() {
        let (start, mut gone) = (now, 0.0);
        let (way, length) = (Vector3::new(*distance, 0.0, *turn), end - start);
        let mut push = |time: f64, seen: Vec<Seen>| {
            let share = if length > 0.0 { ((time - start) / length).clamp(0.0, 1.0) } else { 1.0 };
            let motion = Se2::exp(&(way * (share - gone)));
            gone = share;
            log.steps.push(LandmarkStep {
                stamp: Stamp::from_seconds(time),
                motion,
                covariance: Matrix3::zeros(),
                seen,
            });
        };
        while let Some((number, [time, _, beacon, range])) = next.next_if(|row| row.1[0] <= *end || i == last) {
            let id = beacon_number(ranges, *number, *beacon)?;
            if *range < 0.0 {
                return Err(ranges.line_error(*number, "a range below zero"));
            }
            push(time.clamp(start, *end), vec![Seen { id: Some(id), measured: SeenAs::Range(*range) }]);
        }
        push(*end, Vec::new());
        now = *end;
    }
    Ok(log)
}

fn beacon_number(input: &Input, line: usize, beacon: f64) -> Result<u32, Error> {
    if beacon.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&beacon) {
        return Ok(beacon as u32);
    }
    Err(input.line_error(line, "the beacon's number is none"))
}

fn rows<const N: usize>(input: &Input, names: [&str; N]) -> Result<Vec<(usize, [f64; N])>, Error> {
    let row = |line: Result<(usize, &str), Error>| {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        let row = fields.finite_array(names)?;
        fields.end()?;
        Ok((number, row))
    };
    input.data_lines().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_are_divided_where_ranges_fall() {
        let motions = Input::new("d", "1 0 0\n2 1.0 0.5\n3 2.0 0\n");
        let ranges = Input::new("t", "0.5 2 7 3.5\n1.25 2 7 4.5\n9 2 8 5.5\n");
        let log = read_ranges(&motions, &ranges).unwrap();
        let at: Vec<_> = log.steps.iter().map(|step| step.stamp.seconds()).collect();
        assert_eq!(at, [1.0, 1.0, 1.25, 2.0, 3.0, 3.0]);
        assert_eq!(log.steps.iter().filter(|step| !step.seen.is_empty()).count(), 3);
        let way = log.steps.iter().fold(Se2::default(), |pose, step| pose.compose(&step.motion));
        let whole = Se2::exp(&Vector3::new(1.0, 0.0, 0.5)).compose(&Se2::new(2.0, 0.0, 0.0));
        assert!(way.minus(&whole).norm() < 1e-12);
        assert!((log.steps[2].motion.minus(&Se2::exp(&Vector3::new(0.25, 0.0, 0.125)))).norm() < 1e-12);
    }

    #[test]
    fn faults_are_named() {
        let good = Input::new("d", "1 0 0\n2 1 0\n");
        let error = |text: &str| read_ranges(&good, &Input::new("t", text)).unwrap_err().to_string();
        assert!(error("1 2 7.5 1").contains("t:1"));
        assert!(error("1 2 7 -1").contains("below zero"));
        let back = read_ranges(&Input::new("d", "2 0 0\n1 0 0\n"), &Input::new("t", "")).unwrap_err();
        assert!(back.to_string().contains("backwards"));
    }
}
