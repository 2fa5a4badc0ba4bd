// Features that the kernel of any shape may need. A kernel specialised for one shape imports another variant of this
// file, with the features of that shape. Branches on these constants are resolved at compile time.

// HAS_CHORDS: a part is intersected in closed form. COMBINES_CHORDS: such a part is more than a union. CHORD_LEAVES:
// largest number of leaves of such a part.
const HAS_CHORDS: bool = true;
const COMBINES_CHORDS: bool = true;
const CHORD_LEAVES: u32 = 12u;
// A part is sphere traced.
const MARCHES: bool = true;
