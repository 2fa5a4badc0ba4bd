// WebGL 2: one context for all views of a document.

import { Backend, Bytes, Pass, Program, Shape, Texture, TextureKind, Unavailable, upright } from "./backend";
import { Triangles } from "./surface";
import { Vector } from "./vectors";

/** Uniform blocks of the shaders in the order of their binding points. */
const BLOCKS = ["View", "Own", "Lights"];

/** The vertex shader of rays: one triangle over the whole picture. */
const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

interface GlTexture extends Texture {
  texture: WebGLTexture;
}

interface GlShape extends Shape {
  array: WebGLVertexArrayObject;
  count: number;
}

export class WebGl implements Backend {
  readonly mostRows: number;
  readonly mostLayers: number;
  private readonly canvas = document.createElement("canvas");
  private readonly gl: WebGL2RenderingContext;
  private readonly programs = new Map<string, WebGLProgram>();
  private readonly linked = new Set<WebGLProgram>();
  private readonly blocks: WebGLBuffer[];
  private pass!: Pass;
  /** Whether nothing of the picture has been drawn. */
  private isEmpty = true;

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
    this.blocks = BLOCKS.map(() => gl.createBuffer());
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      onLost();
    });
    // The views have made a new context by then.
    this.canvas.addEventListener("webglcontextrestored", () => this.release());
  }

  /** Whether a graphics processor draws the pictures. */
  get isHardware(): boolean {
    const { gl } = this;
    const names = gl.getExtension("WEBGL_debug_renderer_info");
    return !!names && !/swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(names.UNMASKED_RENDERER_WEBGL));
  }

  get isLost(): boolean {
    return this.gl.isContextLost();
  }

  release(): void {
    if (!this.isLost) this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  texture(kind: TextureKind, [width, height, depth]: Vector, values: ArrayBufferView<ArrayBuffer>): GlTexture {
    const { gl } = this;
    const texture = gl.createTexture();
    const target = kind === "filtered" ? gl.TEXTURE_3D : gl.TEXTURE_2D;
    gl.bindTexture(target, texture);
    const filter = kind === "filtered" ? gl.LINEAR : gl.NEAREST;
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (kind === "filtered") gl.texImage3D(target, 0, gl.R8_SNORM, width, height, depth, 0, gl.RED, gl.BYTE, values);
    else if (kind === "table") gl.texImage2D(target, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, values);
    else this.fillWords(width, height, values as Uint32Array<ArrayBuffer>);
    return { texture, free: () => gl.deleteTexture(texture) };
  }

  /** Copy words to their texture: all whole rows, then the rest. */
  private fillWords(width: number, height: number, words: Uint32Array<ArrayBuffer>): void {
    const { gl } = this;
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, width, height);
    const rows = Math.floor(words.length / width);
    const put = (row: number, across: number, count: number) => {
      if (across * count > 0)
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, across, count, gl.RED_INTEGER, gl.UNSIGNED_INT, words, row * width);
    };
    put(0, width, rows);
    put(rows, words.length - rows * width, 1);
  }

  shape({ corners, indices }: Triangles): GlShape {
    const { gl } = this;
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
    const free = () => {
      gl.deleteVertexArray(array);
      for (const buffer of buffers) gl.deleteBuffer(buffer);
    };
    return { array, count: indices.length, free };
  }

  /** Start the compilation of a program. */
  private start({ glsl }: Program): WebGLProgram {
    const fragment = glsl[glsl.length - 1];
    const known = this.programs.get(fragment);
    if (known) return known;
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [
      [gl.VERTEX_SHADER, glsl.length > 1 ? glsl[0] : VERTEX],
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

  async compiled(text: Program): Promise<void> {
    const { gl } = this;
    const program = this.start(text);
    const extension = gl.getExtension("KHR_parallel_shader_compile");
    while (extension && !gl.isContextLost() && !gl.getProgramParameter(program, extension.COMPLETION_STATUS_KHR))
      await new Promise((done) => setTimeout(done, 5));
  }

  private program(text: Program): WebGLProgram {
    const { gl } = this;
    const program = this.start(text);
    if (this.linked.has(program)) return program;
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = (gl.getAttachedShaders(program) ?? []).map((shader) => gl.getShaderInfoLog(shader));
      throw new Unavailable(`The shader was not compiled: ${[gl.getProgramInfoLog(program), ...logs].join(" ")}`);
    }
    this.linked.add(program);
    return program;
  }

  prepare(pass: Pass): void {
    const { gl, canvas } = this;
    const { width, height, textures } = pass;
    this.pass = pass;
    this.isEmpty = true;
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    const program = this.program(pass.program);
    gl.viewport(0, 0, width, height);
    gl.useProgram(program);
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORM_BLOCKS); i++)
      gl.uniformBlockBinding(program, i, BLOCKS.findIndex((name) => gl.getActiveUniformBlockName(program, i)!.startsWith(name)));
    this.setBlock(0, pass.view);
    if (pass.triangles) this.setBlock(2, pass.triangles.lights);
    const kinds = [
      [gl.UNSIGNED_INT_SAMPLER_2D, "words", gl.TEXTURE_2D],
      [gl.SAMPLER_2D, "table", gl.TEXTURE_2D],
      [gl.SAMPLER_3D, "filtered", gl.TEXTURE_3D],
    ] as const;
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name, type } = gl.getActiveUniform(program, i)!;
      const unit = kinds.findIndex(([kind]) => kind === type);
      if (unit < 0) continue;
      const [, kind, target] = kinds[unit];
      gl.uniform1i(gl.getUniformLocation(program, name), unit);
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, (textures[kind] as GlTexture | null)?.texture ?? null);
    }
    gl.activeTexture(gl.TEXTURE0);
  }

  private setBlock(place: number, values: Float32Array<ArrayBuffer>): void {
    const { gl } = this;
    gl.bindBufferBase(gl.UNIFORM_BUFFER, place, this.blocks[place]);
    gl.bufferData(gl.UNIFORM_BUFFER, values, gl.DYNAMIC_DRAW);
  }

  draw(first: number, rows: number, x = 0, width = this.canvas.width): void {
    const { gl } = this;
    const { triangles } = this.pass;
    if (triangles && this.isEmpty) {
      const [red, green, blue, alpha] = triangles.background;
      gl.disable(gl.SCISSOR_TEST);
      gl.clearColor(red, green, blue, alpha);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    }
    this.isEmpty = false;
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(x, first, width, rows);
    if (!triangles) return gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.enable(gl.DEPTH_TEST);
    for (const { shape, row } of triangles.instances) {
      const { array, count } = shape as GlShape;
      this.setBlock(1, row);
      gl.bindVertexArray(array);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    }
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
  }

  async finished(): Promise<void> {
    const { gl } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (fence && !gl.isContextLost()) {
      const state = gl.clientWaitSync(fence, 0, 0);
      if (state === gl.ALREADY_SIGNALED || state === gl.CONDITION_SATISFIED || state === gl.WAIT_FAILED) break;
      await new Promise((done) => setTimeout(done, 1));
    }
    if (fence) gl.deleteSync(fence);
  }

  read(x: number, y: number, width: number, height: number): Bytes {
    const { gl, canvas } = this;
    const below = new Uint8ClampedArray(4 * width * height);
    gl.readPixels(x, canvas.height - y - height, width, height, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(below.buffer));
    return upright(below, 4 * width, height);
  }

  show(context: CanvasRenderingContext2D): void {
    context.drawImage(this.canvas, 0, 0, context.canvas.width, context.canvas.height);
  }
}
