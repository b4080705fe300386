//! Codes and landmarks: from what a camera sees to a pose (paper 001, section 3).
//!
//! ```text
//! pixels of a code --FloorProjection, CodeReader--> base_from_code --+
//!     (not read) ---------------TemplateLibrary--> its number -------+--MarkerLocalizer--> PoseObservation --> Kalman filter
//!                                                    MarkerMap ------+
//! ranges --trilaterate--> position --heading_from_bearings--> pose
//! ranges and bearings ------------------pose_from_landmarks--> pose
//! ```
//!
//! - [`CodeReader`] locates floor codes in the image of a camera above a level floor ([`FloorProjection`]), and says how well.
//! - [`TemplateLibrary`] knows codes by the triangles that they form: those that are damaged, too.
//! - [`MarkerMap`] says where the codes lie, by plan or by survey; [`MarkerLocalizer`] makes a pose of an image's codes.
//! - [`trilaterate`], [`heading_from_bearings`] and [`pose_from_landmarks`] do so with landmarks.
//! - [`resect`] takes the pixels of any tags, on walls or ceilings as well, for a vehicle that stays on its floor.
//! - [`SourceSwitch`] says when to drive by the laser and when by the codes.
//!
//! Everything that has a pose has its covariance, propagated from the noise of the pixels or readings.

mod floor;
mod fuse;
mod heading;
mod landmark_fix;
mod localizer;
mod map;
mod reader;
mod resection;
mod rigid_fit;
mod switch;
mod template;
mod triangle;
mod trilateration;

pub use floor::{FloorProjection, looking_down};
pub use fuse::{FusedPose, fuse_poses, pose_distance};
pub use heading::{BearingTo, HeadingFix, heading_from_bearings};
pub use landmark_fix::{KnownLandmark, LandmarkFix, MOST_LANDMARKS, pose_from_landmarks};
pub use localizer::{MarkerFix, MarkerLocalizer, MarkerLocalizerParams};
pub use map::{MarkerMap, SurveyOutcome};
pub use reader::{CodeFit, CodeReader, CodeReaderParams, CodeRejection};
pub use resection::{PixelOf, Resection, resect};
pub use switch::{PoseSource, SourceSwitch, SourceSwitchParams, SwitchInput};
pub use template::{
    Identification, MOST_SIGHTED, SightedCode, TemplateLibrary, TemplateMatch, TemplateParams, nine_codes,
};
pub use trilateration::{PositionFix, RangeTo, intersect_circles, trilaterate};
