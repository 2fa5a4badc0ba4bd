// One view: its canvas, the pictures that it draws, and what a pick finds.

import { Camera } from "./camera";
import { Data } from "./data";
import { Engine, Picture, Resources, Settings, Unavailable } from "./engine";
import { Vector, add, times } from "./vectors";

export interface Pick {
  point: Vector;
  normal: Vector;
  /** Distance of the point to the fields; 0 on the surface. */
  distance: number;
  depth: number;
  object: number;
}

/** The arrays of a picture, row 0 on top. */
export interface Pixels {
  width: number;
  height: number;
  /** sRGB and opacity, four bytes a pixel. */
  color: Uint8Array;
  /** World units; Infinity where nothing was hit. */
  depth: Float32Array;
}

/** Depths from here on are of no hit. */
const NO_DEPTH = 2e38;
/** A picture in motion takes about as long, milliseconds. */
const MOVING_MS = 60;
/** A picture at rest is drawn in pieces of about as long. */
const PIECE_MS = 40;
/** A view without input releases its context after as long. */
const IDLE_MS = 1500;
const COARSEST = 6;

let shared: Engine | null = null;
const users = new Set<View>();

function engine(): Engine {
  if (!shared || shared.isLost) {
    const made = new Engine(() => {
      if (shared === made) shared = null;
      for (const view of users) view.lost(made);
    });
    shared = made;
  }
  return shared;
}

