//! What a spatial world is made of, with exact rays. All lengths in metres, in the map frame, z up.

use crate::Error;
use crate::bvh::{Bounds, Ray};
use crate::world2d::{Shape, rectangle_corners};
use agv_core::{check, geometry::Se2};
use nalgebra::{Vector2, Vector3};

/// A solid, or an infinite plane. Rays see surfaces from both sides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// An upright box, turned by `yaw` radians.
    Box {
        /// Its centre.
        center: Vector3<f64>,
        /// Edge lengths along its own x, y and z.
        size: Vector3<f64>,
        /// Rotation about z, in radians.
        yaw: f64,
    },
    /// An upright cylinder with its two caps.
    Cylinder {
        /// Centre of its lower cap.
        base: Vector3<f64>,
        /// Radius.
        radius: f64,
        /// Height.
        height: f64,
    },
    /// A wedge that rises from its foot along its own x axis.
    Ramp {
        /// Middle of the foot line, where the slope begins.
        foot: Vector3<f64>,
        /// Direction of the rise, in radians.
        yaw: f64,
        /// Horizontal length.
        length: f64,
        /// Width across.
        width: f64,
        /// Height at the upper end.
        height: f64,
    },
    /// An infinite plane: a floor or a roof.
    Plane {
        /// A point on it.
        point: Vector3<f64>,
        /// A direction square to it, of any length.
        normal: Vector3<f64>,
    },
}

impl Solid {
    /// The upright box between two opposite corners, in metres.
    pub fn block(min: Vector3<f64>, max: Vector3<f64>) -> Self {
        Self::Box { center: 0.5 * (min + max), size: max - min, yaw: 0.0 }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        match self {
            Self::Box { center, size, yaw } => {
                check::all_finite("box centre", center.iter())?;
                check::finite("box yaw", *yaw)?;
                size.iter().try_for_each(|&s| check::positive("box size", s).map(|_| ()))?;
            }
            Self::Cylinder { base, radius, height } => {
                check::all_finite("cylinder base", base.iter())?;
                check::positive("cylinder radius", *radius)?;
                check::positive("cylinder height", *height)?;
            }
            Self::Ramp { foot, yaw, length, width, height } => {
                check::all_finite("ramp foot", foot.iter())?;
                check::finite("ramp yaw", *yaw)?;
                check::positive("ramp length", *length)?;
                check::positive("ramp width", *width)?;
                check::positive("ramp height", *height)?;
            }
            Self::Plane { point, normal } => {
                check::all_finite("plane point", point.iter())?;
                check::positive("plane normal (length)", normal.norm())?;
            }
        }
        Ok(())
    }

    /// What of the solid lies between two heights, seen from above; none of a plane, or of a solid outside the band.
    pub(super) fn footprint(&self, z_min: f64, z_max: f64) -> Option<Shape> {
        let overlaps = |low: f64, high: f64| low <= z_max && high >= z_min;
        match *self {
            Self::Box { center, size, yaw } => overlaps(center.z - 0.5 * size.z, center.z + 0.5 * size.z)
                .then(|| Shape::rectangle(Se2::new(center.x, center.y, yaw), size.x, size.y)),
            Self::Cylinder { base, radius, height } => {
                overlaps(base.z, base.z + height).then_some(Shape::Circle { center: base.xy(), radius })
            }
            Self::Ramp { foot, yaw, length, width, height } => {
                // At height z the wedge is solid from x = z length / height on.
                let start = ((z_min - foot.z) * length / height).max(0.0);
                (overlaps(foot.z, foot.z + height) && start < length).then(|| {
                    let middle = Se2::new(foot.x, foot.y, yaw) * Vector2::new(0.5 * (start + length), 0.0);
                    Shape::rectangle(Se2::new(middle.x, middle.y, yaw), length - start, width)
                })
            }
            Self::Plane { .. } => None,
        }
    }
}

