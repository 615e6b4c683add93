// The layer from above: x to the right, y up; panned and zoomed.

const flat = (() => {
  const section = element("flat"), canvas = section.querySelector("canvas"), pen = canvas.getContext("2d", { alpha: false });
  const bar = section.querySelector(".scale i"), barText = section.querySelector(".scale span"), where = section.querySelector(".where");
  const note = section.querySelector(".loading"), REST = 100; // ms
  const shownAtAll = () => sizeOf(section)[0] > 0;
  const view = { scale: 0, x: 0, y: 0 }; // page pixels per mm; where (0, 0) of the corner lies, page pixels
  const on = {};

  function fit() {
    const pad = 24, [w, h] = meta.size;
    const [wide, high] = sizeOf(canvas);
    view.scale = Math.max(1e-6, Math.min((wide - 2 * pad) / w, (high - 2 * pad) / h));
    view.x = (wide - w * view.scale) / 2;
    view.y = (high + h * view.scale) / 2;
  }

  function zoom(factor, x, y) {
    const scale = Math.min(Math.max(view.scale * factor, 0.05), 2000);
    factor = scale / view.scale;
    view.x = x + (view.x - x) * factor;
    view.y = y + (view.y - y) * factor;
    view.scale = scale;
    schedule();
  }

  function drawGrid(width, height, ratio) {
    const step = niceStep(56 / view.scale) * view.scale * ratio;
    pen.beginPath();
    for (let x = ((view.x * ratio) % step + step) % step; x < width; x += step) { pen.moveTo(Math.round(x) + .5, 0); pen.lineTo(Math.round(x) + .5, height); }
    for (let y = ((view.y * ratio) % step + step) % step; y < height; y += step) { pen.moveTo(0, Math.round(y) + .5); pen.lineTo(width, Math.round(y) + .5); }
    pen.strokeStyle = colours.grid; pen.lineWidth = 1; pen.stroke();
  }

  function stroke(shape, width, colour) {
    pen.lineWidth = width; pen.strokeStyle = colour; pen.stroke(shape);
  }

  // While layers follow each other quickly, lines are drawn as thin and as plain as can be; at rest, in full.
  let shown = -1, changed = 0, calm = 0;
  function hurried(k) {
    const now = performance.now(), soon = k !== shown && now - changed < REST;
    if (k !== shown) { shown = k; changed = now; }
    if (soon) { clearTimeout(calm); calm = setTimeout(schedule, REST); }
    return soon;
  }

  function draw(k) {
    if (!shownAtAll()) return;
    const layer = COUNT ? layers.get(k) : undefined;
    if (COUNT && !layer) { waitFor(k); return; }
    note.hidden = true;
    const [width, height, ratio] = fitted(canvas), hurry = hurried(k);
    if (!view.scale) fit();
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = colours.card; pen.fillRect(0, 0, width, height);
    drawGrid(width, height, ratio);
    drawBar();
    if (!layer) return;
    const unit = view.scale * meta.quantum * ratio, pixel = ratio / unit;
    pen.setTransform(unit, 0, 0, -unit, view.x * ratio, view.y * ratio);
    const fine = !hurry && meta.widths[0] / meta.quantum > 8 * pixel; // round ends cost time and do not show on thin lines
    pen.lineJoin = fine ? "round" : "bevel"; pen.lineCap = fine ? "round" : "butt";
    for (const [name, i] of [["scaffold", 1], ["part", 0]]) if (on[name]) drawMaterial(layer, name, meta.widths[i], pixel, unit, hurry);
    if (on.travel) {
      pen.setLineDash([4 * pixel, 3 * pixel]);
      const fill = fillOf(layer, "part");
      if (layer.wayOf !== fill) { layer.wayOf = fill; layer.way = travel(layer, "part_" + fill); }
      stroke(layer.way, pixel, colours.travel);
      pen.setLineDash([]);
    }
    if (on.flagged) {
      for (const [x, y, r] of layer.places) {
        pen.beginPath(); pen.arc(x, y, Math.max(r, 7 * pixel), 0, 2 * Math.PI);
        pen.lineWidth = 2 * pixel; pen.strokeStyle = colours.flag; pen.stroke();
      }
    }
  }

  const fillOf = (layer, name) => (on.second && layer[name + "_second_fill"]?.paths ? "second_fill" : "fill");

  function drawMaterial(layer, name, width, pixel, unit, hurry) {
    const bead = width / meta.quantum * .88, wide = bead > 3.2 * pixel, hair = .99 / unit;
    pen.fillStyle = colours[name]; pen.fill(layer[meta.regions ? name : name + "_boundary"].shape, "evenodd");
    const fill = fillOf(layer, name);
    for (const [what, set] of [["fill", fill], ["boundary", "boundary"]]) {
      if (on[what]) stroke(layer[name + "_" + set].shape, wide ? bead : hurry ? hair : pixel, colours[name + "_bead"]);
    }
    if (on.boundary) stroke(layer[name + "_boundary"].shape, hurry ? hair : 1.25 * pixel, colours[name + "_line"]);
    if (on.fill && bead > 9 * pixel) stroke(layer[name + "_" + fill].shape, hurry ? hair : pixel, colours[name + "_line"]);
    if (!on.boundary) stroke(layer[name].shape, hurry ? hair : 1.1 * pixel, colours[name + "_line"]);
  }

  // The last picture stays while a layer is on its way.
  function waitFor(k) {
    const gone = lost.has(Math.floor(k / meta.block));
    note.hidden = false;
    note.textContent = gone ? `layer ${meta.index[k]} cannot be read: is the folder ${meta.folder} beside this page?` : "loading";
  }

  let barLength = "";
  function drawBar() {
    const length = niceStep(90 / view.scale);
    const width = (length * view.scale).toFixed(1) + "px", text = `${length} mm`;
    if (barLength === width + text) return;
    barLength = width + text;
    bar.style.width = width;
    barText.textContent = text;
  }

  gestures(canvas, (dx, dy) => { view.x += dx; view.y += dy; schedule(); }, zoom);
  canvas.addEventListener("dblclick", () => { fit(); schedule(); });
  canvas.addEventListener("pointermove", (event) => {
    const box = canvas.getBoundingClientRect();
    const x = (event.clientX - box.left - view.x) / view.scale + meta.corner[0];
    const y = (view.y - event.clientY + box.top) / view.scale + meta.corner[1];
    where.textContent = `x ${x.toFixed(2)}  y ${y.toFixed(2)} mm`;
  });
  canvas.addEventListener("pointerleave", () => { where.textContent = ""; });
  return { draw, fit, zoom, view, on, canvas, shown: shownAtAll };
})();

// The largest of 1, 2, 5, 10, ... times a power of ten that is not above a length.
function niceStep(length) {
  const power = 10 ** Math.floor(Math.log10(length)), digit = length / power;
  return Number(((digit >= 5 ? 5 : digit >= 2 ? 2 : 1) * power).toPrecision(3));
}
