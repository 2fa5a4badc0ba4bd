// The data of a view: a description in JSON, then the words that the shader reads.
//
//     uint32        length of the description, bytes
//     UTF-8         the description, padded with spaces to a multiple of four bytes
//     uint32 ...    samples of the instances (shaders/viewer/data.wgsl)

import { Program } from "./backend";
import { CameraState } from "./camera";
import { Grid, Triangles } from "./surface";
import { Affine, Vector, cross, subtract } from "./vectors";

export interface InstanceData {
  name: string;
  /** Texels 14 to 21 of the row of this instance, as shaders/viewer/table.wgsl draws it. */
  record: number[];
  fieldFromWorld: Affine;
  color: Vector;
  specular: number;
  emission: Vector;
  shininess: number;
  /** Difference between neighbouring samples of a dense grid that 1 % of the pairs exceed, units of the samples. */
  slope: number;
  /** Numbers of vertices and faces of the mesh whose field this is, where the view has them; null elsewhere. */
  mesh: [number, number] | null;
  /** Share of the view's largest error at a byte of 255 in the map of errors. */
  errorShare: number;
}

/** Dense grids as one texture of signed bytes, stacked along z. */
export interface FilteredGrids {
  size: Vector;
  texels: Int8Array<ArrayBuffer>;
  /** Texel 22 of the row of each instance, as shaders/viewer/table.wgsl draws it. */
  places: number[][];
}

export interface LightData {
  /** 0: `vector` is the direction in which the light travels. 1: `vector` is the position of the light. */
  kind: number;
  vector: Vector;
  color: Vector;
  /** Distance at which the light ends, world units; 0 for a light without falloff. */
  range: number;
  /** Axis of the cone of a spot light, and the cosines of its inner and outer angle; null for all directions. */
  spot: number[] | null;
}

/** A page of an atlas: its picture as an address, and its volumes in rectangles of left, top, width and height, shares. */
export interface PageData {
  title: string;
  picture: string;
  volumes: { name: string; box: [number, number, number, number] }[];
}

/** Sliders of a page: numbers of the first instance that change linearly with parameters. */
export interface SliderData {
  /** Places of the numbers that change, counted from the first number of the instance, and their first values. */
  places: number[];
  numbers: number[];
  /** The range of each parameter, its first value, and the change of each number per unit. */
  parameters: { name: string; range: [number, number]; value: number; slopes: number[] }[];
}

export interface ViewData {
  title: string;
  size: [number, number];
  /** Null for the triangles of level sets and of meshes that the view does not draw. */
  programs: { rays: Program; triangles: Program | null; mesh: Program | null };
  instances: InstanceData[];
  /** Null if the view has only the key light, which moves with the camera. */
  lights: LightData[] | null;
  key: { direction: Vector; color: Vector };
  background: [number, number, number, number];
  ambient: number;
  bounds: [Vector, Vector];
  camera: CameraState;
  /** Smallest and largest level at which the data have a surface, world units. */
  levels: [number, number];
  /** Distance at which the colours of a slice saturate, world units. */
  range: number;
  /** Distance between two iso-lines of a slice, world units. */
  spacing: number;
  most_steps: number;
  /** Largest error of the stored samples, world units; null where the samples are exact or their errors are not known. */
  error: number | null;
  pages: PageData[];
  sliders: SliderData | null;
  note: string;
}

/** Indices of numbers in a record. */
const [KIND, ENCODING, SCALE, FIRST, SHAPE, EMPTY, BLOCKS, MASKS] = [0, 1, 2, 3, 4, 7, 8, 11];
const [LOWER, FLAGS, UPPER, OBJECT, UNIT, INDEX] = [12, 15, 16, 19, 20, 24];
const VISIBLE = 1;
export const [DENSE, SPARSE] = [0, 1];
/** Largest distance in blocks that the map of empty space stores. */
const FARTHEST = 32;
/** Distances in a filtered texture reach so far, texels. */
const REACH = 8;
/** Largest numbers of values in a grid whose level set becomes triangles: for fast devices, and for slow ones. */
const FINE_VALUES = 2 ** 23;
const COARSE_VALUES = 2 ** 18;
/** Largest number of texels in a filtered texture. */
const MOST_TEXELS = 2 ** 25;

export class Data {
  readonly description: ViewData;
  readonly words: Uint32Array<ArrayBuffer>;
  private readonly bytes: Uint8Array;
  /** For each instance, the least sample of each block. */
  private readonly least = new Map<number, Float32Array>();
  /** The grids of the triangles, by their first sample and the distance between their values. */
  private readonly grids = new Map<string, Grid>();