/// A solid prepared for rays.
#[derive(Debug, Clone, Copy)]
pub(super) enum Primitive {
    Block { min: Vector3<f64>, max: Vector3<f64> },
    Turned { center: Vector3<f64>, half: Vector3<f64>, cos: f64, sin: f64 },
    Cylinder { base: Vector3<f64>, radius: f64, height: f64 },
    Ramp { foot: Vector3<f64>, cos: f64, sin: f64, length: f64, half_width: f64, height: f64 },
}

/// The vector in a frame turned by the angle with this cosine and sine.
#[inline]
fn unturn(v: &Vector3<f64>, cos: f64, sin: f64) -> Vector3<f64> {
    Vector3::new(cos * v.x + sin * v.y, cos * v.y - sin * v.x, v.z)
}

/// The vector of a frame turned by the angle with this cosine and sine; undoes [`unturn`].
#[inline]
fn turn(v: &Vector3<f64>, cos: f64, sin: f64) -> Vector3<f64> {
    unturn(v, cos, -sin)
}

/// Where a convex body is met that the line crosses over `[near, far]`, from outside or from inside.
#[inline]
fn surface(near: f64, far: f64) -> Option<f64> {
    let t = if near >= 0.0 { near } else { far };
    (near <= far && t >= 0.0).then_some(t)
}

/// Clips `span` to `low <= position + t direction <= high`.
#[inline]
fn clip(span: &mut (f64, f64), position: f64, direction: f64, low: f64, high: f64) {
    if direction == 0.0 {
        if position < low || position > high {
            *span = (f64::INFINITY, f64::NEG_INFINITY);
        }
        return;
    }
    let (a, b) = ((low - position) / direction, (high - position) / direction);
    *span = (span.0.max(a.min(b)), span.1.min(a.max(b)));
}

const LINE: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

impl Primitive {
    /// None of a plane, which has no bounds.
    pub(super) fn new(solid: &Solid) -> Option<Self> {
        Some(match *solid {
            Solid::Box { center, size, yaw: 0.0 } => Self::Block { min: center - 0.5 * size, max: center + 0.5 * size },
            Solid::Box { center, size, yaw } => {
                Self::Turned { center, half: 0.5 * size, cos: yaw.cos(), sin: yaw.sin() }
            }
            Solid::Cylinder { base, radius, height } => Self::Cylinder { base, radius, height },
            Solid::Ramp { foot, yaw, length, width, height } => {
                Self::Ramp { foot, cos: yaw.cos(), sin: yaw.sin(), length, half_width: 0.5 * width, height }
            }
            Solid::Plane { .. } => return None,
        })
    }

    pub(super) fn bounds(&self) -> Bounds<3> {
        let upright = |corners: [Vector2<f64>; 4], low: f64, high: f64| {
            Bounds::around(corners.iter().flat_map(|c| [[c.x, c.y, low], [c.x, c.y, high]]))
        };
        match *self {
            Self::Block { min, max } => Bounds { min: min.into(), max: max.into() },
            Self::Turned { center, half, cos, sin } => {
                let pose = Se2::new(center.x, center.y, sin.atan2(cos));
                upright(rectangle_corners(&pose, 2.0 * half.x, 2.0 * half.y), center.z - half.z, center.z + half.z)
            }
            Self::Cylinder { base, radius, height } => Bounds {
                min: [base.x - radius, base.y - radius, base.z],
                max: [base.x + radius, base.y + radius, base.z + height],
            },
            Self::Ramp { foot, cos, sin, length, half_width, height } => {
                let middle = foot + turn(&Vector3::new(0.5 * length, 0.0, 0.0), cos, sin);
                let pose = Se2::new(middle.x, middle.y, sin.atan2(cos));
                upright(rectangle_corners(&pose, length, 2.0 * half_width), foot.z, foot.z + height)
            }
        }
    }

