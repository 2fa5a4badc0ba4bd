// The controls of a view: the pointer and the keyboard move the camera and pick points, a bar below has the settings.

import { Pick, View, sentence, text } from "./view";
import { Vector, unit } from "./vectors";

// Rounded corners around the canvas, and shadows, would cost a device in software as much as the whole picture.
const STYLE = `
.fb-view{display:inline-block;max-width:100%;font:12px/1.4 system-ui,sans-serif;color:#2b3038;background:#f3f4f6;position:relative}
.fb-view *{box-sizing:border-box}
.fb-view canvas{display:block;touch-action:none;cursor:grab;outline-offset:-2px}
.fb-view canvas:active{cursor:grabbing}
.fb-bar{display:flex;flex-wrap:wrap;align-items:center;gap:4px 10px;padding:5px 9px}
.fb-bar label{display:inline-flex;align-items:center;gap:5px;white-space:nowrap}
.fb-bar input[type=range]{width:70px;margin:0;accent-color:#2f7fb5}
.fb-bar button,.fb-bar select{font:inherit;color:inherit;border:1px solid #c9ced6;border-radius:5px;background:#fff;padding:1px 7px;cursor:pointer}
.fb-bar output{min-width:3.2em;font-variant-numeric:tabular-nums}
.fb-note{padding:0 9px 6px;display:flex;gap:0 14px;flex-wrap:wrap;color:#5d6572;min-height:1.9em;font-variant-numeric:tabular-nums;overflow-wrap:anywhere}
.fb-note b{font-weight:600;color:#2b3038}
.fb-dark{background:#20242b;color:#dfe3ea}
.fb-dark .fb-note{color:#99a1ad}.fb-dark .fb-note b{color:#dfe3ea}
.fb-dark .fb-bar button,.fb-dark .fb-bar select{background:#2c313a;border-color:#444b57}
.fb-scale{display:inline-flex;align-items:center;gap:5px}
.fb-scale i{width:70px;height:9px;border-radius:3px}
.fb-pages{position:absolute;inset:0 0 auto;overflow:auto;background:inherit;padding:8px 9px;display:grid;gap:8px;align-content:start}
.fb-pages[hidden]{display:none}
.fb-pages figure{margin:0}
.fb-pages figcaption{padding-bottom:3px}
.fb-pages figure div{position:relative;max-width:512px}
.fb-pages img{display:block;width:100%;image-rendering:pixelated}
.fb-pages span{position:absolute;border:1px solid #16181d;overflow:hidden;font-size:11px;line-height:1.2;color:#16181d}
.fb-pages b{background:#fffc;padding:0 3px}
.fb-view .fb-bar button[aria-pressed=true]{background:#2f7fb5;border-color:#2f7fb5;color:#fff}
`;

/** The colours from 0 to the most steps or the largest error, as `heat` in shaders/viewer/view.wgsl has them. */
const HEAT = "linear-gradient(90deg,#08081f,#401f73,#b3336b,#f58040,#ffeb99)";

/** Length of a drag that turns the camera by 360 degrees, pixels. */
const TURN_PX = 500;

function element<K extends keyof HTMLElementTagNameMap>(
  kind: K,
  parent: Element,
  text = "",
  attributes: Record<string, string> = {},
): HTMLElementTagNameMap[K] {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  parent.append(made);
  return made;
}

export class Controls {
  onPick: (pick: Pick) => void = () => {};
  /** Called by the button "reset". */
  onReset: () => void = () => {};
  /** Called after input has changed the camera or a setting. */
  onInput: () => void = () => {};
  private readonly bar: HTMLElement;
  private readonly note: HTMLElement;
  private readonly under: HTMLElement;
  private readonly scale: HTMLElement;
  private readonly pages: HTMLElement | null;
  private readonly level: HTMLInputElement;
  private readonly axis: HTMLSelectElement;
  private readonly place: HTMLInputElement;
  private readonly levelText: HTMLOutputElement;
  private readonly placeText: HTMLOutputElement;
  private readonly buttons = new Map<string, HTMLButtonElement>();
  private readonly pointers = new Map<number, [number, number]>();
  private readonly stop = new AbortController();
  /** The latest pixel below the pointer whose value is not yet requested, and whether a value is on its way. */
  private hovered: [number, number] | null = null;
  private isHovering = false;
  private isLight = false;

