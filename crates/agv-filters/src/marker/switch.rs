//! When to drive by the laser, and when by the codes (paper 001, section 3.1, Fig. 11).
//!
//! ```text
//!            a code is near, or one is seen            seen often enough
//!   Laser  -------------------------------> Searching -------------------> Code
//!     ^                                     |       ^                       |
//!     |      the code is left behind        |       |  not seen for long,   |
//!     +-------------------------------------+       +------ one is near ----+
//!     +------------------ not seen for long, none is near -----------------+
//! ```
//!
//! Each threshold is a pair, so that a vehicle at the edge of a code does not switch to and fro.

use agv_core::{Error, check};

/// Parameters of a [`SourceSwitch`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SourceSwitchParams {
    /// Distance to the nearest code, by the estimate, from which on it is looked for, in metres.
    pub search_radius: f64,
    /// Distance beyond which it is given up, in metres; at least the search radius.
    pub leave_radius: f64,
    /// Images in a row that must show a code before it is driven by.
    pub confirmations: u32,
    /// How far is driven by odometry alone after the last code was seen, in metres.
    pub hold_distance: f64,
}

impl Default for SourceSwitchParams {
    /// A laser's estimate errs by less than half a metre; two images in a row are no stray reading; over 0.3 m odometry errs by
    /// millimetres, as codes do.
    fn default() -> Self {
        Self { search_radius: 0.5, leave_radius: 0.75, confirmations: 2, hold_distance: 0.3 }
    }
}

/// By what the vehicle drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PoseSource {
    /// By the laser, with the scanner of codes at rest.
    #[default]
    Laser,
    /// By the laser, looking for a code.
    Searching,
    /// By codes, and by odometry between them.
    Code,
}

/// What is known since the last image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SwitchInput {
    /// Distance to the nearest code by the estimate, in metres; none if no code is known.
    pub distance_to_code: Option<f64>,
    /// Whether the image shows a code that gives a pose.
    pub code_seen: bool,
    /// Distance driven since the image before, in metres.
    pub travelled: f64,
}

/// Decides by what the vehicle drives, image by image.
///
/// ```
/// use agv_filters::marker::{PoseSource, SourceSwitch, SourceSwitchParams, SwitchInput};
///
/// let mut switch = SourceSwitch::new(SourceSwitchParams::default())?;
/// let mut image = |distance, code_seen| {
///     switch.update(&SwitchInput { distance_to_code: Some(distance), code_seen, travelled: 0.05 })
/// };
/// assert_eq!(image(2.0, false)?, PoseSource::Laser);
/// assert_eq!(image(0.4, false)?, PoseSource::Searching);
/// assert_eq!(image(0.1, true)?, PoseSource::Searching);
/// assert_eq!(image(0.05, true)?, PoseSource::Code);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSwitch"))]
pub struct SourceSwitch {
    params: SourceSwitchParams,
    source: PoseSource,
    /// Images in a row that show a code.
    in_a_row: u32,
    /// Distance driven since one was seen, in metres.
    since_seen: f64,
}

/// A switch as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSwitch {
    params: SourceSwitchParams,
    source: PoseSource,
    in_a_row: u32,
    since_seen: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawSwitch> for SourceSwitch {
    type Error = Error;

    fn try_from(RawSwitch { params, source, in_a_row, since_seen }: RawSwitch) -> Result<Self, Error> {
        check::non_negative("since_seen", since_seen)?;
        Ok(Self { source, in_a_row, since_seen, ..Self::new(params)? })
    }
}

impl SourceSwitch {
    /// A switch that starts with the laser.
    ///
    /// # Errors
    /// A distance that is negative or not finite, a leave radius below the search radius, or no confirmation.
    pub fn new(params: SourceSwitchParams) -> Result<Self, Error> {
        check::non_negative("search_radius", params.search_radius)?;
        check::in_range("leave_radius", params.leave_radius, params.search_radius, f64::MAX)?;
        check::at_least("confirmations", params.confirmations as usize, 1)?;
        check::non_negative("hold_distance", params.hold_distance)?;
        Ok(Self { params, source: PoseSource::Laser, in_a_row: 0, since_seen: 0.0 })
    }

    /// By what the vehicle drives.
    pub const fn source(&self) -> PoseSource {
        self.source
    }

    /// Back to the laser: after a kidnapping, or when the map of codes changes.
    pub const fn reset(&mut self) {
        (self.source, self.in_a_row, self.since_seen) = (PoseSource::Laser, 0, 0.0);
    }

