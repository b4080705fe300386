//! How the beams of a scan go together, for every model that judges them one by one.

use agv_core::{Error, check};

/// How the beams of a scan make one likelihood.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum ScanForm {
    /// The product of the beams' likelihoods, as if `independent_beams` of them were independent and the others repeated
    /// what those say.
    ///
    /// With all beams taken for independent (`likelihood_field_prob` of `nav2_amcl` and Beluga) the filter becomes
    /// overconfident, the more so the denser the scanner: neighbouring beams hit the same wall and share the map's error
    /// (Thrun, Burgard and Fox, *Probabilistic Robotics*, section 6.3.4, who take `p^α` with α < 1 for it). Of `n`
    /// readings whose errors are correlated, the mean has the variance of `n / (1 + 2 Σ ρ_k)` independent ones (Thiébaux
    /// and Zwiers 1984), a number that levels off as the beams get denser: it is a property of the place and of the map,
    /// not of the scanner.
    Product {
        /// As how many independent beams a scan counts; a scan with fewer usable beams counts as what it has.
        independent_beams: f64,
    },
    /// One plus the sum of the cubes (`likelihood_field` of `nav2_amcl` and Beluga): without a derivation, blunt, and
    /// hard to lose.
    SumOfCubes,
}

impl ScanForm {
    /// # Errors
    /// A number of independent beams that is not finite and positive.
    pub(super) fn validate(self) -> Result<(), Error> {
        if let Self::Product { independent_beams } = self {
            check::positive("independent_beams", independent_beams)?;
        }
        Ok(())
    }

    /// What the sum of the logarithms of so many beams is multiplied by; one where no logarithms are summed.
    pub(super) fn power(self, beams: usize) -> f64 {
        match self {
            Self::Product { independent_beams } => (independent_beams / beams.max(1) as f64).min(1.0),
            Self::SumOfCubes => 1.0,
        }
    }

    /// As how many independent readings a scan of so many beams counts.
    pub(super) fn independent_readings(self, beams: usize) -> f64 {
        match self {
            Self::Product { independent_beams } => independent_beams.min(beams.max(1) as f64),
            Self::SumOfCubes => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_counts_as_what_its_power_leaves_of_it() {
        let product = ScanForm::Product { independent_beams: 18.0 };
        for beams in [1, 6, 18, 60, 1081] {
            let counted = product.power(beams) * beams as f64;
            assert!((product.independent_readings(beams) - counted).abs() < 1e-12, "{beams}");
        }
        // No beams at all still leave a number to divide by.
        assert_eq!(product.independent_readings(0), 1.0);
        assert_eq!((ScanForm::SumOfCubes.power(60), ScanForm::SumOfCubes.independent_readings(60)), (1.0, 1.0));
    }
}
