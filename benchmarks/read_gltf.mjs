// Reads a .glb file with three.js and checks it with the Khronos validator: node read_gltf.mjs NODE_MODULES FILE.glb OUT
// OUT.json: versions, the validator's issues, every mesh with its attributes (and indices) and the columns of the matrix that places it, the
// covariances that three's own reader of KHR_gaussian_splatting made of scales and rotations, and animations. Arrays are
// {start, length, width} in OUT.bin, float64.
import fs from 'node:fs';
import path from 'node:path';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const [modules, file, out] = process.argv.slice(2);
const require = createRequire(path.join(path.resolve(modules), 'here.js'));
const validator = require('gltf-validator');
const load = (name) => import(pathToFileURL(path.join(path.resolve(modules), 'three', name)));
const { GLTFLoader } = await load('examples/jsm/loaders/GLTFLoader.js');
const { REVISION } = await load('build/three.module.js');
const data = fs.readFileSync(file);
const whole = data.buffer.slice(data.byteOffset, data.byteOffset + data.length);

const parse = (register) => new Promise((done, failed) => {
    const loader = new GLTFLoader();
    if (register) loader.register(register);
    loader.parse(whole, '', done, failed);
});

const { issues } = await validator.validateBytes(new Uint8Array(whole), { maxIssues: 0 });
const scene = await parse();
const parts = [];
let total = 0;
const keep = (values, width) => {
    parts.push(Float64Array.from(values));
    total += values.length;
    return { start: total - values.length, length: values.length, width };
};
const meshes = [];
scene.scene.updateMatrixWorld(true);
scene.scene.traverse((object) => {
    if (!object.geometry) return;
    const attributes = {};
    for (const [name, attribute] of Object.entries(object.geometry.attributes)) {
        const values = [];
        for (let i = 0; i < attribute.count; i++) for (let k = 0; k < attribute.itemSize; k++) values.push(attribute.getComponent(i, k));
        attributes[name] = keep(values, attribute.itemSize);
    }
    const indices = object.geometry.index ? keep(object.geometry.index.array, 3) : null;
    meshes.push({ name: object.name, kind: object.type, attributes, indices, matrix: keep(object.matrixWorld.elements, 4) });
});
const animations = scene.animations.map((one) => ({
    name: one.name,
    seconds: one.duration,
    tracks: one.tracks.map((track) => ({ name: track.name, times: Array.from(track.times), values: Array.from(track.values) })),
}));

let splats = null;
if ((scene.parser.json.extensionsUsed ?? []).includes('KHR_gaussian_splatting')) {
    const { GLTFGaussianSplatLoaderExtension } = await load('examples/jsm/loaders/GLTFGaussianSplatLoaderExtension.js');
    splats = [];
    const read = await parse((parser) => new GLTFGaussianSplatLoaderExtension(parser));
    read.scene.traverse((one) => one.isGaussianSplat && splats.push(keep(one.splatGeometry.attributes.covariance.array, 6)));
}
const content = { three: REVISION, validator: validator.version(), issues, meshes, animations, splats };
fs.writeFileSync(`${out}.json`, JSON.stringify(content));
fs.writeFileSync(`${out}.bin`, Buffer.concat(parts.map((part) => Buffer.from(part.buffer))));
