//! The leaves of shapes: simple solids about the origin, most of them with z as their axis.
//!
//! The table `primitives!` lists them. Each primitive checks its parameters, declares whether its field is exact or a
//! bound and its Lipschitz constant, and has a support function, which gives tight boxes under any rotation. The
//! distances are in [`crate::csg::evaluation::field`].

use super::checks::{finite, not_negative, positive, unit};
use super::ends::Ends;
use super::language_table::{NumberSource, Word};
use super::profile::Profile;
use super::screw;
use super::volume_leaf::VolumeLeaf;
use crate::error::ShapeError;
use glam::{DVec2, DVec3};
use std::f64::consts::PI;
use std::sync::Arc;

/// The table of the primitives. A row has
///
/// - the help text, the variant of [`Primitive`] and its fields;
/// - the distance function, with one name in [`crate::csg::evaluation::field`] and in
///   `shaders/shared/csg/csg_field.wgsl`. The WGSL constant of the kind has the same name in capitals, and the number
///   of the kind is the place of the row;
/// - `loops`: the WGSL constant with the number of iterations of that function, if it has a loop;
/// - `words`: the forms of the language that make the primitive, the preferred form first.
///
/// `primitives!(name)` calls the macro `name` with all rows.
macro_rules! primitives {
    ($make:ident) => {
        $make! {
            /// A ball.
            Sphere { radius: f64 } = sphere,
                words [("sphere", "sphere", [Half("d")])];
            /// An ellipsoid with its half axes along x, y and z.
            Ellipsoid { radii: DVec3 } = ellipsoid, loops ELLIPSOID_STEPS,
                words [("ellipsoid", "ellipsoid", [Half("dx"), Half("dy"), Half("dz")])];
            /// A box; `half` includes the rounding of the edges.
            Box { half: DVec3, rounding: f64 } = rounded_box,
                words [
                    ("cube", "box", [Full("s"), Same, Same]),
                    ("box", "box", [Full("w"), Full("l"), Full("h")]),
                    ("rounded-box", "rounded_box", [Full("w"), Full("l"), Full("h"), Full("r")]),
                ];
            /// The twelve edges of a box, square bars of the given thickness, inside `half`.
            BoxFrame { half: DVec3, thickness: f64 } = box_frame,
                words [("box-frame", "box_frame", [Full("w"), Full("l"), Full("h"), Full("t")])];
            /// A tube around a circle in the plane z = 0.
            Torus { radius: f64, tube: f64 } = torus,
                words [("torus", "torus", [Rim("D"), Half("d")])];
            /// The part of a torus within an angle of the +x axis, with round ends.
            CappedTorus { radius: f64, tube: f64, half_angle: f64 } = capped_torus,
                words [("capped-torus", "capped_torus", [Rim("D"), Half("d"), Full("degrees")])];
            /// A cylinder along z.
            Cylinder { radius: f64, half_height: f64 } = cylinder,
                words [("cylinder", "cylinder", [Half("d"), Full("h")])];
            /// A cylinder along z whose edges are rounded; the sizes include the rounding.
            RoundedCylinder { radius: f64, half_height: f64, rounding: f64 } = rounded_cylinder,
                words [("rounded-cylinder", "rounded_cylinder", [Half("d"), Full("h"), Full("r")])];
            /// The points within `radius` of a segment of the z axis.
            Capsule { radius: f64, half_height: f64 } = capsule,
                words [("capsule", "capsule", [Half("d"), Full("h")])];
            /// A cone along z from radius `low` at the bottom to `high` at the top.
            Cone { low: f64, high: f64, half_height: f64 } = cone,
                words [
                    ("cone", "cone", [Half("d"), Zero, Full("h")]),
                    ("coninder", "cone", [Half("low"), Half("high"), Full("h")]),
                    ("cylicone", "cone", [Half("low"), Half("high"), Full("h")]),
                ];
            /// The convex hull of two balls on the z axis, of radius `low` at the bottom and `high` at the top.
            RoundedCone { low: f64, high: f64, half_height: f64 } = rounded_cone,
                words [("rounded-cone", "rounded_cone", [Half("low"), Half("high"), Full("h")])];
            /// The half space below the plane `normal . p = offset`.
            Plane { normal: DVec3, offset: f64 } = plane,
                words [
                    ("plane", "plane", [Full("x"), Full("y"), Full("z"), Zero]),
                    ("plane", "plane", [Full("x"), Full("y"), Full("z"), Full("offset")]),
                ];
            /// The space between two parallel planes.
            Slab { normal: DVec3, half_thickness: f64 } = slab,
                words [
                    ("slab", "slab", [Full("t"), Zero, Zero, One]),
                    ("slab", "slab", [Full("t"), Full("x"), Full("y"), Full("z")]),
                ];
            /// A pyramid with a square base at the bottom and its apex at the top.
            Pyramid { half_base: f64, half_height: f64 } = pyramid,
                words [("pyramid", "pyramid", [Full("base"), Full("h")])];
            /// An octahedron with its corners on the axes, at `radius`.
            Octahedron { radius: f64 } = octahedron,
                words [("octahedron", "octahedron", [Half("d")])];
            /// A prism along z with six sides, two of which face +y and -y at `apothem`.
            HexPrism { apothem: f64, half_height: f64 } = hex_prism,
                words [("hex-prism", "hex_prism", [Half("d"), Full("h")])];
            /// A sheet around the gyroid, at least `thickness` thick, that repeats every `cell`.
            Gyroid { cell: f64, thickness: f64 } = gyroid,
                words [("gyroid", "gyroid", [Full("cell"), Full("t")])];
            /// A sheet around the primitive surface of Schwarz, at least `thickness` thick, that repeats every `cell`.
            SchwarzP { cell: f64, thickness: f64 } = schwarz_p,
                words [("schwarz-p", "schwarz_p", [Full("cell"), Full("t")])];
            /// A sheet around the diamond surface of Schwarz, at least `thickness` thick, that repeats every `cell`.
            Diamond { cell: f64, thickness: f64 } = diamond,
                words [("diamond", "diamond", [Full("cell"), Full("t")])];
            /// A sheet around the I-WP surface of Schoen, at least `thickness` thick, that repeats every `cell`.
            Iwp { cell: f64, thickness: f64 } = iwp,
                words [("iwp", "iwp", [Full("cell"), Full("t")])];
            /// A right-handed screw thread about z without ends, of the basic profile of ISO 68-1 (`is_iso`) or
            /// ISO 2904, whose surface is moved outwards by `offset`.
            Thread { radius: f64, pitch: f64, offset: f64, is_iso: bool } = thread,
                words [
                    ("iso-thread", "iso_thread", [Half("d"), Full("pitch"), Full("offset")]),
                    ("trapezoidal-thread", "trapezoidal_thread", [Half("d"), Full("pitch"), Full("offset")]),
                ];
        }
    };
}
pub(crate) use primitives;

