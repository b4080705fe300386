//! Transfer functions in `s`.

use crate::Error;
use agv_core::check;

/// Greatest degree of a [`TransferFunction`].
pub const MAX_ORDER: usize = 8;

/// A proper rational transfer function
///
/// ```text
/// G(s) = (b_m s^m + ... + b_0) / (s^n + a_{n-1} s^{n-1} + ... + a_0),      m <= n <= 8
/// ```
///
/// ```
/// use agv_control::plant::TransferFunction;
///
/// // (s + 2) / (s² + 3 s + 4): coefficients as they are written, highest power first.
/// let g = TransferFunction::new(&[1.0, 2.0], &[1.0, 3.0, 4.0])?;
/// assert_eq!(g.order(), 2);
/// assert_eq!(g.dc_gain(), 0.5);
/// assert!(TransferFunction::new(&[1.0, 0.0, 0.0], &[1.0, 1.0]).is_err(), "improper");
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransferFunction {
    order: usize,
    /// `b_i`, lowest power first.
    numerator: [f64; MAX_ORDER + 1],
    /// `a_i`, lowest power first; `a_n` is one, what follows zero.
    denominator: [f64; MAX_ORDER + 1],
}

impl TransferFunction {
    /// From the coefficients, highest power first; leading zeros do not count.
    ///
    /// # Errors
    /// A coefficient that is not finite, an empty or zero denominator, an improper fraction, or one of more than
    /// [`MAX_ORDER`].
    pub fn new(numerator: &[f64], denominator: &[f64]) -> Result<Self, Error> {
        check::all_finite("numerator", numerator)?;
        check::all_finite("denominator", denominator)?;
        let trimmed = |all: &'_ [f64]| all.iter().position(|&c| c != 0.0).unwrap_or(all.len());
        let numerator = numerator.get(trimmed(numerator)..).unwrap_or_default();
        let denominator = denominator.get(trimmed(denominator)..).unwrap_or_default();
        let Some(&leading) = denominator.first() else {
            return Err(agv_core::Error::Empty { name: "denominator" }.into());
        };
        if numerator.len() > denominator.len() {
            return Err(Error::Improper { numerator: numerator.len() - 1, denominator: denominator.len() - 1 });
        }
        let order = denominator.len() - 1;
        if order > MAX_ORDER {
            return Err(agv_core::Error::TooMany { name: "denominator", len: order + 1, max: MAX_ORDER + 1 }.into());
        }
        let monic = |coefficients: &[f64]| {
            let mut ascending = [0.0; MAX_ORDER + 1];
            for (slot, c) in ascending.iter_mut().zip(coefficients.iter().rev()) {
                *slot = c / leading;
            }
            ascending
        };
        let g = Self { order, numerator: monic(numerator), denominator: monic(denominator) };
        if g.numerator.iter().chain(&g.denominator).all(|c| c.is_finite()) {
            Ok(g)
        } else {
            Err(Error::Overflow { name: "coefficient" })
        }
    }

    /// Degree of the denominator, the number of states.
    pub const fn order(&self) -> usize {
        self.order
    }

    /// `b_0` to `b_n`, lowest power first, of the fraction whose denominator is monic.
    pub fn numerator(&self) -> &[f64] {
        self.numerator.get(..=self.order).unwrap_or_default()
    }

    /// `a_0` to `a_n = 1`, lowest power first.
    pub fn denominator(&self) -> &[f64] {
        self.denominator.get(..=self.order).unwrap_or_default()
    }

    /// `G(0)`: what the output settles at under a unit input, if the plant is stable; infinite for an integrator.
    pub fn dc_gain(&self) -> f64 {
        self.numerator[0] / self.denominator[0]
    }
}
