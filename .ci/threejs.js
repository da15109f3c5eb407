// Plays a chain of levels (maille lod --geomorph) with three.js in a headless browser, drawn by SwiftShader: no graphics card.
//
//   NODE_PATH=... BROWSER=/usr/bin/chromium node .ci/threejs.js CHAIN.glb...
//
// Each node that lists levels (MSFT_lod) has a morph target named `geomorph`, which three.js knows by that name. While each clip
// plays, its weight goes from 0 to 1, to the next level: there, the picture must be that of the next level without a morph. A morph
// target cannot say which joints move a wedge, though, so that less is asked of what has a skin.
const fs = require("fs");
const http = require("http");
const path = require("path");
const puppeteer = require("puppeteer-core");

const SIZE = 256;
const FRAMES = 6;
// how much a switch at weight 1 may change the pixels that the model covers, on average: steps of 8 bits, which the rounding of
// positions explains, and where there is a skin also a share of what a cut changes
const STEPS = 0.05;
const SHARE = 0.9;

const page = `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

window.measure = async (url, size, frames) => {
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(size, size, false);
  const gltf = await new GLTFLoader().loadAsync(url);
  const { parser, scene } = gltf;
  const meshesOf = (object) => {
    const meshes = [];
    object.traverse((child) => child.isMesh && meshes.push(child));
    return meshes;
  };

  // every node with levels, as three.js has made it, and its first level in its place
  const pairs = [];
  for (const [index, node] of parser.json.nodes.entries()) {
    const ids = node.extensions?.MSFT_lod?.ids;
    if (!ids) continue;
    const [finer, coarser] = [await parser.getDependency("node", index), await parser.getDependency("node", ids[0])];
    finer.parent.add(coarser);
    coarser.position.copy(finer.position);
    coarser.quaternion.copy(finer.quaternion);
    coarser.scale.copy(finer.scale);
    pairs.push({ finer: meshesOf(finer), coarser: meshesOf(coarser) });
  }
  const all = (which) => pairs.flatMap((pair) => pair[which]);
  const targets = all("finer").map((mesh) => mesh.morphTargetDictionary?.geomorph);
  [...all("finer"), ...all("coarser")].forEach((mesh) => { mesh.frustumCulled = false; });

  const show = (which, weight) => {
    all("finer").forEach((mesh, i) => {
      mesh.visible = which === "finer";
      mesh.morphTargetInfluences[targets[i]] = weight;
    });
    all("coarser").forEach((mesh) => { mesh.visible = which === "coarser"; });
  };
  show("finer", 0);
  const sphere = new THREE.Box3().setFromObject(scene, true).getBoundingSphere(new THREE.Sphere());
  const camera = new THREE.PerspectiveCamera(30, 1, sphere.radius / 100, 100 * sphere.radius);
  camera.position.set(0.5, 0.3, 1).setLength(4.2 * sphere.radius).add(sphere.center);
  camera.lookAt(sphere.center);
  const world = new THREE.Scene();
  world.add(scene, new THREE.HemisphereLight(0xffffff, 0x404040, 1.5));
  const sun = new THREE.DirectionalLight(0xffffff, 2);
  sun.position.copy(camera.position).add(new THREE.Vector3(-sphere.radius, 2 * sphere.radius, 0));
  world.add(sun);

  const gl = renderer.getContext();
  const draw = (which, weight) => {
    show(which, weight);
    renderer.render(world, camera);
    const pixels = new Uint8Array(4 * size * size);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  };
  const covered = (pixels) => {
    let count = 0;
    for (let i = 0; i < pixels.length; i += 4) count += pixels[i] + pixels[i + 1] + pixels[i + 2] > 0;
    return count;
  };
  const change = (a, b) => {
    let [sum, max] = [0, 0];
    for (let i = 0; i < a.length; i++) {
      const step = Math.abs(a[i] - b[i]);
      sum += step / 3;
      max = Math.max(max, step);
    }
    return { mean: sum / Math.max(covered(a), 1), max };
  };

  const mixer = new THREE.AnimationMixer(scene);
  const moments = [{ clip: "at rest", time: 0 }];
  for (const clip of gltf.animations) moments.push({ clip, time: 0.3 * clip.duration });
  const results = moments.map(({ clip, time }) => {
    mixer.stopAllAction();
    if (clip instanceof THREE.AnimationClip) mixer.clipAction(clip).play();
    mixer.setTime(time);
    const [before, after] = [draw("finer", 0), draw("coarser", 0)];
    let [last, largest] = [before, 0];
    for (let k = 1; k <= frames; k++) {
      const now = draw("finer", k / frames);
      largest = Math.max(largest, change(last, now).mean);
      last = now;
    }
    return {
      clip: clip.name ?? clip, covered: covered(before) / (size * size), cut: change(before, after), largest,
      switch: change(last, after),
    };
  });
  renderer.dispose();
  const skinned = all("finer").some((mesh) => mesh.isSkinnedMesh);
  return { skinned, nodes: pairs.length, named: targets.every((target) => target !== undefined), clips: gltf.animations.length, results };
};
window.isReady = true;
</script>`;