  constructor(
    readonly root: HTMLElement,
    readonly view: View,
  ) {
    const { description } = view.data;
    root.classList.add("fb-view", "fb-dark");
    element("style", root, STYLE);
    const bar = element("div", root, "", { class: "fb-bar", role: "toolbar", "aria-label": "Controls of the view" });
    this.bar = bar;
    const [lowest, highest] = description.levels;
    this.level = this.range(bar, "level", "Level of the surface: an offset preview", lowest, highest, 0);
    this.levelText = element("output", this.level.parentElement!);
    const axes = element("label", bar, "slice ");
    this.axis = element("select", axes, "", { title: "Slice plane across an axis" });
    for (const name of ["off", "x", "y", "z"]) element("option", this.axis, name);
    this.place = element("input", axes, "", { type: "range", min: "0", max: "1", step: "any", title: "Place of the slice" });
    this.place.value = "0.5";
    this.placeText = element("output", axes);
    this.button(bar, "cut", "Cut away the half before the slice", () => this.change(() => {
      const { slice } = view.settings;
      if (slice) view.settings.slice = { ...slice, cut: !slice.cut };
    }));
    this.button(bar, "light", "Drag moves the light (also: Shift and drag)", () => {
      this.isLight = !this.isLight;
      this.refresh();
    });
    const paint = (colors: "steps" | "error") => () => this.change(() => {
      view.settings.colors = view.settings.colors === colors ? "light" : colors;
    });
    this.button(bar, "steps", "Steps of each ray, dark for few and light for many", paint("steps"));
    if (description.error !== null)
      this.button(bar, "error", "Difference of the stored samples from the exact ones, dark for small and light for large", paint("error"));
    if (view.data.hasMesh)
      this.button(bar, "mesh", "The triangles of meshes in place of their fields", () => this.change(() => {
        view.settings.mesh = !view.settings.mesh;
      }));
    this.pages = description.pages.length ? this.addPages() : null;
    this.button(bar, "ground", "Dark or light background", () => this.change(() => {
      const isOwn = view.settings.background === description.background;
      view.settings.background = isOwn ? [0.9, 0.91, 0.93, 1] : description.background;
    }));
    this.button(bar, "save", "Save the picture as PNG", () => this.save());
    this.button(bar, "reset", "The view as it was at first", () => this.reset());
    this.note = element("div", root, "", { class: "fb-note", "aria-live": "polite" });
    element("b", this.note, description.title);
    element("span", this.note, description.note);
    this.scale = element("span", this.note, "", { class: "fb-scale" });
    this.under = element("span", this.note);

    const on = { signal: this.stop.signal };
    this.level.addEventListener("input", () => this.change(() => (view.settings.level = Number(this.level.value)), true), on);
    this.axis.addEventListener("input", () => this.change(() => this.setSlice()), on);
    this.place.addEventListener("input", () => this.change(() => this.setSlice(), true), on);
    this.listen(view.canvas, on);
    this.refresh();
  }

  close(): void {
    this.stop.abort();
  }

  /** Show the settings of the view in the bar. */
  refresh(): void {
    const { settings, data } = this.view;
    const [lower, upper] = data.description.bounds;
    this.level.value = String(settings.level);
    this.levelText.textContent = text(settings.level);
    this.axis.value = settings.slice ? "xyz"[settings.slice.axis] : "off";
    this.place.disabled = !settings.slice;
    this.placeText.textContent = settings.slice ? `${this.axis.value} = ${text(settings.slice.at)}` : "";
    if (settings.slice) {
      const { axis, at } = settings.slice;
      this.place.value = String((at - lower[axis]) / (upper[axis] - lower[axis]));
    }
    const pressed = { cut: settings.slice?.cut ?? false, light: this.isLight, steps: settings.colors === "steps", error: settings.colors === "error", mesh: settings.mesh, pages: this.pages?.hidden === false };
    this.refreshScale();
    for (const [name, is] of Object.entries(pressed)) this.buttons.get(name)?.setAttribute("aria-pressed", String(is));
    this.buttons.get("cut")!.disabled = !settings.slice;
    this.root.classList.toggle("fb-dark", settings.background === data.description.background && data.description.background[0] < 0.3);
  }

