// WebGL 2: one context for all views of a document, and the resources of each view in it.

import { Camera } from "./camera";
import { Data, FilteredGrids, InstanceData } from "./data";
import { levelSet } from "./surface";
import { Affine, Vector, add, direction, dot, inverse, point, product, subtract, times, unit } from "./vectors";

/** Texels in a row of the texture of words. */
const WIDTH = 2048;
/** Texels in a row of the table of instances, as in shaders/viewer/data.wgsl. */
const ROW = 24;
const MOST_LIGHTS = 16;
/** Uniform blocks of the shaders in the order of their binding points. */
const BLOCKS = ["View", "Own", "Lights"];

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

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

/** The reason why a view cannot be drawn, as a sentence for the reader of the page. */
export class Unavailable extends Error {}

export class Engine {
  readonly canvas = document.createElement("canvas");
  readonly gl: WebGL2RenderingContext;
  readonly mostRows: number;
  readonly mostLayers: number;
  private readonly programs = new Map<string, WebGLProgram>();
  private readonly linked = new Set<WebGLProgram>();

  constructor(onLost: () => void) {
    const gl = this.canvas.getContext("webgl2", {
      alpha: true,
      antialias: false,
      depth: true,
      premultipliedAlpha: false,
      preserveDrawingBuffer: true,
    });
    if (!gl) throw new Unavailable("This browser has no WebGL 2, so this picture is still and cannot be turned.");
    this.gl = gl;
    this.mostRows = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    this.mostLayers = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      onLost();
    });
    // The views have made a new context by then.
    this.canvas.addEventListener("webglcontextrestored", () => this.release());
  }

  get isLost(): boolean {
    return this.gl.isContextLost();
  }

  release(): void {
    if (!this.isLost) this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  /** Start the compilation of a program. */
  private start(fragment: string, vertex: string): WebGLProgram {
    const known = this.programs.get(fragment);
    if (known) return known;
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ] as const) {
      const shader = gl.createShader(kind)!;
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    gl.linkProgram(program);
    this.programs.set(fragment, program);
    return program;
  }

  /** Resolves when a program is compiled, where the browser compiles beside the page. */
  async compiled(fragment: string, vertex = VERTEX): Promise<void> {
    const { gl } = this;
    const program = this.start(fragment, vertex);
    const extension = gl.getExtension("KHR_parallel_shader_compile");
    while (extension && !gl.isContextLost() && !gl.getProgramParameter(program, extension.COMPLETION_STATUS_KHR))
      await new Promise((done) => setTimeout(done, 5));
  }

  program(fragment: string, vertex = VERTEX): WebGLProgram {
    const { gl } = this;
    const program = this.start(fragment, vertex);
    if (this.linked.has(program)) return program;
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = (gl.getAttachedShaders(program) ?? []).map((shader) => gl.getShaderInfoLog(shader));
      throw new Unavailable(`The shader was not compiled: ${[gl.getProgramInfoLog(program), ...logs].join(" ")}`);
    }
    this.linked.add(program);
    return program;
  }
}

/** The triangles of a grid on the device. */
interface Surface {
  array: WebGLVertexArrayObject;
  buffers: WebGLBuffer[];
  count: number;
  /** Level of the triangles, units of the samples. */
  level: number;
}

/** The resources of a view in an engine: its programs, its samples and its table of instances. */
export class Resources {
  private program!: WebGLProgram;
  private readonly words: WebGLTexture;
  private readonly frames: WebGLTexture;
  private readonly block: WebGLBuffer;
  private readonly ownBlock: WebGLBuffer;
  private readonly lightBlock: WebGLBuffer;
  /** The table that was filled last. */
  private table = new Float32Array();
  private readonly inverses: Affine[];
  /** The level for which the words on the device are marked; null before the first upload. */
  private level: number | null = null;
  private grids: FilteredGrids | null = null;
  private filtered: WebGLTexture | null = null;
  /** The surface of each grid, by its first sample, and of each mesh, by -1 less that of its field. */
  private readonly surfaces = new Map<number, Surface>();
  /** Whether the picture that was prepared last consists of triangles. */
  private hasTriangles = false;
  /** Settings of the picture that was prepared last. */
  private settings!: Settings;

