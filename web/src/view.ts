// A view: its canvas, its pictures, and the points that picks find.

import { Camera } from "./camera";
import { Data } from "./data";
import { Picture, Resources, Settings } from "./engine";
import { Backend, Bytes, Unavailable } from "./backend";
import { Vector, add, times } from "./vectors";
import { WebGl } from "./webgl";
import { WebGpu, requestedDevice } from "./webgpu";

export interface Pick {
  point: Vector;
  normal: Vector;
  /** Value of the field at the point, world units: the level on the surface, the distance on a slice. */
  distance: number;
  /** Distance from the eye along the viewing axis, world units. */
  depth: number;
  /** Index of the object; -1 for the slice. */
  object: number;
}

/** The arrays of a picture, row 0 on top. */
export interface Pixels {
  width: number;
  height: number;
  /** sRGB and opacity, four bytes per pixel. */
  color: Uint8Array;
  /** Distances from the eye along the viewing axis, world units; Infinity on the background. */
  depth: Float32Array;
}

/** Values from here on mean that the ray hit nothing. */
const NO_DEPTH = 2e38;
/** Time that a picture in motion should take, milliseconds. */
const MOVING_MS = 80;
/** Time that each piece of a picture at rest should take, milliseconds. */
const PIECE_MS = 40;
/** A picture at rest follows the last one in motion after this time, so that it delays no input, milliseconds. */
const PAUSE_MS = 120;
/** An exact picture is smoothed after this time without input, if it was drawn in SMOOTH_MS, milliseconds. */
const SMOOTH_PAUSE_MS = 500;
const SMOOTH_MS = 1000;
/** Places of the four samples of a smooth pixel, pixels from its centre: one in each row and each column of a 4 x 4 grid. */
const SAMPLES = [[-0.125, -0.375], [0.375, -0.125], [0.125, 0.375], [-0.375, 0.125]];
/** A view releases its context after this time without input, milliseconds. */
const IDLE_MS = 3000;
/** A picture of coarse triangles that takes less than this is followed by one of fine ones, about four times as many, milliseconds. */
const FAST_MS = 12;
/** Largest factor by which a picture in motion is smaller. */
const COARSEST = 6;

let shared: Backend | null = null;
const users = new Set<View>();

/** The device of WebGPU; null until the browser has one, where it has none, and after a failure. */
let device: GPUDevice | null = null;
let request: Promise<void> | null = null;

/** Use WebGPU for the next resources of a view, where the browser has a device. */
export function requestDevice(): Promise<void> {
  request ??= requestedDevice().then((found) => {
    device = found;
    void found?.lost.then(() => (device = null));
    // WebGPU reports errors after the call that made them. WebGL 2 draws the picture instead.
    found?.addEventListener("uncapturederror", () => found.destroy());
  });
  return request;
}

function engine(): Backend {
  if (!shared || shared.isLost) {
    const onLost = () => {
      if (shared === made) shared = null;
      for (const view of users) view.lost(made);
    };
    const made = device ? new WebGpu(device, onLost) : new WebGl(onLost);
    // WebGL 2 draws the first pictures. A request to a browser without a graphics processor would write a warning.
    if (made instanceof WebGl && made.isHardware) void requestDevice();
    shared = made;
  }
  return shared;
}

/** Kinds of drawings; see `View.redraw`. */
type Drawing = "moving" | "hidden" | "still" | "smooth";

export class View {
  readonly camera: Camera;
  readonly settings: Settings;
  /** Milliseconds: the start of the page until the first drawing, the last picture at full size, the last smooth one, and the last in motion; its width. */
  readonly times = { first: 0, still: 0, smooth: 0, moving: 0, width: 0 };
  onChange: () => void = () => {};
  onProblem: (message: string) => void = () => {};
  private readonly context: CanvasRenderingContext2D;
  private resources: Resources | null = null;
  /** Number of requests so far. A drawing stops when a later request replaces it. */
  private turn = 0;
  /** Factor by which pictures in motion are smaller, where they are drawn by rays. */
  private coarseness = 2;
  /** Whether pictures in motion have the triangles of coarse grids. */
  private isCoarse = true;
  private isBusy = false;
  private isStale: Drawing | null = null;
  private idle = 0;
  private later = 0;
  private waiting: Array<() => void> = [];
  /** How many contexts this view has lost since its last whole picture. */
  private losses = 0;
  private hasFailed = false;
  /** Whether the canvas has a picture of this view. */
  hasDrawn = false;
  /** Whether the canvas has the picture at full size of the present camera and settings. */
  isComplete = false;
  isClosed = false;
  /** Whether exact pictures are followed by smooth ones. The first picture has one sample for each pixel, as raymarch has. */
  isSmooth = false;

