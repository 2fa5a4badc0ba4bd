// Vectors of three numbers and affine maps of 3 x 4 numbers, by rows, in float64.

export type Vector = [number, number, number];
export type Affine = number[];

export const add = (a: Vector, b: Vector): Vector => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a: Vector, b: Vector): Vector => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const times = (a: Vector, s: number): Vector => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vector, b: Vector): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: Vector): number => Math.hypot(a[0], a[1], a[2]);
export const unit = (a: Vector): Vector => times(a, 1 / (length(a) || 1));
export const cross = (a: Vector, b: Vector): Vector => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Rotate a vector about a unit axis by an angle in radians (Rodrigues). */
export function turned(v: Vector, axis: Vector, angle: number): Vector {
  const c = Math.cos(angle);
  const along = times(axis, dot(axis, v) * (1 - c));
  return add(add(times(v, c), times(cross(axis, v), Math.sin(angle))), along);
}

export const direction = (m: Affine, v: Vector): Vector => [
  m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
  m[4] * v[0] + m[5] * v[1] + m[6] * v[2],
  m[8] * v[0] + m[9] * v[1] + m[10] * v[2],
];
export const point = (m: Affine, v: Vector): Vector => add(direction(m, v), [m[3], m[7], m[11]]);

/** The composition of two maps: `b` is applied first, then `a`. */
export function product(a: Affine, b: Affine): Affine {
  const columns = [0, 1, 2].map((j) => direction(a, [b[j], b[4 + j], b[8 + j]]));
  const shift = point(a, [b[3], b[7], b[11]]);
  return [0, 1, 2].flatMap((i) => [columns[0][i], columns[1][i], columns[2][i], shift[i]]);
}

export function inverse(m: Affine): Affine {
  const [a, b, c]: Vector[] = [
    [m[0], m[1], m[2]],
    [m[4], m[5], m[6]],
    [m[8], m[9], m[10]],
  ];
  const scale = 1 / dot(a, cross(b, c));
  const columns = [cross(b, c), cross(c, a), cross(a, b)].map((v) => times(v, scale));
  const rows = [0, 1, 2].map((i): Vector => [columns[0][i], columns[1][i], columns[2][i]]);
  const shift: Vector = [m[3], m[7], m[11]];
  return rows.flatMap((row) => [...row, -dot(row, shift)]);
}