export class View {
  readonly camera: Camera;
  readonly settings: Settings;
  /** Milliseconds of the last picture at full size, and of the last one in motion. */
  readonly times = { first: 0, still: 0, moving: 0 };
  onChange: () => void = () => {};
  onProblem: (message: string) => void = () => {};
  private readonly context: CanvasRenderingContext2D;
  private resources: Resources | null = null;
  /** Counts requests; a picture that another one replaces stops. */
  private turn = 0;
  /** How many times smaller pictures in motion are. */
  private coarseness = 3;
  private isBusy = false;
  private isStale: "moving" | "still" | null = null;
  private idle = 0;
  private waiting: Array<() => void> = [];
  isComplete = false;
  isClosed = false;

  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly data: Data,
  ) {
    this.context = canvas.getContext("2d")!;
    this.camera = new Camera(data.description.camera);
    this.settings = { level: 0, slice: null, light: null, background: data.description.background, steps: false };
    users.add(this);
  }

  /** Resolves when the picture at full size is on the canvas. */
  get ready(): Promise<void> {
    return this.isComplete ? Promise.resolve() : new Promise((done) => this.waiting.push(done));
  }

  close(): void {
    this.isClosed = true;
    this.turn++;
    clearTimeout(this.idle);
    this.resources?.free();
    this.resources = null;
    users.delete(this);
    if (users.size === 0) releaseShared();
  }

  /** The context was lost: what was in it is gone. */
  lost(engine: Engine): void {
    if (this.resources?.engine !== engine) return;
    this.resources = null;
    // Other documents may want a context as well: later, and not all at once.
    if (!this.isComplete && !this.isClosed) setTimeout(() => this.redraw(), 100 + 500 * Math.random());
  }

  /** Draw again: `moving` for one of many pictures, at a size that can be drawn at once. */
  redraw(kind: "moving" | "still" = "still"): void {
    if (this.isClosed) return;
    this.isComplete = false;
    this.turn++;
    if (this.isBusy) {
      this.isStale = kind;
      return;
    }
    this.isBusy = true;
    const work = kind === "moving" ? this.drawMoving() : this.drawStill();
    work
      .catch((problem) => {
        if (shared && !shared.isLost) this.onProblem(problem instanceof Unavailable ? problem.message : String(problem));
      })
      .finally(() => {
        this.isBusy = false;
        const next = this.isStale;
        this.isStale = null;
        if (next) this.redraw(next);
        else if (kind === "moving") this.redraw("still");
      });
  }

  /** Colours and depths, drawn now. */
  pixels(): Pixels {
    const resources = this.acquire();
    const { width, height } = this.canvas;
    const whole = (picture: number) => {
      resources.prepare(this.camera, this.settings, width, height, picture);
      resources.draw(0, height);
      return resources.read();
    };
    const color = whole(Picture.color);
    const depth = new Float32Array(whole(Picture.depth).buffer).map((value) => (value < NO_DEPTH ? value : Infinity));
    this.redraw();
    return { width, height, color, depth };
  }

  /** What is at a place of the canvas, in its own pixels from the upper left corner. */
  pick(x: number, y: number): Pick | null {
    const slice = this.settings.slice && this.value(Picture.slice, x, y);
    const depth = this.value(Picture.depth, x, y);
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
    const normal = [0, 1, 2].map((axis) => this.value(Picture.normal + axis, x, y)) as Vector;
    const object = Math.round(this.value(Picture.object, x, y));
    return { point: add(this.camera.eye, times(way, depth)), normal, distance: this.settings.level, depth, object };
  }

  /** The distance at a place of the slice, or null beside it. */
  sliceValue(x: number, y: number): number | null {
    if (!this.settings.slice) return null;
    const value = this.value(Picture.slice, x, y);
    return value < NO_DEPTH ? value : null;
  }

  private value(picture: number, x: number, y: number): number {
    const resources = this.acquire();
    resources.prepare(this.camera, this.settings, this.canvas.width, this.canvas.height, picture);
    this.turn++;
    return resources.value(Math.floor(x), Math.floor(y));
  }

  private acquire(): Resources {
    if (!this.resources || this.resources.engine.isLost) this.resources = new Resources(engine(), this.data);
    this.wait();
    return this.resources;
  }

  /** Release the context unless something is being drawn. The canvas keeps the picture. */
  rest(): void {
    if (this.isBusy) return this.wait();
    clearTimeout(this.idle);
    this.resources?.free();
    this.resources = null;
    if (![...users].some((view) => view.resources)) releaseShared();
  }

  /** Rest if nothing happens for a while. */
  private wait(): void {
    clearTimeout(this.idle);
    this.idle = window.setTimeout(() => this.rest(), IDLE_MS);
  }

  /** Show what the context has drawn. */
  private show(width: number, height: number): void {
    const { canvas, context } = this;
    context.globalCompositeOperation = "copy";
    context.imageSmoothingEnabled = width !== canvas.width;
    context.drawImage(this.resources!.engine.canvas, 0, 0, width, height, 0, 0, canvas.width, canvas.height);
    this.onChange();
  }

  private async drawMoving(): Promise<void> {
    const started = performance.now();
    const resources = this.acquire();
    const width = Math.max(1, Math.round(this.canvas.width / this.coarseness));
    const height = Math.max(1, Math.round(this.canvas.height / this.coarseness));
    resources.prepare(this.camera, this.settings, width, height, this.picture);
    resources.draw(0, height);
    await finished(resources.engine.gl);
    if (this.resources !== resources || resources.engine.isLost) return;
    this.show(width, height);
    const spent = performance.now() - started;
    this.times.moving = spent;
    if (spent > 1.5 * MOVING_MS) this.coarseness = Math.min(COARSEST, this.coarseness + 1);
    else if (spent < 0.4 * MOVING_MS) this.coarseness = Math.max(1, this.coarseness - 1);
    await new Promise(requestAnimationFrame);
  }

  private async drawStill(): Promise<void> {
    const turn = this.turn;
    const started = performance.now();
    const resources = this.acquire();
    const { width, height } = this.canvas;
    resources.prepare(this.camera, this.settings, width, height, this.picture);
    // In pieces, so that input comes between, and no driver takes the picture for a hang.
    let rows = Math.max(1, Math.round(height / 8));
    for (let row = 0; row < height; ) {
      const before = performance.now();
      resources.draw(height - Math.min(height, row + rows), Math.min(rows, height - row));
      row += rows;
      await finished(resources.engine.gl);
      if (this.turn !== turn || this.resources !== resources || resources.engine.isLost) return;
      const spent = performance.now() - before;
      rows = Math.max(1, Math.min(height, Math.round((rows * PIECE_MS) / Math.max(spent, 1))));
    }
    this.show(width, height);
    this.times.still = performance.now() - started;
    this.times.first ||= performance.now();
    this.isComplete = true;
    for (const done of this.waiting.splice(0)) done();
  }

  private get picture(): number {
    return this.settings.steps ? Picture.steps : Picture.color;
  }
}

function releaseShared(): void {
  const engine = shared;
  shared = null;
  engine?.release();
}

/** Resolves when the device has drawn everything so far. */
async function finished(gl: WebGL2RenderingContext): Promise<void> {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  while (fence && !gl.isContextLost()) {
    const state = gl.clientWaitSync(fence, 0, 0);
    if (state === gl.ALREADY_SIGNALED || state === gl.CONDITION_SATISFIED || state === gl.WAIT_FAILED) break;
    await new Promise((done) => setTimeout(done, 1));
  }
  if (fence) gl.deleteSync(fence);
}

/** Text of a number with as many digits as its size bears. */
export function text(value: number): string {
  return value === 0 ? "0" : Number(value.toPrecision(4)).toString();
}

