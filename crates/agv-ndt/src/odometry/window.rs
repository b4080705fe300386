//! When a map that slides with the vehicle forgets what lies behind.

use nalgebra::Vector3;

/// How far the vehicle goes before the map forgets, as a share of its radius: forgetting looks at the whole map.
const SLIDE: f64 = 0.1;

/// The ball around a vehicle in which a map is kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Window {
    center: Vector3<f64>,
    radius: f64,
}

impl Window {
    /// Around the origin.
    pub(crate) fn new(radius: f64) -> Self {
        Self { center: Vector3::zeros(), radius }
    }

    /// Where the vehicle was when the map last forgot.
    pub(crate) const fn center(&self) -> Vector3<f64> {
        self.center
    }

    /// Goes back to the origin, as when the map is emptied.
    pub(crate) fn recenter(&mut self) {
        self.center = Vector3::zeros();
    }

    /// Follows the vehicle if it has gone far enough, and says so: what is farther than the radius from here may then be forgotten.
    pub(crate) fn slides(&mut self, here: &Vector3<f64>) -> Option<f64> {
        let far = (here - self.center).norm() > SLIDE * self.radius;
        if far {
            self.center = *here;
        }
        far.then_some(self.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_slides_after_a_tenth_of_its_radius() {
        let mut window = Window::new(50.0);
        assert_eq!(window.slides(&Vector3::new(4.9, 0.0, 0.0)), None);
        assert_eq!(window.center(), Vector3::zeros());
        let here = Vector3::new(0.0, 5.1, 0.0);
        assert_eq!(window.slides(&here), Some(50.0));
        assert_eq!((window.center(), window.slides(&here)), (here, None));
        window.recenter();
        assert_eq!(window, Window::new(50.0));
    }
}
