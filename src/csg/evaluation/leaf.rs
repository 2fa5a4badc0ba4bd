//! Leaves in local units: the distance function of each, on the CPU and as WGSL.
//!
//! The table `primitives!` of [`crate::csg::tree::primitive`] makes the list of distance functions here. Extruded and
//! revolved profiles and baked volumes are added by hand, because they have data besides their parameters.
//!
//! On a graphics device a leaf has a *kind*, the number of its distance function. [`kinds_text`] writes the constants
//! of the kinds and the function that selects by them; `shaders/shared/csg/csg_leaves.wgsl` imports this text as
//! `csg_kinds`.

use super::field;
use super::flat_polygon::FlatPolygon;
use super::placed_volume::PlacedVolume;
use super::scalar::{Scalar, length2};
use crate::csg::tree::primitive::{PARAMETERS, Primitive, primitives};
use crate::csg::tree::profile::Profile;
use crate::csg::tree::volume_leaf::VolumeLeaf;
use crate::gpu::shader::Instead;
use std::fmt::Write;
use std::sync::Arc;

/// The values of a function of the position in the space of a leaf, at each point. A macro, because the compiler may
/// leave a closure as one function for the baseline of the target; see [`crate::simd`].
macro_rules! each {
    ($leaf:ident, $at:ident, |$q:pat_param| $value:expr) => {{
        let mut out = [F::default(); N];
        let [sx, sy, sz] = $leaf.shift;
        if $leaf.is_turned {
            let [a, b, c] = &$leaf.rows;
            for i in 0..N {
                let (x, y, z) = ($at[0][i], $at[1][i], $at[2][i]);
                let $q = [
                    a[0] * x + a[1] * y + a[2] * z + sx,
                    b[0] * x + b[1] * y + b[2] * z + sy,
                    c[0] * x + c[1] * y + c[2] * z + sz,
                ];
                out[i] = $value;
            }
        } else {
            for i in 0..N {
                let $q = [$at[0][i] + sx, $at[1][i] + sy, $at[2][i] + sz];
                out[i] = $value;
            }
        }
        out
    }};
}

macro_rules! declare {
    ($(
        $(#[$help:meta])+
        $variant:ident { $($field:ident: $type:ty),* } = $function:ident, $(loops $loops:ident,)?
            words [$($words:tt)*];
    )*) => {
        /// The distance function of a leaf, with the data that do not fit into its parameters.
        #[derive(Debug, Clone)]
        pub enum LeafField<F> {
            $($variant,)*
            Extrude(Flat<F>),
            Revolve(Flat<F>),
            Volume(Arc<VolumeLeaf>, Box<PlacedVolume<F>>),
        }

        /// The number of each kind of leaf. `Extrude` and `Revolve` are the first of three consecutive numbers, one
        /// per profile.
        #[derive(Clone, Copy)]
        enum First {
            $($variant,)*
            Extrude,
            Revolve = First::Extrude as isize + 3,
            Volume = First::Extrude as isize + 6,
        }

        /// Kinds of leaves, in the order of their numbers.
        const KINDS: &[LeafKind] = &[
            $(LeafKind {
                function: stringify!($function),
                call: concat!(stringify!($function), "(at, k)"),
                loops: &[$(stringify!($loops))?],
            },)*
            LeafKind::new("extruded_circle", "extruded(circle(at.xy, numbers[first]), at.z, k)"),
            LeafKind::new("extruded_rectangle", "extruded(rectangle(at.xy, corner_at(first)), at.z, k)"),
            LeafKind::new("extruded_polygon", "extruded(polygon(at.xy, first), at.z, k)"),
            LeafKind::new("revolved_circle", "circle(revolved(at, k[0]), numbers[first])"),
            LeafKind::new("revolved_rectangle", "rectangle(revolved(at, k[0]), corner_at(first))"),
            LeafKind::new("revolved_polygon", "polygon(revolved(at, k[0]), first)"),
            LeafKind::new("volume", "volume(at, first)"),
        ];

        impl<F: Scalar> LeafField<F> {
            /// The field of a primitive whose lengths are multiplied by `scale`.
            pub fn new(primitive: &Primitive, scale: f64) -> Self {
                match primitive {
                    $(Primitive::$variant { .. } => Self::$variant,)*
                    Primitive::Extrude { profile, .. } => Self::Extrude(Flat::new(profile, scale)),
                    Primitive::Revolve { profile, .. } => Self::Revolve(Flat::new(profile, scale)),
                    Primitive::Volume(volume) => {
                        Self::Volume(volume.clone(), Box::new(PlacedVolume::new(volume, scale)))
                    }
                }
            }

            /// The number of the kind.
            pub fn kind(&self) -> u32 {
                match self {
                    $(Self::$variant => First::$variant as u32,)*
                    Self::Extrude(flat) => First::Extrude as u32 + flat.index(),
                    Self::Revolve(flat) => First::Revolve as u32 + flat.index(),
                    Self::Volume(..) => First::Volume as u32,
                }
            }

            /// WGSL constants with the numbers of iterations of the loops in the distance function.
            pub fn loops(&self) -> &'static [&'static str] {
                KINDS[self.kind() as usize].loops
            }
        }

        impl<F: Scalar> PlacedLeaf<F> {
            /// The field at `N` points, local units.
            #[inline(always)]
            pub fn distances<const N: usize>(&self, at: &[[F; N]; 3]) -> [F; N] {
                let (leaf, p) = (self, &self.parameters);
                match &self.field {
                    $(LeafField::$variant => each!(leaf, at, |q| field::$function(q, p)),)*
                    LeafField::Extrude(flat) => {
                        each!(leaf, at, |[x, y, z]| field::extrude(flat.distance(x, y), z, p))
                    }
                    LeafField::Revolve(flat) => each!(leaf, at, |[x, y, z]| flat.distance(length2(x, y) - p[0], z)),
                    LeafField::Volume(volume, placed) => each!(leaf, at, |q| placed.distance(volume, q)),
                }
            }
        }
    };
}
primitives!(declare);

