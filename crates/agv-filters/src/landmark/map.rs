//! Where the landmarks are.

use agv_core::{Error, check};
use nalgebra::Vector2;

/// Landmarks with their numbers and places, found by number in logarithmic time.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_filters::landmark::LandmarkMap;
///
/// let map = LandmarkMap::new([(7, Vector2::new(1.0, 2.0)), (3, Vector2::new(-4.0, 0.5))])?;
/// assert_eq!(map.position(3), Some(Vector2::new(-4.0, 0.5)));
/// assert_eq!(map.position(4), None);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "Vec<(u32, Vector2<f64>)>", into = "Vec<(u32, Vector2<f64>)>")
)]
pub struct LandmarkMap {
    /// In the order of their numbers.
    landmarks: Vec<(u32, Vector2<f64>)>,
}

impl LandmarkMap {
    /// Landmarks by number and place in the map, in metres.
    ///
    /// # Errors
    /// [`Error::Empty`]; [`Error::NotFinite`] for a place; [`Error::OutOfRange`] for a number that is given twice.
    pub fn new(landmarks: impl IntoIterator<Item = (u32, Vector2<f64>)>) -> Result<Self, Error> {
        let mut landmarks: Vec<_> = landmarks.into_iter().collect();
        if landmarks.is_empty() {
            return Err(Error::Empty { name: "landmarks" });
        }
        for (_, place) in &landmarks {
            check::all_finite("landmark", place.iter())?;
        }
        landmarks.sort_by_key(|&(id, _)| id);
        for pair in landmarks.windows(2) {
            if let [(first, _), (second, _)] = pair {
                let least = f64::from(*first) + 1.0;
                check::in_range("number of the next landmark", f64::from(*second), least, f64::from(u32::MAX))?;
            }
        }
        Ok(Self { landmarks })
    }

    /// Place of a landmark, in metres.
    pub fn position(&self, id: u32) -> Option<Vector2<f64>> {
        let index = self.landmarks.binary_search_by_key(&id, |&(id, _)| id).ok()?;
        self.landmarks.get(index).map(|&(_, place)| place)
    }

    /// Landmarks by number and place, in the order of their numbers.
    pub fn landmarks(&self) -> &[(u32, Vector2<f64>)] {
        &self.landmarks
    }
}

impl TryFrom<Vec<(u32, Vector2<f64>)>> for LandmarkMap {
    type Error = Error;

    fn try_from(landmarks: Vec<(u32, Vector2<f64>)>) -> Result<Self, Error> {
        Self::new(landmarks)
    }
}

impl From<LandmarkMap> for Vec<(u32, Vector2<f64>)> {
    fn from(map: LandmarkMap) -> Self {
        map.landmarks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_maps_are_refused() {
        let at = |x| Vector2::new(x, 0.0);
        assert_eq!(LandmarkMap::new([]), Err(Error::Empty { name: "landmarks" }));
        assert!(LandmarkMap::new([(1, at(f64::NAN))]).is_err());
        assert!(LandmarkMap::new([(1, at(0.0)), (2, at(1.0)), (1, at(2.0))]).is_err());
        assert!(LandmarkMap::new([(u32::MAX, at(0.0)), (0, at(1.0))]).is_ok());
    }
}
