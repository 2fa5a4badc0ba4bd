// A baked field among the meshes of a three.js scene. See README.md in this folder.
import * as THREE from "three";
import { KTX2Loader } from "three/addons/loaders/KTX2Loader.js";
import { read } from "three/addons/libs/ktx-parse.module.js";

const VERTEX = `
  out vec3 world;
  void main() {
    world = (modelMatrix * vec4(position, 1.0)).xyz;
    gl_Position = projectionMatrix * viewMatrix * vec4(world, 1.0);
  }`;

/** A box mesh that draws the zero surface of the field in a .ktx2 file (an ArrayBuffer) by sphere tracing. */
export async function fieldMesh(file, renderer, color = 0xd9853b) {
  const loader = new KTX2Loader().detectSupport(renderer);
  const texture = await new Promise((done, fail) => loader.parse(file, done, fail));
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  const facts = JSON.parse(new TextDecoder().decode(read(new Uint8Array(file)).keyValue.fieldbake).replace(/\0+$/, ""));
  const [lower, upper] = facts.bounds.map((corner) => new THREE.Vector3(...corner));
  const size = upper.clone().sub(lower);
  // Bytes have 0 at the middle of their range; floats are distances.
  const decode = facts.encoding === "unorm8" ? new THREE.Vector2(2 * facts.scale, -facts.scale) : new THREE.Vector2(1, 0);
  const material = new THREE.ShaderMaterial({
    glslVersion: THREE.GLSL3,
    side: THREE.BackSide, // a ray ends on the far side of the box, also with the camera inside
    uniforms: { field: { value: texture }, lower: { value: lower }, size: { value: size }, decode: { value: decode },
      tint: { value: new THREE.Color(color) } },
    vertexShader: VERTEX,
    fragmentShader: `
      precision highp sampler3D;
      uniform sampler3D field;
      uniform vec3 lower, size, tint;
      uniform vec2 decode;
      uniform mat4 projectionMatrix;
      in vec3 world;
      out vec4 pixel;
      float value(vec3 p) { return texture(field, (p - lower) / size).x * decode.x + decode.y; }
      void main() {
        vec3 along = normalize(world - cameraPosition);
        vec3 a = (lower - cameraPosition) / along, b = (lower + size - cameraPosition) / along;
        vec3 first = min(a, b), last = max(a, b);
        float t = max(max(max(first.x, first.y), first.z), 0.0), end = min(min(last.x, last.y), last.z);
        float shortest = 1e-4 * length(size), d = 1.0;
        // The field changes by at most the length of a step; shortest stops the search at the surface.
        for (int i = 0; i < 256 && t < end; i++, t += d) if ((d = value(cameraPosition + t * along)) < shortest) break;
        if (d >= shortest) discard;
        vec3 p = cameraPosition + t * along, h = 0.5 * size / vec3(textureSize(field, 0));
        vec3 normal = normalize(vec3(
          value(p + vec3(h.x, 0, 0)) - value(p - vec3(h.x, 0, 0)),
          value(p + vec3(0, h.y, 0)) - value(p - vec3(0, h.y, 0)),
          value(p + vec3(0, 0, h.z)) - value(p - vec3(0, 0, h.z))) / h);
        pixel = linearToOutputTexel(vec4(tint * (0.25 + 0.75 * max(dot(normal, normalize(vec3(1, 2, 1.5))), 0.0)), 1));
        vec4 clip = projectionMatrix * viewMatrix * vec4(p, 1);
        gl_FragDepth = 0.5 * clip.z / clip.w + 0.5; // meshes and the field hide each other
      }`,
  });
  const mesh = new THREE.Mesh(new THREE.BoxGeometry(...size.toArray()).translate(...lower.clone().addScaledVector(size, 0.5).toArray()), material);
  return mesh;
}
