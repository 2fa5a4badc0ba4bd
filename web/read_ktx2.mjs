// Read a .ktx2 file by the loader of three.js. Argument: the path. Standard output: JSON with the sizes and the texels.
import { readFile } from "node:fs/promises";
import { KTX2Loader } from "three/examples/jsm/loaders/KTX2Loader.js";

const bytes = await readFile(process.argv[2]);
const loader = new KTX2Loader();
// The loader asks for the formats of a renderer, which only compressed textures need.
loader.workerConfig = {};
const texture = await new Promise((done, fail) => {
  loader.parse(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength), done, fail);
});
const { width, height, depth, data } = texture.image;
process.stdout.write(JSON.stringify({ is3D: texture.isData3DTexture === true, flipY: texture.flipY, size: [width, height, depth], data: Array.from(data) }));