  /** Show what the colours of steps and errors mean. */
  private refreshScale(): void {
    const { settings, data } = this.view;
    const { error, most_steps } = data.description;
    this.scale.replaceChildren();
    if (settings.colors === "light") return;
    const isSteps = settings.colors === "steps";
    element("span", this.scale, "0");
    element("i", this.scale).style.background = HEAT;
    element("span", this.scale, isSteps ? `${most_steps} steps of a ray` : `${text(error ?? 0)} world units, error of the nearest sample`);
  }

  /** The pages of an atlas in a layer over the canvas, and the button that shows it. */
  private addPages(): HTMLElement {
    const { canvas, data } = this.view;
    const layer = element("div", this.root, "", { class: "fb-pages", hidden: "" });
    layer.style.height = canvas.style.height;
    for (const { title, picture, volumes } of data.description.pages) {
      const figure = element("figure", layer);
      element("figcaption", figure, title);
      const page = element("div", figure);
      element("img", page, "", { src: picture, alt: title });
      for (const { name, box } of volumes) {
        const frame = element("span", page, "", { title: name });
        [frame.style.left, frame.style.top, frame.style.width, frame.style.height] = box.map((share) => `${100 * share}%`);
        element("b", frame, name);
      }
    }
    this.button(this.bar, "pages", "The pages of the atlas with the frames of its volumes", () => {
      layer.hidden = !layer.hidden;
      this.refresh();
    });
    return layer;
  }

  /** Add a slider whose changes go to `onValue`. Returns a function that moves the slider to its first value. */
  addSlider(name: string, least: number, largest: number, value: number, onValue: (value: number) => void): () => void {
    const input = this.range(this.bar, name, name, least, largest, value);
    const shown = element("output", input.parentElement!, text(value));
    const changed = () => {
      shown.textContent = text(Number(input.value));
      onValue(Number(input.value));
    };
    input.addEventListener("input", changed, { signal: this.stop.signal });
    return () => {
      if (input.value === String(value)) return;
      input.value = String(value);
      changed();
    };
  }

  /** Show a message below the picture. */
  say(message: string): void {
    this.under.textContent = message;
  }

  private range(parent: Element, name: string, title: string, min: number, max: number, value: number): HTMLInputElement {
    const label = element("label", parent, `${name} `);
    const input = element("input", label, "", { type: "range", title, min: String(min), max: String(max), step: "any" });
    input.value = String(value);
    return input;
  }

  private button(parent: Element, name: string, title: string, act: () => void): void {
    const made = element("button", parent, name, { type: "button", title });
    made.addEventListener("click", act, { signal: this.stop.signal });
    this.buttons.set(name, made);
  }

  private change(act: () => void, isMoving = false): void {
    act();
    this.refresh();
    this.view.redraw(isMoving ? "moving" : "still");
    this.onInput();
  }

  private setSlice(): void {
    const axis = "xyz".indexOf(this.axis.value);
    const { settings, data } = this.view;
    const [lower, upper] = data.description.bounds;
    const share = Number(this.place.value);
    const cut = settings.slice?.cut ?? true;
    settings.slice = axis < 0 ? null : { axis, at: lower[axis] + share * (upper[axis] - lower[axis]), cut };
  }

  private reset(): void {
    const { view } = this;
    view.camera.reset();
    Object.assign(view.settings, { level: 0, slice: null, light: null, colors: "light", mesh: false, background: view.data.description.background });
    this.isLight = false;
    if (this.pages) this.pages.hidden = true;
    this.onReset();
    this.change(() => {});
  }

