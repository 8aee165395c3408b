// Draws a net as SVG, and keeps the drawing up with the marking. Nodes stand where they are told to.

import { nodeStanding } from "./model.js";

const SVG = "http://www.w3.org/2000/svg";
const RADIUS = 13;
const BAR = { width: 8, height: 32 };
/** A token travels for so long, ms. */
const TRAVEL = 420;
/** More events at once than this are shown as marking only, and no more tokens than that travel at a time. */
const MOST_AT_ONCE = 20;
const MOST_TRAVELLERS = 60;
/** Names are left out when they would be smaller than this, px. */
const SMALLEST_NAME = 5;

export function element(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

const towards = ([x, y], [to_x, to_y], distance) => {
  const length = Math.hypot(to_x - x, to_y - y) || 1;
  return [x + ((to_x - x) / length) * distance, y + ((to_y - y) / length) * distance];
};

/** Where a line from a node to a point begins: on the node's edge. */
function edge(node, point) {
  if (!("transition" in node.kind)) return towards([node.x, node.y], point, RADIUS + 1.5);
  const [width, height] = node.lying ? [BAR.height, BAR.width] : [BAR.width, BAR.height];
  const [dx, dy] = [point[0] - node.x, point[1] - node.y];
  const part = Math.min((width / 2 + 2) / (Math.abs(dx) || 1e-9), (height / 2 + 2) / (Math.abs(dy) || 1e-9));
  return [node.x + dx * part, node.y + dy * part];
}

/** A line through points, its corners rounded. */
function pathOf(points) {
  let path = "";
  points.forEach((point, at) => {
    const [x, y] = point;
    if (at === 0) path += `M${x} ${y}`;
    else if (at === points.length - 1) path += `L${x} ${y}`;
    else {
      const reach = (other) => Math.min(14, Math.hypot(other[0] - x, other[1] - y) / 2);
      const [bx, by] = towards(point, points[at - 1], reach(points[at - 1]));
      const [ax, ay] = towards(point, points[at + 1], reach(points[at + 1]));
      path += `L${bx.toFixed(1)} ${by.toFixed(1)}Q${x} ${y} ${ax.toFixed(1)} ${ay.toFixed(1)}`;
    }
  });
  return path;
}

/** Whether motion is unwelcome. */
const still = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

/** The picture of one net, or of nodes chosen from several. */
export class Picture {
  /**
   * @param host the element that it fills
   * @param sources for each net its model and drawing, in order
   * @param on `select(key)` and `open(net, place)` are called
   */
  constructor(host, on) {
    this.host = host;
    this.on = on;
    this.box = { x: 0, y: 0, width: 1, height: 1 };
    this.travelling = 0;
    this.svg = element("svg", { class: "net", tabindex: "0", role: "application", "aria-label": "The net. Arrow keys go from node to node." });
    this.svg.append(markers());
    this.layers = {};
    for (const name of ["arcs", "travel", "nodes", "names"]) {
      this.layers[name] = element("g", { class: name });
      this.svg.append(this.layers[name]);
    }
    host.append(this.svg);
    this.navigate();
  }

  /** Shows `parts`: `[{ net, drawing, dx, dy }]`. */
  show(parts) {
    this.parts = parts;
    this.nodes = new Map();
    this.ends = new Map();
    for (const layer of Object.values(this.layers)) layer.replaceChildren();
    for (const part of parts) this.drawPart(part);
    this.fit();
  }

  drawPart({ net, drawing, dx = 0, dy = 0 }) {
    const placed = drawing.nodes.map((node) => ({ ...node, x: node.x + dx, y: node.y + dy }));
    for (const arc of drawing.arcs) {
      const [from, to] = [placed[arc.from], placed[arc.to]];
      const via = arc.via.map(([x, y]) => [x + dx, y + dy]);
      const first = via[0] ?? [to.x, to.y];
      const last = via.at(-1) ?? [from.x, from.y];
      const points = [edge(from, first), ...via, edge(to, last)].map(([x, y]) => [Math.round(x * 10) / 10, Math.round(y * 10) / 10]);
      const path = element("path", { d: pathOf(points), class: `arc ${arc.way}`, "marker-end": `url(#${arc.way === "inhibit" ? "inhibit" : arc.way === "fail" ? "fail" : arc.way === "read" ? "read" : "arrow"})` });
      this.layers.arcs.append(path);
      const ends = `${net.name}\u0000${from.name}\u0000${to.name}`;
      if (!this.ends.has(ends)) this.ends.set(ends, path);
      if (arc.weight > 1) {
        const middle = points[Math.floor((points.length - 1) / 2)];
        const next = points[Math.floor((points.length - 1) / 2) + 1];
        this.layers.names.append(element("text", { class: "weight", x: (middle[0] + next[0]) / 2, y: (middle[1] + next[1]) / 2 - 4 }, String(arc.weight)));
      }
    }
    for (const node of placed) this.drawNode(net, node);
  }

  drawNode(net, node) {
    const key = `${net.name}/${node.name}`;
    const kind = Object.keys(node.kind)[0];
    const group = element("g", { class: `node ${kind}`, "data-key": key, transform: `translate(${node.x} ${node.y})` });
    const title = element("title", {}, node.name);
    group.append(title);
    const shown = { net, node, kind, key, group, title };
    if (kind === "transition") {
      const [width, height] = node.lying ? [BAR.height, BAR.width] : [BAR.width, BAR.height];
      const body = { x: -width / 2, y: -height / 2, width, height, rx: 2 };
      group.append(element("rect", { class: "halo", x: -width / 2 - 6, y: -height / 2 - 6, width: width + 12, height: height + 12, rx: 6 }));
      group.append(element("rect", { class: "bar", ...body }));
      shown.fill = element("rect", { class: "fill", ...body });
      shown.lying = node.lying;
      shown.stop = element("circle", { class: "breakpoint", cx: node.lying ? 0 : -12, cy: node.lying ? -12 : -22, r: 4.5 });
      group.append(shown.fill, shown.stop);
    } else {
      const place = kind === "place" ? net.view.places[node.kind.place] : null;
      group.append(element("circle", { class: "halo", r: RADIUS + 5 }));
      group.append(element("circle", { class: "ring", r: RADIUS }));
      if (place?.data) group.append(element("circle", { class: "data", r: RADIUS - 3.5 }));
      shown.tokens = element("g", { class: "tokens" });
      group.append(shown.tokens);
      shown.count = -1;
    }
    const note = net.notes.find((one) => one.node === node.name);
    if (note) {
      const mark = element("g", { class: `note ${note.severity}`, transform: "translate(12 -14)" });
      mark.append(element("path", { d: "M0 -7 7 6 -7 6z" }), element("text", { y: 4.5 }, "!"), element("title", {}, `${note.message}\n${note.at}`));
      group.append(mark);
    }
    const half = kind === "transition" ? (node.lying ? BAR.width : BAR.height) / 2 : RADIUS;
    const side = kind === "transition" ? (node.lying ? BAR.height : BAR.width) / 2 : RADIUS;
    const [x, y, anchor] = {
      above: [0, -half - 8, "middle"], below: [0, half + 15, "middle"],
      left: [-side - 8, 4, "end"], right: [side + 8, 4, "start"],
    }[node.label];
    shown.name = element("text", { class: `name of-${kind}`, x: node.x + x, y: node.y + y, "text-anchor": anchor }, kind === "remote" ? node.name.split("@")[0] : node.name);
    if (kind === "remote") shown.name.append(element("tspan", { class: "net-name" }, ` → ${node.kind.remote[0]}`));
    this.layers.nodes.append(group);
    this.layers.names.append(shown.name);
    this.nodes.set(key, shown);
  }

  /** Brings marking and transitions up to the states of the nets; `now_ns` is the moment shown. */
  update(stateOf, now_ns) {
    this.now_ns = now_ns;
    this.running = [];
    for (const shown of this.nodes.values()) {
      const state = stateOf(shown.net);
      if (shown.kind === "place") this.updatePlace(shown, state);
      else if (shown.kind === "transition") this.updateTransition(shown, state);
      shown.group.classList.toggle("gone", shown.net.gone !== null);
    }
    this.fillBars(now_ns);
  }

  updatePlace(shown, state) {
    const count = state.places[shown.node.kind.place];
    if (count === shown.count) return;
    shown.count = count;
    shown.tokens.replaceChildren(...dots(count));
    shown.group.classList.toggle("marked", count > 0);
    shown.group.dataset.tokens = count;
    shown.title.textContent = `${shown.node.name}: ${count} token${count === 1 ? "" : "s"}`;
  }

  updateTransition(shown, state) {
    const standing = nodeStanding(shown.net, state, shown.node);
    shown.standing = standing;
    if (shown.state !== standing.state) {
      shown.group.classList.remove("running", "enabled", "waiting");
      shown.group.classList.add(standing.state);
      shown.group.dataset.state = standing.state;
      shown.state = standing.state;
    }
    shown.title.textContent = `${shown.node.name}: ${standing.words}`;
    if (standing.state === "running") this.running.push(shown);
    else fillOf(shown, 0);
    const parts = shown.node.kind.transition[0].map((number) => shown.net.view.transitions[number].name);
    const armed = shown.net.breakpoints.some((one) => parts.includes(one.transition));
    shown.group.classList.toggle("armed", armed);
  }

  /** The bar of each running action fills while it lasts: against what it took so far, on average. */
  fillBars(now_ns) {
    for (const shown of this.running ?? []) {
      const since = Math.min(...shown.standing.running.map((one) => one.since_ns));
      fillOf(shown, share(shown, Math.max(0, now_ns - since)));
    }
  }

  /** Tokens go along the arcs of events that have just happened. */
  travel(net, events) {
    if (still() || document.hidden || events.length > MOST_AT_ONCE) return;
    const node = (name) => net.view.transitions.find((one) => one.name === name)?.shown;
    for (const event of events) {
      if (event.transition === "") {
        for (const [place] of event.produced) this.pulse(`${net.name}/${place}`);
        continue;
      }
      const names = [event.transition, node(event.transition)];
      for (const [place] of event.consumed) this.along(net, names.map((name) => [place, name]));
      for (const [place] of event.produced) this.along(net, names.map((name) => [name, place]));
      for (const name of names) this.pulse(`${net.name}/${name}`, event.phase);
    }
  }

  along(net, ends) {
    const path = ends.map(([from, to]) => this.ends.get(`${net.name}\u0000${from}\u0000${to}`)).find((one) => one);
    if (!path || this.travelling >= MOST_TRAVELLERS) return;
    this.travelling += 1;
    const length = path.getTotalLength();
    const token = element("circle", { class: "traveller", r: 4 });
    this.layers.travel.append(token);
    const begun = performance.now();
    const step = (now) => {
      const part = Math.min(1, (now - begun) / TRAVEL);
      const eased = part < 0.5 ? 2 * part * part : 1 - 2 * (1 - part) ** 2;
      const at = path.getPointAtLength(length * eased);
      token.setAttribute("transform", `translate(${at.x} ${at.y})`);
      if (part < 1) return requestAnimationFrame(step);
      this.travelling -= 1;
      return token.remove();
    };
    requestAnimationFrame(step);
  }

  pulse(key, phase = "received") {
    const shown = this.nodes.get(key);
    if (!shown || this.travelling >= MOST_TRAVELLERS) return;
    const name = phase === "failed" ? "pulse-failed" : "pulse";
    shown.group.classList.remove("pulse", "pulse-failed");
    requestAnimationFrame(() => shown.group.classList.add(name));
    clearTimeout(shown.calm);
    shown.calm = setTimeout(() => shown.group.classList.remove(name), 700);
  }

  /** Marks the chosen node, and what it is joined to. */
  select(key) {
    for (const shown of this.nodes.values()) shown.group.classList.toggle("chosen", shown.key === key);
  }

  /** Shows only what is at most `hops` arcs from `key`; all of it when `key` is null. */
  focus(key, hops = 3) {
    const near = key === null ? null : this.near(key, hops);
    for (const shown of this.nodes.values()) {
      const far = near !== null && !near.has(shown.key);
      shown.group.classList.toggle("far", far);
      shown.name.classList.toggle("far", far);
    }
    for (const [ends, path] of this.ends) {
      const [net, from, to] = ends.split("\u0000");
      path.classList.toggle("far", near !== null && !(near.has(`${net}/${from}`) && near.has(`${net}/${to}`)));
    }
    if (near !== null) this.fit([...near].map((one) => this.nodes.get(one).node));
  }

  near(key, hops) {
    const found = new Set([key]);
    for (let hop = 0; hop < hops; hop += 1) {
      const before = new Set(found);
      for (const ends of this.ends.keys()) {
        const [net, from, to] = ends.split("\u0000");
        if (before.has(`${net}/${from}`)) found.add(`${net}/${to}`);
        if (before.has(`${net}/${to}`)) found.add(`${net}/${from}`);
      }
    }
    return found;
  }

  // -- the part that is seen ---------------------------------------------------------------

  /** Left, top, width and height of nodes with their names. */
  bounds(nodes) {
    let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const node of nodes) {
      const letters = node.name.length * 6.6;
      const reach = { left: [letters + 30, 24], right: [24, letters + 30] }[node.label] ?? [letters / 2 + 8, letters / 2 + 8];
      left = Math.min(left, node.x - reach[0]);
      right = Math.max(right, node.x + reach[1]);
      top = Math.min(top, node.y - 40);
      bottom = Math.max(bottom, node.y + 40);
    }
    return Number.isFinite(left) ? { x: left, y: top, width: right - left, height: bottom - top } : { x: 0, y: 0, width: 100, height: 100 };
  }

  fit(nodes = [...this.nodes.values()].map((one) => one.node)) {
    this.whole = this.bounds([...this.nodes.values()].map((one) => one.node));
    const box = this.bounds(nodes);
    const grow = 1.06;
    this.look({ x: box.x - (box.width * (grow - 1)) / 2, y: box.y - (box.height * (grow - 1)) / 2, width: box.width * grow, height: box.height * grow });
  }

  look(box) {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (width === 0 || height === 0) return;
    // Never larger than twice, so that a small net does not shout.
    const scale = Math.min(width / box.width, height / box.height, 1.9);
    const [w, h] = [width / scale, height / scale];
    this.scale = scale;
    this.box = { x: box.x + (box.width - w) / 2, y: box.y + (box.height - h) / 2, width: w, height: h };
    this.svg.setAttribute("viewBox", `${this.box.x} ${this.box.y} ${this.box.width} ${this.box.height}`);
    this.svg.classList.toggle("nameless", 12 * scale < SMALLEST_NAME);
    this.on.looked?.();
  }

  zoom(factor, [x, y] = [this.box.x + this.box.width / 2, this.box.y + this.box.height / 2]) {
    const scale = Math.min(6, Math.max(0.02, this.scale * factor));
    const part = this.scale / scale;
    this.scale = scale;
    this.box = { x: x - (x - this.box.x) * part, y: y - (y - this.box.y) * part, width: this.box.width * part, height: this.box.height * part };
    this.svg.setAttribute("viewBox", `${this.box.x} ${this.box.y} ${this.box.width} ${this.box.height}`);
    this.svg.classList.toggle("nameless", 12 * scale < SMALLEST_NAME);
    this.on.looked?.();
  }

  pan(dx, dy) {
    this.box.x += dx / this.scale;
    this.box.y += dy / this.scale;
    this.svg.setAttribute("viewBox", `${this.box.x} ${this.box.y} ${this.box.width} ${this.box.height}`);
    this.on.looked?.();
  }

  center(key) {
    const shown = this.nodes.get(key);
    if (!shown) return;
    const { x, y } = shown.node;
    const inside = x > this.box.x + 40 && x < this.box.x + this.box.width - 40 && y > this.box.y + 40 && y < this.box.y + this.box.height - 40;
    if (!inside) this.pan((x - this.box.x - this.box.width / 2) * this.scale, (y - this.box.y - this.box.height / 2) * this.scale);
  }

  navigate() {
    let drag = null;
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      const rect = this.svg.getBoundingClientRect();
      const at = [this.box.x + (event.clientX - rect.left) / this.scale, this.box.y + (event.clientY - rect.top) / this.scale];
      if (event.ctrlKey || Math.abs(event.deltaY) >= Math.abs(event.deltaX)) this.zoom(Math.exp(-event.deltaY * 0.0016), at);
      else this.pan(event.deltaX, 0);
    }, { passive: false });
    this.svg.addEventListener("pointerdown", (event) => {
      drag = { x: event.clientX, y: event.clientY, moved: false };
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (drag === null || event.buttons === 0) return;
      const [dx, dy] = [event.clientX - drag.x, event.clientY - drag.y];
      if (!drag.moved && Math.hypot(dx, dy) < 4) return;
      if (!drag.moved) this.svg.setPointerCapture(event.pointerId);
      this.pan(-dx, -dy);
      drag = { x: event.clientX, y: event.clientY, moved: true };
    });
    this.svg.addEventListener("pointerup", (event) => {
      const moved = drag?.moved ?? false;
      drag = null;
      if (moved) return;
      const key = event.target.closest?.(".node")?.dataset.key ?? null;
      this.on.select(key);
    });
    this.svg.addEventListener("dblclick", (event) => {
      const key = event.target.closest?.(".node")?.dataset.key;
      if (key) this.on.open(key);
    });
  }

  /** The node that an arrow key leads to from `key`. */
  neighbour(key, [dx, dy]) {
    const from = this.nodes.get(key)?.node;
    if (!from) return this.nodes.keys().next().value ?? null;
    let best = null;
    for (const shown of this.nodes.values()) {
      const [x, y] = [shown.node.x - from.x, shown.node.y - from.y];
      const ahead = x * dx + y * dy;
      if (ahead <= 4) continue;
      const cost = ahead + 2.5 * Math.abs(x * dy - y * dx);
      if (best === null || cost < best.cost) best = { cost, key: shown.key };
    }
    return best?.key ?? key;
  }
}

