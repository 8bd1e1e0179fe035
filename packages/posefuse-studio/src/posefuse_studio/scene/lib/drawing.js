// Draws one scene with three.js: instanced bones, joints and ellipsoids, so that a frame is a handful of draw calls.

import { THREE, OrbitControls, CSS2DRenderer, CSS2DObject } from "nicegui-scene";
import { Seen } from "./seen.js";

const MOST_BONES = 2000, MOST_POINTS = 2000;
const MOST_STEPS = 20000;
// what a processor draws at 30 frames a second while it decodes the images of eight cameras
const MOST_SLOW_PIXELS = 250_000;
const BONE_M = 0.016, JOINT_M = 0.024, TRAIL_S = 2.0;
// share of the window that what must be seen fills at most
const MARGIN = 0.84, LEAST_DISTANCE_M = 2.5;
const UP = new THREE.Vector3(0, 1, 0);

export class RigDrawing {
  constructor(element, canvas, labels) {
    this.element = element;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(45, 1, 0.05, 200);
    this.camera.up.set(0, 0, 1);
    const slow = drawn_by_processor();
    this.slow = slow;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !slow, alpha: true });
    this.labels = new CSS2DRenderer({ element: labels });
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x445566, 2.2));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(3, -4, 8);
    this.scene.add(sun);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => this.changed());
    const surface = slow ? () => new THREE.MeshLambertMaterial() : (roughness) => new THREE.MeshStandardMaterial({ roughness });
    const ball = slow ? () => new THREE.IcosahedronGeometry(1, 1) : () => new THREE.SphereGeometry(1, 16, 12);
    this.bones = instances(new THREE.CylinderGeometry(1, 1, 1, slow ? 6 : 10), surface(0.55), MOST_BONES);
    this.joints = instances(ball(), surface(0.4), MOST_POINTS);
    const glass = Object.assign(surface(1.0), { transparent: true, opacity: 0.28, depthWrite: false });
    this.ellipsoids = instances(ball(), glass, MOST_POINTS);
    this.still = new THREE.Group();
    this.people = new Map();
    this.trails = new Trails();
    this.past = new Map();
    this.scene.add(this.bones, this.joints, this.ellipsoids, this.still, this.trails.lines);
    this.setup = { bones: [], bone_rgb: [], keypoint_rgb: [], trails: [], cameras: [], floor: { centre: [0, 0], half_m: 3 } };
    this.shown = { skeletons: true, ellipsoids: true, trails: false, cameras: true };
    this.names = {};
    this.waiting = false;
    // the view fits into the window until the user turns it
    this.chosen = "home";
    this.controls.addEventListener("start", () => { this.chosen = ""; });
    this.seen = new Seen(element, () => this.changed());
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(element);
  }

  take_setup(setup) {
    const first = this.still.children.length === 0;
    this.setup = setup;
    dispose(this.still);
    this.draw_floor(setup.floor);
    this.rig = new THREE.Group();
    for (const camera of setup.cameras) this.rig.add(camera_mark(camera));
    this.rig.visible = this.shown.cameras;
    this.still.add(this.rig);
    if (first) this.look("home");
    this.changed();
  }

  draw_floor(floor) {
    const dark = document.body.classList.contains("body--dark");
    const size = 2 * floor.half_m;
    const grid = new THREE.GridHelper(size, size, dark ? 0x66809c : 0x7a8ca0, dark ? 0x2c3a4a : 0xc9d3de);
    grid.rotateX(Math.PI / 2);
    const axes = new THREE.AxesHelper(0.5);
    const both = new THREE.Group();
    grid.position.set(Math.round(floor.centre[0]), Math.round(floor.centre[1]), 0);
    axes.position.z = 0.002;
    both.add(grid, axes);
    this.still.add(both);
  }

  // the newest poses, which are drawn with the next frame: those that no frame shows cost nothing
  take_poses(message) {
    this.newest = message;
    this.changed();
  }

  draw_poses(message) {
    const { people, keypoints, xyz, rgba, ids } = message;
    let bones = 0, joints = 0;
    const a = new THREE.Vector3(), b = new THREE.Vector3(), middle = new THREE.Vector3(), along = new THREE.Vector3();
    const turn = new THREE.Quaternion(), matrix = new THREE.Matrix4(), size = new THREE.Vector3(), colour = new THREE.Color();
    for (let n = 0; n < people; n++) {
      const own = rgba[n][3] ? rgba[n] : null;
      const point = (k, into) => into.fromArray(xyz, 3 * (n * keypoints + k));
      this.setup.bones.forEach(([from, to], i) => {
        if (bones >= MOST_BONES || Number.isNaN(point(from, a).x) || Number.isNaN(point(to, b).x)) return;
        along.subVectors(b, a);
        const length = along.length();
        if (length < 1e-6) return;
        turn.setFromUnitVectors(UP, along.divideScalar(length));
        matrix.compose(middle.addVectors(a, b).multiplyScalar(0.5), turn, size.set(BONE_M, length, BONE_M));
        this.bones.setMatrixAt(bones, matrix);
        this.bones.setColorAt(bones++, rgb_of(colour, own || this.setup.bone_rgb[i]));
      });
      for (let k = 0; k < keypoints && joints < MOST_POINTS; k++) {
        if (Number.isNaN(point(k, a).x)) continue;
        matrix.makeScale(JOINT_M, JOINT_M, JOINT_M).setPosition(a);
        this.joints.setMatrixAt(joints, matrix);
        this.joints.setColorAt(joints++, rgb_of(colour, own || this.setup.keypoint_rgb[k] || [255, 255, 255]));
      }
    }
    finish(this.bones, bones);
    finish(this.joints, joints);
    this.take_ellipsoids(message);
    this.take_trails(message);
    this.name_people(message, ids);
  }

  take_ellipsoids({ people, keypoints, xyz, rgba, shapes }) {
    let count = 0;
    const matrix = new THREE.Matrix4(), colour = new THREE.Color();
    for (let i = 0; shapes && this.shown.ellipsoids && i < people * keypoints && count < MOST_POINTS; i++) {
      const l = shapes.subarray(9 * i, 9 * i + 9), x = xyz[3 * i];
      if (Number.isNaN(l[0]) || Number.isNaN(x)) continue;
      matrix.set(l[0], l[1], l[2], x, l[3], l[4], l[5], xyz[3 * i + 1], l[6], l[7], l[8], xyz[3 * i + 2], 0, 0, 0, 1);
      this.ellipsoids.setMatrixAt(count, matrix);
      const own = rgba[Math.floor(i / keypoints)];
      this.ellipsoids.setColorAt(count++, rgb_of(colour, own[3] ? own : this.setup.keypoint_rgb[i % keypoints] || [255, 255, 255]));
    }
    finish(this.ellipsoids, count);
  }

  take_trails({ t_s, people, keypoints, xyz, ids }) {
    this.trails.clear();
    if (!this.shown.trails) return this.past.clear();
    const now = new Set();
    for (let n = 0; n < people; n++) {
      for (const k of this.setup.trails) {
        const key = `${ids[n]} ${k}`, at = 3 * (n * keypoints + k);
        now.add(key);
        const past = (this.past.get(key) || []).filter((one) => one.t_s > t_s - TRAIL_S && one.t_s < t_s);
        past.push({ t_s, xyz: [xyz[at], xyz[at + 1], xyz[at + 2]] });
        this.past.set(key, past);
        const known = past.filter((one) => !Number.isNaN(one.xyz[0]));
        const [r, g, b] = this.setup.keypoint_rgb[k];
        this.trails.add(known.map((one) => one.xyz), [r / 255, g / 255, b / 255]);
      }
    }
    this.trails.finish();
    for (const key of this.past.keys()) if (!now.has(key)) this.past.delete(key);
  }

  name_people({ people, keypoints, xyz }, ids) {
    const here = new Set(ids);
    for (const [id, mark] of this.people) {
      if (here.has(id)) continue;
      this.scene.remove(mark);
      mark.element.remove();
      this.people.delete(id);
    }
    for (let n = 0; n < people; n++) {
      let top = -Infinity, x = 0, y = 0, count = 0;
      for (let k = 0; k < keypoints; k++) {
        const at = 3 * (n * keypoints + k);
        if (Number.isNaN(xyz[at])) continue;
        top = Math.max(top, xyz[at + 2]);
        x += xyz[at];
        y += xyz[at + 1];
        count++;
      }
      if (!this.people.has(ids[n])) this.people.set(ids[n], text_mark("", "pf-person"));
      const mark = this.people.get(ids[n]);
      const text = this.names[ids[n]] || `person ${ids[n]}`;
      if (mark.element.textContent !== text) mark.element.textContent = text;
      mark.visible = count > 0;
      if (count) mark.position.set(x / count, y / count, top + 0.18);
      if (!mark.parent) this.scene.add(mark);
    }
  }

  show(parts) {
    Object.assign(this.shown, parts);
    if (this.rig) this.rig.visible = this.shown.cameras;
    this.bones.visible = this.joints.visible = this.shown.skeletons;
    if (!this.shown.ellipsoids) finish(this.ellipsoids, 0);
    if (!this.shown.trails) this.trails.clear();
    this.changed();
  }

  look(where) {
    this.chosen = where;
    const from = { home: [0.53, -0.67, 0.53], top: [0, -0.001, 1], front: [0, -0.98, 0.19], side: [0.98, 0, 0.19] }[where];
    const target = this.controls.target.set(...this.setup.floor.centre, 0.9), direction = new THREE.Vector3(...from);
    for (const far of [() => 1, () => this.distance_to_see(this.whole(), target)]) {
      // first turned, then moved away as far as is needed in that direction
      this.camera.position.copy(target).addScaledVector(direction, far());
      this.controls.update();
      this.camera.updateMatrix();
    }
    this.changed();
  }

  // what a view shows all of: a person in the middle, and the cameras, or the floor where there is none
  whole() {
    const { floor: { centre: [x, y], half_m }, cameras } = this.setup, wide = cameras.length ? 1 : half_m;
    const box = [-wide, wide].flatMap((dx) => [-wide, wide].flatMap((dy) => [0, 2].map((z) => [x + dx, y + dy, z])));
    return [...box, ...cameras.map((one) => one.centre)].map((one) => new THREE.Vector3(...one));
  }

  // how far from the target all points are seen, in the direction in which the camera looks now
  distance_to_see(points, target) {
    const [right, up, back] = [0, 1, 2].map((i) => new THREE.Vector3().setFromMatrixColumn(this.camera.matrix, i));
    const high = MARGIN * Math.tan(THREE.MathUtils.degToRad(this.camera.fov / 2)), wide = high * this.camera.aspect;
    const needed = points.map((one) => {
      const p = one.clone().sub(target);
      return Math.max(Math.abs(p.dot(right)) / wide, Math.abs(p.dot(up)) / high) + p.dot(back);
    });
    return Math.max(LEAST_DISTANCE_M, ...needed);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    const most = this.slow ? Math.min(1, Math.sqrt(MOST_SLOW_PIXELS / (width * height))) : 2;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, most));
    this.renderer.setSize(width, height, false);
    this.labels.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.chosen) this.look(this.chosen);
    this.changed();
  }

  changed() {
    if (this.waiting || !this.seen.now) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      if (this.newest) this.draw_poses(this.newest);
      this.newest = null;
      this.renderer.render(this.scene, this.camera);
      this.labels.render(this.scene, this.camera);
      window.posefuseDrawn.scene++;
    });
  }

  close() {
    this.observer.disconnect();
    this.seen.close();
    this.controls.dispose();
    dispose(this.still);
    dispose(this.trails.lines);
    this.renderer.dispose();
  }
}

