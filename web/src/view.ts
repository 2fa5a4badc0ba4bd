// A view: its canvas, its pictures, and the points that picks find.

import { Camera } from "./camera";
import { Data } from "./data";
import { Picture, Resources, Settings } from "./engine";
import { Backend, Unavailable } from "./backend";
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
/**
 * Places of the 16 samples of a smooth pixel, pixels from its centre: the first 16 points of the sequence of Sobol. There is
 * one in each row and each column of a 16 x 16 grid and in each cell of a 4 x 4 grid. The first four are spread likewise.
 */
const SAMPLES = Array.from({ length: 16 }, (_, i) => {
  const bits = [0, 1, 2, 3].filter((bit) => i & (1 << bit));
  const across = bits.reduce((sum, bit) => sum ^ (8 >> bit), 1);
  const upwards = bits.reduce((sum, bit) => sum ^ [8, 12, 10, 15][bit], 2);
  return [across, upwards].map((place) => (place + 0.5) / 16 - 0.5);
});
/** A smooth picture is shown after this number of samples too. */
const FIRST_SAMPLES = 4;
/** A view releases its context after this time without input, milliseconds. */
const IDLE_MS = 3000;
/** A picture of coarse triangles that takes less than this is followed by one of fine ones, four to ten times as many, milliseconds. */
const FAST_MS = 12;
/** Largest factor by which a picture in motion is smaller. */
const COARSEST = 6;

let shared: Backend | null = null;
const users = new Set<View>();

/** The last drawing of all views of the document. They share one target, so drawings run one after another. */
let last: Promise<unknown> = Promise.resolve();
/** Number of urgent drawings that wait: pictures in motion and values of pixels. Pictures at rest stop for them. */
let urgent = 0;

/** Longest wait for the browser to paint, milliseconds: a page in a frame outside the screen is not painted. */
const PAINT_MS = 500;

/** Resolves before the browser paints, or after `PAINT_MS`. */
export function nextPaint(): Promise<void> {
  return new Promise((done) => {
    requestAnimationFrame(() => done());
    setTimeout(done, PAINT_MS);
  });
}

