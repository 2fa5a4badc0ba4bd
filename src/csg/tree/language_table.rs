//! Forms of the language with numbers only: one table row serves the reader and the writer.

/// A form `(word number...)` and its operation in the Python interface.
#[derive(Debug)]
pub(crate) struct Word {
    pub word: &'static str,
    /// The name in [`super::primitive::Primitive::named`] or [`super::shape::Shape::changed`].
    pub operation: &'static str,
    /// One entry for each argument of the operation.
    pub slots: &'static [NumberSource],
}

/// The source of one argument. The text is the name of the number in messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NumberSource {
    /// The argument is the number.
    Full(&'static str),
    /// The argument is half the number. The language has diameters where the interface has radii.
    Half(&'static str),
    /// The argument is half the number minus the next argument: the radius of the circle inside a tube, from the outer
    /// diameter.
    Rim(&'static str),
    /// The argument is 0, without a number.
    Zero,
    /// The argument is 1, without a number.
    One,
    /// The argument equals the one before, without a number.
    Same,
}

impl Word {
    /// The arguments of the operation; `None` if the form takes another number of values.
    pub(crate) fn arguments(&self, numbers: &[f64]) -> Option<Vec<f64>> {
        let mut remaining = numbers.iter().rev();
        let mut arguments = vec![0.0; self.slots.len()];
        // The arguments are computed from the last to the first, because a rim needs the argument behind it.
        for (i, slot) in self.slots.iter().enumerate().rev() {
            arguments[i] = match slot {
                NumberSource::Full(_) => *remaining.next()?,
                NumberSource::Half(_) => 0.5 * remaining.next()?,
                NumberSource::Rim(_) => 0.5 * remaining.next()? - arguments[i + 1],
                NumberSource::One => 1.0,
                NumberSource::Zero | NumberSource::Same => 0.0,
            };
        }
        for i in 1..arguments.len() {
            if self.slots[i] == NumberSource::Same {
                arguments[i] = arguments[i - 1];
            }
        }
        remaining.next().is_none().then_some(arguments)
    }

    /// The numbers that give these arguments; `None` if the form cannot express them.
    pub(crate) fn numbers(&self, arguments: &[f64]) -> Option<Vec<f64>> {
        let mut numbers = Vec::with_capacity(arguments.len());
        for (i, (slot, &argument)) in self.slots.iter().zip(arguments).enumerate() {
            match slot {
                NumberSource::Full(_) => numbers.push(argument),
                NumberSource::Half(_) => numbers.push(2.0 * argument),
                NumberSource::Rim(_) => numbers.push(2.0 * (argument + arguments[i + 1])),
                NumberSource::Zero if argument == 0.0 => {}
                NumberSource::One if argument == 1.0 => {}
                NumberSource::Same if argument == arguments[i - 1] => {}
                NumberSource::Zero | NumberSource::One | NumberSource::Same => return None,
            }
        }
        (self.slots.len() == arguments.len()).then_some(numbers)
    }

    /// The form for messages, such as `(cylinder d h)`.
    pub(crate) fn usage(&self) -> String {
        let names = self.slots.iter().filter_map(|slot| match slot {
            NumberSource::Full(name) | NumberSource::Half(name) | NumberSource::Rim(name) => Some(*name),
            NumberSource::Zero | NumberSource::One | NumberSource::Same => None,
        });
        format!("({})", [self.word].into_iter().chain(names).collect::<Vec<_>>().join(" "))
    }
}
