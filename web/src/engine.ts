// The resources of a view on a device: its samples, its table of instances, and the input of its pictures.

import { Backend, Bytes, LIGHT_TEXELS, MOST_LIGHTS, Program, ROW, Shape, Texture, Unavailable } from "./backend";
import { Camera } from "./camera";
import { Data, FilteredGrids, InstanceData, LightData } from "./data";
import { levelSet } from "./surface";
import { Affine, Vector, add, direction, dot, inverse, point, product, subtract, times, unit } from "./vectors";

/** Texels in a row of the texture of words. */
const WIDTH = 2048;

export const Picture = { color: 0, steps: 1, depth: 2, normal: 3, object: 6, slice: 7, error: 8 } as const;

/** Settings of a picture besides the camera. */
export interface Settings {
  level: number;
  /** Axis 0 to 2, its coordinate in world units, and whether the half in front of the slice is removed. */
  slice: { axis: number; at: number; cut: boolean } | null;
  /** Direction in which the key light travels, camera space; null for the lights of the data. */
  light: Vector | null;
  background: [number, number, number, number];
  /** Whether meshes are drawn as triangles in place of their fields. */
  mesh: boolean;
  /** What the colours of surfaces show: light, the steps of each ray, or the errors of the stored samples. */
  colors: "light" | "steps" | "error";
}

/** The triangles of a grid on the device. */
interface Surface {
  shape: Shape;
  /** Level of the triangles, units of the samples. */
  level: number;
}

/** The resources of a view on a device. */
export class Resources {
  private words: Texture | null = null;
  private filtered: Texture | null = null;
  private table: Texture | null = null;
  private readonly rows: number;
  private readonly inverses: Affine[];
  /** The level for which the words on the device are marked; null before the first upload. */
  private level: number | null = null;
  private grids: FilteredGrids | null = null;
  /** The surface of each grid, by its first sample and step, and of each mesh, by the first sample of its field. */
  private readonly surfaces = new Map<string, Surface>();
  /** Whether the triangles of level sets in motion come from coarse grids. */
  isCoarse = true;
  /** The level of the last picture in motion; NaN before the first one. */
  movingLevel = NaN;

  constructor(
    readonly engine: Backend,
    private readonly data: Data,
  ) {
    this.rows = Math.max(1, Math.ceil(data.words.length / WIDTH));
    if (this.rows > engine.mostRows)
      throw new Unavailable("The samples exceed the textures of this graphics device, so this picture is still and cannot be turned.");
    this.inverses = data.description.instances.map((instance) => inverse(instance.fieldFromWorld));
  }

  /** Send the words to the device again before the next picture. */
  refresh(): void {
    this.level = null;
  }

  free(): void {
    for (const texture of [this.words, this.filtered, this.table]) texture?.free();
    for (const { shape } of this.surfaces.values()) shape.free();
  }

  /** The triangles of an instance: the triangles of its mesh or of its level set. */
  private surface(instance: InstanceData, settings: Settings, isMotion: boolean): Shape {
    const { record } = instance;
    const grid = this.isMesh(instance, settings) ? null : this.data.grid(record, isMotion && this.isCoarse);
    const key = `${this.data.gridOf(record)} ${grid?.step ?? "mesh"}`;
    const level = grid ? this.data.ownLevel(record, settings.level) : 0;
    const known = this.surfaces.get(key);
    if (known?.level === level) return known.shape;
    known?.shape.free();
    const shape = this.engine.shape(grid ? levelSet(grid, level) : this.data.mesh(instance));
    this.surfaces.set(key, { shape, level });
    return shape;
  }

  private isMesh(instance: InstanceData, settings: Settings): boolean {
    return settings.mesh && instance.mesh !== null;
  }

  /** The program of a picture. A program without what the picture does not need compiles faster. */
  private program(settings: Settings, picture: number, isMotion: boolean): { program: Program; hasTriangles: boolean } {
    const { rays, triangles, mesh } = this.data.description.programs;
    const isSurface = picture === Picture.color && this.isSurface(settings);
    if (isMotion && isSurface && triangles) return { program: triangles, hasTriangles: true };
    if (settings.mesh && isSurface && mesh) return { program: mesh, hasTriangles: true };
    const set = (text: string) => {
      if (!settings.slice) text = text.replace(/const (bool )?HAS_SLICE(: bool)? = true/, "const $1HAS_SLICE$2 = false");
      return isMotion ? text.replace(/const (bool )?IS_MOTION(: bool)? = false/, "const $1IS_MOTION$2 = true") : text;
    };
    return { program: { glsl: rays.glsl.map(set), wgsl: set(rays.wgsl) }, hasTriangles: false };
  }

  /** Whether pictures in motion are triangles: in views of dense grids without a slice. */
  isSurface(settings: Settings): boolean {
    return !settings.slice && !this.data.hasOtherThanDense;
  }

  /** Resolves when the program for a picture at rest is compiled. */
  compiled(settings: Settings, picture: number): Promise<void> {
    return this.engine.compiled(this.program(settings, picture, false).program);
  }