/// A kind of leaf in shaders.
#[derive(Debug)]
struct LeafKind {
    function: &'static str,
    /// The expression of the distance at `at`, with the parameters `k` and the first data at `first`.
    call: &'static str,
    loops: &'static [&'static str],
}

impl LeafKind {
    const fn new(function: &'static str, call: &'static str) -> Self {
        Self { function, call, loops: &[] }
    }
}

/// A set of kinds, one bit per kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct KindSet(u32);

const _: () = assert!(KINDS.len() <= 32, "a set of kinds has 32 bits");

impl KindSet {
    pub(crate) const ALL: Self = Self(u32::MAX);

    pub(crate) fn with(self, field: &LeafField<f32>) -> Self {
        Self(self.0 | 1 << field.kind())
    }

    fn has(self, constant: &str) -> bool {
        KINDS
            .iter()
            .position(|kind| constant == kind.function.to_uppercase())
            .is_some_and(|kind| self.0 >> kind & 1 == 1)
    }

    /// A shader without the cases `case KIND_NAME: { .. }` of kinds that are not in the set.
    pub(crate) fn cases_of(self, text: &str) -> String {
        let mut kept = String::with_capacity(text.len());
        // Number of open braces of a case that is left out.
        let mut depth = 0;
        for line in text.lines() {
            let name = line.trim_start().strip_prefix("case KIND_").and_then(|rest| rest.split_once(':'));
            let is_other = name.is_some_and(|(name, _)| !self.has(name));
            if depth == 0 && !is_other {
                kept.push_str(line);
                kept.push('\n');
            } else {
                depth += line.matches('{').count();
                depth -= line.matches('}').count();
            }
        }
        kept
    }
}

/// The name under which shaders import [`kinds_text`].
pub(crate) const KINDS_MODULE: &str = "csg_kinds";

/// The modules that a kernel which evaluates all kinds of leaves imports.
pub(crate) fn kernel_texts() -> [Instead; 1] {
    [(KINDS_MODULE, kinds_text(KindSet::ALL).into())]
}

/// The text of [`KINDS_MODULE`]: a constant for each kind, and the distances of those in a set.
pub(crate) fn kinds_text(set: KindSet) -> String {
    let mut text = String::from("// Kinds of leaves and their distances, written by src/csg/evaluation/leaf.rs.\n\n");
    let mut cases = String::new();
    for (number, LeafKind { function, call, loops }) in KINDS.iter().enumerate() {
        let constant = function.to_uppercase();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "const KIND_{constant}: u32 = {number}u;");
        if set.0 >> number & 1 == 1 {
            let count: String = loops.iter().map(|steps| format!("rounds += {steps}; ")).collect();
            let _ = writeln!(cases, "        case KIND_{constant}: {{ {count}return {call}; }}");
        }
    }
    text + DISPATCH.0 + &cases + DISPATCH.1
}

