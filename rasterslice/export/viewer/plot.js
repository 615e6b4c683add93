// Area over height, which is also the scrubber: part, and beside it scaffold; flagged layers at the edge.

const plot = (() => {
  const box = element("plot"), canvas = box.querySelector("canvas"), cursor = box.querySelector(".cursor"), text = cursor.querySelector("b");
  const PAD = 26;

  const at = (k) => { const h = sizeOf(box)[1] - 2 * PAD; return PAD + h - (k + .5) / Math.max(COUNT, 1) * h; };

  function draw() {
    const [width, height, ratio] = fitted(canvas), pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const [across, down] = sizeOf(box), wide = across - 16, part = meta.part_area.map((v) => v || 0), scaffold = meta.scaffold_area.map((v) => v || 0);
    const largest = part.reduce((most, v, k) => Math.max(most, v + scaffold[k]), 1e-9);
    const area = (from, to, colour) => {
      pen.beginPath();
      for (let k = 0; k < COUNT; k++) pen.lineTo(4 + to[k] / largest * wide, at(k));
      for (let k = COUNT - 1; k >= 0; k--) pen.lineTo(4 + from[k] / largest * wide, at(k));
      pen.fillStyle = colour; pen.fill();
    };
    area(part, part.map((v, k) => v + scaffold[k]), colours.scaffold_bead);
    area(part.map(() => 0), part, colours.part_bead);
    pen.fillStyle = colours.flag;
    for (const k of flaggedLayers) pen.fillRect(across - 7, at(k) - .75, 4, 1.5);
    pen.fillStyle = colours.grey; pen.font = "11px system-ui, sans-serif";
    const room = across > 100;
    pen.fillText(room ? "area" : "mm\u00b2", 6, 16);
    if (COUNT) pen.fillText((room ? "max " : "") + largest.toPrecision(3) * 1 + (room ? " mm\u00b2" : ""), 6, down - 9);
  }

  function mark(k) {
    cursor.style.transform = `translateY(${at(k)}px)`;
    text.firstChild.data = COUNT ? meta.z[k].toFixed(1) : "";
  }

  function scrub(event) {
    const h = sizeOf(box)[1] - 2 * PAD, y = event.clientY - box.getBoundingClientRect().top - PAD;
    show(Math.floor((1 - y / h) * COUNT));
  }
  box.addEventListener("pointerdown", (event) => { box.setPointerCapture(event.pointerId); stop(); scrub(event); });
  box.addEventListener("pointermove", (event) => { if (box.hasPointerCapture(event.pointerId)) scrub(event); });
  return { draw, mark };
})();
