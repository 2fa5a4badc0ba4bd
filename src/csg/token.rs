//! The tokens of a model in postfix order, and folds over them: the operands of a token come before it.

/// A step of the stack machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Token {
    /// Pushes the distance to a leaf.
    Leaf(u32),
    /// Pops two values and pushes their combination.
    Combine(u32),
    /// Subtracts a radius, or forms a shell; see [`super::model::DistanceOp`].
    DistanceOp(u32),
    /// Negates.
    Complement,
    /// The following tokens are evaluated at a changed position, up to the matching `Leave`.
    Enter(u32),
    Leave(u32),
}

/// A token with the results of its operands. The numbers index the tables of the model. `Enter` is not an operation: a
/// warp has one operand and ends with `Leave`.
pub(super) enum Operation<T> {
    Leaf(u32),
    /// The operand that was evaluated first, then the other one.
    Combine(u32, T, T),
    DistanceOp(u32, T),
    Complement(T),
    Warp(u32, T),
}

/// The result of the last token. `apply` computes the result of a token; None ends the fold. The fold is also None
/// without tokens, and if a token comes before its operands.
pub(super) fn fold_postfix<T>(tokens: &[Token], mut apply: impl FnMut(Operation<T>) -> Option<T>) -> Option<T> {
    let mut stack: Vec<T> = Vec::new();
    for &token in tokens {
        let operation = match token {
            Token::Leaf(leaf) => Operation::Leaf(leaf),
            Token::Combine(i) => {
                let top = stack.pop()?;
                Operation::Combine(i, stack.pop()?, top)
            }
            Token::DistanceOp(i) => Operation::DistanceOp(i, stack.pop()?),
            Token::Complement => Operation::Complement(stack.pop()?),
            Token::Enter(_) => continue,
            Token::Leave(i) => Operation::Warp(i, stack.pop()?),
        };
        let result = apply(operation)?;
        stack.push(result);
    }
    stack.pop()
}