  private save(): void {
    this.view.canvas.toBlob((blob) => {
      if (!blob) return;
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = "fieldbake.png";
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }

  private listen(canvas: HTMLCanvasElement, on: AddEventListenerOptions): void {
    const { view } = this;
    canvas.tabIndex = 0;
    const moved = (act: () => void) => this.change(act, true);
    const failed = (problem: unknown) => this.say(sentence(problem));
    const place = (event: MouseEvent): [number, number] => {
      const box = canvas.getBoundingClientRect();
      return [
        ((event.clientX - box.left) * canvas.width) / box.width,
        ((event.clientY - box.top) * canvas.height) / box.height,
      ];
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    }, on);
    for (const name of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId), on);
    }
    canvas.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      if (!before) {
        if (view.settings.slice && view.isComplete) void this.showValue(place(event)).catch(failed);
        return;
      }
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      const height = canvas.clientHeight || canvas.height;
      if (this.pointers.size === 2) {
        // Two fingers pan with their middle and zoom with their distance.
        const other = [...this.pointers].find(([id]) => id !== event.pointerId)![1];
        const apart = (p: [number, number]) => Math.hypot(p[0] - other[0], p[1] - other[1]);
        const factor = apart(before) / Math.max(1, apart([event.clientX, event.clientY]));
        moved(() => {
          view.camera.zoom(factor);
          view.camera.pan(dx / 2 / height, dy / 2 / height);
        });
      } else if (this.isLight || event.shiftKey) {
        moved(() => this.moveLight(dx, dy));
      } else if (event.buttons & 6 || event.ctrlKey || event.metaKey) {
        moved(() => view.camera.pan(dx / height, dy / height));
      } else {
        moved(() => view.camera.orbit((2 * Math.PI * dx) / TURN_PX, (2 * Math.PI * dy) / TURN_PX));
      }
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    }, on);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 33 : 1;
      moved(() => view.camera.zoom(Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY * lines * 0.0015)))));
    }, { ...on, passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault(), on);
    canvas.addEventListener("dblclick", (event) => void this.showPick(place(event)).catch(failed), on);
    canvas.addEventListener("keydown", (event) => {
      const step = Math.PI / 24;
      const acts: Record<string, () => void> = {
        ArrowLeft: () => (event.shiftKey ? view.camera.pan(-0.05, 0) : view.camera.orbit(-step, 0)),
        ArrowRight: () => (event.shiftKey ? view.camera.pan(0.05, 0) : view.camera.orbit(step, 0)),
        ArrowUp: () => (event.shiftKey ? view.camera.pan(0, -0.05) : view.camera.orbit(0, -step)),
        ArrowDown: () => (event.shiftKey ? view.camera.pan(0, 0.05) : view.camera.orbit(0, step)),
        "+": () => view.camera.zoom(0.9),
        "=": () => view.camera.zoom(0.9),
        "-": () => view.camera.zoom(1 / 0.9),
      };
      if (event.key === "Home" || event.key === "r") this.reset();
      else if (acts[event.key]) moved(acts[event.key]);
      else return;
      event.preventDefault();
    }, on);
  }

  private moveLight(dx: number, dy: number): void {
    const { settings, data } = this.view;
    const [x, y, z] = settings.light ?? unit(data.description.key.direction);
    // The drag moves the position of the light on a sphere around the object.
    settings.light = unit([x - (2 * dx) / TURN_PX, y + (2 * dy) / TURN_PX, Math.min(z, -0.05)] as Vector);
  }

  private async showPick([x, y]: [number, number]): Promise<void> {
    const { view } = this;
    const pick = await view.pick(x, y);
    if (!pick) return this.say("no surface at this pixel");
    const name = view.data.count > 1 ? view.data.nameOf(pick.object) : "";
    this.say(`${name}   point ${pick.point.map(text).join(", ")}   normal ${pick.normal.map((x) => x.toFixed(3)).join(", ")}   distance ${text(pick.distance)}`);
    this.onPick(pick);
  }

  /** Show the distance at a pixel. Pixels that the pointer passes while a value is read are skipped. */
  private async showValue(pixel: [number, number]): Promise<void> {
    this.hovered = pixel;
    if (this.isHovering) return;
    this.isHovering = true;
    try {
      while (this.hovered) {
        const [x, y]: [number, number] = this.hovered;
        this.hovered = null;
        const value = await this.view.sliceValue(x, y);
        this.say(value === null ? "" : `distance ${text(value)}`);
      }
    } finally {
      this.isHovering = false;
    }
  }
}
