// The entry of the viewer. It has two hosts: a page that contains its data, and a widget of a notebook (widget.ts).

import { Controls } from "./controls";
import { Data } from "./data";
import { Pixels, View, nextPaint, requestDevice } from "./view";
import { inTurn } from "./turns";
import { isForced } from "./webgpu";
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

/** Put a view into an element. A picture in the element is shown until the view has drawn its own. */
export function mount(root: HTMLElement, buffer: ArrayBuffer): Mounted {
  const data = new Data(buffer);
  const [width, height] = data.description.size;
  const still = root.querySelector("img");
  const canvas = document.createElement("canvas");
  const density = Math.min(2, window.devicePixelRatio || 1);
  canvas.width = Math.round(width * density);
  canvas.height = Math.round(height * density);
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  // The bar of controls needs 240 pixels.
  root.style.width = `${Math.max(width, 240)}px`;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", data.description.title);
  const view = new View(canvas, data);
  if (still) still.before(canvas);
  else root.append(canvas);
  const controls = new Controls(root, view);
  const sliders = data.description.sliders?.parameters ?? [];
  const values = sliders.map(({ value }) => value);
  const resets = sliders.map(({ name, range: [least, largest], value }, i) =>
    controls.addSlider(name, least, largest, value, (changed) => {
      values[i] = changed;
      view.setParameters(values);
    }),
  );
  controls.onReset = () => resets.forEach((reset) => reset());
  const copied = still && showStill(still, view);
  view.onProblem = (message) => {
    controls.say(message);
    if (!still || view.hasDrawn) return;
    canvas.style.display = "none";
    still.style.display = "";
  };
  void Promise.resolve(copied).then(() => drawFirst(view, still ? "hidden" : "moving"));
  const close = () => {
    controls.close();
    view.close();
  };
  return { view, controls, close };
}

/** Copy the picture of a page to the canvas of its view, so that the view accepts input before it has drawn. */
function showStill(still: HTMLImageElement, view: View): Promise<void> {
  const copy = () => {
    if (view.hasDrawn) return;
    view.canvas.getContext("2d")!.drawImage(still, 0, 0, view.canvas.width, view.canvas.height);
    view.canvas.style.display = "";
    still.style.display = "none";
  };
  view.canvas.style.display = "none";
  view.onChange = () => {
    view.canvas.style.display = "";
    still.remove();
    view.onChange = () => {};
  };
  return still.decode().then(copy, () => {});
}

/** Draw the first picture in turn with the other windows of the tab, and release the context if there are others. */
function drawFirst(view: View, kind: "moving" | "hidden"): Promise<void> {
  return inTurn(async () => {
    view.redraw(kind);
    await view.settled;
    if (window.top !== window) view.rest();
  });
}

/** The object `window.fieldbake` of a page, for scripts and tests. */
interface PageHook {
  /** Resolves when the first picture is drawn, or the view has reported why there is none. */
  ready: Promise<void>;
  pixels(): Promise<Pixels>;
  view: View;
}

/** The bytes of a text in base64. Browsers before 2025 lack the function for it, which is a hundred times faster. */
function decoded(text: string): Uint8Array<ArrayBuffer> {
  const { fromBase64 } = Uint8Array as { fromBase64?: (text: string) => Uint8Array<ArrayBuffer> };
  if (fromBase64) return fromBase64.call(Uint8Array, text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function openPage(): Promise<void> {
  const holder = document.getElementById("fieldbake-data");
  const root = document.getElementById("fieldbake-view");
  if (!holder || !root) return;
  // The browser paints the picture of the page first.
  await nextPaint();
  await new Promise((done) => setTimeout(done));
  if (isForced) await requestDevice();
  const mounted = mount(root, await inflated(decoded(holder.textContent ?? "")));
  const hook: PageHook = { ready: mounted.view.settled, pixels: () => mounted.view.pixels(), view: mounted.view };
  Object.assign(window, { fieldbake: hook });
  await hook.ready;
  document.documentElement.dataset.fieldbake = mounted.view.hasDrawn ? "ready" : "still";
}

void openPage();
