//! The stack of an evaluation in postfix order.

/// Results that wait for their operator, or a value for each warp that has begun. No token comes before its operands
/// ([`super::token::Token`]), and no end of a warp before its start, so a missing entry is an error of this program.
#[derive(Debug, Clone)]
pub(crate) struct OperandStack<T>(Vec<T>);

impl<T> Default for OperandStack<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

/// The message of the panic for a missing entry.
const MISSING: &str = "operands come before their token, and the start of a warp before its end";

impl<T> OperandStack<T> {
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        Self(Vec::with_capacity(capacity))
    }

    #[inline(always)]
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    #[inline(always)]
    pub(crate) fn push(&mut self, result: T) {
        self.0.push(result);
    }

    /// Removes the last result.
    #[inline(always)]
    pub(crate) fn pop(&mut self) -> T {
        // Tokens are in postfix order, so the operand was pushed before its operator.
        self.0.pop().expect(MISSING)
    }

    /// Removes the last `count` results, in their order.
    pub(crate) fn pop_many(&mut self, count: usize) -> Vec<T> {
        let mut results: Vec<T> = (0..count).map(|_| self.pop()).collect();
        results.reverse();
        results
    }

    /// Removes the result of all tokens; None without tokens.
    #[inline(always)]
    pub(crate) fn finish(&mut self) -> Option<T> {
        self.0.pop()
    }

    #[inline(always)]
    pub(crate) fn top(&self) -> &T {
        // The position of the whole shape is pushed first, and each warp removes only its own.
        self.0.last().expect(MISSING)
    }

    #[inline(always)]
    pub(crate) fn top_mut(&mut self) -> &mut T {
        // Tokens are in postfix order, so the operand was pushed before its operator.
        self.0.last_mut().expect(MISSING)
    }

    /// The last two results, in the order of their evaluation; None if there are fewer.
    #[inline(always)]
    pub(crate) fn top_two(&self) -> Option<[&T; 2]> {
        self.0.last_chunk().map(|[first, second]| [first, second])
    }
}