  constructor(
    readonly canvas: HTMLCanvasElement,
    public data: Data,
  ) {
    this.context = canvas.getContext("2d")!;
    this.camera = new Camera(data.description.camera);
    this.settings = { level: 0, slice: null, light: null, background: data.description.background, mesh: false, colors: "light" };
    users.add(this);
  }

  /** Resolves when the picture at full size is on the canvas, when it cannot be drawn, or when the view is closed. */
  get settled(): Promise<void> {
    const isSettled = this.isComplete || this.isClosed || this.hasFailed;
    return isSettled ? Promise.resolve() : new Promise((done) => this.waiting.push(done));
  }

  private settle(): void {
    for (const done of this.waiting.splice(0)) done();
  }

  /** Draw other data of the same size from now on; false if the size differs. A known shader is not compiled again. */
  replace(buffer: ArrayBuffer): boolean {
    const data = new Data(buffer);
    const [width, height] = this.data.description.size;
    if (data.description.size[0] !== width || data.description.size[1] !== height) return false;
    this.data = data;
    this.resources?.free();
    this.resources = null;
    this.redraw("moving");
    return true;
  }

  close(): void {
    this.isClosed = true;
    this.turn++;
    clearTimeout(this.idle);
    clearTimeout(this.later);
    this.resources?.free();
    this.resources = null;
    users.delete(this);
    if (users.size === 0) releaseShared();
    this.settle();
  }

  /** Forget the resources of a lost context. An unfinished picture is drawn again in a new context. */
  lost(engine: Backend): void {
    if (this.resources?.engine !== engine) return;
    this.resources = null;
    if (this.isComplete || this.isClosed) return;
    // The browser drops a context when other windows make new ones. The delay grows, so that those finish first.
    const delay = (100 + 500 * Math.random()) * 2 ** Math.min(this.losses++, 5);
    setTimeout(() => this.redraw(), delay);
  }

  /**
   * Draw again. A "moving" picture is drawn at once: by triangles at full size, or by rays at a smaller size. A "still" one
   * follows after a pause. A "smooth" one replaces a still one by the mean of four samples for each pixel.
   * A "hidden" picture is a moving one that leaves the canvas as it is: it prepares the device for the first input.
   */
  redraw(kind: Drawing = "still"): void {
    if (this.isClosed) return;
    clearTimeout(this.later);
    if (kind !== "smooth") this.isComplete = this.hasFailed = false;
    this.turn++;
    if (this.isBusy) {
      this.isStale = kind;
      return;
    }
    this.isBusy = true;
    const work = kind === "smooth" ? this.drawSmooth() : kind === "still" ? this.drawStill() : this.drawMoving(kind === "moving");
    work
      .catch((problem) => {
        // A lost context is no problem of the view: `lost` draws again.
        if (shared?.isLost) return;
        if (shared instanceof WebGpu) {
          // WebGL 2 draws the picture instead.
          device?.destroy();
          return;
        }
        this.hasFailed = true;
        this.onProblem(problem instanceof Unavailable ? problem.message : String(problem));
      })
      .finally(() => {
        this.isBusy = false;
        const next = this.isStale;
        this.isStale = null;
        if (next) this.redraw(next);
        else if ((kind === "moving" || kind === "hidden") && this.resources) this.redrawLater();
        else if (this.isComplete || this.hasFailed) this.settle();
      });
  }

  /** Draw the picture at rest after a pause. */
  private redrawLater(kind: Drawing = "still", pause = PAUSE_MS): void {
    clearTimeout(this.later);
    this.later = window.setTimeout(() => this.redraw(kind), pause);
  }

