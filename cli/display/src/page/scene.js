// The scene in three dimensions, by WebGL2. It draws what it is given, and says which part is where a person points.

import { Sights, pyramidOf, seenFrom } from "./sight.js";
import { arrowFrames, arrowParts, ballOf, cross, hit, inner, joined, looking, minus, norm, outline, perspective, placed, plus, point4, surface, times, unit3, unit4 } from "./solids.js";

const SOLID = [`#version 300 es
in vec3 at; in vec3 normal;
uniform mat4 seen; uniform mat4 frame; uniform vec3 sun; uniform float fallen;
out vec3 side; out vec3 spot;
void main() {
  vec4 world = frame * vec4(at, 1.0);
  side = mat3(frame) * normal;
  // A shadow is flat on the ground, away from the sun.
  if (fallen > 0.5) world = vec4(world.xy - sun.xy * max(0.0, world.z) / sun.z, 0.002, 1.0);
  spot = world.xyz;
  gl_Position = seen * world;
}`, `#version 300 es
precision highp float;
in vec3 side; in vec3 spot;
uniform vec3 colour; uniform vec3 eye; uniform vec3 sky; uniform vec3 ground; uniform float glow;
uniform vec3 sun; uniform vec3 paper; uniform vec3 shadow; uniform float reach; uniform float fallen;
out vec4 ink;
void main() {
  if (fallen > 0.5) {
    ink = vec4(mix(shadow, paper, smoothstep(0.35 * reach, reach, length(spot.xy))), 1.0);
    return;
  }
  vec3 n = normalize(side);
  vec3 away = normalize(eye - spot);
  if (dot(n, away) < 0.0) n = -n;
  vec3 to = normalize(sun);
  vec3 light = mix(ground, sky, 0.5 + 0.5 * n.z) + 0.36 * max(0.0, dot(n, to));
  float shine = pow(max(0.0, dot(reflect(-to, n), away)), 32.0);
  float rim = pow(1.0 - max(0.0, dot(n, away)), 3.0);
  ink = vec4(colour * light + 0.12 * shine + glow * (0.12 + 0.5 * rim), 1.0);
}`];

const LINE = [`#version 300 es
in vec3 at; in float strength;
uniform mat4 seen; uniform mat4 frame;
out float shown; out vec3 spot;
void main() {
  vec4 world = frame * vec4(at, 1.0);
  shown = strength;
  spot = world.xyz;
  gl_Position = seen * world;
}`, `#version 300 es
precision highp float;
in float shown; in vec3 spot;
uniform vec4 colour; uniform float reach;
out vec4 ink;
void main() {
  float near = reach > 0.0 ? 1.0 - smoothstep(0.35 * reach, reach, length(spot.xy)) : 1.0;
  ink = vec4(colour.rgb, colour.a * shown * near);
}`];

/** The ground reaches so far, m. */
const GROUND_REACH = 2.6;
/** Its lines are so far above it, m, and shadows between. */
const LIFT = 0.004;
const ANGLE = 0.6;
/** Where the scene is narrower than this, wide to high, as much is seen across as here. */
const NARROW = 1.2;
/** Where the sun is. */
const SUN = [0.45, -0.5, 0.85];
/** Radius of an arrow, m, and the longest that is drawn. */
const ARROW = 0.008;
const LONGEST_ARROW = 1.5;
/** What does not say how large the scene is: it may reach far beyond, or is nowhere yet. */
const BESIDE = new Set(["guard", "margin", "nearest", "contact", "path", "force"]);
/** A frame that takes longer, ms, has too many pixels; one that takes less could have more. */
const SLOW_FRAME = 45;
const FAST_FRAME = 22;
const LEAST_QUALITY = 0.5;
/** The first picture is there soon. */
const FIRST_QUALITY = 0.6;
/** Below this round things have fewer facets, and below that nothing has a shadow. */
const FINE_QUALITY = 0.8;
const SHADED_QUALITY = 0.6;
const VIEWS = { azimuth: -0.95, height: 0.34 };