macro_rules! declare {
    ($(
        $(#[$help:meta])+
        $variant:ident { $($field:ident: $type:ty),* } = $function:ident, $(loops $loops:ident,)?
            words [$(($word:literal, $named:literal, [$($slot:expr),*])),* $(,)?];
    )*) => {
        /// A simple solid in its own space. Lengths are halves and radii.
        #[derive(Debug, Clone, PartialEq)]
        pub enum Primitive {
            $($(#[$help])+ $variant { $($field: $type),* },)*
            /// A profile of the plane z = 0, extruded along z.
            Extrude { profile: Arc<Profile>, half_height: f64, ends: Ends },
            /// A profile revolved about z: its x is the distance from the axis less `offset`, its y is z.
            Revolve { profile: Arc<Profile>, offset: f64 },
            /// A baked field.
            Volume(Arc<VolumeLeaf>),
        }

        /// The forms of the language that make primitives.
        pub(crate) const WORDS: &[Word] = {
            use NumberSource::*;
            &[$($(Word { word: $word, operation: $named, slots: &[$($slot),*] }),*),*]
        };

        impl Primitive {
            /// The name of the distance function in shaders. It distinguishes structures, and messages contain it.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => stringify!($function),)*
                    Self::Extrude { profile, .. } => match **profile {
                        Profile::Circle { .. } => "extrude_circle",
                        Profile::Rectangle { .. } => "extrude_rectangle",
                        Profile::Polygon(_) => "extrude_polygon",
                    },
                    Self::Revolve { profile, .. } => match **profile {
                        Profile::Circle { .. } => "revolve_circle",
                        Profile::Rectangle { .. } => "revolve_rectangle",
                        Profile::Polygon(_) => "revolve_polygon",
                    },
                    Self::Volume(_) => "volume",
                }
            }
        }
    };
}
primitives!(declare);

/// Number of parameters of a distance function.
pub(crate) const PARAMETERS: usize = 6;

/// The largest `n . p` over the points with `normal . p <= offset`, which is finite along the normal only.
fn half_space_support(n: DVec3, normal: DVec3, offset: f64) -> f64 {
    let along = n.dot(normal);
    let is_along = along > 0.0 && (n - along * normal).length() <= 1e-12 * along;
    if is_along { along * offset } else { f64::INFINITY }
}

impl Primitive {
    /// A primitive by the name and the arguments of the Python interface, where sizes are full lengths and radii.
    pub fn named(name: &str, numbers: &[f64]) -> Result<Self, ShapeError> {
        let size = |x, y, z| -> Result<DVec3, ShapeError> {
            Ok(DVec3::new(positive("size", x)?, positive("size", y)?, positive("size", z)?))
        };
        Ok(match (name, numbers) {
            ("sphere", &[radius]) => Self::Sphere { radius: positive("radius", radius)? },
            ("ellipsoid", &[x, y, z]) => {
                let radii = [x, y, z].map(|radius| positive("radii", radius));
                let [x, y, z] = radii;
                Self::Ellipsoid { radii: DVec3::new(x?, y?, z?) }
            }
            ("box", &[x, y, z]) => Self::Box { half: 0.5 * size(x, y, z)?, rounding: 0.0 },
            ("rounded_box", &[x, y, z, radius]) => {
                let half = 0.5 * size(x, y, z)?;
                let rounding = not_negative("radius", radius)?;
                if rounding > half.min_element() {
                    let limit = half.min_element();
                    let problem = format!("must be at most half the shortest side, {limit}, got {rounding}");
                    return Err(ShapeError::argument("radius", problem));
                }
                Self::Box { half, rounding }
            }
            ("box_frame", &[x, y, z, thickness]) => {
                let half = 0.5 * size(x, y, z)?;
                let thickness = positive("thickness", thickness)?;
                if thickness > half.min_element() {
                    let limit = half.min_element();
                    let problem = format!("must be at most half the shortest side, {limit}, got {thickness}");
                    return Err(ShapeError::argument("thickness", problem));
                }
                Self::BoxFrame { half, thickness }
            }
            ("torus", &[radius, tube]) => {
                let (radius, tube) = (not_negative("radius", radius)?, positive("tube", tube)?);
                Self::Torus { radius: ring_radius(radius, tube), tube }
            }
            ("capped_torus", &[radius, tube, angle_deg]) => {
                if !(angle_deg > 0.0 && angle_deg <= 360.0) {
                    let problem = format!("must be above 0 and at most 360 degrees, got {angle_deg}");
                    return Err(ShapeError::argument("angle_deg", problem));
                }
                let half_angle = 0.5 * angle_deg.to_radians();
                let (radius, tube) = (positive("radius", radius)?, positive("tube", tube)?);
                Self::CappedTorus { radius: ring_radius(radius, tube), tube, half_angle }
            }
            ("cylinder", &[radius, height]) => {
                Self::Cylinder { radius: positive("radius", radius)?, half_height: 0.5 * positive("height", height)? }
            }
            ("rounded_cylinder", &[radius, height, rounding]) => {
                let (radius, half_height) = (positive("radius", radius)?, 0.5 * positive("height", height)?);
                let (rounding, limit) = (not_negative("rounding", rounding)?, radius.min(half_height));
                if rounding > limit {
                    let problem = format!("must be at most the radius and half the height, {limit}, got {rounding}");
                    return Err(ShapeError::argument("rounding", problem));
                }
                Self::RoundedCylinder { radius, half_height, rounding }
            }
            ("capsule", &[radius, height]) => Self::Capsule {
                radius: positive("radius", radius)?,
                half_height: 0.5 * not_negative("height", height)?,
            },
            ("cone", &[low, high, height]) => {
                let (low, high) = (not_negative("radius", low)?, not_negative("top_radius", high)?);
                if low == 0.0 && high == 0.0 {
                    return Err(ShapeError::argument("radius", "both ends are 0: nothing is left of the cone"));
                }
                Self::Cone { low, high, half_height: 0.5 * positive("height", height)? }
            }
            ("rounded_cone", &[low, high, height]) => {
                let (low, high) = (not_negative("radius", low)?, not_negative("top_radius", high)?);
                if low == 0.0 && high == 0.0 {
                    return Err(ShapeError::argument("radius", "both radii are 0: nothing is left of the cone"));
                }
                Self::RoundedCone { low, high, half_height: 0.5 * not_negative("height", height)? }
            }
            ("plane", &[x, y, z, offset]) => {
                Self::Plane { normal: unit("normal", [x, y, z])?, offset: finite("offset", offset)? }
            }
            ("slab", &[thickness, x, y, z]) => {
                let half_thickness = 0.5 * positive("thickness", thickness)?;
                Self::Slab { normal: unit("normal", [x, y, z])?, half_thickness }
            }
            ("pyramid", &[base, height]) => Self::Pyramid {
                half_base: 0.5 * positive("base", base)?,
                half_height: 0.5 * positive("height", height)?,
            },
            ("octahedron", &[radius]) => Self::Octahedron { radius: positive("radius", radius)? },
            ("hex_prism", &[radius, height]) => Self::HexPrism {
                apothem: 0.75f64.sqrt() * positive("radius", radius)?,
                half_height: 0.5 * positive("height", height)?,
            },
            ("gyroid", &[cell, thickness]) => {
                Self::Gyroid { cell: positive("cell", cell)?, thickness: positive("thickness", thickness)? }
            }
            ("schwarz_p", &[cell, thickness]) => {
                Self::SchwarzP { cell: positive("cell", cell)?, thickness: positive("thickness", thickness)? }
            }
            ("diamond", &[cell, thickness]) => {
                Self::Diamond { cell: positive("cell", cell)?, thickness: positive("thickness", thickness)? }
            }
            ("iso_thread" | "trapezoidal_thread", &[radius, pitch, offset]) => {
                let is_iso = name == "iso_thread";
                screw::check(radius, pitch, offset, is_iso)?;
                Self::Thread { radius, pitch, offset, is_iso }
            }
            ("iwp", &[cell, thickness]) => {
                Self::Iwp { cell: positive("cell", cell)?, thickness: positive("thickness", thickness)? }
            }
            _ => {
                let problem = format!("there is no primitive '{name}' of {} numbers", numbers.len());
                return Err(ShapeError::argument("primitive", problem));
            }
        })
    }

    /// The name and the arguments from which [`Self::named`] makes the primitive; `None` for profiles and volumes.
    pub fn arguments(&self) -> Option<(&'static str, Vec<f64>)> {
        let sides = |half: DVec3, rest: &[f64]| [&(2.0 * half).to_array(), rest].concat();
        Some(match *self {
            Self::Sphere { radius } => ("sphere", vec![radius]),
            Self::Ellipsoid { radii } => ("ellipsoid", radii.to_array().to_vec()),
            Self::Box { half, rounding: 0.0 } => ("box", sides(half, &[])),
            Self::Box { half, rounding } => ("rounded_box", sides(half, &[rounding])),
            Self::BoxFrame { half, thickness } => ("box_frame", sides(half, &[thickness])),
            Self::Torus { radius, tube } => ("torus", vec![radius, tube]),
            Self::CappedTorus { radius, tube, half_angle } => {
                ("capped_torus", vec![radius, tube, 2.0 * half_angle.to_degrees()])
            }
            Self::Cylinder { radius, half_height } => ("cylinder", vec![radius, 2.0 * half_height]),
            Self::RoundedCylinder { radius, half_height, rounding } => {
                ("rounded_cylinder", vec![radius, 2.0 * half_height, rounding])
            }
            Self::Capsule { radius, half_height } => ("capsule", vec![radius, 2.0 * half_height]),
            Self::Cone { low, high, half_height } => ("cone", vec![low, high, 2.0 * half_height]),
            Self::RoundedCone { low, high, half_height } => ("rounded_cone", vec![low, high, 2.0 * half_height]),
            Self::Plane { normal, offset } => ("plane", vec![normal.x, normal.y, normal.z, offset]),
            Self::Slab { normal, half_thickness } => ("slab", vec![2.0 * half_thickness, normal.x, normal.y, normal.z]),
            Self::Pyramid { half_base, half_height } => ("pyramid", vec![2.0 * half_base, 2.0 * half_height]),
            Self::Octahedron { radius } => ("octahedron", vec![radius]),
            Self::HexPrism { apothem, half_height } => ("hex_prism", vec![apothem / 0.75f64.sqrt(), 2.0 * half_height]),
            Self::Gyroid { cell, thickness } => ("gyroid", vec![cell, thickness]),
            Self::SchwarzP { cell, thickness } => ("schwarz_p", vec![cell, thickness]),
            Self::Diamond { cell, thickness } => ("diamond", vec![cell, thickness]),
            Self::Iwp { cell, thickness } => ("iwp", vec![cell, thickness]),
            Self::Thread { radius, pitch, offset, is_iso } => {
                (if is_iso { "iso_thread" } else { "trapezoidal_thread" }, vec![radius, pitch, offset])
            }
            Self::Extrude { .. } | Self::Revolve { .. } | Self::Volume(_) => return None,
        })
    }

    /// Whether the field is the Euclidean distance everywhere, inside too. Otherwise its magnitude never exceeds the
    /// Lipschitz constant times that distance.
    pub fn is_exact(&self) -> bool {
        match self {
            Self::BoxFrame { .. } | Self::Volume(_) => false,
            Self::Gyroid { .. } | Self::SchwarzP { .. } | Self::Diamond { .. } | Self::Iwp { .. } => false,
            Self::Thread { .. } => false,
            // A tube that intersects itself has its surface inside the tube.
            Self::Torus { radius, tube } => tube <= radius,
            Self::CappedTorus { radius, tube, half_angle } => tube <= radius && *half_angle <= 0.5 * PI,
            Self::Extrude { ends, .. } => ends.is_plain(),
            Self::Revolve { profile, offset } => profile.is_clear_of_axis(*offset),
            _ => true,
        }
    }

    /// Lipschitz constant of the field.
    pub fn lipschitz(&self) -> f64 {
        match self {
            Self::Volume(volume) => volume.lipschitz(),
            // See [`crate::csg::evaluation::helicoid`].
            Self::Thread { radius, pitch, is_iso, .. } => screw::lipschitz(*radius, *pitch, *is_iso),
            _ => 1.0,
        }
    }

    /// Parameters of the distance function, with lengths times `scale`, in the order of
    /// [`crate::csg::evaluation::field`].
    pub fn parameters(&self, scale: f64) -> [f64; PARAMETERS] {
        let s = scale;
        let mut out = [0.0; PARAMETERS];
        let mut put = |values: &[f64]| out[..values.len()].copy_from_slice(values);
        match *self {
            Self::Sphere { radius } | Self::Octahedron { radius } => put(&[s * radius]),
            Self::Ellipsoid { radii } => {
                // The squares minus the smallest of them follow.
                let shortest = radii.min_element();
                let above = (s * (radii - shortest)) * (s * (radii + shortest));
                put(&[s * radii.x, s * radii.y, s * radii.z, above.x, above.y, above.z]);
            }
            Self::Box { half, rounding } => {
                let inner = s * (half - rounding);
                put(&[inner.x, inner.y, inner.z, s * rounding]);
            }
            // Half sides of the outer box, and half the thickness of a bar.
            Self::BoxFrame { half, thickness } => {
                let half = s * half;
                put(&[half.x, half.y, half.z, 0.5 * s * thickness]);
            }
            Self::Torus { radius, tube } => put(&[s * radius, s * tube]),
            Self::CappedTorus { radius, tube, half_angle } => {
                put(&[s * radius, s * tube, half_angle.cos(), half_angle.sin()]);
            }
            Self::Cylinder { radius, half_height } | Self::Capsule { radius, half_height } => {
                put(&[s * radius, s * half_height]);
            }
            Self::RoundedCylinder { radius, half_height, rounding } => {
                put(&[s * (radius - rounding), s * (half_height - rounding), s * rounding]);
            }
            Self::Cone { low, high, half_height } => {
                let (dx, dy) = (s * (high - low), 2.0 * s * half_height);
                put(&[s * low, s * high, s * half_height, 1.0 / (dx * dx + dy * dy)]);
            }
            Self::RoundedCone { low, high, half_height } => {
                // Radii, z of the lower centre, distance of the centres, and the normal (cos, sin) of the side.
                let height = 2.0 * half_height;
                if height > (low - high).abs() {
                    let sin = (low - high) / height;
                    // The cosine as a product, so that nothing cancels for a steep side.
                    let cos = ((1.0 - sin) * (1.0 + sin)).sqrt();
                    put(&[s * low, s * high, -s * half_height, s * height, cos, sin]);
                } else {
                    // The larger ball contains the other.
                    let (radius, z) = if low > high { (low, -half_height) } else { (high, half_height) };
                    put(&[s * radius, s * radius, s * z, 0.0, 1.0, 0.0]);
                }
            }
            Self::Plane { normal, offset } => put(&[normal.x, normal.y, normal.z, s * offset]),
            Self::Slab { normal, half_thickness } => put(&[normal.x, normal.y, normal.z, s * half_thickness]),
            Self::Pyramid { half_base, half_height } => {
                // Slope of a side: from the middle of a base edge to the apex.
                let slant = half_base.hypot(2.0 * half_height);
                put(&[s * half_base, s * half_height, s * slant, half_base / slant, 2.0 * half_height / slant]);
            }
            Self::HexPrism { apothem, half_height } => put(&[s * apothem, s * half_height]),
            Self::Extrude { half_height, ends, .. } => {
                put(&[&[s * half_height], &ends.parameters(s)[..]].concat());
            }
            Self::Revolve { offset, .. } => put(&[s * offset]),
            // The level functions of the first three have gradients of at most sqrt(3), the last one of at most
            // sqrt(27). For the diamond, with t = cos^2 x, Cauchy's inequality bounds the square of the gradient by a
            // linear function of t with the values 3 - cos^2(y - z) - cos^2(y + z) and 1 + cos^2(y - z) + cos^2(y + z)
            // at its ends. A test bounds the gradient of I-WP by intervals.
            Self::Gyroid { cell, thickness }
            | Self::SchwarzP { cell, thickness }
            | Self::Diamond { cell, thickness }
            | Self::Iwp { cell, thickness } => {
                let slope = if matches!(self, Self::Iwp { .. }) { 27f64.sqrt() } else { 3f64.sqrt() };
                let frequency = 2.0 * PI / (s * cell);
                put(&[frequency, 1.0 / (frequency * slope), 0.5 * s * thickness]);
            }
            Self::Thread { radius, pitch, offset, is_iso } => {
                let [minor, crest, root] = screw::profile(radius, pitch, is_iso);
                put(&[s * pitch, s * minor, s * radius, s * crest, s * root, s * offset]);
            }
            Self::Volume(_) => put(&[s]),
        }
        out
    }

    /// The largest `n . p` over the solid; infinite if it is unbounded in that direction. `n` need not have unit
    /// length.
    pub fn support(&self, n: DVec3) -> f64 {
        let across = n.x.hypot(n.y);
        match *self {
            Self::Sphere { radius } => radius * n.length(),
            Self::Ellipsoid { radii } => (n * radii).length(),
            Self::Box { half, rounding } => (n.abs() * (half - rounding)).element_sum() + rounding * n.length(),
            Self::BoxFrame { half, .. } => (n.abs() * half).element_sum(),
            Self::Torus { radius, tube } => radius * across + tube * n.length(),
            Self::CappedTorus { radius, tube, half_angle } => {
                // The direction nearest to n on the arc.
                let angle = n.y.atan2(n.x).clamp(-half_angle, half_angle);
                radius * (n.x * angle.cos() + n.y * angle.sin()) + tube * n.length()
            }
            Self::Cylinder { radius, half_height } => radius * across + half_height * n.z.abs(),
            Self::RoundedCylinder { radius, half_height, rounding } => {
                (radius - rounding) * across + (half_height - rounding) * n.z.abs() + rounding * n.length()
            }
            Self::Capsule { radius, half_height } => radius * n.length() + half_height * n.z.abs(),
            Self::Cone { low, high, half_height } => {
                (high * across + half_height * n.z).max(low * across - half_height * n.z)
            }
            Self::RoundedCone { low, high, half_height } => {
                (high * n.length() + half_height * n.z).max(low * n.length() - half_height * n.z)
            }
            Self::Plane { normal, offset } => half_space_support(n, normal, offset),
            Self::Slab { normal, half_thickness } => {
                half_space_support(if n.dot(normal) < 0.0 { -n } else { n }, normal, half_thickness)
            }
            Self::Pyramid { half_base, half_height } => {
                (half_height * n.z).max(half_base * (n.x.abs() + n.y.abs()) - half_height * n.z)
            }
            Self::Octahedron { radius } => radius * n.abs().max_element(),
            Self::HexPrism { apothem, half_height } => {
                let radius = apothem / 0.75f64.sqrt();
                let corner = |degrees: f64| {
                    let (sin, cos) = degrees.to_radians().sin_cos();
                    radius * (n.x.abs() * cos + n.y.abs() * sin)
                };
                corner(0.0).max(corner(60.0)) + half_height * n.z.abs()
            }
            Self::Extrude { ref profile, half_height, ends } => ends.support(profile, half_height, n),
            Self::Revolve { ref profile, offset } => {
                // The part beyond the axis counts too, which can only enlarge the box.
                profile.support(DVec2::new(across, n.z)) + offset * across
            }
            Self::Gyroid { .. } | Self::SchwarzP { .. } | Self::Diamond { .. } | Self::Iwp { .. } => {
                if n == DVec3::ZERO { 0.0 } else { f64::INFINITY }
            }
            Self::Thread { radius, offset, .. } => {
                if n.z == 0.0 {
                    (radius + offset) * across
                } else {
                    f64::INFINITY
                }
            }
            Self::Volume(ref volume) => volume.support(n),
        }
    }

    /// Bound on the level sets of the field: `{field <= t}` lies in the box grown by `slack + growth * t` for `t > 0`.
    pub fn growth(&self) -> (f64, f64) {
        match self {
            Self::Volume(volume) => (1.0, volume.slack()),
            // Below the wider end the slanted sides go on.
            Self::Extrude { ends, .. } => (ends.growth(), 0.0),
            _ => (1.0, 0.0),
        }
    }
}

/// The radius of a ring that its outer diameter gives, the number of its text. A shape is then equal to the one that is
/// read from its text. The difference is within the rounding of the sum.
fn ring_radius(radius: f64, tube: f64) -> f64 {
    (radius + tube) - tube
}