  constructor(buffer: ArrayBuffer) {
    const length = new DataView(buffer).getUint32(0, true);
    this.description = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    const start = 4 + 4 * Math.ceil(length / 4);
    this.words = new Uint32Array(buffer.slice(start));
    this.bytes = new Uint8Array(this.words.buffer);
  }

  /** Write the numbers of the first instance for these values of the sliders. */
  setParameters(values: number[]): void {
    const { sliders, instances } = this.description;
    if (!sliders) return;
    const numbers = new Float32Array(this.words.buffer, 4 * instances[0].record[FIRST]);
    sliders.places.forEach((place, i) => {
      let number = sliders.numbers[i];
      sliders.parameters.forEach(({ value, slopes }, k) => (number += (values[k] - value) * slopes[i]));
      numbers[place] = number;
    });
  }

  get count(): number {
    return this.description.instances.length;
  }

  /** Whether an instance has data besides dense grids, which pictures in motion read from the texture of words. */
  get hasOtherThanDense(): boolean {
    return this.description.instances.some(({ record }) => record[KIND] !== DENSE);
  }

  /** The dense grids for pictures in motion. Every `step`-th sample is kept, so that no side of the texture exceeds `most`. */
  filtered(most: number): FilteredGrids {
    const { instances } = this.description;
    const grids = new Map(instances.filter(({ record }) => record[KIND] === DENSE).map((one) => [one.record[FIRST], one]));
    let step = 0;
    let counts: Vector[];
    let size: Vector;
    do {
      step++;
      counts = [...grids.values()].map(({ record }) => this.thinnedCounts(record, step));
      const along = (axis: number) => counts.map((count) => count[axis]);
      size = [Math.max(1, ...along(0)), Math.max(1, ...along(1)), Math.max(1, along(2).reduce((sum, n) => sum + n, 0))];
    } while (Math.max(...size) > most || size[0] * size[1] * size[2] > MOST_TEXELS);

    const texels = new Int8Array(size[0] * size[1] * size[2]);
    const places = new Map<number, number[]>();
    let layer = 0;
    [...grids].forEach(([first, { record, slope }], i) => {
      const reach = REACH * step * (slope || 1);
      const start = layer;
      this.thinned(record, step, (value, x, y, z) => {
        texels[x + size[0] * (y + size[1] * (start + z))] = Math.round(127 * Math.max(-1, Math.min(1, value / reach)));
      });
      places.set(first, [layer, 1 / step, reach, 1 / (slope || 1)]);
      layer += counts[i][2];
    });
    return { size, texels, places: instances.map(({ record }) => (record[KIND] === DENSE ? places.get(record[FIRST])! : [0, 1, 1, 1])) };
  }

  /** Samples along each axis if every `step`-th one is kept, and the last one. */
  private thinnedCounts(record: number[], step: number): Vector {
    return record.slice(SHAPE, SHAPE + 3).map((n) => Math.ceil((n - 1) / step) + 1) as Vector;
  }

  /** Pass every `step`-th sample of a dense grid along each axis, and the last one, to `put` with its index. */
  private thinned(record: number[], step: number, put: (value: number, x: number, y: number, z: number) => void): void {
    const [nx, ny, nz] = record.slice(SHAPE, SHAPE + 3);
    const [cx, cy, cz] = this.thinnedCounts(record, step);
    const sample = this.samples(record);
    for (let z = 0; z < cz; z++) {
      for (let y = 0; y < cy; y++) {
        const row = nx * (Math.min(step * y, ny - 1) + ny * Math.min(step * z, nz - 1));
        for (let x = 0; x < cx; x++) put(sample(row + Math.min(step * x, nx - 1)), x, y, z);
      }
    }
  }

  /** The number by which instances of the same dense grid are known. */
  gridOf(record: number[]): number {
    return record[FIRST];
  }

  isVisible(record: number[]): boolean {
    return (record[FLAGS] & VISIBLE) !== 0;
  }

  /** A level, world units, in the units of the samples of an instance. */
  ownLevel(record: number[], level: number): number {
    return Math.fround(level / record[UNIT]);
  }

  /** Whether a picture can have the triangles of a mesh in place of its field. */
  get hasMesh(): boolean {
    return !this.hasOtherThanDense && this.description.instances.some(({ mesh }) => mesh);
  }