/** A drawing area. `colours` gives those of the page by name. */
export class SceneView {
  constructor(canvas, colours) {
    this.canvas = canvas;
    this.colours = colours;
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "low-power" });
    this.camera = { ...VIEWS, distance: 3.4, target: [0, 0, 0.62] };
    this.fitted = false;
    /** The keys of the part that is followed, and of the camera from which the scene is seen; null: none. */
    [this.followed, this.from] = [null, null];
    this.drawn = 0;
    /** Pixels of the drawing for one of the page, along a side: fewer where drawing them takes too long. */
    this.quality = FIRST_QUALITY;
    [this.cost, this.paced] = [0, 0];
    /** What is drawn of each part; it goes with the part. */
    this.looks = new WeakMap();
    if (this.gl === null) return;
    this.prepare();
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.lost = true; });
    canvas.addEventListener("webglcontextrestored", () => { this.lost = false; this.looks = new WeakMap(); this.prepare(); this.stale = true; });
  }

  /** A frame took so long, ms, in which the scene was drawn: the next ones have fewer pixels, or more. */
  pace(took) {
    this.cost = this.cost === 0 ? took : 0.7 * this.cost + 0.3 * Math.min(took, 500);
    this.paced += 1;
    if (this.cost > SLOW_FRAME && this.paced >= 4) this.quality = Math.max(LEAST_QUALITY, this.quality * 0.75);
    else if (this.cost < FAST_FRAME && this.paced >= 12 && this.quality < 1) this.quality = Math.min(1, this.quality * 1.2);
    else return;
    [this.cost, this.paced] = [0, 0];
  }

  /** Whether what was drawn last has fewer pixels than there are. */
  get coarse() {
    return this.works && this.shown < 1;
  }

  get works() {
    return this.gl !== null;
  }

  prepare() {
    const gl = this.gl;
    this.solid = this.program(SOLID);
    this.line = this.program(LINE);
    this.sights = new Sights(this);
    const ground = [];
    for (let at = -5; at <= 5; at += 1) {
      const [half, strength] = [at / 2, at === 0 ? 1 : 0.55];
      ground.push(-GROUND_REACH, half, LIFT, strength, GROUND_REACH, half, LIFT, strength, half, -GROUND_REACH, LIFT, strength, half, GROUND_REACH, LIFT, strength);
    }
    this.ground = this.buffer(new Float32Array(ground), 4);
    this.way = this.buffer(new Float32Array(4), 4);
    this.arrows = Object.fromEntries(Object.entries(arrowParts).map(([name, numbers]) => [name, this.mesh(numbers)]));
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  program([vertex, fragment]) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ["at", "normal"].forEach((name, at) => gl.bindAttribLocation(program, at, name));
    for (const name of ["strength", "spot"]) gl.bindAttribLocation(program, 1, name);
    gl.linkProgram(program);
    const at = {};
    for (const name of ["seen", "frame", "colour", "eye", "sky", "ground", "glow", "reach", "sun", "paper", "shadow", "fallen"]) at[name] = gl.getUniformLocation(program, name);
    return { program, at };
  }

  /** Corners of so many numbers: three for the place, the rest for what goes with it. */
  buffer(numbers, each) {
    const gl = this.gl;
    const made = { array: gl.createVertexArray(), buffer: gl.createBuffer(), count: numbers.length / each };
    gl.bindVertexArray(made.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, made.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
    for (const [at, size, from] of [[0, 3, 0], [1, each - 3, 12]]) {
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 4 * each, from);
    }
    gl.bindVertexArray(null);
    return made;
  }

  /** Corners, and the order in which triangles have them: each corner is computed once or twice, not six times. */
  mesh({ corners, order }) {
    const gl = this.gl;
    const made = this.buffer(new Float32Array(corners), 6);
    gl.bindVertexArray(made.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(order), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return { ...made, count: order.length, ordered: true };
  }

  fill(made, numbers, each) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, made.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.DYNAMIC_DRAW);
    made.count = numbers.length / each;
  }

  // -- who looks ------------------------------------------------------------------------

  eye() {
    const { azimuth, height, distance, target } = this.camera;
    return plus(target, [Math.cos(azimuth) * Math.cos(height), Math.sin(azimuth) * Math.cos(height), Math.sin(height)], distance);
  }

  turn(by, up) {
    this.from = null;
    this.camera.azimuth += by;
    this.camera.height = Math.min(1.5, Math.max(0.03, this.camera.height + up));
    this.stale = true;
  }

  /** Nearer or farther. */
  dolly(by) {
    this.from = null;
    this.camera.distance = Math.min(20, Math.max(0.5, this.camera.distance * by));
    this.stale = true;
  }

  /** Moves what is looked at, px. */
  shift(dx, dy) {
    [this.from, this.followed] = [null, null];
    this.camera.target = minus(this.camera.target, this.along(this.camera.target, dx, dy));
    this.stale = true;
  }

  /** How far a point of the scene goes that is moved by so many px in the plane of the view, m. */
  along(at, dx, dy) {
    const back = unit3(minus(this.eye(), this.camera.target));
    const right = unit3(cross([0, 0, 1], back));
    const up = cross(back, right);
    const each = (2 * this.tall() * inner(minus(this.eye(), at), back)) / Math.max(1, this.canvas.clientHeight);
    return plus(plus([0, 0, 0], right, dx * each), up, -dy * each);
  }

  /** The place as high as a point of the scene that is seen at a point of the canvas, px; null where there is none. */
  onLevel(at, [px, py]) {
    // Newton's method: a millimetre along each axis says which way.
    const small = 1e-3;
    let place = at;
    for (let step = 0; step < 8; step++) {
      const [here, x, y] = [place, plus(place, [small, 0, 0]), plus(place, [0, small, 0])].map((one) => this.where(one));
      if (here === null || x === null || y === null) return null;
      const [a, b, c, d] = [x[0] - here[0], y[0] - here[0], x[1] - here[1], y[1] - here[1]];
      const whole = a * d - b * c;
      if (Math.abs(whole) < 1e-9) return null;
      const [u, v] = [px - here[0], py - here[1]];
      place = plus(place, [(small * (d * u - b * v)) / whole, (small * (a * v - c * u)) / whole, 0]);
    }
    return place.every(Number.isFinite) ? place : null;
  }

  /** Shows all parts, as at first. */
  fit(parts) {
    parts = parts.filter(({ part }) => !BESIDE.has(part.kind));
    [this.from, this.followed] = [null, null];
    const balls = parts.flatMap(({ part, frame }) => part.solids.map(ballOf).filter((ball) => ball !== null).map(([at, radius]) => [point4(frame, at).slice(0, 3), radius]));
    if (balls.length === 0) return;
    const low = [0, 1, 2].map((axis) => Math.min(...balls.map(([at, radius]) => at[axis] - radius)));
    const high = [0, 1, 2].map((axis) => Math.max(...balls.map(([at, radius]) => at[axis] + radius)));
    const size = Math.max(2.3, norm(minus(high, low)));
    this.camera = { ...VIEWS, distance: (0.56 * size) / Math.tan(ANGLE / 2), target: plus(low, minus(high, low), 0.5) };
    this.fitted = true;
    this.stale = true;
  }

  /** Half of what is seen from below to above, at a distance of 1. */
  tall() {
    const { clientWidth, clientHeight } = this.canvas;
    return Math.tan(ANGLE / 2) * Math.max(1, (NARROW * clientHeight) / Math.max(1, clientWidth));
  }

  seen() {
    const aspect = this.canvas.width / Math.max(1, this.canvas.height);
    if (this.through) return seenFrom(this.through.frame, pyramidOf(this.through.part).corners, aspect);
    const { distance, target } = this.camera;
    return times(perspective(2 * Math.atan(this.tall()), aspect, Math.max(0.02, distance / 50), distance + 20), looking(this.eye(), target));
  }

  /** Where a point of the scene is in the canvas, px; null when it is behind. */
  where(at) {
    const [x, y, , w] = point4(this.seen(), at);
    return w <= 0 ? null : [(0.5 + x / w / 2) * this.canvas.clientWidth, (0.5 - y / w / 2) * this.canvas.clientHeight];
  }

  /** The part that is seen at a point of the canvas, px. */
  pick(parts, [px, py]) {
    if (this.through) return null;
    const eye = this.eye();
    const back = unit3(minus(eye, this.camera.target));
    const right = unit3(cross([0, 0, 1], back));
    const up = cross(back, right);
    const tall = this.tall();
    const wide = (tall * this.canvas.clientWidth) / Math.max(1, this.canvas.clientHeight);
    const [x, y] = [((2 * px) / this.canvas.clientWidth - 1) * wide, (1 - (2 * py) / this.canvas.clientHeight) * tall];
    const way = unit3(plus(plus(plus([0, 0, 0], back, -1), right, x), up, y));
    let best = null;
    for (const one of parts) {
      const { frame } = one;
      const away = minus(eye, frame.slice(12, 15));
      const local = (v) => [inner(v, frame.slice(0, 3)), inner(v, frame.slice(4, 7)), inner(v, frame.slice(8, 11))];
      for (const solid of one.part.solids) {
        const far = hit(solid, local(away), local(way));
        if (far !== null && (best === null || far < best.far)) best = { far, key: one.key };
      }
    }
    return best?.key ?? null;
  }

  // -- drawing ----------------------------------------------------------------------------

  /** What of a part is drawn, made once. */
  lookOf(part) {
    if (!this.looks.has(part)) {
      const lines = part.solids.flatMap(outline);
      const made = (mesh) => (mesh.order.length > 0 ? this.mesh(mesh) : null);
      this.looks.set(part, {
        surface: made(joined(part.solids.map((solid) => surface(solid)))),
        coarse: made(joined(part.solids.map((solid) => surface(solid, 1)))),
        shade: made(joined(part.solids.map((solid) => surface(solid, 2)))),
        outline: lines.length > 0 ? this.buffer(new Float32Array(lines.flatMap((at) => [...at, 1])), 4) : null,
        axes: part.solids.map((solid) => solid.axes).find((length) => length !== undefined) ?? null,
      });
    }
    return this.looks.get(part);
  }

  /** Draws `parts`, each with `key`, `part`, `frame`, `truth` and `chosen`, the `trails` of tools, and `pictures` by camera. */
  paint(parts, trails, pictures, quality = this.quality) {
    if (!this.works || this.lost) return;
    const gl = this.gl;
    this.shown = quality;
    const ratio = Math.min(2, globalThis.devicePixelRatio || 1) * quality;
    const [width, height] = [Math.round(this.canvas.clientWidth * ratio), Math.round(this.canvas.clientHeight * ratio)];
    if (width === 0 || height === 0) return;
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    if (!this.fitted) this.fit(parts.filter((one) => !one.truth));
    const followed = parts.find((one) => one.key === this.followed);
    if (followed) this.camera.target = followed.frame.slice(12, 15);
    this.through = parts.find((one) => one.key === this.from && pyramidOf(one.part)) ?? null;
    const colours = this.colours();
    gl.viewport(0, 0, width, height);
    gl.clearColor(...colours.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const seen = this.seen();
    const own = parts.filter((one) => !one.truth);
    if (this.through) this.sights.paint([this.through], pictures, seen, true);
    else this.sights.paint(own, pictures, seen, false);

    const { program, at } = this.solid;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at.seen, false, seen);
    gl.uniform3fv(at.eye, this.eye());
    gl.uniform3fv(at.sky, colours.sky);
    gl.uniform3fv(at.ground, colours.ground);
    gl.uniform3fv(at.sun, SUN);
    gl.uniform3fv(at.paper, colours.paper);
    gl.uniform3fv(at.shadow, colours.shadow);
    gl.uniform1f(at.reach, GROUND_REACH);
    const coarse = quality < FINE_QUALITY;
    const solids = (look, prepared) => {
      for (const one of own) {
        const made = this.lookOf(one.part)[coarse && look === "surface" ? "coarse" : look];
        if (made === null || one.part.kind === "margin") continue;
        prepared(one);
        gl.uniformMatrix4fv(at.frame, false, one.frame);
        this.draw(made, gl.TRIANGLES);
      }
    };
    gl.uniform1f(at.fallen, 1);
    if (quality >= SHADED_QUALITY) solids("shade", () => {});
    gl.uniform1f(at.fallen, 0);
    gl.enable(gl.CULL_FACE);
    solids("surface", (one) => {
      gl.uniform3fv(at.colour, one.chosen ? colours.mark : one.part.colour.map((value) => value / 255));
      gl.uniform1f(at.glow, one.chosen ? 0.6 : colours.rim);
    });
    gl.disable(gl.CULL_FACE);
    for (const one of parts) {
      if (one.part.kind === "nearest") continue;
      for (const { way, turns } of vectorsOf(one)) {
        gl.uniform3fv(at.colour, one.chosen ? colours.mark : one.truth ? colours.truth : one.part.colour.map((value) => value / 255));
        gl.uniform1f(at.glow, 0.6);
        for (const [name, frame] of arrowFrames(way, ARROW, turns)) {
          gl.uniformMatrix4fv(at.frame, false, times(one.frame, frame));
          this.draw(this.arrows[name], gl.TRIANGLES);
        }
      }
    }
    gl.enable(gl.BLEND);
    this.lines(this.ground, seen, unit4(), [...colours.faint, 0.42], GROUND_REACH);
    for (const points of trails) {
      if (points.length < 2) continue;
      const last = points.length - 1;
      this.fill(this.way, new Float32Array(points.flatMap((spot, step) => [...spot, (step / last) ** 1.5])), 4);
      this.lines(this.way, seen, unit4(), [...colours.running, 0.9], 0, gl.LINE_STRIP);
    }
    for (const one of parts.filter((other) => other !== this.through)) {
      const { outline: edges, axes, surface: mesh } = this.lookOf(one.part);
      // What is only lines is drawn so in every layer.
      if (edges !== null && (one.truth || mesh === null || one.part.kind === "margin")) this.lines(edges, seen, one.frame, [...(one.chosen ? colours.mark : one.truth ? colours.truth : one.part.kind === "margin" ? one.part.colour.map((value) => value / 255) : colours.soft), one.chosen ? 1 : one.part.kind === "margin" ? 0.4 : 0.75], 0);
      if (axes !== null && !one.truth) this.axes(seen, one.frame, axes);
      if (one.part.kind !== "nearest") continue;
      for (const { way } of vectorsOf(one)) {
        this.fill(this.way, new Float32Array([0, 0, 0, 1, ...way, 1]), 4);
        this.lines(this.way, seen, one.frame, [...(one.chosen ? colours.mark : one.part.colour.map((value) => value / 255)), 1], 0);
      }
    }
    gl.disable(gl.BLEND);
    this.drawn += 1;
    this.stale = false;
  }

  draw(made, kind) {
    const gl = this.gl;
    gl.bindVertexArray(made.array);
    if (made.ordered) gl.drawElements(kind, made.count, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(kind, 0, made.count);
  }

  lines(made, seen, frame, colour, reach, kind = this.gl.LINES) {
    const gl = this.gl;
    const { program, at } = this.line;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at.seen, false, seen);
    gl.uniformMatrix4fv(at.frame, false, frame);
    gl.uniform4fv(at.colour, colour);
    gl.uniform1f(at.reach, reach);
    this.draw(made, kind);
  }

  axes(seen, frame, length) {
    // x, y and z in red, green and blue.
    const ends = [[[0.85, 0.27, 0.24], 0], [[0.2, 0.62, 0.35], 1], [[0.28, 0.42, 0.92], 2]];
    for (const [colour, axis] of ends) {
      const tip = [0, 0, 0];
      tip[axis] = length;
      this.fill(this.way, new Float32Array([0, 0, 0, 1, ...tip, 1]), 4);
      this.lines(this.way, seen, frame, [...colour, 1], 0);
    }
  }
}