const DISPATCH: (&str, &str) = (
    "
// The distance of a leaf at a position in its own space.
fn own_distance(leaf: u32, at: vec3f) -> f32 {
    let a = leaves[leaf].a;
    let b = leaves[leaf].b;
    let k = array<f32, 6>(a.x, a.y, a.z, a.w, b.x, b.y);
    let first = leaves[leaf].first;
    switch leaves[leaf].kind {
",
    "        default: { return CSG_FAR; }
    }
}
",
);

/// A profile in local units.
#[derive(Debug, Clone)]
pub enum Flat<F> {
    Circle(F),
    Rectangle([F; 2]),
    Polygon(FlatPolygon<F>),
}

impl<F: Scalar> Flat<F> {
    fn new(profile: &Profile, scale: f64) -> Self {
        match profile {
            Profile::Circle { radius } => Self::Circle(F::of(scale * radius)),
            Profile::Rectangle { half } => Self::Rectangle((scale * *half).to_array().map(F::of)),
            Profile::Polygon(region) => Self::Polygon(FlatPolygon::new(region, scale)),
        }
    }

    /// Index among the three kinds of profiles.
    fn index(&self) -> u32 {
        match self {
            Self::Circle(_) => 0,
            Self::Rectangle(_) => 1,
            Self::Polygon(_) => 2,
        }
    }

    #[inline(always)]
    fn distance(&self, x: F, y: F) -> F {
        match self {
            Self::Circle(radius) => field::circle(x, y, *radius),
            Self::Rectangle(half) => field::rectangle(x, y, *half),
            Self::Polygon(corners) => field::polygon(x, y, corners),
        }
    }
}

/// A leaf in local units.
#[derive(Debug, Clone)]
pub struct PlacedLeaf<F> {
    /// Rows of `leaf_from_local`.
    pub rows: [[F; 3]; 3],
    pub shift: [F; 3],
    /// Whether the rows are other than the identity.
    pub is_turned: bool,
    pub parameters: [F; PARAMETERS],
    pub field: LeafField<F>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::tree::region::Rule;
    use crate::gpu::shader::shared;

    /// The bit of a kind.
    fn only(name: &str) -> KindSet {
        KindSet(1 << KINDS.iter().position(|kind| kind.function == name).unwrap())
    }

    #[test]
    fn kinds_are_in_the_order_of_their_numbers() {
        assert_eq!(KINDS[LeafField::<f32>::Gyroid.kind() as usize].function, "gyroid");
        let circle = LeafField::Extrude(Flat::Circle(1.0f32));
        assert_eq!(KINDS[circle.kind() as usize].function, "extruded_circle");
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let profile = Profile::polygon(&[&corners], Rule::EvenOdd).unwrap();
        let polygon = LeafField::<f32>::Revolve(Flat::new(&profile, 1.0));
        assert_eq!(KINDS[polygon.kind() as usize].function, "revolved_polygon");
        assert_eq!(First::Volume as usize + 1, KINDS.len());
    }

    #[test]
    fn chords_name_kinds_that_exist() {
        for line in shared("csg_chord").unwrap().lines() {
            if let Some((name, _)) = line.trim_start().strip_prefix("case KIND_").and_then(|rest| rest.split_once(':'))
            {
                assert!(KindSet::ALL.has(name), "{name}");
            }
        }
    }

    #[test]
    fn a_text_has_the_cases_of_its_kinds_and_no_others() {
        let all = kinds_text(KindSet::ALL);
        assert_eq!(all.matches("case KIND_").count(), KINDS.len());
        assert!(all.contains("case KIND_ELLIPSOID: { rounds += ELLIPSOID_STEPS; return ellipsoid(at, k); }"));
        let cone = kinds_text(only("cone"));
        assert_eq!(cone.matches("case KIND_").count(), 1);
        assert!(cone.contains("case KIND_CONE: { return cone(at, k); }"));
        // The constants remain, because chords use them.
        assert_eq!(cone.matches("const KIND_").count(), KINDS.len());
    }

    #[test]
    fn other_cases_are_left_out_whole() {
        let text =
            "switch a {\n case KIND_CONE: {\n  if b { c(); }\n }\n case KIND_SPHERE: { d(); }\n default: {}\n}\n";
        let cone = "switch a {\n case KIND_CONE: {\n  if b { c(); }\n }\n default: {}\n}\n";
        assert_eq!(only("cone").cases_of(text), cone);
        let sphere = "switch a {\n case KIND_SPHERE: { d(); }\n default: {}\n}\n";
        assert_eq!(only("sphere").cases_of(text), sphere);
        assert_eq!(KindSet::default().cases_of(text), "switch a {\n default: {}\n}\n");
    }
}