/** The part of a running action that is over: against its limit, or else against its usual time. */
function share(shown, lasted_ns) {
  const transition = shown.net.view.transitions[shown.node.kind.transition[0][0]];
  const number = shown.node.kind.transition[0][0];
  const { ended, busy_ns } = shown.net.head;
  const usual = ended[number] > 0 ? busy_ns[number] / ended[number] : 0;
  const limit = usual > 0 ? usual : transition.within_ms > 0 ? transition.within_ms * 1e6 : 0;
  // Without either it fills ever more slowly, and never wholly.
  return limit > 0 ? Math.min(1, lasted_ns / limit) : 1 - 1 / (1 + lasted_ns / 2e9);
}

function fillOf(shown, part) {
  const { width, height } = shown.lying ? { width: BAR.height, height: BAR.width } : BAR;
  if (shown.lying) shown.fill.setAttribute("width", (width * part).toFixed(1));
  else {
    shown.fill.setAttribute("height", (height * part).toFixed(1));
    shown.fill.setAttribute("y", (height / 2 - height * part).toFixed(1));
  }
}

/** Up to five tokens are dots; more are a number. */
function dots(count) {
  if (count === 0) return [];
  if (count > 5) return [element("text", { class: "count", y: 4 }, count > 999 ? `${Math.floor(count / 1000)}k` : String(count))];
  const at = [[], [[0, 0]], [[-4.2, 0], [4.2, 0]], [[0, -4.4], [-4.4, 3.4], [4.4, 3.4]], [[-4.2, -4.2], [4.2, -4.2], [-4.2, 4.2], [4.2, 4.2]], [[0, 0], [-5.2, -5.2], [5.2, -5.2], [-5.2, 5.2], [5.2, 5.2]]][count];
  const radius = [0, 5, 3.6, 3.2, 3, 2.7][count];
  return at.map(([cx, cy]) => element("circle", { cx, cy, r: radius }));
}