/** The arrows of a part as they are now: along its numbers, m, in its frame, as long as there is anything of them. */
export function vectorsOf({ part, row }) {
  return part.solids.map((solid) => solid.vector).filter((one) => one !== undefined).map(({ first, scale, turns }) => {
    const numbers = row.slice(8 + first, 11 + first);
    const size = norm(numbers) * scale;
    const known = numbers.length === 3 && !numbers.includes(null) && size > 1e-3;
    return known ? { way: numbers.map((one) => (one * scale * Math.min(1, LONGEST_ARROW / size))), turns } : null;
  }).filter((one) => one !== null);
}

/** The parts of tracks at a moment, with the frame of each. Those in `held` are seen even if only the simulator knows them. */
export function partsAt(tracks, at_ns, withTruth, chosen, held) {
  const parts = [];
  for (const track of tracks) {
    const state = track.at(at_ns);
    if (state === null) continue;
    const simulated = state.view.layer === "truth";
    state.view.parts.forEach((part, index) => {
      const row = state.rows[index];
      const key = `${track.source}/${part.name}`;
      const truth = simulated && !held.has(key);
      if ((truth && !withTruth) || !row || row.slice(0, 8).includes(null)) return;
      parts.push({ key, part, row, truth, frame: placed(row.slice(1, 4), row.slice(4, 8)), chosen: key === chosen, track });
    });
  }
  return parts;
}
