//! The field of a shape as a graph of arithmetic operations, for files that store implicit functions.
//!
//! The graph is made by tracing: the program of the shape runs with symbols in place of numbers, and each operation of
//! symbols adds a node. So every primitive and operator has the operations of its evaluation, and the values of the
//! graph are the values of the field in float64. Equal nodes are stored once. Operations of constants are computed, and
//! an operation that changes nothing, such as the sum with zero, adds no node.

use crate::csg::evaluation::program::{LocalFrame, Program, Stack};
use crate::csg::evaluation::scalar::Scalar;
use crate::csg::model::lowered::Model;
use crate::csg::text::volume_image::{DIGITS, Layout, reach};
use crate::csg::tree::volume_leaf::{PARTS, VolumeLeaf};
use glam::DVec3;
use rustc_hash::FxHashMap;
use std::cell::RefCell;
use std::cmp::Ordering;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
use std::sync::Arc;

/// An operation of the graph. The names are the names of the nodes in the implicit extension of 3MF.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Node {
    pub name: &'static str,
    /// Indices of earlier nodes; unused ones are zero.
    pub inputs: [u32; 4],
    /// The bits of the value of a `constant`, the index of the volume of an `image`, else zero.
    bits: u64,
}

impl Node {
    fn constant(value: f64) -> Self {
        // One zero, so that equal constants are one node.
        Self { name: "constant", inputs: [0; 4], bits: (value + 0.0).to_bits() }
    }

    /// The value of a constant.
    pub(crate) fn value(&self) -> Option<f64> {
        (self.name == "constant").then(|| f64::from_bits(self.bits))
    }

    /// The index of the volume of an image.
    pub(crate) fn image(&self) -> Option<usize> {
        (self.name == "image").then_some(self.bits as usize)
    }
}

/// The nodes of a field, each after its inputs. The nodes 1 to 3 are the coordinates `x`, `y` and `z` of the point.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    pub nodes: Vec<Node>,
    index: FxHashMap<Node, u32>,
    /// The node of the distance.
    pub result: u32,
    /// The volumes of the nodes `image`, whose inputs are the position in the image of the volume
    /// ([`crate::csg::text::volume_image`]), 0 to 1 along x, y and z, and whose value is the trilinear sample.
    pub images: Vec<Arc<VolumeLeaf>>,
    /// Whether a branch or an index depended on a symbol.
    is_incomplete: bool,
}

impl Graph {
    /// The graph of a model in world units; None if the field has a branch that no graph has.
    pub(crate) fn of(model: &Model) -> Option<Self> {
        let mut graph = Self::default();
        graph.add(Node::constant(0.0));
        let at = ["x", "y", "z"].map(|name| [Symbol(graph.add(Node { name, inputs: [0; 4], bits: 0 }))]);
        GRAPH.replace(graph);
        let program = Program::<Symbol>::new(model, LocalFrame { center: DVec3::ZERO, scale: 1.0 });
        let [Symbol(result)] = program.run(&model.tokens, &at, &mut Stack::default());
        let graph = Self { result, ..GRAPH.take() };
        (!graph.is_incomplete).then(|| graph.needed())
    }

    fn add(&mut self, node: Node) -> u32 {
        *self.index.entry(node).or_insert_with(|| {
            self.nodes.push(node);
            self.nodes.len() as u32 - 1
        })
    }

    /// The graph without the nodes on which the result does not depend.
    fn needed(self) -> Self {
        let mut is_needed = vec![false; self.nodes.len()];
        is_needed[..4].fill(true);
        is_needed[self.result as usize] = true;
        for (i, node) in self.nodes.iter().enumerate().rev() {
            if is_needed[i] {
                node.inputs.iter().for_each(|&input| is_needed[input as usize] = true);
            }
        }
        let mut places = vec![0; self.nodes.len()];
        let mut kept = Self { images: self.images, ..Self::default() };
        for (i, node) in self.nodes.into_iter().enumerate().filter(|&(i, _)| is_needed[i]) {
            places[i] = kept.nodes.len() as u32;
            kept.nodes.push(Node { inputs: node.inputs.map(|input| places[input as usize]), ..node });
        }
        kept.result = places[self.result as usize];
        kept
    }
}

thread_local! {
    /// The graph to which operations of symbols on this thread add their nodes.
    static GRAPH: RefCell<Graph> = RefCell::default();
}

/// A number of the graph: the index of its node.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Symbol(u32);

