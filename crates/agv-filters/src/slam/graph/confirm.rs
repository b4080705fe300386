//! Which closures confirm each other: the largest set found of claims that all agree, of places that lie apart.

use super::closures::agree;
use agv_core::geometry::{PoseSigma, Se2};

/// Least way between key scans whose closures confirm each other, in metres: neighbours see the same and are deceived alike.
const APART: f64 = 1.0;

/// What a closure says.
#[derive(Debug, Clone, Copy)]
pub(super) struct Claim {
    /// Way at the key scan that was found, in metres.
    pub(super) way: f64,
    /// Where the last key scan would be.
    pub(super) pose: Se2,
}

/// Which of the `pending` claims are to be believed with a new one, all of which agree with it and with each other; none if fewer than
/// `confirmations` of them, with the new one, are of places apart.
///
/// Sets are gathered one by one, once from each pending claim, and the one with most places counts: O(n³) for n claims that wait.
pub(super) fn confirmed(new: Claim, pending: &[Claim], limit: PoseSigma, confirmations: usize) -> Option<Vec<usize>> {
    let fits = |claim: &Claim, set: &[usize]| {
        let mut all = set.iter().filter_map(|&i| pending.get(i)).chain([&new]);
        all.all(|other| agree(&other.pose, &claim.pose, limit))
    };
    let lies_apart = |claim: &Claim, set: &[usize]| {
        let mut all = set.iter().filter_map(|&i| pending.get(i)).chain([&new]);
        all.all(|other| (other.way - claim.way).abs() >= APART)
    };
    let mut best: Vec<usize> = Vec::new();
    for first in 0..pending.len() {
        let mut set = Vec::new();
        for (i, claim) in pending.iter().enumerate().cycle().skip(first).take(pending.len()) {
            if lies_apart(claim, &set) && fits(claim, &set) {
                set.push(i);
            }
        }
        if set.len() > best.len() {
            best = set;
        }
    }
    if best.len() + 1 < confirmations {
        return None;
    }
    // Neighbours of these that say the same come along.
    for (i, claim) in pending.iter().enumerate() {
        if !best.contains(&i) && fits(claim, &best) {
            best.push(i);
        }
    }
    best.sort_unstable();
    Some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: PoseSigma = PoseSigma { translation: 0.25, rotation: 0.1 };

    /// Ways and places along a line; what is believed with a claim of (10, 0) if three are asked for.
    fn of_three(pending: &[(f64, f64)]) -> Option<Vec<usize>> {
        let claim = |way, x| Claim { way, pose: Se2::new(x, 0.0, 0.0) };
        let pending: Vec<Claim> = pending.iter().map(|&(way, x)| claim(way, x)).collect();
        confirmed(claim(10.0, 0.0), &pending, LIMIT, 3)
    }

    #[test]
    fn all_that_are_believed_agree() {
        let (a, c, b) = ((9.0, 0.10), (8.0, 0.12), (7.0, -0.24));
        assert_eq!(of_three(&[a, c, b]), Some(vec![0, 1]), "the third agrees with the new one alone");
        assert_eq!(of_three(&[b, a, c]), Some(vec![1, 2]), "nor does it stand in the way");
        assert_eq!(of_three(&[a, b]), None);
        assert_eq!(of_three(&[]), None);
        // Further than the limit from the new one, or turned.
        assert_eq!(of_three(&[(9.0, 0.3), (8.0, 0.3)]), None);
        let turned = Claim { way: 9.0, pose: Se2::new(0.0, 0.0, 0.2) };
        let new = Claim { way: 10.0, pose: Se2::default() };
        assert_eq!(confirmed(new, &[turned], LIMIT, 2), None);
        assert_eq!(confirmed(new, &[], LIMIT, 1), Some(vec![]), "one is enough by itself if so asked");
    }

    #[test]
    fn a_place_counts_once() {
        assert_eq!(of_three(&[(9.0, 0.0), (9.0, 0.01)]), None, "two closures of one key scan");
        assert_eq!(of_three(&[(9.4, 0.0), (9.7, 0.0)]), None, "neighbours of the new one");
        assert_eq!(of_three(&[(8.7, 0.0), (9.0, 0.0)]), None, "neighbours of each other");
        // Where others confirm it, a neighbour comes along if it agrees with all.
        assert_eq!(of_three(&[(8.7, 0.0), (9.0, 0.0), (7.0, 0.1)]), Some(vec![0, 1, 2]));
        assert_eq!(of_three(&[(8.7, -0.2), (9.0, 0.0), (7.0, 0.1)]), Some(vec![1, 2]));
    }
}
