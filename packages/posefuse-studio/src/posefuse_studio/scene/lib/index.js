// One websocket per stream and page; every element that draws it gets the decoded messages. Layout: scene/messages.py.

const SETUP = 1, POSES = 2, IMAGE = 3, VALUES = 4, LABELS = 5;
const RETRY_MS = 800;
const streams = new Map();

// counted for the measurements of bench/studio.py
window.posefuseDrawn = window.posefuseDrawn || { scene: 0, tile: 0, messages: 0 };

export function listen(name, listener) {
  let stream = streams.get(name);
  if (!stream) {
    stream = { listeners: new Set(), kept: new Map(), socket: null, closed: false };
    streams.set(name, stream);
    open(name, stream);
  }
  stream.listeners.add(listener);
  for (const message of stream.kept.values()) listener(message);
  return () => {
    stream.listeners.delete(listener);
    if (stream.listeners.size) return;
    stream.closed = true;
    stream.socket?.close();
    streams.delete(name);
  };
}

function open(name, stream) {
  if (stream.closed) return;
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/studio/stream/${name}`);
  socket.binaryType = "arraybuffer";
  stream.socket = socket;
  socket.onmessage = (event) => {
    const message = decoded(event.data);
    if (!message) return;
    window.posefuseDrawn.messages++;
    if (message.kind === SETUP || message.kind === LABELS) stream.kept.set(message.kind, message);
    for (const listener of stream.listeners) listener(message);
  };
  socket.onclose = () => setTimeout(() => open(name, stream), RETRY_MS);
}

function decoded(buffer) {
  const view = new DataView(buffer);
  if (view.getUint16(0) !== 0x5046 || view.getUint8(2) !== 1) return null;
  const kind = view.getUint8(3), t_s = view.getFloat64(8, true);
  if (kind === SETUP || kind === LABELS) {
    return { kind, content: JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 16))) };
  }
  if (kind === POSES) return { kind, t_s, ...poses(buffer, view) };
  if (kind === IMAGE) return { kind, t_s, ...image(buffer, view) };
  if (kind === VALUES) return { kind, t_s, values: floats(buffer, 20, 2 * view.getUint32(16, true)) };
  return null;
}

function floats(buffer, offset, count) {
  // a copy: views must begin at multiples of four
  return new Float32Array(buffer.slice(offset, offset + 4 * count));
}

function poses(buffer, view) {
  const people = view.getUint16(16, true), keypoints = view.getUint16(18, true), flags = view.getUint32(20, true);
  const ids = [], rgba = [];
  for (let n = 0; n < people; n++) {
    ids.push(view.getUint32(24 + 8 * n, true));
    rgba.push([...new Uint8Array(buffer, 28 + 8 * n, 4)]);
  }
  const at = 24 + 8 * people, size = people * keypoints;
  const xyz = floats(buffer, at, 3 * size);
  const shapes = flags & 1 ? floats(buffer, at + 12 * size, 9 * size) : null;
  return { people, keypoints, ids, rgba, xyz, shapes };
}

function image(buffer, view) {
  const [camera, width, height, detections, people, keypoints] = [0, 1, 2, 3, 4, 5].map((i) => view.getUint16(16 + 2 * i, true));
  const rgba = [];
  for (let n = 0; n < people; n++) rgba.push([...new Uint8Array(buffer, 32 + 4 * n, 4)]);
  const at = 32 + 4 * people;
  const seen = floats(buffer, at, 2 * detections * keypoints);
  const fused = floats(buffer, at + 8 * detections * keypoints, 2 * people * keypoints);
  const jpeg = new Blob([new Uint8Array(buffer, at + 8 * (detections + people) * keypoints)], { type: "image/jpeg" });
  return { camera, width, height, detections, people, keypoints, rgba, seen, fused, jpeg };
}

export { SETUP, POSES, IMAGE, VALUES, LABELS };
export { RigDrawing } from "./drawing.js";
export { Seen } from "./seen.js";