  /**
   * Set the program and all its input for a picture of this size; `draw` follows. Only colours are drawn in motion. Rays go
   * through the centres of the pixels plus `shift`, pixels to the right and up.
   */
  prepare(camera: Camera, settings: Settings, width: number, height: number, picture: number, isMotion = false, shift = [0, 0]): void {
    const { engine, data } = this;
    const { program, hasTriangles } = this.program(settings, picture, isMotion);
    if (settings.level !== this.level && (!isMotion || data.hasOtherThanDense)) {
      this.level = settings.level;
      data.markEmpty(settings.level);
      this.words?.free();
      this.words = engine.texture("words", [WIDTH, this.rows, 1], data.words);
    }
    if (isMotion && !hasTriangles && !this.filtered) {
      this.grids = data.filtered(engine.mostLayers);
      this.filtered = engine.texture("filtered", this.grids.size, this.grids.texels);
    }
    const [across, upwards] = shift.map((share) => share * camera.pixel(height));
    const { texels, lights } = this.frames(camera, settings, add(times(camera.right, across), times(camera.up, upwards)));
    this.table?.free();
    this.table = engine.texture("table", [ROW, texels.length / (4 * ROW), 1], texels);
    const row = (i: number, count: number) => texels.slice(4 * ROW * i, 4 * (ROW * i + count));
    const { instances } = data.description;
    const block = new Float32Array(4 * LIGHT_TEXELS * MOST_LIGHTS);
    for (let i = 0; i < lights; i++) block.set(row(instances.length + 1 + i, LIGHT_TEXELS), 4 * LIGHT_TEXELS * i);
    const visible = instances.flatMap((instance, i) => (data.isVisible(instance.record) ? [{ instance, row: row(i, ROW) }] : []));
    engine.prepare({
      program,
      width,
      height,
      view: this.block(camera, settings, width, height, picture, lights, shift),
      textures: { words: this.words, filtered: this.filtered, table: this.table },
      triangles: hasTriangles
        ? {
            background: [...settings.background.slice(0, 3).map(srgb), settings.background[3]],
            lights: block,
            instances: visible.map(({ instance, row }) => ({ shape: this.surface(instance, settings, isMotion), row })),
          }
        : null,
    });
  }

  /** Draw `rows` rows from row `first`, counted from below. */
  draw(first: number, rows: number): void {
    this.engine.draw(first, rows);
  }

  /** The float32 at pixel (x, y), row 0 on top, of a picture of this height that was prepared last. */
  async value(x: number, y: number, height: number): Promise<number> {
    this.engine.draw(height - 1 - y, 1, x, 1);
    const bytes = await this.engine.read(x, y, 1, 1);
    return new DataView(bytes.buffer).getFloat32(0, true);
  }

  /** The bytes of the picture that was drawn last, row 0 on top. */
  read(width: number, height: number): Bytes | Promise<Bytes> {
    return this.engine.read(0, 0, width, height);
  }

  /** Corners of an instance's box, world units. */
  private cornersOf(i: number): Vector[] {
    return corners(this.data.box(i)).map((corner) => point(this.inverses[i], corner));
  }

  /** The origin and the unit of scene space in world units: the centre and the longest side of the view's box. */
  private sceneFrame(): { center: Vector; scale: number } {
    const [lower, upper] = this.data.description.bounds;
    const extent = subtract(upper, lower);
    return { center: times(add(lower, upper), 0.5), scale: Math.max(...extent) || 1 };
  }

