// What ties them together: the layer that is shown, keys, buttons, numbers.

const TOGGLES = [
  ["part", "part", "part_bead", true], ["scaffold", "scaffold", "scaffold_bead", true],
  ["boundary", "boundary", "part_line", true], ["fill", "fill", "scaffold_line", true],
  ["second", "upper ice layer", "", false], ["travel", "travel", "travel", false], ["flagged", "flagged", "flag", true],
];
const VIEWS = ["flat", "both", "stack"];
let current = 0, way = 1, waiting = false, playing = 0, drawTimes = [];

function schedule() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    const begin = performance.now();
    flat.draw(current); stack.draw(current);
    askAhead(current, way);
    drawTimes.push(performance.now() - begin);
    if (drawTimes.length > 2000) drawTimes = drawTimes.slice(-1000);
  });
}
function wake() { schedule(); } // a block has come

function show(k) {
  if (!COUNT) return;
  k = Math.min(Math.max(Math.round(k) || 0, 0), COUNT - 1);
  if (k !== current) way = Math.sign(k - current);
  current = k;
  element("slider").value = current;
  plot.mark(current);
  describe(current);
  schedule();
}

const formats = [2, 1, 0].map((digits) => new Intl.NumberFormat("en", { maximumFractionDigits: digits }));
function number(value, unit) {
  return value === null ? "-" : formats[value < 10 ? 0 : value < 1000 ? 1 : 2].format(value) + unit;
}

// The table is made once, and then the texts that differ are changed: that keeps the browser from laying it out anew.
const ROWS = [["area", "part_area", "scaffold_area", " mm\u00b2"], ["boundary", "part_boundary_mm", "scaffold_boundary_mm", " mm"],
  ["fill", "part_fill_mm", "scaffold_fill_mm", " mm"], ["lost", "lost_area", "", " mm\u00b2"]];
const cells = [];
function makeTable() {
  const body = element("facts_table").tBodies[0];
  body.innerHTML = "<tr><th></th><th>part</th><th>scaffold</th></tr>";
  for (const [name, ...columns] of ROWS) {
    const row = body.insertRow();
    row.insertCell().textContent = name;
    for (const column of columns.slice(0, 2)) {
      const text = row.insertCell().appendChild(document.createTextNode(""));
      if (column) cells.push([text, column, columns[2]]);
    }
  }
}

function put(text, value) { if (text.data !== value) text.data = value; }
let flagText = "";
function describe(k) {
  const input = element("number");
  if (document.activeElement !== input) input.value = meta.index[k];
  put(element("z").firstChild, `z ${meta.z[k].toFixed(2)} mm`);
  for (const [text, column, unit] of cells) put(text, number(meta[column][k], unit));
  if (meta.flags[k] === flagText) return;
  flagText = meta.flags[k];
  element("flags").innerHTML = flagText ? flagText.split(";").map((f) => `<span>${f.replace(/[^\w-]/g, "")}</span>`).join("") : "";
}

// The field holds the number of a slice as files have it, which is not its place where only some were sliced.
function numberOf(text) {
  const wanted = Number(text), first = meta.index[0] ?? 0;
  return text.trim() === "" || Number.isNaN(wanted) ? current : wanted - first;
}

function nextFlagged(way) {
  const found = way > 0 ? flaggedLayers.find((k) => k > current) ?? flaggedLayers[0]
    : flaggedLayers.findLast((k) => k < current) ?? flaggedLayers.at(-1);
  if (found !== undefined) show(found);
}

function stop() { if (playing) play(); }
function play() {
  playing = playing ? 0 : performance.now();
  element("play").querySelector("path").setAttribute("d", playing ? "M6 4h4v16H6zM14 4h4v16h-4z" : "M7 4l13 8-13 8z");
  if (!playing) return;
  const from = current === COUNT - 1 ? 0 : current, begin = playing, rate = Math.max(COUNT / 25, 8); // layers a second
  const step = (now) => {
    if (playing !== begin) return;
    const k = from + Math.max(0, (now - begin) / 1000 * rate);
    show(k);
    if (k < COUNT - 1) requestAnimationFrame(step); else stop();
  };
  requestAnimationFrame(step);
}

