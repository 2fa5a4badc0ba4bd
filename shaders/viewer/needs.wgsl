// Which kinds of fields a view has. The text of a view replaces this file and drops the lines of the other kinds.

const HAS_DENSE: bool = true;
const HAS_SPARSE: bool = true;
const HAS_SHAPE: bool = true;
const HAS_QUADRIC: bool = true;
// Whether there is a slice. The viewer sets this to false in the text where there is none: smaller programs start
// faster.
const HAS_SLICE: bool = true;
// Whether the program draws pictures in motion, which read dense grids by the filter of the device. The viewer sets
// this.
const IS_MOTION: bool = false;
// The encoding of all sampled fields; -1 where they differ.
const ONE_ENCODING: i32 = -1;