// The page, three.js and the models, at one address.
function serve(models) {
  const three = path.join(path.dirname(require.resolve("three")), "..");
  const fileOf = (url) => {
    if (url.startsWith("/three/")) return path.join(three, path.normalize(url.slice("/three".length)));
    return models[Number(url.slice("/model/".length))];
  };
  return http.createServer((request, response) => {
    if (request.url === "/") return response.setHeader("content-type", "text/html").end(page);
    const type = request.url.endsWith(".js") ? "text/javascript" : "application/octet-stream";
    fs.readFile(fileOf(request.url) ?? "", (error, bytes) => {
      response.writeHead(error ? 404 : 200, { "content-type": type });
      response.end(error ? "" : bytes);
    });
  });
}

function faults(told) {
  const faults = [];
  if (told.nodes === 0) faults.push("no node lists levels");
  if (!told.named) faults.push("a mesh has no morph target named geomorph");
  for (const { clip, covered, cut, switch: left } of told.results ?? []) {
    if (covered < 0.02) faults.push(`${clip}: nothing is drawn`);
    if (cut.mean === 0) faults.push(`${clip}: both levels look the same`);
    const allowed = STEPS + (told.skinned ? SHARE * cut.mean : 0);
    if (left.mean > allowed) faults.push(`${clip}: at weight 1, ${left.mean.toFixed(2)} steps from the next level; ${allowed.toFixed(2)} allowed`);
  }
  return faults;
}

async function main(models) {
  const server = serve(models).listen(0, "127.0.0.1");
  await new Promise((resolve) => server.once("listening", resolve));
  const browser = await puppeteer.launch({
    executablePath: process.env.BROWSER,
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
    protocolTimeout: 300_000,
  });
  let failed = 0;
  try {
    for (const [i, model] of models.entries()) {
      const tab = await browser.newPage();
      const said = [];
      tab.on("console", (message) => ["error", "warn"].includes(message.type()) && said.push(`${message.type()}: ${message.text()}`));
      tab.on("pageerror", (error) => said.push(`error: ${error.message}`));
      await tab.goto(`http://127.0.0.1:${server.address().port}/`);
      await tab.waitForFunction("window.isReady", { timeout: 60_000 });
      const told = await tab.evaluate((url, size, frames) => window.measure(url, size, frames), `/model/${i}`, SIZE, FRAMES);
      // what the driver says of its own speed is no fault of the file
      const found = faults(told).concat(said.filter((line) => !/GPU stall|GL Driver Message|performance/i.test(line)));
      for (const { clip, covered, cut, largest, switch: left } of told.results) {
        const numbers = [cut.mean, largest, left.mean].map((mean) => mean.toFixed(3));
        console.log(`${path.basename(model)}, ${clip}: ${(100 * covered).toFixed(1)} % covered; mean change: cut ${numbers[0]}, largest frame ${numbers[1]}, at the switch ${numbers[2]}`);
      }
      found.forEach((fault) => console.log(`${path.basename(model)}: ${fault}`));
      failed += found.length > 0;
      await tab.close();
    }
  } finally {
    await browser.close();
    server.close();
  }
  console.log(`three.js: ${models.length} chains, ${failed} with faults`);
  process.exitCode = failed > 0 || models.length === 0 ? 1 : 0;
}

main(process.argv.slice(2));
