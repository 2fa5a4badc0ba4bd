// WebGPU: one device for all views of a document. It compiles the WGSL itself.

import { Backend, Bytes, LIGHT_TEXELS, MOST_LIGHTS, Pass, Program, ROW, Shape, Texture, TextureKind, VIEW_FLOATS, upright } from "./backend";
import { Triangles } from "./surface";
import { Vector } from "./vectors";

const FORMATS = { words: "r32uint", table: "rgba32float", filtered: "r8snorm" } as const;
const TEXEL_BYTES = { words: 4, table: 16, filtered: 1 };
const COLOR = "rgba8unorm";
const DEPTH = "depth32float";
/** The next multiple of 256 bytes. Offsets of uniforms and rows of copies are such multiples on every device. */
const aligned = (bytes: number): number => 256 * Math.ceil(bytes / 256);
/** Bytes of a row of the table, and from one row to the next. */
const ROW_BYTES = TEXEL_BYTES.table * ROW;
const ROW_STRIDE = aligned(ROW_BYTES);

/** The vertex shader of rays: one triangle over the whole picture. */
const VERTEX = `@vertex fn whole(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
  return vec4f(select(-1.0, 3.0, i == 1u), select(-1.0, 3.0, i == 2u), 0.0, 1.0);
}`;

interface GpuTexture extends Texture {
  view: GPUTextureView;
}

interface GpuShape extends Shape {
  corners: GPUBuffer;
  indices: GPUBuffer;
  count: number;
}

export class WebGpu implements Backend {
  readonly mostRows: number;
  readonly mostLayers: number;
  isLost = false;
  private readonly layout: GPUBindGroupLayout;
  private readonly pipelines = new Map<string, GPURenderPipeline>();
  /** The programs that the browser compiles beside the page, so that none is compiled twice. */
  private readonly compiling = new Map<string, Promise<void>>();
  /** Ends the wait of the one drawing that runs. */
  private stopWaiting = () => {};
  /** The blocks `View`, `Own` and `Lights` of the shaders. `Own` has the rows of all instances that are drawn. */
  private readonly view: GPUBuffer;
  private own: GPUBuffer;
  private readonly lights: GPUBuffer;
  private readonly sampler: GPUSampler;
  /** Textures in place of those that a picture does not have. */
  private readonly missing: Record<TextureKind, GpuTexture>;
  private target: { color: GPUTexture; depth: GPUTexture; width: number; height: number } | null = null;
  private pass!: Pass;
  private pipeline!: GPURenderPipeline;
  private group!: GPUBindGroup;
  private isEmpty = true;
  private readonly copy = document.createElement("canvas");

  constructor(
    private readonly device: GPUDevice,
    onLost: () => void,
  ) {
    this.mostRows = device.limits.maxTextureDimension2D;
    this.mostLayers = device.limits.maxTextureDimension3D;
    void device.lost.then(() => {
      this.isLost = true;
      this.stopWaiting();
      onLost();
    });
    const visibility = GPUShaderStage.VERTEX | GPUShaderStage.FRAGMENT;
    const kinds: Omit<GPUBindGroupLayoutEntry, "binding" | "visibility">[] = [
      { buffer: {} },
      { texture: { sampleType: "uint" } },
      { texture: { sampleType: "unfilterable-float" } },
      { texture: { viewDimension: "3d" } },
      { sampler: {} },
      { buffer: { hasDynamicOffset: true } },
      { buffer: {} },
    ];
    this.layout = device.createBindGroupLayout({ entries: kinds.map((kind, binding) => ({ binding, visibility, ...kind })) });
    this.view = this.block(4 * VIEW_FLOATS);
    this.own = this.block(ROW_STRIDE);
    this.lights = this.block(16 * LIGHT_TEXELS * MOST_LIGHTS);
    this.sampler = device.createSampler({ magFilter: "linear", minFilter: "linear" });
    const empty = (kind: TextureKind) => this.texture(kind, [1, 1, 1], new Uint8Array(TEXEL_BYTES[kind]));
    this.missing = { words: empty("words"), table: empty("table"), filtered: empty("filtered") };
  }

