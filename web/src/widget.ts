// The view as a widget of a notebook: anywidget calls `render`, and the traits of the model are the view's settings.

import { Mounted, inflated, mount } from "./main";
import { CameraState } from "./camera";
import { Vector } from "./vectors";

/** The model of a widget, as anywidget passes it to `render`. */
interface Model {
  get(name: string): unknown;
  set(name: string, value: unknown): void;
  save_changes(): void;
  on(name: string, callback: () => void): void;
  off(name: string, callback: () => void): void;
}

interface SliceTrait {
  axis: "x" | "y" | "z";
  at: number;
  cut?: boolean;
}

const same = (a: unknown, b: unknown): boolean => JSON.stringify(a) === JSON.stringify(b);

/** Put the model's view into an element. The result closes the view. */
export async function render({ model, el }: { model: Model; el: HTMLElement }): Promise<() => void> {
  const root = document.createElement("div");
  el.append(root);
  let mounted: Mounted | null = null;
  let isApplying = false;

  /** Copy the traits of the model to the view. */
  const apply = () => {
    if (!mounted || isApplying) return;
    const { view, controls } = mounted;
    const camera = model.get("camera") as CameraState;
    if (camera?.pose && !same(camera, view.camera.state)) view.camera.set(camera);
    view.settings.level = model.get("level") as number;
    const slice = model.get("slice") as SliceTrait | null;
    view.settings.slice = slice && { axis: "xyz".indexOf(slice.axis), at: slice.at, cut: slice.cut ?? true };
    const light = model.get("light") as Vector | null;
    view.settings.light = light?.length === 3 ? light : null;
    controls.refresh();
    view.redraw("moving");
  };
  /** Copy the settings of the view to the model after input. */
  const report = () => {
    const { view } = mounted!;
    const { level, slice, light } = view.settings;
    isApplying = true;
    model.set("camera", view.camera.state);
    model.set("level", level);
    model.set("slice", slice && { axis: "xyz"[slice.axis], at: slice.at, cut: slice.cut });
    model.set("light", light);
    model.save_changes();
    isApplying = false;
  };
  let turn = 0;
  /** Show the model's data. New data of the same size go into the present view, so that no slider is replaced in use. */
  const open = async () => {
    const mine = ++turn;
    const bytes = model.get("data") as DataView;
    const buffer = await inflated(new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength) as Uint8Array<ArrayBuffer>);
    if (mine !== turn) return;
    if (mounted?.view.replace(buffer)) return;
    mounted?.close();
    root.replaceChildren();
    mounted = mount(root, buffer);
    addParameters();
    mounted.controls.onPick = (pick) => {
      model.set("picked", pick);
      model.save_changes();
    };
    mounted.controls.onInput = report;
    apply();
  };
  /** A slider for each parameter of the model's shape. */
  const addParameters = () => {
    const ranges = model.get("_ranges") as Record<string, [number, number]>;
    const values = model.get("parameters") as Record<string, number>;
    for (const [name, [least, largest]] of Object.entries(ranges ?? {})) {
      mounted!.controls.addSlider(name, least, largest, values[name], (value) => {
        model.set("parameters", { ...(model.get("parameters") as object), [name]: value });
        model.save_changes();
      });
    }
  };

  const names = ["camera", "level", "slice", "light"].map((name) => `change:${name}`);
  const replace = () => void open();
  for (const name of names) model.on(name, apply);
  model.on("change:data", replace);
  await open();
  return () => {
    turn++;
    for (const name of names) model.off(name, apply);
    model.off("change:data", replace);
    mounted?.close();
    root.remove();
  };
}
