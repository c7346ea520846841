// Draws the mesh embedded in the page and lets the user turn it; see mesh_viewer.py for its format.
import * as THREE from "three";
import { OrbitControls } from "three/OrbitControls";

const STEPS = 65535;
const box = document.getElementById("viewer");

async function unpacked() {
  const text = document.getElementById("mesh-body").textContent.trim();
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

function geometryOf(header, buffer) {
  const index = new Uint32Array(buffer, 0, 3 * header.triangles);
  for (let i = 1; i < index.length; i++) index[i] += index[i - 1];
  const steps = new Uint16Array(buffer, index.byteLength, 3 * header.vertices);
  const positions = new Float32Array(steps.length);
  // Relative to the middle of the box, so that single precision suffices anywhere in the world.
  for (let i = 0; i < steps.length; i++) positions[i] = (steps[i] / STEPS - 0.5) * header.size[i % 3];
  const geometry = new THREE.BufferGeometry();
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  geometry.computeVertexNormals();
  let start = index.byteLength + steps.byteLength;
  const colors = header.layers.map(() => {
    const layer = new Uint8Array(buffer, start, 3 * header.vertices);
    start += layer.byteLength;
    return new THREE.BufferAttribute(linear(layer), 3, true);
  });
  return { geometry, colors };
}

// Images are sRGB, shading is linear.
function linear(layer) {
  const table = Uint16Array.from({ length: 256 }, (_, i) => Math.round(65535 * toLinear(i / 255)));
  return Uint16Array.from(layer, (value) => table[value]);
}

function toLinear(value) {
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
}

function camerasOf(header) {
  const middle = header.low.map((low, axis) => low + header.size[axis] / 2);
  const frusta = header.cameras.map((frustum) =>
    frustum.map((point) => new THREE.Vector3(...point.map((x, axis) => x - middle[axis]))));
  const edges = frusta.flatMap(([eye, a, b, c, d]) => [eye, a, eye, b, eye, c, eye, d, a, b, b, c, c, d, d, a]);
  const group = new THREE.Group();
  const ink = (color, opacity) => new THREE.LineBasicMaterial({ color, opacity, transparent: true });
  group.add(new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(edges), ink(0xd2691e, 0.9)));
  const way = frusta.map(([eye]) => eye);
  group.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(way), ink(0x1c2126, 0.35)));
  group.visible = false;
  return group;
}

function lights(scene) {
  const sun = new THREE.DirectionalLight(0xffffff, 0);
  sun.position.set(0.4, 0.35, 0.85);
  const sky = new THREE.AmbientLight(0xffffff, 0);
  scene.add(sun, sky);
  return (shaded) => {
    sun.intensity = 2.6 * shaded;
    sky.intensity = Math.PI - 2.0 * shaded;
  };
}

function start(header, buffer) {
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "The mesh: drag to turn, wheel to zoom, right button to move");
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xfafbfc);
  const { geometry, colors } = geometryOf(header, buffer);
  const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
  scene.add(new THREE.Mesh(geometry, material));
  const cameras = camerasOf(header);
  scene.add(cameras);
  const shade = lights(scene);

  const diagonal = Math.hypot(...header.size);
  const camera = new THREE.PerspectiveCamera(40, 2, diagonal / 1000, diagonal * 10);
  camera.up.set(0, 0, 1);
  const controls = new OrbitControls(camera, canvas);
  controls.listenToKeyEvents(canvas);
  controls.minDistance = diagonal / 200;
  controls.maxDistance = 4 * diagonal;
  const draw = () => renderer.render(scene, camera);
  controls.addEventListener("change", draw);

  const look = () => {
    controls.target.set(0, 0, 0);
    camera.position.set(-0.52, -0.7, 0.5);
    camera.position.setLength(distanceToSeeAll(camera, header.size));
    controls.update();
    draw();
  };
  const choose = (number) => {
    geometry.setAttribute("color", colors[number]);
    shade(header.layers[number].shaded);
    document.getElementById("layer-note").textContent = header.layers[number].note;
    box.dataset.layer = header.layers[number].title;
    draw();
  };
  const fit = () => {
    const { clientWidth: width, clientHeight: height } = box;
    if (!width || !height) return;
    renderer.setSize(width, height);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  };
  aimOnDoubleClick(canvas, camera, scene, controls);
  box.replaceChildren(canvas);
  new ResizeObserver(fit).observe(box);
  buttons(header, choose, look, (shown) => { cameras.visible = shown; draw(); });
  fit();
  choose(0);
  look();
}

// Distance from which a camera that looks at the middle sees the whole box.
function distanceToSeeAll(camera, size) {
  camera.lookAt(0, 0, 0);
  const turn = camera.quaternion.clone().invert();
  const slope = Math.tan(THREE.MathUtils.degToRad(camera.fov / 2));
  let distance = 0;
  for (let corner = 0; corner < 8; corner++) {
    const place = new THREE.Vector3(...size.map((length, axis) => (((corner >> axis) & 1) - 0.5) * length));
    place.applyQuaternion(turn);
    const across = Math.max(Math.abs(place.x) / camera.aspect, Math.abs(place.y)) / slope;
    distance = Math.max(distance, place.z + 1.04 * across);
  }
  return distance;
}

function aimOnDoubleClick(canvas, camera, scene, controls) {
  canvas.addEventListener("dblclick", (event) => {
    const frame = canvas.getBoundingClientRect();
    const place = new THREE.Vector2(
      2 * (event.clientX - frame.left) / frame.width - 1, 1 - 2 * (event.clientY - frame.top) / frame.height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(place, camera);
    const found = ray.intersectObject(scene.children[0])[0];
    if (found) { controls.target.copy(found.point); controls.update(); }
  });
}

function buttons(header, choose, look, show) {
  const bar = document.getElementById("viewer-buttons");
  const layers = header.layers.map((layer, number) => {
    const button = document.createElement("button");
    button.textContent = layer.title;
    button.addEventListener("click", () => {
      layers.forEach((each) => each.setAttribute("aria-pressed", String(each === button)));
      choose(number);
    });
    button.setAttribute("aria-pressed", String(number === 0));
    return button;
  });
  bar.append(...layers);
  if (header.cameras.length) {
    const views = document.createElement("button");
    views.textContent = "views";
    views.setAttribute("aria-pressed", "false");
    views.addEventListener("click", () => {
      const shown = views.getAttribute("aria-pressed") === "false";
      views.setAttribute("aria-pressed", String(shown));
      show(shown);
    });
    bar.append(views);
  }
  const back = document.createElement("button");
  back.textContent = "look from the start";
  back.addEventListener("click", look);
  bar.append(back);
}

try {
  start(JSON.parse(document.getElementById("mesh-header").textContent), await unpacked());
  box.dataset.state = "ready";
} catch (error) {
  box.dataset.state = "failed";
  document.getElementById("layer-note").textContent =
    `This browser cannot turn the mesh (${error.message}): a picture is shown instead.`;
}