    /// Distance along the ray to the surface.
    #[inline]
    pub(super) fn cast(&self, ray: &Ray<3>) -> Option<f64> {
        let (origin, direction) = (Vector3::from(ray.origin), Vector3::from(ray.direction));
        match self {
            Self::Block { min, max } => {
                let (near, far) = ray.span(&Bounds { min: (*min).into(), max: (*max).into() });
                surface(near, far)
            }
            Self::Turned { center, half, cos, sin } => {
                let (o, d) = (unturn(&(origin - center), *cos, *sin), unturn(&direction, *cos, *sin));
                let mut span = LINE;
                for axis in 0..3 {
                    clip(&mut span, o[axis], d[axis], -half[axis], half[axis]);
                }
                surface(span.0, span.1)
            }
            Self::Cylinder { base, radius, height } => {
                let o = origin - base;
                let mut span = LINE;
                clip(&mut span, o.z, direction.z, 0.0, *height);
                let (flat, away) = (direction.xy(), -o.xy());
                let length = flat.norm();
                if length > 0.0 {
                    // In the plane, along the unit vector: as a circle, then back to lengths along the ray.
                    let unit = flat / length;
                    let (along, offset) = (away.dot(&unit), away.perp(&unit));
                    let half_chord_squared = (radius - offset) * (radius + offset);
                    if half_chord_squared < 0.0 {
                        return None;
                    }
                    let half_chord = half_chord_squared.sqrt();
                    span = (span.0.max((along - half_chord) / length), span.1.min((along + half_chord) / length));
                } else if away.norm() > *radius {
                    return None;
                }
                surface(span.0, span.1)
            }
            Self::Ramp { foot, cos, sin, length, half_width, height } => {
                let (o, d) = (unturn(&(origin - foot), *cos, *sin), unturn(&direction, *cos, *sin));
                let mut span = LINE;
                clip(&mut span, o.x, d.x, 0.0, *length);
                clip(&mut span, o.y, d.y, -half_width, *half_width);
                clip(&mut span, o.z, d.z, 0.0, *height);
                // Below the slope: z length - x height <= 0.
                let (p, v) = (o.z * length - o.x * height, d.z * length - d.x * height);
                clip(&mut span, p, v, f64::NEG_INFINITY, 0.0);
                surface(span.0, span.1)
            }
        }
    }

    /// Unit normal of the face that a point of the surface lies on, outwards.
    pub(super) fn normal(&self, point: &Vector3<f64>) -> Vector3<f64> {
        // The face that the point is least far inside of.
        let face = |faces: &[(f64, Vector3<f64>)]| {
            faces.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Vector3::z, |f| f.1)
        };
        let box_face = |p: Vector3<f64>, half: &Vector3<f64>| {
            let axis = |i: usize, unit: Vector3<f64>| (p[i].abs() - half[i], unit * p[i].signum());
            face(&[axis(0, Vector3::x()), axis(1, Vector3::y()), axis(2, Vector3::z())])
        };
        match self {
            Self::Block { min, max } => box_face(point - 0.5 * (min + max), &(0.5 * (max - min))),
            Self::Turned { center, half, cos, sin } => {
                turn(&box_face(unturn(&(point - center), *cos, *sin), half), *cos, *sin)
            }
            Self::Cylinder { base, radius, height } => {
                let p = point - base;
                let side = p.xy().try_normalize(0.0).unwrap_or_else(Vector2::x);
                face(&[
                    (p.xy().norm() - radius, Vector3::new(side.x, side.y, 0.0)),
                    (p.z - height, Vector3::z()),
                    (-p.z, -Vector3::z()),
                ])
            }
            Self::Ramp { foot, cos, sin, length, half_width, height } => {
                let p = unturn(&(point - foot), *cos, *sin);
                let slope = Vector3::new(-height, 0.0, *length).normalize();
                let normal = face(&[
                    (p.dot(&slope), slope),
                    (p.x - length, Vector3::x()),
                    (p.y.abs() - half_width, Vector3::y() * p.y.signum()),
                    (-p.z, -Vector3::z()),
                ]);
                turn(&normal, *cos, *sin)
            }
        }
    }
}