// all trails as one mesh of lines, whose buffers stay
class Trails {
  constructor() {
    const geometry = new THREE.BufferGeometry();
    for (const name of ["position", "color"]) geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(6 * MOST_STEPS), 3));
    this.lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, opacity: 0.8 }));
    this.lines.frustumCulled = false;
    this.clear();
  }

  clear() {
    this.count = 0;
    this.lines.geometry.setDrawRange(0, 0);
  }

  // a line through these points
  add(points, rgb) {
    const { position, color } = this.lines.geometry.attributes;
    const [r, g, b] = new THREE.Color().setRGB(...rgb, THREE.SRGBColorSpace).toArray();
    for (let i = 1; i < points.length && this.count < MOST_STEPS; i++) {
      const at = 2 * this.count++;
      position.setXYZ(at, ...points[i - 1]).setXYZ(at + 1, ...points[i]);
      color.setXYZ(at, r, g, b).setXYZ(at + 1, r, g, b);
    }
  }

  finish() {
    const { geometry } = this.lines;
    geometry.setDrawRange(0, 2 * this.count);
    for (const attribute of Object.values(geometry.attributes)) send(attribute, 2 * this.count);
  }
}

// without a graphics card every pixel costs the processor that also decodes the cameras' images
function drawn_by_processor() {
  const gl = document.createElement("canvas").getContext("webgl");
  const about = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

function instances(geometry, material, most) {
  const mesh = new THREE.InstancedMesh(geometry, material, most);
  mesh.count = 0;
  mesh.frustumCulled = false;
  mesh.setColorAt(0, new THREE.Color(1, 1, 1));
  return mesh;
}

function finish(mesh, count) {
  mesh.count = count;
  send(mesh.instanceMatrix, count);
  send(mesh.instanceColor, count);
}

// to the graphics card: only what is drawn of a buffer that has room for many
function send(attribute, count) {
  attribute.clearUpdateRanges();
  if (count) attribute.addUpdateRange(0, count * attribute.itemSize);
  attribute.needsUpdate = count > 0;
}

function rgb_of(colour, rgb) {
  return colour.setRGB(rgb[0] / 255, rgb[1] / 255, rgb[2] / 255, THREE.SRGBColorSpace);
}

function camera_mark(camera) {
  const mark = new THREE.Group(), [a, b, c, d] = camera.corners, o = camera.centre;
  const up = a.map((value, i) => (value + b[i]) / 2 + 0.25 * (a[i] - d[i]));
  const lines = [o, a, o, b, o, c, o, d, a, b, b, c, c, d, d, a, a, up, up, b];
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(lines.flat(), 3));
  const colour = camera.faulty ? 0xef5350 : 0x26a69a;
  mark.add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour })));
  const name = text_mark(camera.name, camera.faulty ? "pf-camera pf-faulty" : "pf-camera");
  name.position.set(...o);
  mark.add(name);
  if (camera.ellipsoid) {
    const l = camera.ellipsoid;
    const ball = new THREE.Mesh(
      new THREE.SphereGeometry(1, 24, 16),
      new THREE.MeshStandardMaterial({ color: 0xffb300, transparent: true, opacity: 0.55, depthWrite: false }),
    );
    ball.matrixAutoUpdate = false;
    ball.matrix.set(l[0], l[1], l[2], o[0], l[3], l[4], l[5], o[1], l[6], l[7], l[8], o[2], 0, 0, 0, 1);
    mark.add(ball);
  }
  return mark;
}

function text_mark(text, classes) {
  const element = document.createElement("div");
  element.className = classes;
  element.textContent = text;
  return new CSS2DObject(element);
}

function dispose(group) {
  group.traverse((one) => {
    one.geometry?.dispose();
    one.material?.dispose?.();
    if (one.isCSS2DObject) one.element.remove();
  });
  group.clear();
}