  private block(size: number): GPUBuffer {
    return this.device.createBuffer({ size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
  }

  /** The views share the device, which stays for the next picture. */
  release(): void {
    this.target?.color.destroy();
    this.target?.depth.destroy();
    this.target = null;
  }

  texture(kind: TextureKind, size: Vector, values: ArrayBufferView<ArrayBuffer>): GpuTexture {
    const usage = GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST;
    const dimension = kind === "filtered" ? "3d" : "2d";
    const texture = this.device.createTexture({ size, dimension, format: FORMATS[kind], usage });
    const [width, height, depth] = size;
    const rowBytes = TEXEL_BYTES[kind] * width;
    const put = (row: number, across: number, rows: number) => {
      if (across * rows === 0) return;
      const layout = { offset: row * rowBytes, bytesPerRow: rowBytes, rowsPerImage: height };
      this.device.queue.writeTexture({ texture, origin: [0, row, 0] }, values, layout, [across, rows, kind === "filtered" ? depth : 1]);
    };
    const rows = kind === "filtered" ? height : Math.floor(values.byteLength / rowBytes);
    put(0, width, rows);
    if (kind === "words") put(rows, values.byteLength / 4 - rows * width, 1);
    return { view: texture.createView(), free: () => texture.destroy() };
  }

  shape({ corners, indices }: Triangles): GpuShape {
    const made = ([[corners, GPUBufferUsage.VERTEX], [indices, GPUBufferUsage.INDEX]] as const).map(([values, usage]) => {
      const buffer = this.device.createBuffer({ size: Math.max(values.byteLength, 4), usage: usage | GPUBufferUsage.COPY_DST });
      this.device.queue.writeBuffer(buffer, 0, values as Float32Array<ArrayBuffer>);
      return buffer;
    });
    return { corners: made[0], indices: made[1], count: indices.length, free: () => made.forEach((buffer) => buffer.destroy()) };
  }

  private description({ wgsl }: Program): GPURenderPipelineDescriptor {
    const { device } = this;
    const [, corner] = /@vertex\s+fn (\w+)/.exec(wgsl) ?? [];
    const [, color] = /@fragment\s+fn (\w+)/.exec(wgsl)!;
    const module = device.createShaderModule({ code: wgsl });
    const attributes = [0, 1].map((i) => ({ shaderLocation: i, offset: 12 * i, format: "float32x3" as const }));
    return {
      layout: device.createPipelineLayout({ bindGroupLayouts: [this.layout] }),
      vertex: corner
        ? { module, entryPoint: corner, buffers: [{ arrayStride: 24, attributes }] }
        : { module: device.createShaderModule({ code: VERTEX }), entryPoint: "whole" },
      fragment: { module, entryPoint: color, targets: [{ format: COLOR }] },
      depthStencil: { format: DEPTH, depthWriteEnabled: !!corner, depthCompare: corner ? "less" : "always" },
    };
  }

  async compiled(program: Program): Promise<void> {
    const key = program.wgsl;
    if (this.pipelines.has(key)) return;
    const compile = async () => void this.pipelines.set(key, await this.device.createRenderPipelineAsync(this.description(program)));
    if (!this.compiling.has(key)) this.compiling.set(key, compile());
    await this.compiling.get(key);
  }

  prepare(pass: Pass): void {
    const { device } = this;
    const { width, height, textures, triangles } = pass;
    this.pass = pass;
    this.isEmpty = true;
    if (this.target?.width !== width || this.target.height !== height) {
      this.release();
      const made = (format: GPUTextureFormat, usage: number) => device.createTexture({ size: [width, height], format, usage: usage | GPUTextureUsage.RENDER_ATTACHMENT });
      this.target = { color: made(COLOR, GPUTextureUsage.COPY_SRC), depth: made(DEPTH, 0), width, height };
    }
    const key = pass.program.wgsl;
    this.pipeline = this.pipelines.get(key) ?? device.createRenderPipeline(this.description(pass.program));
    this.pipelines.set(key, this.pipeline);
    device.queue.writeBuffer(this.view, 0, pass.view);
    if (triangles?.instances.length) {
      const rows = new Float32Array((ROW_STRIDE / 4) * triangles.instances.length);
      triangles.instances.forEach(({ row }, i) => rows.set(row, (ROW_STRIDE / 4) * i));
      if (rows.byteLength > this.own.size) {
        this.own.destroy();
        this.own = this.block(rows.byteLength);
      }
      device.queue.writeBuffer(this.own, 0, rows);
      device.queue.writeBuffer(this.lights, 0, triangles.lights);
    }
    const texture = (kind: TextureKind) => ((textures[kind] as GpuTexture | null) ?? this.missing[kind]).view;
    const resources = [
      { buffer: this.view },
      texture("words"),
      texture("table"),
      texture("filtered"),
      this.sampler,
      { buffer: this.own, size: ROW_BYTES },
      { buffer: this.lights },
    ];
    this.group = device.createBindGroup({ layout: this.layout, entries: resources.map((resource, binding) => ({ binding, resource })) });
  }

  draw(first: number, rows: number, x = 0, width = this.pass.width): void {
    const { device } = this;
    const { triangles } = this.pass;
    const [r, g, b, a] = triangles?.background ?? [0, 0, 0, 0];
    const loadOp = this.isEmpty ? "clear" : "load";
    this.isEmpty = false;
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: this.target!.color.createView(), loadOp, clearValue: { r, g, b, a }, storeOp: "store" }],
      depthStencilAttachment: { view: this.target!.depth.createView(), depthLoadOp: loadOp, depthClearValue: 1, depthStoreOp: "store" },
    });
    pass.setPipeline(this.pipeline);
    pass.setScissorRect(x, first, width, rows);
    if (!triangles) {
      pass.setBindGroup(0, this.group, [0]);
      pass.draw(3);
    }
    triangles?.instances.forEach(({ shape }, i) => {
      const { corners, indices, count } = shape as GpuShape;
      pass.setBindGroup(0, this.group, [ROW_STRIDE * i]);
      pass.setVertexBuffer(0, corners);
      pass.setIndexBuffer(indices, "uint32");
      pass.drawIndexed(count);
    });
    pass.end();
    device.queue.submit([encoder.finish()]);
  }

  finished(): Promise<void> {
    // A race with `device.lost` would leave a callback there for each picture, until the device is lost.
    return new Promise((done, fail) => {
      this.stopWaiting = done;
      this.device.queue.onSubmittedWorkDone().then(done, fail);
    });
  }

  async read(x: number, y: number, width: number, height: number): Promise<Bytes> {
    const { device } = this;
    const stride = aligned(4 * width);
    const buffer = device.createBuffer({ size: stride * height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = device.createCommandEncoder();
    const origin = [x, this.target!.height - y - height];
    encoder.copyTextureToBuffer({ texture: this.target!.color, origin }, { buffer, bytesPerRow: stride }, [width, height]);
    device.queue.submit([encoder.finish()]);
    await buffer.mapAsync(GPUMapMode.READ);
    const bytes = upright(new Uint8ClampedArray(buffer.getMappedRange()), 4 * width, height, stride);
    buffer.destroy();
    return bytes;
  }

  async show(context: CanvasRenderingContext2D): Promise<void> {
    const { width, height } = this.target!;
    const { canvas } = context;
    // The bytes go through memory. A copy of the target to a canvas of WebGPU ends the graphics process of Chromium with
    // SwiftShader, and needs colours that are multiplied by their opacity.
    const image = new ImageData(await this.read(0, 0, width, height), width, height);
    if (width === canvas.width && height === canvas.height) return context.putImageData(image, 0, 0);
    Object.assign(this.copy, { width, height });
    this.copy.getContext("2d")!.putImageData(image, 0, 0);
    context.drawImage(this.copy, 0, 0, canvas.width, canvas.height);
  }
}

/** Whether the address of the page demands WebGPU, also of a device in software. */
export const isForced = location.hash === "#webgpu";

/** The device of WebGPU; null where the browser has none, or has one in software only. */
export async function requestedDevice(): Promise<GPUDevice | null> {
  try {
    const adapter = await navigator.gpu?.requestAdapter({ powerPreference: "high-performance" });
    if (!adapter || (adapter.info.isFallbackAdapter && !isForced)) return null;
    const { maxTextureDimension2D, maxTextureDimension3D, maxBufferSize } = adapter.limits;
    return await adapter.requestDevice({ requiredLimits: { maxTextureDimension2D, maxTextureDimension3D, maxBufferSize } });
  } catch {
    return null;
  }
}