function setView(name) {
  element("flat").hidden = name === "stack"; element("stack").hidden = name === "flat";
  element("flat").style.display = name === "stack" ? "none" : ""; element("stack").style.display = name === "flat" ? "none" : "";
  for (const other of VIEWS) element("view_" + other).setAttribute("aria-pressed", other === name);
  resized();
}
function resized() {
  sizes.clear();
  flat.view.scale = 0;
  plot.draw(); plot.mark(current);
  schedule();
}

function setTheme(dark) {
  document.documentElement.classList.toggle("dark", dark);
  readColours();
  for (const [name, , colour] of TOGGLES) if (colour) element("swatch_" + name).style.background = colours[colour];
  plot.draw();
  schedule();
}
const toggleTheme = () => setTheme(!document.documentElement.classList.contains("dark"));

const KEYS = {
  ArrowRight: () => show(current + 1), ArrowUp: () => show(current + 1), ArrowLeft: () => show(current - 1), ArrowDown: () => show(current - 1),
  PageUp: () => show(current + 10), PageDown: () => show(current - 10), Home: () => show(0), End: () => show(COUNT - 1),
  " ": play, n: () => nextFlagged(1), p: () => nextFlagged(-1), f: () => { flat.fit(); schedule(); }, t: toggleTheme,
  "+": () => flat.zoom(1.25, ...sizeOf(flat.canvas).map((v) => v / 2)),
  "-": () => flat.zoom(.8, ...sizeOf(flat.canvas).map((v) => v / 2)),
  1: () => setView("flat"), 2: () => setView("both"), 3: () => setView("stack"),
};

function begin() {
  makeTable();
  element("facts").textContent = `${COUNT} layers of ${meta.thickness} mm \u00b7 paths ${meta.widths[0]} mm (part), ${meta.widths[1]} mm (scaffold)`;
  element("slider").max = element("number").max = Math.max(COUNT - 1, 0);
  for (const [name, label, colour, initially] of TOGGLES) {
    flat.on[name] = initially;
    element("toggles").insertAdjacentHTML("beforeend",
      `<label><input type="checkbox" id="show_${name}"${initially ? " checked" : ""}>${label}${colour ? `<i id="swatch_${name}"></i>` : ""}</label>`);
    element("show_" + name).addEventListener("change", (event) => { flat.on[name] = event.target.checked; schedule(); });
  }
  const flagged = element("flagged_text");
  flagged.textContent = flaggedLayers.length ? `next of ${flaggedLayers.length} flagged` : "nothing flagged";
  flagged.dataset.short = flaggedLayers.length;
  element("flagged").disabled = !flaggedLayers.length;
  element("flagged").addEventListener("click", () => { stop(); nextFlagged(1); });
  element("slider").addEventListener("input", (event) => { stop(); show(+event.target.value); });
  element("number").addEventListener("change", (event) => {
    stop(); show(numberOf(event.target.value)); event.target.value = meta.index[current] ?? "";
  });
  element("play").addEventListener("click", play);
  element("back").addEventListener("click", () => { stop(); show(current - 1); });
  element("on").addEventListener("click", () => { stop(); show(current + 1); });
  element("theme").addEventListener("click", toggleTheme);
  for (const name of VIEWS) element("view_" + name).addEventListener("click", () => setView(name));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.id === "number") return;
    if (event.key === " " && (event.target.tagName === "BUTTON" || event.target.type === "checkbox")) return;
    if (!KEYS[event.key]) return;
    event.preventDefault();
    if (event.key !== " ") stop();
    KEYS[event.key]();
  });
  new ResizeObserver(resized).observe(element("views"));
  setTheme(matchMedia("(prefers-color-scheme: dark)").matches);
  setView(window.innerWidth > 1100 ? "both" : "flat");
  show(Math.floor(COUNT / 2));
  window.viewer = {
    show, redraw: schedule, count: COUNT, flat: flat.view, stack: stack.view, meshes: stack.meshes, current: () => current,
    kept: () => [blocks.map.size, layers.map.size], ready: () => layers.map.has(current),
    places: () => layers.get(current).places, takeTimes: () => drawTimes.splice(0),
  };
}
begin();