/** Run a drawing after all earlier ones. */
function inQueue<T>(isUrgent: boolean, draw: () => Promise<T>): Promise<T> {
  if (isUrgent) urgent++;
  const work = last.then(() => {
    if (isUrgent) urgent--;
    return draw();
  });
  last = work.catch(() => {});
  return work;
}

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
  /** Ends the wait of a picture at rest for its program. */
  private stopWaiting = () => {};
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

  /** Draw the shape with these values of the sliders of the page. */
  setParameters(values: number[]): void {
    this.data.setParameters(values);
    this.resources?.refresh();
    this.redraw("moving");
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

  /** Forget the resources of a lost device. An unfinished picture is drawn again by a new one. */
  lost(engine: Backend): void {
    if (this.resources?.engine !== engine) return;
    this.resources = null;
    // WebGPU reports errors late, so that a picture that seems complete may have one.
    if ((this.isComplete && engine instanceof WebGl) || this.isClosed) return;
    // The browser drops a context when other windows make new ones. The delay grows, so that those finish first.
    const delay = (100 + 500 * Math.random()) * 2 ** Math.min(this.losses++, 5);
    setTimeout(() => this.redraw(), delay);
  }

  /**
   * Draw again. A "moving" picture is drawn at once: by triangles at full size, or by rays at a smaller size. A "still" one
   * follows after a pause. A "smooth" one replaces a still one by the mean of 16 samples for each pixel.
   * A "hidden" picture is a moving one that leaves the canvas as it is: it prepares the device for the first input.
   */
  redraw(kind: Drawing = "still"): void {
    if (this.isClosed) return;
    clearTimeout(this.later);
    if (kind !== "smooth") this.isComplete = this.hasFailed = false;
    this.turn++;
    if (this.isBusy) {
      this.isStale = kind;
      this.stopWaiting();
      return;
    }
    this.isBusy = true;
    let used: Backend | null = null;
    const draw = async () => {
      const resources = this.acquire();
      used = resources.engine;
      if (kind === "smooth") await this.drawSmooth(resources);
      else if (kind === "still") await this.drawStill(resources);
      else await this.drawMoving(resources, kind === "moving");
    };
    draw()
      .catch((problem) => {
        // The loss of a device is no problem of the view: `lost` draws again.
        if (used?.isLost) return;
        if (used instanceof WebGpu) {
          // WebGL 2 draws the picture instead.
          device?.destroy();
          return;
        }
        this.hasFailed = true;
        this.onProblem(sentence(problem));
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

  /** Colours and depths of the present camera and settings. */
  async pixels(): Promise<Pixels> {
    await this.compiled(this.settings, [Picture.color, Picture.depth]);
    return inQueue(true, async () => {
      const resources = this.acquire();
      const { width, height } = this.canvas;
      const whole = (picture: number) => {
        resources.prepare(this.camera, this.settings, width, height, picture);
        resources.draw(0, height);
        return resources.read(width, height);
      };
      const [color, depth] = await Promise.all([Picture.color, Picture.depth].map(whole));
      const depths = new Float32Array(depth.buffer).map((value) => (value < NO_DEPTH ? value : Infinity));
      return { width, height, color: new Uint8Array(color.buffer), depth: depths };
    });
  }

  /** The surface or slice at a pixel of the canvas, counted from the upper left corner; null on the background. */
  async pick(x: number, y: number): Promise<Pick | null> {
    // The ray goes through the centre of the pixel, as in the shader. The camera may turn before the values are there.
    [x, y] = [Math.floor(x), Math.floor(y)];
    const { eye } = this.camera;
    const { level, slice } = this.settings;
    const way = this.camera.through(x, y, this.canvas.width, this.canvas.height);
    const pictures = [Picture.depth, Picture.object, Picture.normal, Picture.normal + 1, Picture.normal + 2];
    if (slice) pictures.push(Picture.slice);
    const [depth, object, nx, ny, nz, distance] = await this.values(pictures, x, y);
    if (slice && distance < NO_DEPTH) {
      const { axis, at } = slice;
      const t = (at - eye[axis]) / way[axis];
      if (t > 0 && (t <= depth || slice.cut)) {
        const normal: Vector = [0, 0, 0];
        normal[axis] = -Math.sign(way[axis]);
        return { point: add(eye, times(way, t)), normal, distance, depth: t, object: -1 };
      }
    }
    if (!(depth < NO_DEPTH)) return null;
    return { point: add(eye, times(way, depth)), normal: [nx, ny, nz], distance: level, depth, object: Math.round(object) };
  }

  /** The distance on the slice at a pixel of the canvas; null where the slice is not visible. */
  async sliceValue(x: number, y: number): Promise<number | null> {
    if (!this.settings.slice) return null;
    const [value] = await this.values([Picture.slice], x, y);
    return value < NO_DEPTH ? value : null;
  }

  /** The float32 of each of these pictures at a pixel, for the camera and the settings at the time of the call. */
  private async values(pictures: number[], x: number, y: number): Promise<number[]> {
    const camera = new Camera(this.camera.state);
    const settings = { ...this.settings };
    await this.compiled(settings, pictures);
    return inQueue(true, async () => {
      if (this.isClosed) return pictures.map(() => Infinity);
      const resources = this.acquire();
      const { width, height } = this.canvas;
      const value = (picture: number) => {
        resources.prepare(camera, settings, width, height, picture);
        return resources.value(Math.floor(x), Math.floor(y), height);
      };
      // A lost device may fail in any call.
      const found = await Promise.all(pictures.map(value)).catch((problem) => {
        if (resources.engine.isLost) return [];
        throw problem;
      });
      if (resources.engine.isLost) throw new Unavailable("The graphics device was lost. The next input uses another one.");
      return found;
    });
  }

  /** Resolves when the browser has compiled the programs of these pictures at rest, beside the page and other drawings. */
  private async compiled(settings: Settings, pictures: number[]): Promise<void> {
    if (this.isClosed) return;
    const resources = this.acquire();
    await Promise.all(pictures.map((picture) => resources.compiled(settings, picture)));
  }

  private acquire(): Resources {
    // A picture may be unfinished on the lost device.
    if (this.resources?.engine.isLost) this.lost(this.resources.engine);
    this.resources ??= new Resources(engine(), this.data);
    this.wait();
    return this.resources;
  }

  /** Release the context, or wait while a picture is being drawn. The canvas keeps the picture, which is not smoothed then. */
  rest(): void {
    if (this.isBusy) return this.wait();
    clearTimeout(this.idle);
    if (this.isComplete) clearTimeout(this.later);
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

  /**
   * Whether a drawing that started with `resources` and `turn` may go on after a wait. It stops after `redraw` or `close`, which
   * change the turn; after `rest` or `replace`, which free the resources; and after the loss of the device. A picture in motion
   * draws the camera of the latest request, so it is called without `turn`: only freed resources and a lost device stop it.
   */
  private isCurrent(resources: Resources, turn = this.turn): boolean {
    return this.turn === turn && this.resources === resources && !resources.engine.isLost;
  }

  private async drawMoving(resources: Resources, isShown: boolean): Promise<void> {
    await inQueue(true, async () => {
      if (!this.isCurrent(resources)) return;
      // This picture has the camera and the settings of a request that came while it waited.
      if (isShown && this.isStale === "moving") this.isStale = null;
      const started = performance.now();
      // Steps and errors belong to the exact picture.
      const isFiltered = this.picture === Picture.color;
      // The time for triangles hardly depends on the number of pixels.
      const isTriangles = isFiltered && resources.isSurface(this.settings);
      const share = isTriangles ? 1 : 1 / this.coarseness;
      const width = Math.max(1, Math.round(this.canvas.width * share));
      const height = Math.max(1, Math.round(this.canvas.height * share));
      // The triangles of a new level or of new data are made once, so their time is not used to choose the next grid.
      const isNew = this.settings.level !== resources.movingLevel;
      resources.movingLevel = this.settings.level;
      resources.isCoarse = this.isCoarse || isNew;
      resources.prepare(this.camera, this.settings, width, height, this.picture, isFiltered);
      resources.draw(0, height);
      await resources.engine.finished();
      if (!this.isCurrent(resources)) return;
      if (isShown) await this.show(resources);
      const spent = performance.now() - started;
      this.times.moving = spent;
      this.times.width = width;
      this.times.first ||= performance.now();
      // The time for rays goes with the number of pixels. One slow frame, such as the frame of a first compilation, changes
      // little.
      const factor = Math.max(0.7, Math.min(1.4, Math.sqrt(spent / MOVING_MS)));
      if (!isTriangles) this.coarseness = Math.max(1, Math.min(COARSEST, this.coarseness * factor));
      else if (!isNew) this.isCoarse = spent > (this.isCoarse ? FAST_MS : MOVING_MS);
    });
    // Other views draw until the browser shows the picture.
    await nextPaint();
  }

  private async drawStill(resources: Resources): Promise<void> {
    const { turn } = this;
    // The browser compiles while other views draw, and until a later request replaces this one.
    const stopped = new Promise<void>((done) => (this.stopWaiting = done));
    await Promise.race([resources.compiled(this.settings, this.picture), stopped]);
    await inQueue(false, async () => {
      if (!this.isCurrent(resources, turn)) return;
      const started = performance.now();
      resources.prepare(this.camera, this.settings, this.canvas.width, this.canvas.height, this.picture);
      if (!(await this.drawPieces(resources, turn, "still"))) return;
      await this.show(resources);
      if (this.turn !== turn) return;
      this.times.still = performance.now() - started;
      this.times.first ||= performance.now();
      this.isComplete = true;
      this.losses = 0;
      if (this.picture === Picture.color && this.times.still < SMOOTH_MS) this.redrawLater("smooth", SMOOTH_PAUSE_MS);
    });
  }

  /** Draw the prepared picture in pieces; false if a later request replaces it, or if it is drawn later. */
  private async drawPieces(resources: Resources, turn: number, kind: Drawing): Promise<boolean> {
    const { height } = this.canvas;
    // Input is handled between the pieces, and no driver mistakes a long picture for a hang.
    let rows = Math.max(1, Math.round(height / 8));
    for (let row = 0; row < height; ) {
      if (urgent > 0) {
        this.redrawLater(kind, kind === "smooth" ? SMOOTH_PAUSE_MS : PAUSE_MS);
        return false;
      }
      const before = performance.now();
      resources.draw(height - Math.min(height, row + rows), Math.min(rows, height - row));
      row += rows;
      await resources.engine.finished();
      if (!this.isCurrent(resources, turn)) return false;
      const spent = performance.now() - before;
      rows = Math.max(1, Math.min(height, Math.round((rows * PIECE_MS) / Math.max(spent, 1))));
    }
    return true;
  }

  /** Replace the picture by the mean of four samples for each pixel, then by the mean of all. */
  private drawSmooth(resources: Resources): Promise<void> {
    const { turn } = this;
    return inQueue(false, async () => {
      const started = performance.now();
      const { width, height } = this.canvas;
      const sums = new Float32Array(4 * width * height);
      for (const [number, shift] of SAMPLES.entries()) {
        if (!this.isCurrent(resources, turn)) return;
        resources.prepare(this.camera, this.settings, width, height, this.picture, false, shift);
        if (!(await this.drawPieces(resources, turn, "smooth"))) return;
        const bytes = await resources.read(width, height);
        for (let i = 0; i < sums.length; i += 4) {
          const opacity = bytes[i + 3];
          for (let k = 0; k < 3; k++) sums[i + k] += bytes[i + k] * opacity;
          sums[i + 3] += opacity;
        }
        if (this.turn !== turn) return;
        const count = number + 1;
        if (count !== FIRST_SAMPLES && count !== SAMPLES.length) continue;
        const image = this.context.createImageData(width, height);
        sums.forEach((sum, i) => (image.data[i] = (i & 3) === 3 ? sum / count : sum / (sums[i | 3] || 1)));
        this.context.putImageData(image, 0, 0);
      }
      this.times.smooth = performance.now() - started;
    });
  }

  private get picture(): number {
    return { light: Picture.color, steps: Picture.steps, error: Picture.error }[this.settings.colors];
  }
}

/** Release the context of WebGL. The device of WebGPU stays, with its compiled programs. */
function releaseShared(): void {
  shared?.release();
  if (!(shared instanceof WebGpu)) shared = null;
}

/** A number with four significant digits, at most eleven characters long. */
export function text(value: number): string {
  const short = Number(value.toPrecision(4));
  const size = Math.abs(short);
  return size === 0 || (size >= 1e-4 && size < 1e6) ? String(short) : short.toExponential();
}

/** An error as a sentence for the reader of the page. */
export function sentence(problem: unknown): string {
  return problem instanceof Unavailable ? problem.message : String(problem);
}
