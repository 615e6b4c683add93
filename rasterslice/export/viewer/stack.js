// The stack in three dimensions: walls of every level, drawn up to the layer that is shown, which is closed by a cap.
// The narrow steps between levels are not closed: what is seen through them, the inner sides of walls, is lit as
// a surface that faces up. While it moves on a slow machine it is drawn with fewer pixels.

const stack = (() => {
  const section = element("stack"), canvas = section.querySelector("canvas");
  const view = { turn: -0.6, tilt: 0.42, zoom: 1 };
  const height = Math.max(COUNT * meta.thickness, 1e-6), size = [meta.size[0], meta.size[1], height];
  const radius = Math.hypot(...size) / 2;
  let gl, program, places, meshes;

  const VERTEX = `#version 300 es
    in vec3 position; in vec3 normal; uniform mat4 matrix; uniform mat3 turn; out vec3 n; out float depth;
    void main() { gl_Position = matrix * vec4(position, 1.); n = turn * normal; depth = gl_Position.z; }`;
  const FRAGMENT = `#version 300 es
    precision mediump float; in vec3 n; in float depth; uniform vec3 shade, up; uniform float alpha, flatly; out vec4 colour;
    void main() {
      vec3 m = gl_FrontFacing ? normalize(n) : up;
      float key = max(dot(m, normalize(vec3(-.45, .55, .7))), 0.), fill = max(dot(m, normalize(vec3(.8, .1, .4))), 0.);
      float rim = pow(1. - max(m.z, 0.), 3.) * .18, sky = .5 + .5 * m.y;
      vec3 c = shade * (.30 + .14 * sky + .62 * key + .16 * fill) + (gl_FrontFacing ? rim : 0.);
      colour = vec4(mix(c, shade, flatly) * (1. - .12 * depth), 1.) * alpha;
    }`;

  function build(name) {
    const reader = new Reader(bytesOf("relief_" + name)), levels = meta.levels.length, step = height / Math.max(levels, 1);
    const points = [], corners = [], ends = [0], fans = [], fanEnds = [0];
    for (let level = 0; level < levels; level++) {
      let x = 0, y = 0;
      const loops = reader.whole(), counts = Array.from({ length: loops }, () => reader.whole());
      for (const n of counts) {
        const first = points.length / 6;
        for (let i = 0; i < n; i++) {
          x += reader.signed(); y += reader.signed();
          const normal = [reader.whole() / 63 - 1, reader.whole() / 63 - 1, reader.whole() / 63 - 1];
          for (const z of [level, level + 1]) {
            points.push(x * meta.quantum - size[0] / 2, y * meta.quantum - size[1] / 2, z * step - height / 2, ...normal);
          }
          const a = first + 2 * i, b = first + 2 * ((i + 1) % n);
          corners.push(a, b, a + 1, a + 1, b, b + 1);
          if (i && i < n - 1) fans.push(first + 1, a + 1, b + 1);
        }
      }
      ends.push(corners.length); fanEnds.push(fans.length);
    }
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(corners.concat(fans)), gl.STATIC_DRAW);
    for (const [i, attribute] of ["position", "normal"].entries()) {
      const at = gl.getAttribLocation(program, attribute);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 24, 12 * i);
    }
    return { array, ends, fanEnds: fanEnds.map((v) => v + corners.length), triangles: corners.length / 3 };
  }

  function start() {
    gl = canvas.getContext("webgl2", { antialias: false, stencil: true });
    if (!gl) {
      canvas.insertAdjacentHTML("afterend", '<div class="failed">This browser offers no WebGL 2, so the stack cannot be shown.</div>');
      return;
    }
    program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source); gl.compileShader(shader); gl.attachShader(program, shader);
    }
    gl.linkProgram(program); gl.useProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    places = Object.fromEntries(["matrix", "turn", "shade", "up", "alpha", "flatly"].map((n) => [n, gl.getUniformLocation(program, n)]));
    meshes = { part: build("part"), scaffold: build("scaffold") };
    gl.enable(gl.DEPTH_TEST); gl.polygonOffset(1, 4);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // Parallel projection: turned about z, tilted towards the eye, fitted into the canvas.
  function matrices(width, high) {
    const [c, s, d, e] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.tilt), Math.sin(view.tilt)];
    const turn = [c, s * e, -s * d, -s, c * e, -c * d, 0, d, e]; // columns: where x, y and z go
    const tall = size[2] * Math.abs(d) + Math.hypot(size[0], size[1]) * Math.abs(e), wide = Math.hypot(size[0], size[1]);
    const scale = view.zoom * .94 * Math.min(2 / tall, 2 / wide * width / high);
    const k = [scale * high / width, scale, -.9 / radius];
    return [turn, [turn[0] * k[0], turn[1] * k[1], turn[2] * k[2], 0, turn[3] * k[0], turn[4] * k[1], turn[5] * k[2], 0,
      turn[6] * k[0], turn[7] * k[1], turn[8] * k[2], 0, 0, 0, 0, 1]];
  }

  // Pixels per page pixel: many when nothing moves, few while a slow machine is at it.
  // There, too, scrubbing draws the stack a few times a second only, so that the layer keeps up.
  let last = 0, slow = 0, calm = 0, resting = false, drawn = 0, camera = "";
  function quality() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), now = performance.now(), gap = now - last;
    const before = camera;
    camera = JSON.stringify(view);
    last = now;
    clearTimeout(calm);
    calm = setTimeout(() => { resting = true; last = 0; schedule(); }, 180);
    if (resting) { resting = false; clearTimeout(calm); slow = Math.min(slow, 2.9); return Math.max(ratio, 2); }
    if (slow >= 2 && camera === before && flat.shown() && now - drawn < 250) return 0;
    drawn = now;
    if (gap < 400) slow = Math.min(Math.max(slow + (gap > 30 ? 1 : gap < 20 ? -.1 : 0), 0), 6);
    return ratio / [1, 1, 1.5, 2, 3, 4, 4][Math.floor(slow)];
  }

  const rgb = (text) => text.split(" ").map((v) => v / 255);

  function draw(k) {
    if (!section.clientWidth) return;
    if (!meshes) { if (gl === undefined && COUNT) start(); if (!meshes) return; }
    const ratio = quality();
    if (!ratio) return;
    const [width, high] = fitted(canvas, ratio);
    const [turn, matrix] = matrices(width, high);
    gl.viewport(0, 0, width, high);
    gl.clearColor(0, 0, 0, 0); gl.depthMask(true); gl.stencilMask(255);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.uniformMatrix4fv(places.matrix, false, matrix); gl.uniformMatrix3fv(places.turn, false, turn);
    gl.uniform3f(places.up, turn[6], turn[7], turn[8]);
    const levels = meta.levels.length, top = Math.min(levels, Math.ceil((k + 1) / COUNT * levels));
    gl.disable(gl.BLEND); gl.uniform1f(places.flatly, 0);
    if (flat.on.part) { paint("part", "shade_", meshes.part.ends, 0, top, 1); if (top) cap("part", top, 1); }
    if (flat.on.scaffold) {
      gl.enable(gl.POLYGON_OFFSET_FILL); // where both lie in one place, the part is seen
      if (flat.on.part) veil("scaffold", 0, top, .42); else paint("scaffold", "shade_", meshes.scaffold.ends, 0, top, 1);
      gl.disable(gl.POLYGON_OFFSET_FILL);
      if (top) cap("scaffold", top, flat.on.part ? .8 : 1);
      gl.disable(gl.BLEND);
    }
    if (flat.on.part && top < levels && slow < 3) veil("part", top, levels, .16); // what is still to come
  }

  // The nearest surface alone, so that what lies behind it shows through once: its depth first, then its colour.
  function veil(name, from, to, alpha) {
    gl.colorMask(false, false, false, false);
    paint(name, "shade_", meshes[name].ends, from, to, 1);
    gl.colorMask(true, true, true, true);
    gl.enable(gl.BLEND); gl.depthFunc(gl.EQUAL);
    paint(name, "shade_", meshes[name].ends, from, to, alpha);
    gl.depthFunc(gl.LESS);
  }

  function paint(name, colour, ends, from, to, alpha) {
    gl.uniform3fv(places.shade, rgb(colours[colour + name])); gl.uniform1f(places.alpha, alpha);
    gl.bindVertexArray(meshes[name].array);
    if (ends[to] > ends[from]) gl.drawElements(gl.TRIANGLES, ends[to] - ends[from], gl.UNSIGNED_INT, 4 * ends[from]);
  }

  // The top of a level: fans of its loops count, in the stencil, whether a pixel lies inside an odd number of them.
  function cap(name, top, alpha) {
    const ends = meshes[name].fanEnds;
    gl.enable(gl.STENCIL_TEST);
    gl.stencilMask(1); gl.stencilFunc(gl.ALWAYS, 0, 1); gl.stencilOp(gl.INVERT, gl.INVERT, gl.INVERT);
    gl.colorMask(false, false, false, false); gl.depthMask(false);
    paint(name, "cap_", ends, top - 1, top, 1);
    gl.colorMask(true, true, true, true); gl.depthMask(true); gl.depthFunc(gl.LEQUAL);
    gl.stencilFunc(gl.EQUAL, 1, 1); gl.stencilOp(gl.ZERO, gl.ZERO, gl.ZERO);
    gl.uniform1f(places.flatly, 1);
    paint(name, "cap_", ends, top - 1, top, alpha);
    gl.uniform1f(places.flatly, 0);
    gl.depthFunc(gl.LESS); gl.disable(gl.STENCIL_TEST);
  }

  gestures(canvas, (dx, dy) => {
    view.turn += dx * .01;
    view.tilt = Math.min(Math.max(view.tilt + dy * .01, -.2), Math.PI / 2);
    schedule();
  }, (factor) => { view.zoom = Math.min(Math.max(view.zoom * factor, .3), 30); schedule(); });
  canvas.addEventListener("dblclick", () => { Object.assign(view, { turn: -.6, tilt: .42, zoom: 1 }); schedule(); });
  return { draw, view, canvas, meshes: () => meshes };
})();