  /** Colours and depths of the present camera and settings, drawn at once; a promise by WebGPU. */
  pixels(): Pixels | Promise<Pixels> {
    const resources = this.acquire();
    const { width, height } = this.canvas;
    const whole = (picture: number) => {
      resources.prepare(this.camera, this.settings, width, height, picture);
      resources.draw(0, height);
      return resources.read(width, height);
    };
    const [color, depth] = [whole(Picture.color), whole(Picture.depth)];
    this.redraw();
    const made = (color: Bytes, depth: Bytes): Pixels => {
      const depths = new Float32Array(depth.buffer).map((value) => (value < NO_DEPTH ? value : Infinity));
      return { width, height, color: new Uint8Array(color.buffer), depth: depths };
    };
    if (color instanceof Promise || depth instanceof Promise) return Promise.all([color, depth]).then((both) => made(...both));
    return made(color, depth);
  }

  /** The surface or slice at a pixel of the canvas, counted from the upper left corner; null on the background. */
  async pick(x: number, y: number): Promise<Pick | null> {
    // The ray goes through the centre of the pixel, as in the shader.
    [x, y] = [Math.floor(x), Math.floor(y)];
    const slice = this.settings.slice && (await this.value(Picture.slice, x, y));
    const depth = await this.value(Picture.depth, x, y);
    const { width, height } = this.canvas;
    const way = this.camera.through(x, y, width, height);
    if (slice !== null && slice < NO_DEPTH && this.settings.slice) {
      const { axis, at } = this.settings.slice;
      const t = (at - this.camera.eye[axis]) / way[axis];
      if (t > 0 && (t <= depth || this.settings.slice.cut)) {
        const normal: Vector = [0, 0, 0];
        normal[axis] = -Math.sign(way[axis]);
        return { point: add(this.camera.eye, times(way, t)), normal, distance: slice, depth: t, object: -1 };
      }
    }
    if (!(depth < NO_DEPTH)) return null;
    const normal: Vector = [0, 0, 0];
    for (const axis of [0, 1, 2]) normal[axis] = await this.value(Picture.normal + axis, x, y);
    const object = Math.round(await this.value(Picture.object, x, y));
    return { point: add(this.camera.eye, times(way, depth)), normal, distance: this.settings.level, depth, object };
  }

  /** The distance on the slice at a pixel of the canvas; null where the slice is not visible. */
  async sliceValue(x: number, y: number): Promise<number | null> {
    if (!this.settings.slice) return null;
    const value = await this.value(Picture.slice, x, y);
    return value < NO_DEPTH ? value : null;
  }

  private value(picture: number, x: number, y: number): Promise<number> {
    const resources = this.acquire();
    resources.prepare(this.camera, this.settings, this.canvas.width, this.canvas.height, picture);
    // The value replaces the picture in the context, so that an unfinished one is drawn again.
    this.turn++;
    if (!this.isComplete) this.redrawLater();
    return resources.value(Math.floor(x), Math.floor(y), this.canvas.height);
  }

  private acquire(): Resources {
    if (!this.resources || this.resources.engine.isLost) this.resources = new Resources(engine(), this.data);
    this.wait();
    return this.resources;
  }

  /** Release the context, or wait while a picture is being drawn. The canvas keeps the picture. */
  rest(): void {
    if (this.isBusy) return this.wait();
    clearTimeout(this.idle);
    this.resources?.free();
    this.resources = null;
    if (![...users].some((view) => view.resources)) releaseShared();
  }

  /** Release the context after a time without input. */
  private wait(): void {
    clearTimeout(this.idle);
    this.idle = window.setTimeout(() => this.rest(), IDLE_MS);
  }

  /** Copy the picture in the context to the canvas. */
  private async show(resources: Resources): Promise<void> {
    this.context.globalCompositeOperation = "copy";
    await resources.engine.show(this.context);
    this.hasDrawn = true;
    this.onChange();
  }

