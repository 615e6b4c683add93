// The layers: blocks of text are decoded when one of their layers is wanted, and a bounded number is kept. The blocks
// stand in the page or, where `meta.folder` is given, in scripts beside it: a page from a disk may fetch nothing else.

const element = (id) => document.getElementById(id);
const meta = JSON.parse(element("meta").textContent);
const COUNT = meta.z.length;
const KEPT_BLOCKS = 24, KEPT_LAYERS = 96, AHEAD = 3;

function bytesOf(encoded) {
  const text = atob(encoded);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

class Reader {
  constructor(bytes, at = 0) { this.bytes = bytes; this.at = at; }
  whole() { // 7 bits a byte, low bits first
    const bytes = this.bytes;
    let byte = bytes[this.at++], value = byte & 127, unit = 128;
    while (byte > 127) { byte = bytes[this.at++]; value += (byte & 127) * unit; unit *= 128; }
    return value;
  }
  signed() { const v = this.whole(); return v % 2 ? -(v + 1) / 2 : v / 2; }
}

// A map that forgets what was not used for longest.
class Kept {
  constructor(size, make) { this.size = size; this.make = make; this.map = new Map(); }
  get(key) {
    let value = this.map.get(key);
    if (value === undefined) value = this.make(key); else this.map.delete(key);
    if (value === undefined) return value;
    this.map.set(key, value);
    if (this.map.size > this.size) this.map.delete(this.map.keys().next().value);
    return value;
  }
}

// The text of a block, or undefined while its script is on the way.
const texts = new Kept(KEPT_BLOCKS, () => undefined), asked = new Map();
function textOf(number) {
  if (!meta.folder) return element("block" + number).textContent;
  const text = texts.get(number);
  if (text === undefined && !asked.has(number) && !lost.has(number)) {
    const script = document.createElement("script");
    const done = () => { script.remove(); asked.delete(number); };
    script.onload = () => { done(); wake(); };
    script.onerror = () => { done(); lost.add(number); wake(); };
    script.src = `${encodeURIComponent(meta.folder)}/block${number}.js`;
    asked.set(number, script);
    document.head.append(script);
  }
  return text;
}
const lost = new Set(); // blocks whose files are not there
window.viewerBlock = (number, text) => { texts.map.delete(number); texts.map.set(number, text); };

const blocks = new Kept(KEPT_BLOCKS, (number) => {
  const text = textOf(number);
  if (text === undefined) return undefined;
  const bytes = bytesOf(text), reader = new Reader(bytes), starts = [];
  const count = Math.min(meta.block, COUNT - number * meta.block);
  for (let i = 0; i < count; i++) starts.push(reader.whole());
  for (let i = 0, at = reader.at; i < count; i++) { const size = starts[i]; starts[i] = at; at += size; }
  return { bytes, starts };
});

// Ask for the blocks that scrubbing will need next, in its direction.
function askAhead(k, way) {
  for (let i = 1; meta.folder && i <= AHEAD; i++) {
    const number = Math.floor(k / meta.block) + i * way;
    if (number >= 0 && number * meta.block < COUNT && !lost.has(number)) blocks.get(number);
  }
}

function readSet(reader, closed) {
  const paths = reader.whole(), shape = new Path2D(), ends = new Int32Array(4 * paths);
  let x = 0, y = 0, points = 0;
  for (let p = 0; p < paths; p++) {
    const n = reader.whole();
    points += n;
    for (let i = 0; i < n; i++) {
      x += reader.signed(); y += reader.signed();
      if (i) shape.lineTo(x, y); else { shape.moveTo(x, y); ends[4 * p] = x; ends[4 * p + 1] = y; }
    }
    if (closed) { shape.closePath(); ends[4 * p + 2] = ends[4 * p]; ends[4 * p + 3] = ends[4 * p + 1]; }
    else { ends[4 * p + 2] = x; ends[4 * p + 3] = y; }
  }
  return { shape, ends, paths, points };
}

const layers = new Kept(KEPT_LAYERS, (k) => {
  const block = blocks.get(Math.floor(k / meta.block));
  if (!block) return undefined;
  const reader = new Reader(block.bytes, block.starts[k % meta.block]), layer = {};
  for (const name of meta.sets) layer[name] = readSet(reader, !name.endsWith("fill"));
  layer.places = [];
  for (let n = reader.whole(); n > 0; n--) layer.places.push([reader.signed(), reader.signed(), reader.whole()]);
  return layer;
});

// The straight ways from the end of each path to the beginning of the next, with the fill of the part that is shown.
function travel(layer, fill) {
  const shape = new Path2D();
  let begun = false;
  for (const name of ["part_boundary", fill, "scaffold_boundary", "scaffold_fill"]) {
    const { ends, paths } = layer[name];
    for (let p = 0; p < paths; p++) {
      if (begun) shape.lineTo(ends[4 * p], ends[4 * p + 1]);
      shape.moveTo(ends[4 * p + 2], ends[4 * p + 3]);
      begun = true;
    }
  }
  return shape;
}

const flaggedLayers = meta.flags.map((text, k) => (text ? k : -1)).filter((k) => k >= 0);

const colours = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["card", "grid", "rule", "grey", "text", "part", "part_bead", "part_line", "scaffold", "scaffold_bead",
    "scaffold_line", "travel", "flag", "accent", "shade_part", "cap_part", "shade_scaffold", "cap_scaffold"]) {
    colours[name] = style.getPropertyValue("--" + name).trim();
  }
}

// The sizes of boxes, page pixels: asked once after each change of the window, for asking makes the browser lay out.
const sizes = new Map();
function sizeOf(box) {
  let size = sizes.get(box);
  if (!size) sizes.set(box, size = [box.clientWidth, box.clientHeight]);
  return size;
}

// Fit a canvas to its box; return [width, height, ratio] in its own pixels.
function fitted(canvas, ratio = Math.min(window.devicePixelRatio || 1, 2)) {
  const [width, height] = sizeOf(canvas).map((v) => Math.max(1, Math.round(v * ratio)));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  return [width, height, ratio];
}

// Drags, pinches and the wheel, as calls of move(dx, dy, event) and zoom(factor, x, y), in pixels of the page.
function gestures(canvas, move, zoom) {
  const fingers = new Map();
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
  const place = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, place(event)); });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId), now = place(event);
    if (!before) return;
    const wide = fingers.size === 2 ? spread() : 0;
    fingers.set(event.pointerId, now);
    move((now[0] - before[0]) / fingers.size, (now[1] - before[1]) / fingers.size, event);
    if (wide) {
      const [a, b] = [...fingers.values()];
      zoom(spread() / wide, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...place(event));
  }, { passive: false });
}
