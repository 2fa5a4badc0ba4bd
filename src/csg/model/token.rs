//! The tokens of a model in postfix order, and folds over them: the operands of a token come before it.

/// A step of the stack machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Token {
    /// Pushes the distance to a leaf.
    Leaf(u32),
    /// Pops two values and pushes their combination.
    Combine(u32),
    /// Subtracts a radius, or forms a shell; see [`super::lowered::DistanceOp`].
    DistanceOp(u32),
    /// Negates.
    Complement,
    /// The following tokens are evaluated at a changed position, up to the matching `Leave`.
    Enter(u32),
    Leave(u32),
}

/// A token with the results of its operands. The numbers index the tables of the model. `Enter` is not an operation: a
/// warp has one operand and ends with `Leave`.
pub(crate) enum Operation<T> {
    Leaf(u32),
    /// The operand that was evaluated first, then the other one.
    Combine(u32, T, T),
    DistanceOp(u32, T),
    Complement(T),
    Warp(u32, T),
}

/// The result of the last token; None without tokens. `apply` computes the result of a token; None ends the fold.
///
/// Tokens are in postfix order: no token comes before its operands.
pub(crate) fn fold_postfix<T>(tokens: &[Token], mut apply: impl FnMut(Operation<T>) -> Option<T>) -> Option<T> {
    let mut stack: Vec<T> = Vec::new();
    for &token in tokens {
        let operation = match token {
            Token::Leaf(leaf) => Operation::Leaf(leaf),
            Token::Combine(i) => {
                let top = operand(&mut stack)?;
                Operation::Combine(i, operand(&mut stack)?, top)
            }
            Token::DistanceOp(i) => Operation::DistanceOp(i, operand(&mut stack)?),
            Token::Complement => Operation::Complement(operand(&mut stack)?),
            Token::Enter(_) => continue,
            Token::Leave(i) => Operation::Warp(i, operand(&mut stack)?),
        };
        let result = apply(operation)?;
        stack.push(result);
    }
    stack.pop()
}

/// The operand on top of the stack.
fn operand<T>(stack: &mut Vec<T>) -> Option<T> {
    debug_assert!(!stack.is_empty(), "tokens are not in postfix order");
    stack.pop()
}