  private async drawMoving(isShown: boolean): Promise<void> {
    const started = performance.now();
    const resources = this.acquire();
    // Steps and errors are those of the exact picture.
    const isFiltered = this.picture === Picture.color;
    // The time for triangles hardly depends on the number of pixels.
    const isTriangles = isFiltered && resources.isSurface(this.settings);
    const share = isTriangles ? 1 : 1 / this.coarseness;
    const width = Math.max(1, Math.round(this.canvas.width * share));
    const height = Math.max(1, Math.round(this.canvas.height * share));
    resources.isCoarse = this.isCoarse;
    resources.prepare(this.camera, this.settings, width, height, this.picture, isFiltered);
    resources.draw(0, height);
    await resources.engine.finished();
    if (this.resources !== resources || resources.engine.isLost) return;
    if (isShown) await this.show(resources);
    const spent = performance.now() - started;
    this.times.moving = spent;
    this.times.width = width;
    this.times.first ||= performance.now();
    // The time for rays goes with the number of pixels. One slow frame, such as that of a first compilation, changes little.
    const factor = Math.max(0.7, Math.min(1.4, Math.sqrt(spent / MOVING_MS)));
    if (isTriangles) this.isCoarse = spent > (this.isCoarse ? FAST_MS : MOVING_MS);
    else this.coarseness = Math.max(1, Math.min(COARSEST, this.coarseness * factor));
    await new Promise(requestAnimationFrame);
  }

  private async drawStill(): Promise<void> {
    const turn = this.turn;
    const started = performance.now();
    const resources = this.acquire();
    const { width, height } = this.canvas;
    await resources.compiled(this.settings, this.picture);
    if (this.turn !== turn || this.resources !== resources || resources.engine.isLost) return;
    resources.prepare(this.camera, this.settings, width, height, this.picture);
    if (!(await this.drawPieces(resources, turn))) return;
    await this.show(resources);
    if (this.turn !== turn) return;
    this.times.still = performance.now() - started;
    this.times.first ||= performance.now();
    this.isComplete = true;
    this.losses = 0;
    if (this.isSmooth && this.picture === Picture.color && this.times.still < SMOOTH_MS) this.redrawLater("smooth", SMOOTH_PAUSE_MS);
  }

  /** Draw the prepared picture in pieces; false if a later request replaces it. */
  private async drawPieces(resources: Resources, turn: number): Promise<boolean> {
    const { height } = this.canvas;
    // Input is handled between the pieces, and no driver mistakes a long picture for a hang.
    let rows = Math.max(1, Math.round(height / 8));
    for (let row = 0; row < height; ) {
      const before = performance.now();
      resources.draw(height - Math.min(height, row + rows), Math.min(rows, height - row));
      row += rows;
      await resources.engine.finished();
      if (this.turn !== turn || this.resources !== resources || resources.engine.isLost) return false;
      const spent = performance.now() - before;
      rows = Math.max(1, Math.min(height, Math.round((rows * PIECE_MS) / Math.max(spent, 1))));
    }
    return true;
  }

  /** Replace the picture by the mean of four samples for each pixel. */
  private async drawSmooth(): Promise<void> {
    const turn = this.turn;
    const started = performance.now();
    const resources = this.acquire();
    const { width, height } = this.canvas;
    const sums = new Float32Array(4 * width * height);
    for (const shift of SAMPLES) {
      resources.prepare(this.camera, this.settings, width, height, this.picture, false, shift);
      if (!(await this.drawPieces(resources, turn))) return;
      const bytes = await resources.read(width, height);
      for (let i = 0; i < sums.length; i += 4) {
        const opacity = bytes[i + 3];
        for (let k = 0; k < 3; k++) sums[i + k] += bytes[i + k] * opacity;
        sums[i + 3] += opacity;
      }
    }
    if (this.turn !== turn) return;
    const image = this.context.createImageData(width, height);
    sums.forEach((sum, i) => (image.data[i] = (i & 3) === 3 ? sum / SAMPLES.length : sum / (sums[i | 3] || 1)));
    this.context.putImageData(image, 0, 0);
    this.times.smooth = performance.now() - started;
  }

  private get picture(): number {
    return { light: Picture.color, steps: Picture.steps, error: Picture.error }[this.settings.colors];
  }
}

function releaseShared(): void {
  const engine = shared;
  shared = null;
  engine?.release();
}

/** A number with four significant digits. */
export function text(value: number): string {
  return value === 0 ? "0" : Number(value.toPrecision(4)).toString();
}
