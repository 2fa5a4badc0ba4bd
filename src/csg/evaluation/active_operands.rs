//! The part of a program that decides a field at some points.
//!
//! Where the operands of a sharp union differ, the smaller one is the field, and its gradient is the gradient of the
//! field. The same holds for the other operators, and for blends outside their width. A list of tokens without the
//! operands that have no effect at any of some points therefore returns the same bits there, for values and for
//! gradients. One evaluation without gradients finds it.

use super::program::{Joint, PlacedCombine, Program, Stack};
use crate::csg::model::token::Token;
use crate::csg::tree::kind::Op;
use crate::simd::with_vectors;

/// Tokens that decide a field, and the buffers of their search.
#[derive(Debug, Default)]
pub(crate) struct ActiveTokens<const N: usize> {
    found: Vec<Token>,
    /// First token of each operand.
    starts: Vec<usize>,
    stack: Stack<f64, N>,
}

impl<const N: usize> ActiveTokens<N> {
    /// The tokens among `tokens` that decide the field at `N` points, local units. A difference that is minus its
    /// second operand becomes the complement of this operand.
    pub(crate) fn find(&mut self, program: &Program<f64>, tokens: &[Token], at: &[[f64; N]; 3]) -> &[Token] {
        search(self, program, tokens, at);
        &self.found
    }
}

fn search<const N: usize>(buffers: &mut ActiveTokens<N>, program: &Program<f64>, tokens: &[Token], at: &[[f64; N]; 3]) {
    with_vectors!(
        [const N: usize]
        (buffers: &mut ActiveTokens<N> = buffers, program: &Program<f64> = program, tokens: &[Token] = tokens,
         at: &[[f64; N]; 3] = at)
        {
            let ActiveTokens { found, starts, stack } = buffers;
            found.clear();
            starts.clear();
            stack.start(at);
            for &token in tokens {
                match token {
                    Token::Leaf(_) => starts.push(found.len()),
                    // The operand of a warp now begins with its `Enter`, which comes directly before it.
                    Token::Leave(_) => starts.iter_mut().next_back().into_iter().for_each(|start| *start -= 1),
                    _ => {}
                }
                let mut kept = Some(token);
                if let (Token::Combine(i), &[.., first, second]) = (token, &starts[..]) {
                    let combine = &program.combines[i as usize];
                    let decides = stack.top_two().and_then(|[a, b]| combine.deciding(a, b));
                    match decides {
                        Some(Operand::First) => found.truncate(second),
                        Some(Operand::Second) => drop(found.drain(first..second)),
                        None => {}
                    }
                    if let Some(decides) = decides {
                        kept = combine.negates(decides).then_some(Token::Complement);
                    }
                    starts.pop();
                }
                found.extend(kept);
                program.step(token, stack);
            }
        }
    );
}

/// An operand of a combination, in the order of evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Operand {
    First,
    Second,
}

impl PlacedCombine<f64> {
    /// The operand that alone decides the result at all points, if one does.
    #[inline(always)]
    fn deciding<const N: usize>(&self, first: &[f64; N], second: &[f64; N]) -> Option<Operand> {
        // A combination is the union of its operands, each with this sign, up to the sign of the result.
        let signs =
            [Operand::First, Operand::Second].map(|operand| if self.is_complemented(operand) { -1.0 } else { 1.0 });
        let mut decides = [self.op != Op::Xor; 2];
        for i in 0..N {
            let (a, b) = (signs[0] * first[i], signs[1] * second[i]);
            decides[0] &= self.joint.is_first(a, b);
            decides[1] &= self.joint.is_first(b, a);
        }
        match decides {
            [true, _] => Some(Operand::First),
            [_, true] => Some(Operand::Second),
            _ => None,
        }
    }

    /// Whether the union behind this combination has the complement of an operand.
    #[inline(always)]
    fn is_complemented(&self, operand: Operand) -> bool {
        match self.op {
            Op::Intersection => true,
            Op::Difference => (operand == Operand::Second) == self.is_swapped,
            Op::Union | Op::Xor => false,
        }
    }

    /// Whether the result is minus the operand that decides it.
    fn negates(&self, operand: Operand) -> bool {
        self.op == Op::Difference && !self.is_complemented(operand)
    }
}

impl Joint<f64> {
    /// Whether the union of two fields is the first one.
    #[inline(always)]
    fn is_first(&self, a: f64, b: f64) -> bool {
        match *self {
            Self::Sharp => a < b,
            Self::Smooth(k, _) => a < b && b - a > k,
            Self::Chamfer(k) => a < b && a < (a + b - k) * 0.5f64.sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::parts::solid::{Solid, run_wide};
    use crate::csg::text::language::parse;
    use glam::DVec3;

    #[test]
    fn the_deciding_tokens_return_the_same_bits() {
        let leaves = ["(sphere 2)", "(move 0.4 0.3 0 (box 1 2 1.5))", "(twist 30 (cone 2 1.5))"];
        let mut shorter = 0;
        for op in ["union", "inter", "diff", "xor"] {
            for joint in [op.to_owned(), format!("blend {op} 0.3"), format!("chamfer {op} 0.3")] {
                let pair = |a: &str, b: &str| format!("({joint} {a} {b})");
                let inner = pair(leaves[1], leaves[2]);
                for text in [pair(leaves[0], &inner), pair(&inner, leaves[0])] {
                    let solid = Solid::new(&parse(&text).unwrap_or_else(|error| panic!("{text}: {error}"))).unwrap();
                    let (program, tokens) = (solid.precise(), &solid.model.tokens);
                    let mut random = crate::mesh::random::uniform(3);
                    for _ in 0..200 {
                        let p = DVec3::new(random(), random(), random()) - 0.5;
                        let at: [[f64; 4]; 3] =
                            std::array::from_fn(|axis| std::array::from_fn(|i| p[axis] + 0.01 * (i * axis) as f64));
                        let mut deciding = ActiveTokens::default();
                        let found = deciding.find(program, tokens, &at);
                        let [all, some] =
                            [tokens, found].map(|list| run_wide(program, list, &at, &mut Stack::default()));
                        assert_eq!(all.map(f64::to_bits), some.map(f64::to_bits), "{text} at {p}");
                        shorter += usize::from(found.len() < tokens.len());
                    }
                }
            }
        }
        // 4 operators, 3 joints, 2 orders of 200 groups of points each; at most of them one operand decides.
        assert!(shorter >= 2400, "{shorter}");
    }
}
