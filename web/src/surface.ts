// The level set of a dense grid as triangles, for pictures in motion: surface nets, whose corners lie in the cells that the
// level crosses. Beyond the grid a sample has the size of the nearest one of the grid and is outside, so that the surface
// ends on the faces of the box.

import { Vector } from "./vectors";

/** Triangles of a level set. */
export interface Triangles {
  /** Six numbers for each corner: its place and a vector along the gradient, field space. */
  corners: Float32Array;
  indices: Uint32Array;
}

/** Values of a grid, x fastest. */
export interface Grid {
  counts: Vector;
  values: Float32Array;
  /** Voxels between two values. */
  step: number;
  /** Voxels of the field, whose box ends half a voxel beyond the first and the last one. */
  voxels: Vector;
}

/** An array that grows. */
class List<T extends Float32Array | Uint32Array> {
  length = 0;

  constructor(
    private values: T,
    private readonly longer: (count: number) => T,
  ) {}

  /** Room for `count` more values; the array and the place of the first. */
  room(count: number): [T, number] {
    const first = this.length;
    this.length += count;
    if (this.length > this.values.length) {
      const grown = this.longer(2 * this.length);
      grown.set(this.values);
      this.values = grown;
    }
    return [this.values, first];
  }

  get all(): T {
    return this.values.subarray(0, this.length) as T;
  }
}

/** The first corner of each edge of a cell, four for each axis. Bits of a corner: x, y, z. */
const EDGES = Uint8Array.of(0, 2, 4, 6, 0, 1, 4, 5, 0, 1, 2, 3);

const mixed = (p: number, q: number, t: number): number => p + (q - p) * t;
/** A place on an axis of `n` voxels, within the box. */
const within = (place: number, n: number): number => Math.max(-0.5, Math.min(n - 0.5, place));
const cut = (t: number): number => Math.max(0, Math.min(1, t));

export function levelSet({ counts, values, step, voxels }: Grid, level: number): Triangles {
  const [nx, ny, nz] = counts;
  // Whether each sample is inside, with one layer more on each side.
  const [px, py] = [nx + 2, ny + 2];
  const inside = new Uint8Array(px * py * (nz + 2));
  for (let z = 0, i = 0; z < nz; z++) {
    for (let y = 0; y < ny; y++) {
      for (let x = 0, to = 1 + px * (y + 1 + py * (z + 1)); x < nx; x++, i++, to++) inside[to] = values[i] <= level ? 1 : 0;
    }
  }
  const corners = new List(new Float32Array(1 << 16), (count) => new Float32Array(count));
  const indices = new List(new Uint32Array(1 << 17), (count) => new Uint32Array(count));
  const v = new Float64Array(8);
  const offsets = Int32Array.from({ length: 8 }, (_, k) => (k & 1) + nx * (((k >> 1) & 1) + ny * (k >> 2)));
  const last = (i: number, n: number) => (i < 0 ? 0 : i < n ? i : n - 1);
  /** The corner in the cell between samples x - 1 and x, y - 1 and y, z - 1 and z. */
  const corner = (x: number, y: number, z: number): number => {
    if (x > 0 && y > 0 && z > 0 && x < nx && y < ny && z < nz) {
      const base = x - 1 + nx * (y - 1 + ny * (z - 1));
      for (let k = 0; k < 8; k++) v[k] = values[base + offsets[k]] - level;
    } else {
      for (let k = 0; k < 8; k++) {
        const sx = x - 1 + (k & 1);
        const sy = y - 1 + ((k >> 1) & 1);
        const sz = z - 1 + (k >> 2);
        const value = values[last(sx, nx) + nx * (last(sy, ny) + ny * last(sz, nz))] - level;
        const isThere = sx === last(sx, nx) && sy === last(sy, ny) && sz === last(sz, nz);
        v[k] = isThere ? value : Math.abs(value) || 1e-30;
      }
    }
    // The mean of the zeros on the edges.
    let a = 0;
    let b = 0;
    let c = 0;
    let n = 0;
    for (let e = 0; e < 12; e++) {
      const k = EDGES[e];
      const bit = 1 << (e >> 2);
      const start = v[k];
      const end = v[k | bit];
      if (start <= 0 === end <= 0) continue;
      const t = start / (start - end);
      a += bit === 1 ? t : k & 1;
      b += bit === 2 ? t : (k >> 1) & 1;
      c += bit === 4 ? t : k >> 2;
      n++;
    }
    a /= n;
    b /= n;
    c /= n;
    const v00 = mixed(v[0], v[1], a);
    const v10 = mixed(v[2], v[3], a);
    const v01 = mixed(v[4], v[5], a);
    const v11 = mixed(v[6], v[7], a);
    const gx = mixed(mixed(v[1] - v[0], v[3] - v[2], b), mixed(v[5] - v[4], v[7] - v[6], b), c);
    const gy = mixed(v10 - v00, v11 - v01, c);
    const low = mixed(v00, v10, b);
    const high = mixed(v01, v11, b);
    const gz = high - low;
    // One step of Newton's method along the gradient, within the cell.
    const away = mixed(low, high, c) / (gx * gx + gy * gy + gz * gz || 1);
    const [to, first] = corners.room(6);
    to[first] = within(step * (x - 1 + cut(a - away * gx)), voxels[0]);
    to[first + 1] = within(step * (y - 1 + cut(b - away * gy)), voxels[1]);
    to[first + 2] = within(step * (z - 1 + cut(c - away * gz)), voxels[2]);
    to[first + 3] = gx;
    to[first + 4] = gy;
    to[first + 5] = gz;
    return first / 6;
  };
  const quad = (p: number, q: number, r: number, s: number) => {
    const [to, first] = indices.room(6);
    to[first] = to[first + 3] = p;
    to[first + 1] = q;
    to[first + 2] = to[first + 4] = r;
    to[first + 5] = s;
  };
  // The corners of two layers of cells.
  const row = nx + 1;
  let [before, own] = [new Int32Array(row * (ny + 1)), new Int32Array(row * (ny + 1))];
  for (let z = 0; z <= nz; z++, [before, own] = [own, before]) {
    for (let y = 0; y <= ny; y++) {
      const at = px * (y + py * z);
      let left = 0;
      for (let x = 0; x <= nx; x++) {
        // Bits of the samples with x at this place: (y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1). The first ones are outside.
        const i = at + x + 1;
        const right = inside[i] | (inside[i + px] << 1) | (inside[i + px * py] << 2) | (inside[i + px + px * py] << 3);
        const both = left | (right << 4);
        if (both !== 0 && both !== 255) {
          const cell = x + row * y;
          own[cell] = corner(x, y, z);
          // A face for each edge that starts at the first sample of the cell.
          if ((left & 1) !== (right & 1)) quad(before[cell - row], before[cell], own[cell], own[cell - row]);
          if ((left & 1) !== ((left >> 1) & 1)) quad(before[cell - 1], before[cell], own[cell], own[cell - 1]);
          if ((left & 1) !== ((left >> 2) & 1)) quad(own[cell - row - 1], own[cell - row], own[cell], own[cell - 1]);
        }
        left = right;
      }
    }
  }
  return { corners: corners.all, indices: indices.all };
}
