// What a picture of any shape may need. A kernel that is written for a shape has another text in place of this file, which
// says what that shape needs: branches on these go as the text is compiled.

// Some part is met in closed form; some such part is more than a union; leaves of one at most.
const HAS_CHORDS: bool = true;
const COMBINES_CHORDS: bool = true;
const CHORD_LEAVES: u32 = 12u;
// Some part is met by marching its field.
const MARCHES: bool = true;
