// Writes the files of this folder with encoders of other projects. Run this script once, by hand:
//
//   npm install @gltf-transform/core@4 @gltf-transform/extensions@4
//   npm install @gltf-transform/functions@4 draco3dgltf meshoptimizer ktx2-encoder
//   node make.mjs FOLDER
//
// The scene of the .glb files is a grid of 5 × 4 vertices on z = sin(x) · y, with normals and
// texture coordinates, whose node turns. The .ktx2 files contain a picture of 20 × 12 texels.
import { writeFileSync } from 'node:fs';
import { Document, NodeIO } from '@gltf-transform/core';
import { ALL_EXTENSIONS, EXTMeshoptCompression, KHRDracoMeshCompression } from '@gltf-transform/extensions';
import { reorder, quantize } from '@gltf-transform/functions';
import draco3d from 'draco3dgltf';
import { MeshoptDecoder, MeshoptEncoder } from 'meshoptimizer';
import { encodeToKTX2 } from 'ktx2-encoder';

const folder = process.argv[2];
await MeshoptEncoder.ready;
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({
    'draco3d.encoder': await draco3d.createEncoderModule(),
    'draco3d.decoder': await draco3d.createDecoderModule(),
    'meshopt.encoder': MeshoptEncoder,
    'meshopt.decoder': MeshoptDecoder,
});

function grid() {
    const document = new Document();
    const buffer = document.createBuffer();
    const [positions, normals, uvs, indices] = [[], [], [], []];
    for (let row = 0; row < 4; row++) {
        for (let column = 0; column < 5; column++) {
            const [x, y] = [column / 2, row / 2];
            positions.push(x, y, Math.sin(x) * y);
            const normal = [-Math.cos(x) * y, -Math.sin(x), 1];
            const length = Math.hypot(...normal);
            normals.push(...normal.map((value) => value / length));
            uvs.push(column / 4, row / 3);
            if (row < 3 && column < 4) {
                const corner = row * 5 + column;
                indices.push(corner, corner + 1, corner + 5, corner + 1, corner + 6, corner + 5);
            }
        }
    }
    const accessor = (type, values) => document.createAccessor().setType(type).setArray(values).setBuffer(buffer);
    const primitive = document.createPrimitive()
        .setAttribute('POSITION', accessor('VEC3', new Float32Array(positions)))
        .setAttribute('NORMAL', accessor('VEC3', new Float32Array(normals)))
        .setAttribute('TEXCOORD_0', accessor('VEC2', new Float32Array(uvs)))
        .setIndices(accessor('SCALAR', new Uint16Array(indices)));
    const node = document.createNode().setMesh(document.createMesh().addPrimitive(primitive));
    document.createScene().addChild(node);
    const half = Math.SQRT1_2;
    const sampler = document.createAnimationSampler().setInterpolation('LINEAR')
        .setInput(accessor('SCALAR', new Float32Array([0, 1, 2])))
        .setOutput(accessor('VEC4', new Float32Array([0, 0, 0, 1, 0, 0, half, half, 0, 0, 1, 0])));
    const channel = document.createAnimationChannel().setTargetNode(node).setTargetPath('rotation').setSampler(sampler);
    document.createAnimation('turn').addSampler(sampler).addChannel(channel);
    return document;
}

await io.write(`${folder}/grid.glb`, grid());
const { EDGEBREAKER, SEQUENTIAL } = KHRDracoMeshCompression.EncoderMethod;
for (const [name, method] of [['edgebreaker', EDGEBREAKER], ['sequential', SEQUENTIAL]]) {
    const document = grid();
    document.createExtension(KHRDracoMeshCompression).setRequired(true).setEncoderOptions({ method });
    await io.write(`${folder}/grid-draco-${name}.glb`, document);
}
for (const method of ['quantize', 'filter']) {
    const document = grid();
    await document.transform(reorder({ encoder: MeshoptEncoder }), quantize({ pattern: /^(POSITION|TEXCOORD|NORMAL)(_\d+)?$/, quantizeNormal: method === 'filter' ? 8 : 10 }));
    document.createExtension(EXTMeshoptCompression).setRequired(true).setEncoderOptions({ method });
    await io.write(`${folder}/grid-meshopt-${method}.glb`, document);
}

const [width, height] = [20, 12];
const texels = new Uint8Array(4 * width * height);
for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
        texels.set([40 + 8 * x, 200 - 10 * y, 90, x < 10 ? 255 : 128], 4 * (y * width + x));
    }
}
const imageDecoder = async () => ({ width, height, data: texels });
for (const [name, options] of [
    ['etc1s', { isUASTC: false, qualityLevel: 255, compressionLevel: 2 }],
    ['uastc', { isUASTC: true, needSupercompression: false }],
    ['uastc-zstd', { isUASTC: true, needSupercompression: true }],
]) {
    const base = { imageDecoder, generateMipmap: false, isKTX2File: true, isPerceptual: false, isSetKTX2SRGBTransferFunc: false };
    const file = await encodeToKTX2(new Uint8Array(8), { ...base, ...options });
    writeFileSync(`${folder}/${name}.ktx2`, file);
}