    /// Takes in what an image shows.
    ///
    /// # Errors
    /// A distance that is negative or not finite; the switch is as it was.
    pub fn update(&mut self, input: &SwitchInput) -> Result<PoseSource, Error> {
        check::non_negative("travelled", input.travelled)?;
        if let Some(distance) = input.distance_to_code {
            check::non_negative("distance_to_code", distance)?;
        }
        let within = |radius: f64| input.distance_to_code.is_some_and(|distance| distance <= radius);
        (self.in_a_row, self.since_seen) = if input.code_seen {
            (self.in_a_row.saturating_add(1), 0.0)
        } else {
            (0, self.since_seen + input.travelled)
        };
        let (is_confirmed, near) = (self.in_a_row >= self.params.confirmations, within(self.params.leave_radius));
        self.source = match self.source {
            PoseSource::Code if self.since_seen <= self.params.hold_distance => PoseSource::Code,
            _ if is_confirmed => PoseSource::Code,
            PoseSource::Laser if input.code_seen || within(self.params.search_radius) => PoseSource::Searching,
            PoseSource::Searching | PoseSource::Code if input.code_seen || near => PoseSource::Searching,
            _ => PoseSource::Laser,
        };
        Ok(self.source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use PoseSource::{Code, Laser, Searching};

    fn drive(switch: &mut SourceSwitch, distance: f64, code_seen: bool, travelled: f64) -> PoseSource {
        switch.update(&SwitchInput { distance_to_code: Some(distance), code_seen, travelled }).unwrap()
    }

    /// Past a code at x = 2 m that is seen within 0.15 m, in steps of 1 cm.
    #[test]
    fn a_pass_over_a_code_switches_once_each_way() {
        let mut switch = SourceSwitch::new(SourceSwitchParams::default()).unwrap();
        let mut sources = vec![];
        for step in 0..400 {
            let x = 0.01 * f64::from(step);
            let distance = (x - 2.0).abs();
            sources.push((drive(&mut switch, distance, distance <= 0.15, 0.01), x));
        }
        sources.dedup_by_key(|(source, _)| *source);
        let changes: Vec<_> = sources.iter().map(|&(source, _)| source).collect();
        assert_eq!(changes, [Laser, Searching, Code, Searching, Laser]);
        // Search from 0.5 m before, codes from the second image on, held for 0.3 m, given up 0.75 m behind.
        for ((_, x), expected) in sources[1..].iter().zip([1.5, 1.86, 2.46, 2.76]) {
            assert!((x - expected).abs() < 0.011, "{x} {expected}");
        }
    }

    #[test]
    fn flickering_does_not_switch_to_and_fro() {
        let mut switch = SourceSwitch::new(SourceSwitchParams::default()).unwrap();
        drive(&mut switch, 0.1, true, 0.0);
        assert_eq!(drive(&mut switch, 0.1, true, 0.0), PoseSource::Code);
        for image in 0..50 {
            assert_eq!(drive(&mut switch, 0.14, image % 3 == 0, 0.01), PoseSource::Code);
        }
        // At the edge of the search radius.
        switch.reset();
        assert_eq!(drive(&mut switch, 0.5, false, 0.0), PoseSource::Searching);
        for image in 0..50 {
            let distance = if image % 2 == 0 { 0.49 } else { 0.6 };
            assert_eq!(drive(&mut switch, distance, false, 0.0), PoseSource::Searching);
        }
    }

    /// Where the estimate is wrong, codes are still taken: that is how a kidnapped vehicle finds itself.
    #[test]
    fn a_code_that_was_not_expected_counts() {
        let mut switch = SourceSwitch::new(SourceSwitchParams::default()).unwrap();
        assert_eq!(drive(&mut switch, 9.0, true, 0.1), PoseSource::Searching);
        assert_eq!(drive(&mut switch, 9.0, true, 0.1), PoseSource::Code);
        assert_eq!(drive(&mut switch, 9.0, false, 0.4), PoseSource::Laser);
        let unknown = SwitchInput { distance_to_code: None, code_seen: false, travelled: 0.1 };
        assert_eq!(switch.update(&unknown), Ok(PoseSource::Laser));
    }

    #[test]
    fn bad_parameters_and_inputs_are_refused() {
        let good = SourceSwitchParams::default();
        for bad in [
            SourceSwitchParams { search_radius: -1.0, ..good },
            SourceSwitchParams { leave_radius: 0.1, ..good },
            SourceSwitchParams { leave_radius: f64::NAN, ..good },
            SourceSwitchParams { confirmations: 0, ..good },
            SourceSwitchParams { hold_distance: f64::INFINITY, ..good },
        ] {
            assert!(SourceSwitch::new(bad).is_err(), "{bad:?}");
        }
        let mut switch = SourceSwitch::new(good).unwrap();
        let before = switch;
        for (distance, travelled) in [(f64::NAN, 0.1), (-1.0, 0.1), (1.0, f64::NAN), (1.0, -0.1)] {
            let input = SwitchInput { distance_to_code: Some(distance), code_seen: true, travelled };
            assert!(switch.update(&input).is_err());
            assert_eq!(switch, before);
        }
    }
}
