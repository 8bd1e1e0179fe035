// One websocket per stream and page; every element that draws it gets the decoded messages. Layout: scene_messages.py.

const SETUP = "setup", POSES = "poses", IMAGE = "image", VALUES = "values", LABELS = "labels";
const RETRY_MS = 800;
const streams = new Map();

// counted for tests and measurements in a browser
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
    window.posefuseDrawn.messages++;
    if (message.kind === SETUP || message.kind === LABELS) stream.kept.set(message.kind, message);
    for (const listener of stream.listeners) listener(message);
  };
  socket.onclose = () => setTimeout(() => open(name, stream), RETRY_MS);
}

function decoded(buffer) {
  const begin = 4 + new DataView(buffer).getUint32(0, true);
  const message = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, begin - 4)));
  let at = begin;
  for (const [name, count] of Object.entries(message.arrays)) {
    message[name] = new Float32Array(buffer, at, count);
    at += 4 * count;
  }
  if (message.kind === IMAGE) message.jpeg = new Blob([new Uint8Array(buffer, at)], { type: "image/jpeg" });
  return message;
}

export { SETUP, POSES, IMAGE, VALUES, LABELS };
export { RigDrawing } from "./drawing.js";
export { Seen } from "./seen.js";