function markers() {
  const marker = (id, size, ...shapes) => element("marker", { id, viewBox: "0 0 10 10", refX: id === "inhibit" ? 9 : 8.5, refY: 5, markerWidth: size, markerHeight: size, orient: "auto-start-reverse", markerUnits: "userSpaceOnUse" }, ...shapes);
  return element("defs", {},
    marker("arrow", 8, element("path", { class: "head", d: "M0 1.2 9 5 0 8.8z" })),
    marker("fail", 8, element("path", { class: "head fail", d: "M0 1.2 9 5 0 8.8z" })),
    marker("inhibit", 9, element("circle", { class: "head inhibit", cx: 5, cy: 5, r: 3.6 })),
    marker("read", 7, element("rect", { class: "head", x: 3, y: 3, width: 5, height: 5 })));
}

/** The whole net small, with the part that is seen. */
export class Minimap {
  constructor(host, picture) {
    this.picture = picture;
    this.svg = element("svg", { class: "minimap", "aria-hidden": "true" });
    host.append(this.svg);
    this.svg.addEventListener("pointerdown", (event) => this.go(event));
    this.svg.addEventListener("pointermove", (event) => event.buttons > 0 && this.go(event));
  }

  go(event) {
    const { whole, box } = this.picture;
    const rect = this.svg.getBoundingClientRect();
    const x = whole.x + ((event.clientX - rect.left) / rect.width) * whole.width;
    const y = whole.y + ((event.clientY - rect.top) / rect.height) * whole.height;
    this.picture.pan((x - box.x - box.width / 2) * this.picture.scale, (y - box.y - box.height / 2) * this.picture.scale);
  }

  show() {
    const { whole, nodes } = this.picture;
    this.svg.setAttribute("viewBox", `${whole.x} ${whole.y} ${whole.width} ${whole.height}`);
    this.svg.style.aspectRatio = `${whole.width} / ${whole.height}`;
    const size = Math.max(whole.width, whole.height) / 90;
    this.dots = [...nodes.values()].map((shown) => {
      const dot = element("circle", { cx: shown.node.x, cy: shown.node.y, r: size });
      return [shown, dot];
    });
    this.frame = element("rect", { class: "frame", rx: size });
    this.svg.replaceChildren(...this.dots.map(([, dot]) => dot), this.frame);
    this.update();
  }

  update() {
    const { whole, box } = this.picture;
    if (!this.frame || !whole) return;
    for (const [shown, dot] of this.dots) dot.setAttribute("class", shown.count > 0 ? "marked" : shown.state ?? "");
    const inside = box.width >= whole.width && box.height >= whole.height;
    this.svg.classList.toggle("needless", inside);
    for (const [key, value] of Object.entries(box)) this.frame.setAttribute(key, value);
  }
}
