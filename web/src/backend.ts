// The devices that draw pictures: WebGL 2 (webgl.ts) and WebGPU (webgpu.ts). Both store row 0 of a picture at the bottom.

import { Triangles } from "./surface";
import { Vector } from "./vectors";

/** The shaders of a program: GLSL with its fragment shader last, and the WGSL with all entry points. */
export interface Program {
  glsl: string[];
  wgsl: string;
}

/** Kinds of textures: 32-bit words of the fields, the table of instances, and dense grids that the device filters. */
export type TextureKind = "words" | "table" | "filtered";

/** Resources of a device. */
export interface Texture {
  free(): void;
}
export interface Shape {
  free(): void;
}

/** The program, the size in pixels and the input of a picture. */
export interface Pass {
  program: Program;
  width: number;
  height: number;
  /** The block `View` of shaders/viewer/table.wgsl. */
  view: Float32Array<ArrayBuffer>;
  textures: Record<TextureKind, Texture | null>;
  /** The triangles of the picture; null for a picture of rays. */
  triangles: Scenery | null;
}

/** The triangles of all visible instances, each with its row of the table; four texels for each light. */
export interface Scenery {
  background: number[];
  lights: Float32Array<ArrayBuffer>;
  instances: { shape: Shape; row: Float32Array<ArrayBuffer> }[];
}

export interface Backend {
  /** Largest side of a texture in two and in three dimensions, texels. */
  readonly mostRows: number;
  readonly mostLayers: number;
  readonly isLost: boolean;
  /** A texture of this size; `values` are all its texels, or the texels of the first rows. */
  texture(kind: TextureKind, size: Vector, values: ArrayBufferView<ArrayBuffer>): Texture;
  shape(triangles: Triangles): Shape;
  /** Resolves when a program is compiled, where the browser compiles beside the page. */
  compiled(program: Program): Promise<void>;
  /** Set the program and all its input; `draw` follows. */
  prepare(pass: Pass): void;
  /** Draw `rows` rows from row `first`, counted from below, of all columns or of `width` columns from column `x`. */
  draw(first: number, rows: number, x?: number, width?: number): void;
  /** Resolves when the device has drawn. */
  finished(): Promise<void>;
  /** Four bytes for each pixel of a rectangle, row 0 on top; `y` is counted from above. */
  read(x: number, y: number, width: number, height: number): Bytes | Promise<Bytes>;
  /** Copy the picture to the whole of a canvas. */
  show(context: CanvasRenderingContext2D): void | Promise<void>;
  release(): void;
}

export type Bytes = Uint8ClampedArray<ArrayBuffer>;

/** Floats of the block `View` of the shaders. */
export const VIEW_FLOATS = 56;
/** Texels in a row of the table of instances, as in shaders/viewer/table.wgsl. */
export const ROW = 24;
/** Largest number of lights, and the number of texels of each. */
export const MOST_LIGHTS = 16;
export const LIGHT_TEXELS = 4;

/** The reason why a view cannot be drawn, as a sentence for the reader of the page. */
export class Unavailable extends Error {}

/** Rows of a picture in the opposite order. */
export function upright(below: Bytes, rowBytes: number, height: number, stride = rowBytes): Bytes {
  const bytes = new Uint8ClampedArray(rowBytes * height);
  for (let y = 0; y < height; y++) bytes.set(below.subarray(stride * y, stride * y + rowBytes), rowBytes * (height - 1 - y));
  return bytes;
}
