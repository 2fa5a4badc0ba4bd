// The viewer of fieldbake, in two hosts: a page that holds its data, and a widget of a notebook (widget.ts).

import { Controls } from "./controls";
import { Data } from "./data";
import { Pixels, View } from "./view";
import { render } from "./widget";

export default { render };

/** A view in an element, with its controls. */
export interface Mounted {
  view: View;
  controls: Controls;
  close(): void;
}

/** Inflate data that are compressed by gzip. */
export async function inflated(bytes: Uint8Array<ArrayBuffer>): Promise<ArrayBuffer> {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** Put a view into an element; a picture that is there stays until the first one is drawn. */
export function mount(root: HTMLElement, buffer: ArrayBuffer): Mounted {
  const data = new Data(buffer);
  const [width, height] = data.description.size;
  const before = root.querySelector("img");
  const canvas = document.createElement("canvas");
  const dense = Math.min(2, window.devicePixelRatio || 1);
  canvas.width = Math.round(width * dense);
  canvas.height = Math.round(height * dense);
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  // At least as wide as the bar of controls needs.
  root.style.width = `${Math.max(width, 240)}px`;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", data.description.title);
  const view = new View(canvas, data);
  if (before) before.before(canvas);
  else root.append(canvas);
  const controls = new Controls(root, view);
  if (before) {
    canvas.style.display = "none";
    view.onChange = () => {
      before.remove();
      canvas.style.display = "";
      view.onChange = () => {};
    };
  }
  view.onProblem = (message) => controls.say(message);
  void drawFirst(view);
  const close = () => {
    controls.close();
    view.close();
  };
  return { view, controls, close };
}

/** Draws at the same time, over all documents of an origin: browsers stop at 16 contexts. */
const SLOTS = 4;
/** A picture that takes longer gives its slot away, milliseconds. */
const SLOT_MS = 20_000;

/** Draw a coarse picture, then the exact one, when one of a few slots is free; then give the context back. */
async function drawFirst(view: View): Promise<void> {
  const draw = async () => {
    view.redraw("moving");
    await Promise.race([view.ready, new Promise((done) => setTimeout(done, SLOT_MS))]);
    view.rest();
  };
  // Documents without an origin, such as sandboxed frames, have no locks.
  const locks = window.origin === "null" ? undefined : navigator.locks;
  if (locks) await locks.request(`fieldbake ${Math.floor(Math.random() * SLOTS)}`, draw);
  else await draw();
}

/** What a page offers to scripts and tests. */
interface PageHook {
  ready: Promise<void>;
  pixels(): Pixels;
  view: View;
}

async function openPage(): Promise<void> {
  const holder = document.getElementById("fieldbake-data");
  const root = document.getElementById("fieldbake-view");
  if (!holder || !root) return;
  const binary = atob(holder.textContent ?? "");
  const bytes = Uint8Array.from(binary, (character) => character.charCodeAt(0));
  const mounted = mount(root, await inflated(bytes));
  const hook: PageHook = { ready: mounted.view.ready, pixels: () => mounted.view.pixels(), view: mounted.view };
  Object.assign(window, { fieldbake: hook });
  mounted.view.ready.then(() => (document.documentElement.dataset.fieldbake = "ready"));
}

void openPage();
