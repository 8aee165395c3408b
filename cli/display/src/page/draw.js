// Draws a net, and keeps the drawing up with the marking: as SVG, or on canvases when it has many nodes. Nodes
// stand where they are told to.

import { BAR, Field, RADIUS } from "./field.js";
import { called, foldStanding, nodeStanding, seconds, valueOf } from "./model.js";
import { alongPoints, dots, element, markers, middleOf, pathOf, pointsOf } from "./shapes.js";
import { View } from "./view.js";

/** A token travels for so long, ms. */
const TRAVEL = 420;
/** More events at once, or in a second, than this are shown as marking only, and no more tokens than that travel at a
 * time. */
const MOST_AT_ONCE = 20;
const MOST_TRAVELLERS = 60;
/** Nets of more nodes are painted on canvases. */
const LARGE = 300;

/** So much of a value stands beside a place, characters. */
const VALUE = 24;

/** Whether motion is unwelcome. */
const still = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

const MARKERS = { inhibit: "inhibit", fail: "fail", read: "read" };

/** The picture of one net, or of nodes chosen from several. */
export class Picture extends View {
  /**
   * @param host the element that it fills
   * @param on `select(key)`, `open(key)`, `looked()` and `moved(key)` are called; `movable()` says whether nodes may be moved
   */
  constructor(host, on) {
    super();
    this.host = host;
    this.on = on;
    this.box = { x: 0, y: 0, width: 1, height: 1 };
    this.scale = 1;
    this.travellers = [];
    this.near = null;
    this.field = new Field(host);
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

  /** Shows `parts`: `[{ net, drawing }]`, and `links` between them: `[{ from, to, way, weight }]`. Places of other nets
   * at which a link ends are drawn there, once. */
  show(parts, links = [], keep = false) {
    this.parts = parts;
    this.nodes = new Map();
    this.arcs = [];
    this.ends = new Map();
    this.groups = [];
    this.near = null;
    this.travellers = [];
    this.large = parts.reduce((sum, part) => sum + part.drawing.nodes.length, 0) > LARGE;
    this.field.clear();
    this.field.shown = this.large;
    for (const layer of Object.values(this.layers)) layer.replaceChildren();
    const joined = new Set(links.map((link) => link.instead));
    for (const part of parts) this.drawPart(part, joined);
    for (const { from, to, way, weight } of links) {
      const ends = [this.nodes.get(from), this.nodes.get(to)];
      if (ends.every((one) => one)) this.drawArc(ends[0], ends[1], { way, weight, via: [] }, "between");
    }
    if (keep) this.look(this.box);
    else this.fit();
  }

  drawPart({ net, drawing }, joined) {
    const placed = drawing.nodes.map((node) => this.prepare(net, { ...node }));
    const kept = placed.map((shown) => !joined.has(shown.key));
    for (const arc of drawing.arcs) if (kept[arc.from] && kept[arc.to]) this.drawArc(placed[arc.from], placed[arc.to], arc);
    placed.forEach((shown, at) => kept[at] && this.drawNode(shown));
    this.groups.push(groupOf(net, placed.filter((_, at) => kept[at])));
  }

  drawArc(from, to, { way, weight, via }, more = "") {
    const arc = { from: from.key, to: to.key, ends: [from.node, to.node], via, way };
    arc.points = pointsOf(arc);
    this.arcs.push(arc);
    const ends = `${from.key}\u0000${to.key}`;
    if (!this.ends.has(ends)) this.ends.set(ends, arc);
    if (this.large) {
      this.field.arcs.push(arc);
      return;
    }
    arc.path = element("path", { d: pathOf(arc.points), class: `arc ${way} ${more}`, "marker-end": `url(#${MARKERS[way] ?? "arrow"})` });
    this.layers.arcs.append(arc.path);
    if (weight > 1) {
      arc.weight = element("text", { class: "weight", ...middleOf(arc.points) }, String(weight));
      this.layers.names.append(arc.weight);
    }
  }

  /** A node before it is drawn. */
  prepare(net, node) {
    const kind = Object.keys(node.kind)[0];
    const half = kind === "fold" ? 15 : kind === "transition" ? (node.lying ? BAR.width : BAR.height) / 2 : RADIUS;
    const side = kind === "transition" ? (node.lying ? BAR.height : BAR.width) / 2 : RADIUS;
    const [x, y, anchor] = {
      above: [0, -half - 8, "middle"], below: [0, half + 15, "middle"],
      left: [-side - 8, 4, "end"], right: [side + 8, 4, "start"],
    }[node.label];
    const text = kind === "remote" ? `${node.name.split("@")[0]} → ${node.kind.remote[0]}` : node.name;
    return { net, node, kind, key: `${net.name}/${node.name}`, count: -1, label: { x, y, anchor, text } };
  }

  drawNode(shown) {
    const { net, node, kind, key } = shown;
    this.nodes.set(key, shown);
    if (this.large) {
      this.field.nodes.push(shown);
      return;
    }
    const group = element("g", { class: `node ${kind}`, "data-key": key, transform: `translate(${node.x} ${node.y})` });
    shown.title = element("title", {}, node.name);
    shown.group = group;
    group.append(shown.title);
    if (kind === "transition") {
      const [width, height] = node.lying ? [BAR.height, BAR.width] : [BAR.width, BAR.height];
      const body = { x: -width / 2, y: -height / 2, width, height, rx: 2 };
      group.append(element("rect", { class: "halo", x: -width / 2 - 6, y: -height / 2 - 6, width: width + 12, height: height + 12, rx: 6 }));
      group.append(element("rect", { class: "bar", ...body }));
      shown.fill = element("rect", { class: "fill", ...body });
      shown.stop = element("circle", { class: "breakpoint", cx: node.lying ? 0 : -12, cy: node.lying ? -12 : -22, r: 4.5 });
      // What it took is in nobody's place until it ends: it is here.
      group.append(shown.fill, element("circle", { class: "held", r: 5 }), shown.stop);
    } else if (kind === "fold") {
      group.append(element("rect", { class: "halo", x: -28, y: -21, width: 56, height: 42, rx: 10 }));
      group.append(element("rect", { class: "bar", x: -22, y: -15, width: 44, height: 30, rx: 6 }));
      shown.tokens = element("text", { class: "inside", y: 4.5 });
      shown.stop = element("circle", { class: "breakpoint", cx: -22, cy: -15, r: 4.5 });
      group.append(shown.tokens, shown.stop);
    } else {
      const place = kind === "place" ? net.view.places[node.kind.place] : null;
      group.append(element("circle", { class: "halo", r: RADIUS + 5 }));
      group.append(element("circle", { class: "ring", r: RADIUS }));
      if (place?.data) group.append(element("circle", { class: "data", r: RADIUS - 3.5 }));
      shown.tokens = element("g", { class: "tokens" });
      shown.stop = element("circle", { class: "breakpoint", cx: -14, cy: -12, r: 4.5 });
      group.append(shown.tokens, shown.stop);
    }
    const note = net.notes.find((one) => one.node === node.name);
    if (note) {
      const mark = element("g", { class: `note ${note.severity}`, transform: "translate(12 -14)" });
      mark.append(element("path", { d: "M0 -7 7 6 -7 6z" }), element("text", { y: 4.5 }, "!"), element("title", {}, `${note.message}\n${note.at}`));
      group.append(mark);
    }
    const { x, y, anchor, text } = shown.label;
    shown.name = element("text", { class: `name of-${kind}`, x: node.x + x, y: node.y + y, "text-anchor": anchor }, text);
    if (kind === "transition") {
      shown.tally = element("tspan", { class: "tally", x: node.x + x, dy: node.label === "above" ? -13 : 12 });
      shown.name.append(shown.tally);
    }
    if (kind === "place") {
      // The values that are stored with the place.
      shown.values = net.view.data.flatMap((data, number) => (data.place === node.kind.place ? [{ number, data, line: element("tspan", { class: "value", x: node.x + x, dy: node.label === "above" ? -13 : 12 }) }] : []));
      shown.name.append(...shown.values.map(({ line }) => line));
    }
    this.layers.nodes.append(group);
    this.layers.names.append(shown.name);
  }

  /** Brings marking and transitions up to the states of the nets; `now_ns` is the moment shown. Only what has changed is
   * touched. */
  update(stateOf, now_ns) {
    this.now_ns = now_ns;
    const changed = new Set();
    for (const group of this.groups) this.updateNet(group, stateOf(group.net), changed);
    this.running = this.groups.flatMap((group) => group.transitions.filter((shown) => shown.kind === "transition" && shown.state === "running"));
    if (this.large && this.field.pens) this.field.paint(this.field.seen.filter((shown) => changed.has(shown)));
    this.fillBars(now_ns);
  }

  updateNet(group, state, changed) {
    const { net } = group;
    const touched = new Set();
    const touch = (shown) => touched.add(shown);
    state.places.forEach((count, place) => {
      if (group.counts[place] === count) return;
      group.counts[place] = count;
      group.touches[place]?.forEach(touch);
      const shown = group.places.get(place);
      if (shown) this.updatePlace(shown, count, changed.add(shown));
    });
    for (const { number, data, line } of group.values) {
      if (group.data[number] === state.data[number]) continue;
      group.data[number] = state.data[number];
      line.textContent = valueText(data, state.data[number]);
    }
    state.ended.forEach((count, number) => {
      if (group.ended[number] === count) return;
      group.ended[number] = count;
      group.parts[number]?.forEach(touch);
    });
    // What counts for every transition.
    const brief = JSON.stringify([state.running.map((one) => one.firing), state.tape[0], state.in_progress, state.paused, state.stopped]);
    const about = JSON.stringify([net.gone, net.breakpoints]);
    if (brief !== group.brief || about !== group.about) group.transitions.forEach(touch);
    for (const shown of touched) this.updateTransition(shown, state, changed.add(shown));
    if (about !== group.about) {
      for (const shown of group.places.values()) this.mark(shown, net.breakpoints.some((one) => one.place === shown.node.name), changed.add(shown));
      for (const shown of group.all) shown.group?.classList.toggle("gone", net.gone !== null);
    }
    [group.brief, group.about] = [brief, about];
  }

  updatePlace(shown, count) {
    shown.count = count;
    if (this.large) return;
    shown.tokens.replaceChildren(...dots(count));
    shown.group.classList.toggle("marked", count > 0);
    shown.group.dataset.tokens = count;
    shown.title.textContent = `${shown.node.name}: ${count} token${count === 1 ? "" : "s"}`;
  }

  updateTransition(shown, state) {
    const folded = shown.kind === "fold";
    const standing = folded ? foldStanding(shown.net, state, shown.node.kind.fold) : nodeStanding(shown.net, state, shown.node);
    const before = shown.state;
    shown.standing = standing;
    shown.state = standing.state;
    if (folded) shown.count = standing.tokens;
    const { places, transitions } = shown.net.view;
    const parts = numbersOf(shown.node).map((number) => called(transitions[number]));
    // What is folded into one node is marked there.
    const within = folded ? shown.node.kind.fold[0].map((number) => places[number]?.name) : [];
    this.mark(shown, shown.net.breakpoints.some((one) => parts.includes(one.transition) || within.includes(one.place)));
    if (standing.state !== "running") fillOf(shown, 0);
    if (this.large) return;
    if (before !== standing.state) {
      shown.group.classList.remove("running", "enabled", "waiting");
      shown.group.classList.add(standing.state);
      shown.group.dataset.state = standing.state;
    }
    shown.title.textContent = `${shown.node.name}: ${standing.words}`;
    if (folded) shown.tokens.textContent = standing.tokens === 0 ? "…" : `● ${standing.tokens}`;
    else shown.tally.textContent = tallyOf(shown, state);
  }

  /** Whether a breakpoint is set there. */
  mark(shown, armed) {
    shown.armed = armed;
    shown.group?.classList.toggle("armed", armed);
  }

  /** The bar of each running action fills while it lasts: against what it took so far, on average. */
  fillBars(now_ns) {
    for (const shown of this.running ?? []) {
      const since = Math.min(...shown.standing.running.map((one) => one.since_ns));
      fillOf(shown, share(shown, Math.max(0, now_ns - since)));
    }
    if (this.large && this.running?.length > 0) this.field.paint(this.field.seen.filter((shown) => this.running.includes(shown)));
  }

  /** Tokens go along the arcs of events that have just happened. */
  travel(net, events) {
    const now = performance.now();
    this.budget = Math.min(MOST_AT_ONCE, (this.budget ?? MOST_AT_ONCE) + ((now - (this.travelled ?? 0)) * MOST_AT_ONCE) / 1000) - events.length;
    this.travelled = now;
    if (this.budget < 0 || still() || document.hidden) {
      this.budget = Math.max(this.budget, -MOST_AT_ONCE);
      return;
    }
    const node = (name) => net.view.transitions[net.index.transitions.get(name)]?.shown;
    for (const event of events) {
      if (event.transition === "") {
        for (const [place] of event.produced) this.pulse(`${net.name}/${place}`);
        continue;
      }
      const names = [event.transition, node(event.transition)].map((name) => `${net.name}/${name}`);
      for (const [place] of event.consumed) this.along(names.map((name) => [`${net.name}/${place}`, name]));
      for (const [place] of event.produced) this.along(names.map((name) => [name, `${net.name}/${place}`]));
      for (const sent of event.sent) this.along(names.map((name) => [name, `${sent.net}/${sent.place}`]));
      for (const name of new Set(names)) this.pulse(name, event.phase);
    }
  }

  along(ends) {
    const arc = ends.map(([from, to]) => this.ends.get(`${from}\u0000${to}`)).find((one) => one);
    if (!arc || this.travellers.length >= MOST_TRAVELLERS) return;
    const token = element("circle", { class: "traveller", r: 4 });
    this.layers.travel.append(token);
    this.travellers.push({ token, points: arc.points, begun: performance.now() });
  }

  /** Moves the tokens that travel; they are gone when they have arrived. */
  tick(now) {
    if (this.travellers.length === 0) return;
    this.travellers = this.travellers.filter(({ token, points, begun }) => {
      const part = (now - begun) / TRAVEL;
      if (part >= 1) {
        token.remove();
        return false;
      }
      const eased = part < 0.5 ? 2 * part * part : 1 - 2 * (1 - part) ** 2;
      const [x, y] = alongPoints(points, Math.max(0, eased));
      token.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
      return true;
    });
  }

  pulse(key, phase = "received") {
    const shown = this.nodes.get(key);
    if (!shown?.group || this.travellers.length >= MOST_TRAVELLERS) return;
    const name = phase === "failed" ? "pulse-failed" : "pulse";
    shown.group.classList.remove("pulse", "pulse-failed");
    requestAnimationFrame(() => shown.group.classList.add(name));
    clearTimeout(shown.calm);
    shown.calm = setTimeout(() => shown.group.classList.remove(name), 700);
  }

  /** Marks the chosen node. */
  select(key) {
    const changed = [];
    for (const shown of this.nodes.values()) {
      const chosen = shown.key === key;
      if (Boolean(shown.chosen) === chosen) continue;
      shown.chosen = chosen;
      shown.group?.classList.toggle("chosen", chosen);
      changed.push(shown);
    }
    if (this.large && this.field.pens) this.field.paint(changed);
  }

  /** Shows only what is at most `hops` arcs from `key`; all of it when `key` is null. */
  focus(key, hops = 3) {
    const near = key === null ? null : this.around(key, hops);
    this.near = near;
    const far = (one) => near !== null && !near.has(one);
    for (const shown of this.nodes.values()) {
      shown.group?.classList.toggle("far", far(shown.key));
      shown.name?.classList.toggle("far", far(shown.key));
    }
    for (const arc of this.arcs) {
      arc.path?.classList.toggle("far", far(arc.from) || far(arc.to));
      arc.weight?.classList.toggle("far", far(arc.from) || far(arc.to));
    }
    if (near !== null) this.fit([...near].map((one) => this.nodes.get(one).node));
    else this.look(this.box);
  }

  around(key, hops) {
    const found = new Set([key]);
    for (let hop = 0; hop < hops; hop += 1) {
      const before = new Set(found);
      for (const { from, to } of this.arcs) {
        if (before.has(from)) found.add(to);
        if (before.has(to)) found.add(from);
      }
    }
    return found;
  }

  /** A person moves a node by so much; its arcs go straight. */
  move(key, dx, dy) {
    const shown = this.nodes.get(key);
    if (!shown) return;
    const { node, label } = shown;
    [node.x, node.y] = [node.x + dx, node.y + dy];
    for (const arc of this.arcs.filter((one) => one.from === key || one.to === key)) {
      arc.via = [];
      arc.points = pointsOf(arc);
      arc.path?.setAttribute("d", pathOf(arc.points));
      if (arc.weight) for (const [name, value] of Object.entries(middleOf(arc.points))) arc.weight.setAttribute(name, value);
    }
    shown.group?.setAttribute("transform", `translate(${node.x} ${node.y})`);
    shown.name?.setAttribute("x", node.x + label.x);
    shown.name?.setAttribute("y", node.y + label.y);
    for (const line of [shown.tally, ...(shown.values ?? []).map((one) => one.line)]) line?.setAttribute("x", node.x + label.x);
    if (this.large) this.field.look(this, this.near);
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
  shown.part = part;
  if (!shown.fill) return;
  const { lying } = shown.node;
  const { width, height } = lying ? { width: BAR.height, height: BAR.width } : BAR;
  if (lying) shown.fill.setAttribute("width", (width * part).toFixed(1));
  else {
    shown.fill.setAttribute("height", (height * part).toFixed(1));
    shown.fill.setAttribute("y", (height / 2 - height * part).toFixed(1));
  }
}

/** What a display must look at again when a place of a net, or a number of firings, has changed. */
function groupOf(net, all) {
  const group = { net, all, places: new Map(), transitions: [], touches: [], parts: [], counts: [], ended: [], values: [], data: [], brief: null, about: null };
  const add = (lists, number, shown) => (lists[number] ??= new Set()).add(shown);
  for (const shown of all) {
    if (shown.kind === "place") group.places.set(shown.node.kind.place, shown);
    group.values.push(...(shown.values ?? []));
    if (shown.kind !== "transition" && shown.kind !== "fold") continue;
    group.transitions.push(shown);
    const watched = shown.kind === "fold" ? shown.node.kind.fold[0] : [shown.node.kind.transition[1]];
    for (const place of watched) if (place !== null) add(group.touches, place, shown);
    for (const number of numbersOf(shown.node)) {
      add(group.parts, number, shown);
      const { inputs, reads, inhibitors } = net.view.transitions[number];
      for (const { place } of [...inputs, ...reads, ...inhibitors]) add(group.touches, place, shown);
    }
  }
  return group;
}

/** The transitions that a node stands for, by number. */
function numbersOf({ kind }) {
  return kind.fold ? kind.fold[1].flatMap(([parts]) => parts) : kind.transition[0];
}

/** A value beside a place: a field by its own name. */
function valueText(data, value) {
  const text = `${data.name.split(".").at(-1)} = ${valueOf(data, value)}`;
  return text.length > VALUE ? `${text.slice(0, VALUE - 1)}…` : text;
}

/** How often a transition has fired, and how long its action takes. */
function tallyOf(shown, state) {
  const [parts] = shown.node.kind.transition;
  const counted = parts.length > 1 ? parts[1] : parts[0];
  const ended = state.ended[counted];
  if (ended === 0) return "";
  const busy = state.busy_ns[counted];
  return busy > 0 ? `${ended}× ${seconds(busy / (ended + state.failed[counted]), 2)}` : `${ended}×`;
}