  /** The triangles of an instance's mesh, each with its own corners. */
  mesh({ record, mesh }: InstanceData): Triangles {
    const [vertices, faces] = mesh!;
    const start = 4 * record[INDEX];
    const places = new Float32Array(this.words.buffer, start, 3 * vertices);
    const indices = new Uint32Array(this.words.buffer, start + 12 * vertices, 3 * faces);
    const corners = new Float32Array(6 * indices.length);
    const vertex = (i: number) => [...places.subarray(3 * indices[i], 3 * indices[i] + 3)] as Vector;
    for (let i = 0; i < indices.length; i += 3) {
      const [a, b, c] = [vertex(i), vertex(i + 1), vertex(i + 2)];
      const normal = cross(subtract(b, a), subtract(c, a));
      [a, b, c].forEach((corner, k) => corners.set([...corner, ...normal], 6 * (i + k)));
    }
    return { corners, indices: Uint32Array.from(indices.keys()) };
  }

  /** The values of a dense grid; of a large one every `step`-th. A coarse grid keeps fewer values. */
  grid(record: number[], isCoarse: boolean): Grid {
    const [nx, ny, nz] = record.slice(SHAPE, SHAPE + 3);
    const step = Math.ceil(Math.cbrt((nx * ny * nz) / (isCoarse ? COARSE_VALUES : FINE_VALUES)));
    const key = `${record[FIRST]} ${step}`;
    const known = this.grids.get(key);
    if (known) return known;
    const counts = this.thinnedCounts(record, step);
    const values = new Float32Array(counts[0] * counts[1] * counts[2]);
    let i = 0;
    this.thinned(record, step, (value) => (values[i++] = value));
    const made: Grid = { counts, values, step, voxels: [nx, ny, nz] };
    this.grids.set(key, made);
    return made;
  }

  /** The name of an object; several instances may belong to it. */
  nameOf(object: number): string {
    return this.description.instances.find(({ record }) => record[OBJECT] === object)?.name ?? "";
  }

  /** Corners of an instance's box, field space. */
  box(instance: number): [Vector, Vector] {
    const { record } = this.description.instances[instance];
    const corner = (at: number) => record.slice(at, at + 3) as Vector;
    return [corner(LOWER), corner(UPPER)];
  }

  /** Store for each block how many blocks around it are above a level, world units, and which cells may contain a root. */
  markEmpty(level: number): void {
    for (let i = 0; i < this.count; i++) {
      const { record } = this.description.instances[i];
      if (record[KIND] > SPARSE) continue;
      if (!this.least.has(i)) this.least.set(i, record[KIND] === DENSE ? this.leastOfBlocks(record) : this.leastOfBricks(record));
      const least = this.least.get(i)!;
      const own = this.ownLevel(record, level);
      const distance = this.bytes.subarray(4 * record[EMPTY], 4 * record[EMPTY] + least.length);
      for (let b = 0; b < least.length; b++) distance[b] = least[b] <= own ? 0 : FARTHEST;
      if (record[KIND] === DENSE) this.markCells(record, distance, own);
      spread(distance, record.slice(BLOCKS, BLOCKS + 3));
    }
  }

  /** The least sample of each block of 4^3 cells. Neighbouring blocks share the samples on their faces. */
  private leastOfBlocks(record: number[]): Float32Array {
    const [nx, ny, nz] = record.slice(SHAPE, SHAPE + 3);
    const [bx, by, bz] = record.slice(BLOCKS, BLOCKS + 3);
    const sample = this.samples(record);
    const least = new Float32Array(bx * by * bz).fill(Infinity);
    const row = new Float32Array(bx);
    for (let z = 0, i = 0; z < nz; z++) {
      for (let y = 0; y < ny; y++) {
        // Sample x is a corner of cells x - 1 and x, which lie in blocks floor(x / 4) and floor((x + 1) / 4).
        row.fill(Infinity);
        for (let x = 0; x < nx; x++, i++) {
          const value = sample(i);
          const b = x >> 2;
          if (value < row[b]) row[b] = value;
          if ((x & 3) === 3 && value < row[b + 1]) row[b + 1] = value;
        }
        for (let cz = z >> 2; cz <= (z + 1) >> 2; cz++) {
          for (let cy = y >> 2; cy <= (y + 1) >> 2; cy++) {
            const first = bx * (cy + by * cz);
            for (let b = 0; b < bx; b++) if (row[b] < least[first + b]) least[first + b] = row[b];
          }
        }
      }
    }
    return least;
  }