  constructor(
    readonly engine: Engine,
    private readonly data: Data,
  ) {
    const { gl } = engine;
    const rows = Math.ceil(data.words.length / WIDTH);
    if (rows > engine.mostRows)
      throw new Unavailable("The samples exceed the textures of this graphics device, so this picture is still and cannot be turned.");
    this.words = this.texture();
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, WIDTH, Math.max(rows, 1));
    this.frames = this.texture();
    this.block = gl.createBuffer();
    this.ownBlock = gl.createBuffer();
    this.lightBlock = gl.createBuffer();
    this.inverses = data.description.instances.map((instance) => inverse(instance.fieldFromWorld));
  }

  free(): void {
    const { gl } = this.engine;
    gl.deleteTexture(this.words);
    gl.deleteTexture(this.frames);
    gl.deleteTexture(this.filtered);
    for (const block of [this.block, this.ownBlock, this.lightBlock]) gl.deleteBuffer(block);
    for (const surface of this.surfaces.values()) this.freeSurface(surface);
  }

  private texture(): WebGLTexture {
    const { gl } = this.engine;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    return texture;
  }

  /** Copy the words to their texture: all whole rows, then the rest. */
  private upload(): void {
    const { gl } = this.engine;
    const { words } = this.data;
    const rows = Math.floor(words.length / WIDTH);
    const put = (row: number, width: number, height: number) => {
      if (width * height > 0)
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, width, height, gl.RED_INTEGER, gl.UNSIGNED_INT, words, row * WIDTH);
    };
    gl.bindTexture(gl.TEXTURE_2D, this.words);
    put(0, WIDTH, rows);
    put(rows, words.length - rows * WIDTH, 1);
  }

  /** Copy the dense grids to a texture that the device filters. */
  private uploadFiltered(): void {
    const { gl } = this.engine;
    const { size, texels } = (this.grids = this.data.filtered(this.engine.mostLayers));
    this.filtered = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_3D, this.filtered);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, name, gl.LINEAR);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(gl.TEXTURE_3D, name, gl.CLAMP_TO_EDGE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8_SNORM, ...size, 0, gl.RED, gl.BYTE, texels);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
  }

  /** The triangles of an instance: those of its mesh, or those of its level set. */
  private surface(instance: InstanceData): Surface {
    const { gl } = this.engine;
    const { record } = instance;
    const isMesh = this.settings.mesh && instance.mesh !== null;
    // No grid has a negative number.
    const key = isMesh ? -1 - this.data.gridOf(record) : this.data.gridOf(record);
    const own = isMesh ? 0 : this.data.ownLevel(record, this.settings.level);
    const known = this.surfaces.get(key);
    if (known?.level === own) return known;
    if (known) this.freeSurface(known);
    const { corners, indices } = isMesh ? this.data.mesh(instance) : levelSet(this.data.grid(record), own);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = ([[gl.ARRAY_BUFFER, corners], [gl.ELEMENT_ARRAY_BUFFER, indices]] as const).map(([target, values]) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(target, buffer);
      gl.bufferData(target, values, gl.STATIC_DRAW);
      return buffer;
    });
    for (const place of [0, 1]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 24, 12 * place);
    }
    gl.bindVertexArray(null);
    const made = { array, buffers, count: indices.length, level: own };
    this.surfaces.set(key, made);
    return made;
  }

  private freeSurface({ array, buffers }: Surface): void {
    const { gl } = this.engine;
    gl.deleteVertexArray(array);
    for (const buffer of buffers) gl.deleteBuffer(buffer);
  }

  /** The text of the program for a picture. A program without what the picture does not need compiles faster. */
  private text(settings: Settings, isMotion: boolean): string {
    let text = this.data.description.shader;
    if (!settings.slice) text = text.replace("const bool HAS_SLICE = true", "const bool HAS_SLICE = false");
    if (isMotion) text = text.replace("const bool IS_MOTION = false", "const bool IS_MOTION = true");
    return text;
  }

  /** Whether pictures in motion are triangles: those of views of dense grids without a slice. */
  isSurface(settings: Settings): boolean {
    return !settings.slice && !this.data.hasOtherThanDense;
  }

  /** Resolves when the program for a picture at rest is compiled. */
  compiled(settings: Settings): Promise<void> {
    return this.engine.compiled(this.text(settings, false));
  }

  /** Set the program and all its input for a picture of this size; `draw` follows. Only colours are drawn in motion. */
  prepare(camera: Camera, settings: Settings, width: number, height: number, picture: number, isMotion = false): void {
    const { gl, canvas } = this.engine;
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    if (settings.level !== this.level && (!isMotion || this.data.hasOtherThanDense)) {
      this.level = settings.level;
      this.data.markEmpty(settings.level);
      this.upload();
    }
    this.hasTriangles = isMotion && this.isSurface(settings);
    if (isMotion && !this.hasTriangles && !this.filtered) this.uploadFiltered();
    const [vertex, fragment] = this.data.description.triangles;
    this.program = this.hasTriangles ? this.engine.program(fragment, vertex) : this.engine.program(this.text(settings, isMotion));
    this.settings = settings;
    const lights = this.fillFrames(camera, settings);
    this.fillBlock(camera, settings, width, height, picture, lights);
    gl.viewport(0, 0, width, height);
    gl.useProgram(this.program);
    for (let i = 0; i < gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORM_BLOCKS); i++)
      gl.uniformBlockBinding(this.program, i, BLOCKS.findIndex((name) => gl.getActiveUniformBlockName(this.program, i)!.startsWith(name)));
    gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, this.block);
    const active = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < active; i++) {
      const { name, type } = gl.getActiveUniform(this.program, i)!;
      const unit = [gl.UNSIGNED_INT_SAMPLER_2D, gl.SAMPLER_2D, gl.SAMPLER_3D].indexOf(type as 0x8dd2);
      if (unit < 0) continue;
      gl.uniform1i(gl.getUniformLocation(this.program, name), unit);
      gl.activeTexture(gl.TEXTURE0 + unit);
      if (unit === 2) gl.bindTexture(gl.TEXTURE_3D, this.filtered);
      else gl.bindTexture(gl.TEXTURE_2D, unit === 0 ? this.words : this.frames);
    }
    gl.activeTexture(gl.TEXTURE0);
  }

  /** Draw `rows` rows from row `first`, counted from below. */
  draw(first: number, rows: number): void {
    const { gl, canvas } = this.engine;
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, first, canvas.width, rows);
    if (this.hasTriangles) this.drawTriangles();
    else gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  private drawTriangles(): void {
    const { gl } = this.engine;
    const { background } = this.settings;
    const [red, green, blue] = background.map(srgb);
    gl.clearColor(red, green, blue, background[3]);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const { instances } = this.data.description;
    const put = (place: number, block: WebGLBuffer, values: Float32Array) => {
      gl.bindBufferBase(gl.UNIFORM_BUFFER, place, block);
      gl.bufferData(gl.UNIFORM_BUFFER, values, gl.DYNAMIC_DRAW);
    };
    const row = (i: number, texels: number) => this.table.subarray(4 * ROW * i, 4 * (ROW * i + texels));
    const lights = new Float32Array(8 * MOST_LIGHTS);
    for (let i = instances.length + 1; i < this.table.length / (4 * ROW); i++) lights.set(row(i, 2), 8 * (i - instances.length - 1));
    put(2, this.lightBlock, lights);
    instances.forEach((instance, i) => {
      if (!this.data.isVisible(instance.record)) return;
      const { array, count } = this.surface(instance);
      put(1, this.ownBlock, row(i, ROW));
      gl.bindVertexArray(array);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    });
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
  }

  /** The float32 at pixel (x, y), row 0 on top, of the picture that was prepared last. */
  value(x: number, y: number): number {
    const { gl, canvas } = this.engine;
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(x, canvas.height - 1 - y, 1, 1);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const bytes = new Uint8Array(4);
    gl.readPixels(x, canvas.height - 1 - y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return new DataView(bytes.buffer).getFloat32(0, true);
  }

  /** The bytes of the canvas, row 0 on top. */
  read(): Uint8Array<ArrayBuffer> {
    const { gl, canvas } = this.engine;
    const { width, height } = canvas;
    const below = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, below);
    const bytes = new Uint8Array(below.length);
    for (let y = 0; y < height; y++) {
      bytes.set(below.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    }
    return bytes;
  }

  /** The origin and the unit of scene space in world units: the centre and the longest side of the view's box. */
  private sceneFrame(): { center: Vector; scale: number } {
    const [lower, upper] = this.data.description.bounds;
    const extent = subtract(upper, lower);
    return { center: times(add(lower, upper), 0.5), scale: Math.max(...extent) || 1 };
  }

  private fillFrames(camera: Camera, settings: Settings): number {
    const { gl } = this.engine;
    const { instances, lights, key } = this.data.description;
    const { center, scale } = this.sceneFrame();
    const sceneFromWorld = [1 / scale, 0, 0, -center[0] / scale, 0, 1 / scale, 0, -center[1] / scale, 0, 0, 1 / scale, -center[2] / scale];
    const worldFromScene = inverse(sceneFromWorld);
    const fromCamera = (v: Vector): Vector =>
      unit(add(add(times(camera.right, v[0]), times(camera.up, v[1])), times(camera.back, v[2])));
    const keyed = [{ kind: 0, vector: fromCamera(settings.light ?? key.direction), color: key.color }];
    const shining = (settings.light || !lights ? keyed : lights).slice(0, MOST_LIGHTS);

    const rows = instances.length + 1 + shining.length;
    const texels = new Float32Array(4 * ROW * rows);
    const put = (row: number, texel: number, values: number[]) => texels.set(values, 4 * (ROW * row + texel));
    const rays = (row: number, map: Affine, corners: Vector[]) => {
      // Rays start on a plane just before the box. The plane is found in float64; float32 is exact enough beyond it.
      const depths = corners.map((corner) => camera.depth(corner));
      const nearest = Math.min(...depths);
      const start = Math.max(0, nearest - 0.01 * (Math.max(...depths) - nearest));
      const forward = times(camera.back, -1);
      put(row, 0, [...point(map, add(camera.eye, times(forward, start))), start]);
      put(row, 1, direction(map, times(camera.right, start)));
      put(row, 2, direction(map, times(camera.up, start)));
      put(row, 3, direction(map, forward));
      put(row, 4, direction(map, camera.right));
      put(row, 5, direction(map, camera.up));
    };
    instances.forEach((instance, i) => {
      const map = instance.fieldFromWorld;
      rays(i, map, corners(this.data.box(i)).map((corner) => point(this.inverses[i], corner)));
      const fieldFromScene = product(map, worldFromScene);
      put(i, 6, fieldFromScene);
      put(i, 9, inverse(fieldFromScene));
      put(i, 12, [...instance.color, instance.specular]);
      put(i, 13, [...instance.emission, instance.shininess]);
      put(i, 14, instance.record);
      put(i, 22, this.grids?.places[i] ?? [0, 1, 1, 1]);
      put(i, 23, [instance.errorShare]);
    });
    rays(instances.length, sceneFromWorld, corners(this.data.description.bounds));
    shining.forEach((light, i) => {
      const row = instances.length + 1 + i;
      put(row, 0, light.kind === 1 ? [...point(sceneFromWorld, light.vector), 1] : [...unit(light.vector), 0]);
      put(row, 1, light.color);
    });
    this.table = texels;
    gl.bindTexture(gl.TEXTURE_2D, this.frames);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, ROW, rows, 0, gl.RGBA, gl.FLOAT, texels);
    return shining.length;
  }

  /** Rows of the matrix to clip space, as shaders/viewer/table.wgsl has them; y points down, which naga turns round. */
  private clip(camera: Camera, width: number, height: number, center: Vector, scale: number): number[] {
    const from = subtract(camera.eye, center);
    const row = (axis: Vector, factor: number) => [...times(axis, factor * scale), -factor * dot(axis, from)];
    const pixel = camera.pixel(height);
    const depths = corners(this.data.description.bounds).map((corner) => camera.depth(corner));
    const far = Math.max(...depths, 1e-6 * scale) * 1.1;
    const near = Math.max(Math.min(...depths) * 0.9, 1e-3 * far);
    const share = far / (far - near);
    return [
      ...row(camera.right, 2 / (width * pixel)),
      ...row(camera.up, -2 / (height * pixel)),
      ...[share, -share * near, 0, 0],
      ...row(camera.back, -1),
    ];
  }

  private fillBlock(camera: Camera, settings: Settings, width: number, height: number, picture: number, lights: number): void {
    const { gl } = this.engine;
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
    const values = [
      ...[width, height, camera.pixel(height), count],
      ...settings.background,
      ...[description.ambient, description.hemisphere ? 1 : 0, lights, picture],
      ...[settings.level, description.spacing, description.range, description.most_steps],
      ...plane,
      ...[...lower, 0],
      ...[...upper, 0],
      ...[scale, slice?.cut ? 1 : 0, 0, 0],
      ...(this.grids?.size.map((n) => 1 / n) ?? [1, 1, 1]),
      0,
      ...this.clip(camera, width, height, center, scale),
      ...[...times(subtract(camera.eye, center), 1 / scale), 0],
    ];
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.block);
    gl.bufferData(gl.UNIFORM_BUFFER, new Float32Array(values), gl.DYNAMIC_DRAW);
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

