// The stack in three dimensions: walls of every level, drawn up to the layer that is shown, which is closed by a cap.
// The narrow steps between levels are not closed: what is seen through them, the inner sides of walls, is lit as
// a surface that faces up. While it moves on a slow machine it is drawn with fewer walls and pixels.

const stack = (() => {
  const section = element("stack"), canvas = section.querySelector("canvas"), COARSE = 4; // levels in one, while it moves
  const view = { turn: -0.6, tilt: 0.42, zoom: 1 };
  const height = Math.max(COUNT * meta.thickness, 1e-6), size = [meta.size[0], meta.size[1], height];
  const radius = Math.hypot(...size) / 2;
  let gl, program, places, meshes, begun = false;

  // Lit at the corners: there are fewer of them than pixels.
  const VERTEX = `#version 300 es
    in vec3 position; in vec3 normal; uniform mat4 matrix; uniform mat3 turn; uniform vec3 shade, up; uniform float flatly;
    out vec3 front, back;
    vec3 lit(vec3 m) {
      float key = max(dot(m, normalize(vec3(-.45, .55, .7))), 0.), fill = max(dot(m, normalize(vec3(.8, .1, .4))), 0.);
      return shade * (.30 + .14 * (.5 + .5 * m.y) + .62 * key + .16 * fill);
    }
    void main() {
      gl_Position = matrix * vec4(position, 1.);
      vec3 m = turn * normal;
      float far = 1. - .12 * gl_Position.z;
      front = mix(lit(m) + pow(1. - max(m.z, 0.), 3.) * .18, shade, flatly) * far;
      back = mix(lit(up), shade, flatly) * far;
    }`;
  const FRAGMENT = `#version 300 es
    precision mediump float; in vec3 front, back; uniform float alpha; out vec4 colour;
    void main() { colour = vec4(gl_FrontFacing ? front : back, 1.) * alpha; }`;

  // The outlines of every level: for each loop x, y and the normal of each point, in mm.
  function outlines(name) {
    const reader = new Reader(bytesOf(element("relief_" + name).textContent));
    return meta.levels.map(() => {
      let x = 0, y = 0;
      return Array.from({ length: reader.whole() }, () => reader.whole()).map((n) => Array.from({ length: n }, () => {
        x += reader.signed(); y += reader.signed();
        return [x * meta.quantum - size[0] / 2, y * meta.quantum - size[1] / 2, reader.whole() / 63 - 1, reader.whole() / 63 - 1, reader.whole() / 63 - 1];
      }));
    });
  }

  // Points of a loop that are some way apart; a loop that is all within that way is left out.
  function sparse(loop, apart) {
    const kept = [loop[0]];
    for (const p of loop) { const q = kept.at(-1); if (Math.hypot(p[0] - q[0], p[1] - q[1]) >= apart) kept.push(p); }
    return kept.length > 2 ? kept : [];
  }

  // Walls of some levels, each as high as `tall` of them, and the fans that close their tops.
  function build(levels, tall) {
    const step = tall * height / Math.max(meta.levels.length, 1);
    const points = [], corners = [], ends = [0], fans = [], fanEnds = [0];
    for (const [level, loops] of levels.entries()) {
      const low = level * step - height / 2, high = Math.min(low + step, height / 2);
      for (const loop of loops) {
        const first = points.length / 6, n = loop.length;
        for (let i = 0; i < n; i++) {
          const [x, y, u, v, w] = loop[i];
          // A wall leans as its normal does, so that it meets those above and below it.
          const flat = Math.max(Math.hypot(u, v), .2), lean = Math.min(Math.max(w / flat, -2), 2) * (high - low) / 2 / flat;
          points.push(x + u * lean, y + v * lean, low, u, v, w, x - u * lean, y - v * lean, high, u, v, w);
          const a = first + 2 * i, b = first + 2 * ((i + 1) % n);
          corners.push(a, b, a + 1, a + 1, b, b + 1);
          if (i && i < n - 1) fans.push(first + 1, a + 1, b + 1);
        }
      }
      ends.push(corners.length); fanEnds.push(fans.length);
    }
    const array = gl.createVertexArray(), all = new Uint32Array(corners.length + fans.length);
    all.set(corners); all.set(fans, corners.length);
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, all, gl.STATIC_DRAW);
    for (const [i, attribute] of ["position", "normal"].entries()) {
      const at = gl.getAttribLocation(program, attribute);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 24, 12 * i);
    }
    return { array, ends, fanEnds: fanEnds.map((v) => v + corners.length), triangles: corners.length / 3 };
  }

  function both(name) {
    const levels = outlines(name), some = levels.filter((_, i) => i % COARSE === COARSE >> 1);
    return { fine: build(levels, 1), coarse: build(some.map((loops) => loops.map((loop) => sparse(loop, radius / 30))), COARSE) };
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
    meshes = { part: both("part"), scaffold: both("scaffold") };
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

  // Pixels per page pixel, and whether with all walls: at rest in full, while it moves as the machine allows. A level
  // that was too slow is tried again later and later. On a slow machine scrubbing draws the stack a few times a second
  // only, so that the layer beside it keeps up.
  let last = 0, slow = 0, good = 0, patience = 60, calm = 0, resting = false, drawn = 0, camera = "";
  const TIERS = [[1, true], [1, false], [1.5, false], [2, false], [3, false]];
  function quality() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), now = performance.now(), gap = now - last;
    const before = camera;
    camera = JSON.stringify(view);
    last = now;
    clearTimeout(calm);
    calm = setTimeout(() => { resting = true; schedule(); }, slow ? 300 : 180);
    if (resting) { resting = false; last = 0; clearTimeout(calm); return [slow > 1 ? ratio : Math.max(ratio, 2), true]; }
    if (gap < 400) {
      good = gap < 20 ? good + 1 : 0;
      if (gap > 25 && slow < TIERS.length - 1) { slow++; patience = Math.min(2 * patience, 2000); }
      if (good > patience && slow) { slow--; good = 0; }
    }
    if (slow > 1 && camera === before && flat.shown() && now - drawn < 100) return [0];
    drawn = now;
    return [ratio / TIERS[slow][0], TIERS[slow][1]];
  }

  const rgb = (text) => text.split(" ").map((v) => v / 255);

  function draw(k) {
    if (!sizeOf(section)[0]) return;
    if (!meshes) {
      if (COUNT && !begun) { begun = true; setTimeout(() => { start(); schedule(); }); } // the layer beside it comes first
      return;
    }
    const [ratio, full] = quality();
    if (!ratio) return;
    const [width, high] = fitted(canvas, ratio), [turn, matrix] = matrices(width, high);
    gl.viewport(0, 0, width, high);
    gl.clearColor(0, 0, 0, 0); gl.depthMask(true); gl.stencilMask(255);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.uniformMatrix4fv(places.matrix, false, matrix); gl.uniformMatrix3fv(places.turn, false, turn);
    gl.uniform3f(places.up, turn[6], turn[7], turn[8]);
    const levels = meta.levels.length, top = Math.min(levels, Math.ceil((k + 1) / COUNT * levels));
    gl.disable(gl.BLEND); gl.uniform1f(places.flatly, 0);
    if (flat.on.part) { walls("part", 0, top, 1, full); if (top) cap("part", top, 1); }
    if (flat.on.scaffold) {
      gl.enable(gl.POLYGON_OFFSET_FILL); // where both lie in one place, the part is seen
      if (flat.on.part) veil("scaffold", 0, top, .42, full); else walls("scaffold", 0, top, 1, full);
      gl.disable(gl.POLYGON_OFFSET_FILL);
      if (top) cap("scaffold", top, flat.on.part ? .8 : 1);
      gl.disable(gl.BLEND);
    }
    if (flat.on.part && top < levels) veil("part", top, levels, .16, full); // what is still to come
  }

  // The nearest surface alone, so that what lies behind it shows through once: its depth first, then its colour. While
  // it moves, all that faces the eye, in one go.
  function veil(name, from, to, alpha, full) {
    if (!full) {
      gl.enable(gl.BLEND); gl.enable(gl.CULL_FACE);
      walls(name, from, to, alpha, full);
      gl.disable(gl.CULL_FACE);
      return;
    }
    gl.colorMask(false, false, false, false);
    walls(name, from, to, 1, full);
    gl.colorMask(true, true, true, true);
    gl.enable(gl.BLEND); gl.depthFunc(gl.EQUAL);
    walls(name, from, to, alpha, full);
    gl.depthFunc(gl.LESS);
  }

  // Walls of some levels; if not in full, coarse ones, and fine ones where these do not fit.
  function walls(name, from, to, alpha, full) {
    const { fine, coarse } = meshes[name], a = Math.ceil(from / COARSE), b = Math.floor(to / COARSE);
    if (full || a >= b) { paint(name, "shade_", fine, fine.ends, from, to, alpha); return; }
    paint(name, "shade_", fine, fine.ends, from, a * COARSE, alpha);
    paint(name, "shade_", coarse, coarse.ends, a, b, alpha);
    paint(name, "shade_", fine, fine.ends, b * COARSE, to, alpha);
  }

  function paint(name, colour, mesh, ends, from, to, alpha) {
    if (ends[to] <= ends[from]) return;
    gl.uniform3fv(places.shade, rgb(colours[colour + name])); gl.uniform1f(places.alpha, alpha);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, ends[to] - ends[from], gl.UNSIGNED_INT, 4 * ends[from]);
  }

  // The top of a level: fans of its loops count, in the stencil, whether a pixel lies inside an odd number of them.
  function cap(name, top, alpha) {
    const mesh = meshes[name].fine;
    gl.enable(gl.STENCIL_TEST);
    gl.stencilMask(1); gl.stencilFunc(gl.ALWAYS, 0, 1); gl.stencilOp(gl.INVERT, gl.INVERT, gl.INVERT);
    gl.colorMask(false, false, false, false); gl.depthMask(false);
    paint(name, "cap_", mesh, mesh.fanEnds, top - 1, top, 1);
    gl.colorMask(true, true, true, true); gl.depthMask(true); gl.depthFunc(gl.LEQUAL);
    gl.stencilFunc(gl.EQUAL, 1, 1); gl.stencilOp(gl.ZERO, gl.ZERO, gl.ZERO);
    gl.uniform1f(places.flatly, 1);
    paint(name, "cap_", mesh, mesh.fanEnds, top - 1, top, alpha);
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