  /** Set the bit of each cell with a corner that is not above the level, in the blocks at distance 0. */
  private markCells(record: number[], distance: Uint8Array, level: number): void {
    const [nx, ny, nz] = record.slice(SHAPE, SHAPE + 3);
    const [bx, by] = record.slice(BLOCKS, BLOCKS + 2);
    const sample = this.samples(record);
    const masks = this.words.subarray(record[MASKS], record[MASKS] + 2 * distance.length).fill(0);
    for (let b = 0; b < distance.length; b++) {
      if (distance[b] > 0) continue;
      const [x0, y0, z0] = [4 * (b % bx), 4 * (Math.floor(b / bx) % by), 4 * Math.floor(b / (bx * by))];
      // Sample s of the block, 0 to 4 on each axis, is a corner of its cells s - 1 and s; sample 0 is one before the block.
      for (let z = 0; z < 5; z++) {
        const row = Math.min(Math.max(z0 - 1 + z, 0), nz - 1);
        for (let y = 0; y < 5; y++) {
          const line = nx * (Math.min(Math.max(y0 - 1 + y, 0), ny - 1) + ny * row);
          for (let x = 0; x < 5; x++) {
            if (sample(line + Math.min(Math.max(x0 - 1 + x, 0), nx - 1)) > level) continue;
            for (let cz = Math.max(z - 1, 0); cz <= Math.min(z, 3); cz++) {
              for (let cy = Math.max(y - 1, 0); cy <= Math.min(y, 3); cy++) {
                for (let cx = Math.max(x - 1, 0); cx <= Math.min(x, 3); cx++) {
                  masks[2 * b + (cz >> 1)] |= 1 << (cx + 4 * cy + 16 * (cz & 1));
                }
              }
            }
          }
        }
      }
    }
  }

  /** The least sample of each brick. A brick without samples lies inside (-Infinity) or outside (Infinity) as a whole. */
  private leastOfBricks(record: number[]): Float32Array {
    const [bx, by, bz] = record.slice(BLOCKS, BLOCKS + 3);
    const sample = this.samples(record);
    const known = new Map<number, number>();
    return Float32Array.from({ length: bx * by * bz }, (_, b) => {
      const word = this.words[record[INDEX] + b];
      if (word >>> 30 === 3) return word & 1 ? -Infinity : Infinity;
      const brick = word & 0x3fffffff;
      if (!known.has(brick)) {
        let least = Infinity;
        for (let i = 512 * brick; i < 512 * (brick + 1); i++) least = Math.min(least, sample(i));
        known.set(brick, least);
      }
      return known.get(brick)!;
    });
  }

  /** The function that decodes sample `i` of an instance, as `decode_sample` in shaders/shared/field/decode.wgsl does. */
  private samples(record: number[]): (i: number) => number {
    const first = 4 * record[FIRST];
    const buffer = this.words.buffer;
    const scale = record[SCALE];
    switch (record[ENCODING]) {
      case 0: {
        const values = new Float32Array(buffer, first);
        return (i) => values[i];
      }
      case 1: {
        const values = new Uint16Array(buffer, first);
        return (i) => half(values[i]) * scale;
      }
      case 2: {
        const values = new Int16Array(buffer, first);
        return (i) => Math.max(values[i] / 32767, -1) * scale;
      }
      default: {
        const values = new Int8Array(buffer, first);
        return (i) => Math.max(values[i] / 127, -1) * scale;
      }
    }
  }
}

function half(bits: number): number {
  const magnitude = bits & 0x7fff;
  const size = magnitude < 0x400 ? magnitude * 2 ** -24 : (1024 + (bits & 0x3ff)) * 2 ** ((magnitude >> 10) - 25);
  return bits & 0x8000 ? -size : size;
}

/** Chessboard distances to the nearest 0, axis by axis: distance(i) = min over j of max(distance(j), |i - j|). */
function spread(distance: Uint8Array, [nx, ny, nz]: number[]): void {
  const line = new Uint8Array(Math.max(nx, ny, nz));
  const along = (n: number, stride: number, starts: Iterable<number>) => {
    for (const start of starts) {
      for (let i = 0; i < n; i++) line[i] = distance[start + i * stride];
      for (let i = 0; i < n; i++) {
        let best = line[i];
        // An element at a distance of `best` or more cannot lower it.
        for (let away = 1; away < best; away++) {
          if (i >= away) best = Math.min(best, Math.max(line[i - away], away));
          if (i + away < n) best = Math.min(best, Math.max(line[i + away], away));
        }
        distance[start + i * stride] = best;
      }
    }
  };
  function* grid(a: number, stepA: number, b: number, stepB: number) {
    for (let j = 0; j < b; j++) for (let i = 0; i < a; i++) yield i * stepA + j * stepB;
  }
  along(nx, 1, grid(ny, nx, nz, nx * ny));
  along(ny, nx, grid(nx, 1, nz, nx * ny));
  along(nz, nx * ny, grid(nx, 1, ny, nx));
}