  /** The table of shaders/viewer/table.wgsl, and its number of lights. */
  private frames(camera: Camera, settings: Settings, shift: Vector): { texels: Float32Array<ArrayBuffer>; lights: number } {
    const { instances, lights, key } = this.data.description;
    const { center, scale } = this.sceneFrame();
    const sceneFromWorld = [1 / scale, 0, 0, -center[0] / scale, 0, 1 / scale, 0, -center[1] / scale, 0, 0, 1 / scale, -center[2] / scale];
    const worldFromScene = inverse(sceneFromWorld);
    const fromCamera = (v: Vector): Vector =>
      unit(add(add(times(camera.right, v[0]), times(camera.up, v[1])), times(camera.back, v[2])));
    const keyed: LightData[] = [{ kind: 0, vector: fromCamera(settings.light ?? key.direction), color: key.color, range: 0, spot: null }];
    const shining = (settings.light || !lights ? keyed : lights).slice(0, MOST_LIGHTS);

    const rows = instances.length + 1 + shining.length;
    const texels = new Float32Array(4 * ROW * rows);
    const put = (row: number, texel: number, values: number[]) => texels.set(values, 4 * (ROW * row + texel));
    const rays = (row: number, map: Affine, corners: Vector[]) => {
      // Rays start on a plane just before the box. The plane is found in float64; float32 is exact enough beyond it.
      const depths = corners.map((corner) => camera.depth(corner));
      const nearest = Math.min(...depths);
      const start = Math.max(0, nearest - 0.01 * (Math.max(...depths) - nearest));
      const forward = subtract(shift, camera.back);
      put(row, 0, [...point(map, add(camera.eye, times(forward, start))), start]);
      put(row, 1, direction(map, times(camera.right, start)));
      put(row, 2, direction(map, times(camera.up, start)));
      put(row, 3, direction(map, forward));
      put(row, 4, direction(map, camera.right));
      put(row, 5, direction(map, camera.up));
    };
    instances.forEach((instance, i) => {
      const map = instance.fieldFromWorld;
      rays(i, map, this.cornersOf(i));
      const fieldFromScene = product(map, worldFromScene);
      put(i, 6, fieldFromScene);
      put(i, 9, inverse(fieldFromScene));
      put(i, 12, [...instance.color, instance.specular]);
      put(i, 13, [...instance.emission, instance.shininess]);
      put(i, 14, instance.record);
      put(i, 22, this.grids?.places[i] ?? [0, 1, 1, 1]);
      put(i, 23, [instance.errorShare, this.isMesh(instance, settings) ? 1 : 0, i]);
    });
    rays(instances.length, sceneFromWorld, corners(this.data.description.bounds));
    shining.forEach((light, i) => {
      const row = instances.length + 1 + i;
      put(row, 0, light.kind === 1 ? [...point(sceneFromWorld, light.vector), 1] : [...unit(light.vector), 0]);
      // With falloff, the colour is the one at a distance of one scene unit.
      put(row, 1, [...(light.range > 0 ? times(light.color, 1 / scale ** 2) : light.color), light.range / scale]);
      put(row, 2, light.spot ?? [0, 0, 0, 0, -2]);
    });
    return { texels, lights: shining.length };
  }

  /** Rows of the matrix to clip space, as shaders/viewer/table.wgsl has them; y points down, which naga turns round. */
  private clip(camera: Camera, width: number, height: number, center: Vector, scale: number, shift: number[]): number[] {
    const from = subtract(camera.eye, center);
    const row = (axis: Vector, factor: number) => [...times(axis, factor * scale), -factor * dot(axis, from)];
    const pixel = camera.pixel(height);
    const depths = this.data.description.instances.flatMap((_, i) => this.cornersOf(i).map((corner) => camera.depth(corner)));
    const far = Math.max(...depths, 1e-6 * scale) * 1.1;
    const near = Math.max(Math.min(...depths) * 0.9, 1e-3 * far);
    const share = far / (far - near);
    const w = row(camera.back, -1);
    const shifted = (values: number[], by: number) => values.map((value, i) => value + by * w[i]);
    return [
      ...shifted(row(camera.right, 2 / (width * pixel)), (-2 * shift[0]) / width),
      ...shifted(row(camera.up, -2 / (height * pixel)), (2 * shift[1]) / height),
      ...[share, -share * near, 0, 0],
      ...w,
    ];
  }

  /** The block `View` of shaders/viewer/table.wgsl. */
  private block(camera: Camera, settings: Settings, width: number, height: number, picture: number, lights: number, shift: number[]): Float32Array<ArrayBuffer> {
    const { description, count } = this.data;
    const { center, scale } = this.sceneFrame();
    const [lower, upper] = description.bounds.map((corner) => times(subtract(corner, center), 1 / scale));
    const plane = [0, 0, 0, 0];
    const slice = settings.slice;
    if (slice) {
      // The normal of the plane points to the eye.
      const place = (slice.at - center[slice.axis]) / scale;
      const sign = camera.eye[slice.axis] >= slice.at ? 1 : -1;
      plane[slice.axis] = sign;
      plane[3] = sign * place;
      lower[slice.axis] = place - 1e-4;
      upper[slice.axis] = place + 1e-4;
    }
    return new Float32Array([
      ...[width, height, camera.pixel(height), count],
      ...settings.background,
      ...[description.ambient, 0, lights, picture],
      ...[settings.level, description.spacing, description.range, description.most_steps],
      ...plane,
      ...[...lower, 0],
      ...[...upper, 0],
      ...[scale, slice?.cut ? 1 : 0, 0, 0],
      ...(this.grids?.size.map((n) => 1 / n) ?? [1, 1, 1]),
      0,
      ...this.clip(camera, width, height, center, scale, shift),
      ...[...times(subtract(camera.eye, center), 1 / scale), 0],
    ]);
  }
}

/** A linear colour as sRGB, as in shaders/viewer/table.wgsl. */
function srgb(linear: number): number {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * Math.min(linear, 1) ** (1 / 2.4) - 0.055;
}

/** The eight corners of a box. */
function corners([lower, upper]: [Vector, Vector]): Vector[] {
  const found: Vector[] = [];
  for (const x of [lower[0], upper[0]]) for (const y of [lower[1], upper[1]]) for (const z of [lower[2], upper[2]]) found.push([x, y, z]);
  return found;
}