impl Symbol {
    fn constant(self) -> Option<f64> {
        GRAPH.with_borrow(|graph| graph.nodes[self.0 as usize].value())
    }

    /// A node with these inputs.
    fn node<const N: usize>(name: &'static str, from: [Self; N]) -> Self {
        let mut inputs = [0; 4];
        inputs.iter_mut().zip(from).for_each(|(input, symbol)| *input = symbol.0);
        Self(GRAPH.with_borrow_mut(|graph| graph.add(Node { name, inputs, bits: 0 })))
    }

    /// A function of one symbol.
    fn map(self, name: &'static str, value: impl Fn(f64) -> f64) -> Self {
        match self.constant() {
            Some(x) => Self::of(value(x)),
            None => Self::node(name, [self]),
        }
    }

    /// A function of two symbols.
    fn zip(self, other: Self, name: &'static str, value: impl Fn(f64, f64) -> f64) -> Self {
        match (self.constant(), other.constant()) {
            (Some(x), Some(y)) => Self::of(value(x, y)),
            _ => Self::node(name, [self, other]),
        }
    }
}

/// A comparison of symbols has no value; fields compare them by [`Scalar::select_less`].
impl PartialOrd for Symbol {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        let (Some(x), Some(y)) = (self.constant(), other.constant()) else {
            GRAPH.with_borrow_mut(|graph| graph.is_incomplete = true);
            return None;
        };
        x.partial_cmp(&y)
    }
}

impl Add for Symbol {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        match (self.constant(), other.constant()) {
            (Some(0.0), _) => other,
            (_, Some(0.0)) => self,
            _ => self.zip(other, "addition", |x, y| x + y),
        }
    }
}

impl AddAssign for Symbol {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Symbol {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        if other.constant() == Some(0.0) { self } else { self.zip(other, "subtraction", |x, y| x - y) }
    }
}

impl Mul for Symbol {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        match (self.constant(), other.constant()) {
            (Some(1.0), _) => other,
            (_, Some(1.0)) => self,
            (Some(0.0), _) | (_, Some(0.0)) => Self::default(),
            _ => self.zip(other, "multiplication", |x, y| x * y),
        }
    }
}

impl Div for Symbol {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        if other.constant() == Some(1.0) { self } else { self.zip(other, "division", |x, y| x / y) }
    }
}

impl Neg for Symbol {
    type Output = Self;
    fn neg(self) -> Self {
        Self::default() - self
    }
}

impl Scalar for Symbol {
    const IS_SYMBOLIC: bool = true;

    fn of(value: f64) -> Self {
        Self(GRAPH.with_borrow_mut(|graph| graph.add(Node::constant(value))))
    }

    fn widen(self) -> f64 {
        self.constant().unwrap_or_else(|| {
            GRAPH.with_borrow_mut(|graph| graph.is_incomplete = true);
            0.0
        })
    }

    fn sqrt(self) -> Self {
        self.map("sqrt", f64::sqrt)
    }

    fn abs(self) -> Self {
        self.map("abs", f64::abs)
    }

    fn sin(self) -> Self {
        self.map("sin", f64::sin)
    }

    fn cos(self) -> Self {
        self.map("cos", f64::cos)
    }

    fn floor(self) -> Self {
        self.map("floor", f64::floor)
    }

    fn atan2(self, x: Self) -> Self {
        self.zip(x, "atan2", f64::atan2)
    }

    fn least(self, other: Self) -> Self {
        if other.constant() == Some(f64::INFINITY) { self } else { self.zip(other, "min", f64::min) }
    }

    fn most(self, other: Self) -> Self {
        self.zip(other, "max", f64::max)
    }

    fn branch_less<const N: usize>(
        a: Self,
        b: Self,
        then: impl FnOnce() -> [Self; N],
        otherwise: impl FnOnce() -> [Self; N],
    ) -> [Self; N] {
        let (then, otherwise) = (then(), otherwise());
        std::array::from_fn(|i| Self::select_less(a, b, then[i], otherwise[i]))
    }

    fn image_sample(volume: &Arc<VolumeLeaf>, at: [Self; 3]) -> Option<Self> {
        let bits = GRAPH.with_borrow_mut(|graph| {
            let earlier = graph.images.iter().position(|other| Arc::ptr_eq(other, volume));
            earlier.unwrap_or_else(|| {
                graph.images.push(volume.clone());
                graph.images.len() - 1
            })
        });
        let layout = Layout::of(volume);
        let number = |value: usize| Self::of(value as f64);
        let texel = |at: [Self; 3]| {
            let share = |axis: usize| (at[axis] + Self::of(0.5)) / number(layout.shape[axis]);
            let [Self(u), Self(v), Self(w)] = [share(0), share(1), share(2)];
            let node = Node { name: "image", inputs: [u, v, w, 0], bits: bits as u64 };
            Self(GRAPH.with_borrow_mut(|graph| graph.add(node)))
        };
        let whole = texel(at);
        if volume.divided().blocks().is_empty() {
            return Some(whole);
        }
        let last = volume.grid().shape.map(|n| number(n.saturating_sub(2)));
        let cell = [0, 1, 2].map(|axis| at[axis].floor().least(last[axis]));
        // A texel t has the value (2 t / 65535 - 1) reach.
        let scale = Self::of((DIGITS - 1) as f64 / 2.0);
        let reach = Self::of(f64::from(reach(volume)));
        let digit = |first: usize| {
            let value = texel([cell[0], cell[1], cell[2] + number(first)]);
            ((value / reach + Self::of(1.0)) * scale + Self::of(0.5)).floor()
        };
        let block = digit(layout.low_digits) + digit(layout.high_digits) * number(DIGITS) - Self::of(1.0);
        // The whole part of a quotient, and the remainder.
        let divide = |value: Self, by: usize| {
            let quotient = ((value + Self::of(0.5)) / number(by)).floor();
            (quotient, value - quotient * number(by))
        };
        let (line, column) = divide(block, layout.columns);
        let (sheet, row) = divide(line, layout.rows);
        let first = [column, row, sheet].map(|index| index * number(PARTS + 1));
        let part = |axis: usize| first[axis] + (at[axis] - cell[axis]) * number(PARTS);
        let fine = texel([part(0), part(1), part(2) + number(layout.blocks)]);
        Some(Self::select_less(block, Self::default(), whole, fine))
    }

    fn select_less(a: Self, b: Self, then: Self, otherwise: Self) -> Self {
        match (a.constant(), b.constant()) {
            (Some(x), Some(y)) => {
                if x < y {
                    then
                } else {
                    otherwise
                }
            }
            _ if then == otherwise => then,
            _ => Self::node("select", [a, b, then, otherwise]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::text::language::parse;

    /// The value of a graph at a point.
    fn value(graph: &Graph, p: [f64; 3]) -> f64 {
        let mut values: Vec<f64> = Vec::new();
        for node in &graph.nodes {
            let [a, b, c, d] = node.inputs.map(|input| values.get(input as usize).copied().unwrap_or_default());
            values.push(match node.name {
                "constant" => node.value().unwrap(),
                "x" => p[0],
                "y" => p[1],
                "z" => p[2],
                "addition" => a + b,
                "subtraction" => a - b,
                "multiplication" => a * b,
                "division" => a / b,
                "sqrt" => a.sqrt(),
                "abs" => a.abs(),
                "sin" => a.sin(),
                "cos" => a.cos(),
                "floor" => a.floor(),
                "atan2" => a.atan2(b),
                "min" => a.min(b),
                "max" => a.max(b),
                "select" => {
                    if a < b {
                        c
                    } else {
                        d
                    }
                }
                other => panic!("{other}"),
            });
        }
        values[graph.result as usize]
    }

    #[test]
    fn values_are_the_values_of_the_program() {
        for text in ["(union (sphere 1) (move 1 2 3 (rotate-x 30 (box 1 2 3))))", "(gyroid 1 0.1)"] {
            let model = Model::new(&parse(text).unwrap()).unwrap();
            let graph = Graph::of(&model).unwrap();
            let program = Program::<f64>::new(&model, LocalFrame { center: DVec3::ZERO, scale: 1.0 });
            for p in [[0.3, -0.4, 0.9], [1.1, 2.3, 2.9], [5.0, 0.0, 0.0]] {
                let truth = program.run(&model.tokens, &p.map(|x| [x]), &mut Stack::default())[0];
                assert!((value(&graph, p) - truth).abs() <= 1e-14, "{text} at {p:?}");
            }
        }
    }

    #[test]
    fn equal_operations_are_one_node() {
        let sphere = Graph::of(&Model::new(&parse("(sphere 1)").unwrap()).unwrap()).unwrap();
        let twice = "(xor (sphere 1) (sphere 1))";
        let twice = Graph::of(&Model::new(&parse(twice).unwrap()).unwrap()).unwrap();
        assert!(twice.nodes.len() <= sphere.nodes.len() + 8);
    }
}
