// What stands around the net: the chosen node, what goes on, lanes of actions, the table of events.

import { nodeStanding, passes, seconds } from "./model.js";

/** The table shows no more rows than this; filters find the others. */
const MOST_ROWS = 150;
const LANE = 17;

export function make(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

const tokens = (list) => list.map(([place, count]) => (count === 1 ? place : `${count} ${place}`)).join(" + ");

// -- the side ------------------------------------------------------------------------------

/** Fills the side: `app` has the chosen key, nets, states and what may be done. */
export function showSide(host, app) {
  const shown = app.chosen === null ? null : app.picture.nodes.get(app.chosen);
  const parts = [shown ? nodePart(shown, app) : null, ...app.visibleNets().map((net) => netPart(net, app))];
  host.replaceChildren(...parts.filter((part) => part !== null));
}

function nodePart(shown, app) {
  const { net, node, kind } = shown;
  if (kind === "remote") {
    const [other, place] = node.kind.remote;
    return make("section", {}, make("h2", {}, place, make("small", {}, `place of net ${other}`)),
      link(`Show net ${other}`, () => app.open(other, `${other}/${place}`)));
  }
  return kind === "place" ? placePart(net, node, app) : transitionPart(net, node, app);
}

function placePart(net, node, app) {
  const place = net.view.places[node.kind.place];
  const state = app.stateOf(net);
  const count = state.places[node.kind.place];
  const facts = [["tokens", String(count)], ["at the start", String(place.tokens)]];
  if (place.capacity !== null) facts.push(["at most", String(place.capacity)]);
  if (place.data !== null) facts.push(["says whether valid", place.data]);
  facts.push(inText(place.at));
  const takers = net.view.transitions.filter((one) => one.inputs.some((arc) => arc.place === node.kind.place));
  return make("section", {},
    make("h2", {}, place.name, make("small", {}, "place")),
    tokenHistory(net, place.name, app),
    factList(facts), notesOf(net, node),
    app.control ? make("div", { class: "actions" },
      make("button", { onclick: () => app.order("put", net, { place: place.name }) }, "Put a token"),
      make("button", { onclick: () => app.order("take", net, { place: place.name }), disabled: count === 0 }, "Take one"),
      breakButton(net, app, { place: place.name })) : null,
    takers.length > 0 ? make("p", { class: "soft" }, "taken by ", ...between(takers.map((one) => jump(net, one.shown, app)))) : null);
}

function transitionPart(net, node, app) {
  const parts = node.kind.transition[0];
  const transition = net.view.transitions[parts[0]];
  const state = app.stateOf(net);
  const standing = nodeStanding(net, state, node);
  const sum = (list) => parts.reduce((all, number) => all + list[number], 0);
  // A request counts when it has ended.
  const request = parts.length > 1;
  const ended = request ? state.ended[parts[1]] : sum(state.ended);
  const failed = request ? state.ended[parts[2]] ?? 0 : sum(state.failed);
  const facts = [];
  if (transition.target !== "") facts.push(["calls", transition.target]);
  if (transition.tape !== null) facts.push(["reads", transition.tape]);
  const writes = parts.map((number) => net.view.transitions[number].write).filter((one) => one !== null);
  if (writes.length > 0) facts.push(["writes", writes.join(", ")]);
  if (transition.when !== null) facts.push(["when", transition.when]);
  facts.push(["completed", String(ended)]);
  if (failed > 0) facts.push(["failed", String(failed)]);
  if (sum(state.busy_ns) > 0) facts.push(["on average", seconds(sum(state.busy_ns) / Math.max(1, sum(state.ended) + sum(state.failed)))]);
  if (transition.within_ms > 0) facts.push(["limit", seconds(transition.within_ms * 1e6)]);
  if (transition.priority > 0) facts.push(["priority", String(transition.priority)]);
  facts.push(inText(transition.at));
  return make("section", {},
    make("h2", {}, node.name, make("small", {}, request ? "request" : "transition")),
    make("p", { class: `words ${standing.state}` }, standing.words, elapsed(standing, app)),
    factList(facts), notesOf(net, node),
    app.control ? make("div", { class: "actions" },
      make("button", { onclick: () => app.order("fire", net, { transition: transition.name }), disabled: standing.state === "running" }, "Fire"),
      breakButton(net, app, { transition: transition.name })) : null,
    transition.task !== null ? taskPart(transition.task, app) : null);
}

function elapsed(standing, app) {
  if (standing.running.length === 0) return null;
  const since = Math.min(...standing.running.map((one) => one.since_ns));
  return make("span", { class: "soft" }, ` · ${seconds(Math.max(0, app.now() - since), 1)}`);
}

function breakButton(net, app, at) {
  // What a breakpoint is not about is null in it.
  const armed = net.breakpoints.some((one) => one.transition === (at.transition ?? null) && one.place === (at.place ?? null));
  return make("button", { "aria-pressed": String(armed), onclick: () => app.order(armed ? "clear" : "break", net, at) }, "Breakpoint");
}

function taskPart(name, app) {
  const task = app.tasks.get(name);
  if (task === undefined) {
    app.ask("task", { task: name });
    return make("p", { class: "soft" }, `task ${name}`);
  }
  const facts = [["task", name], ["on", task.on]];
  if (task.error) facts.push(["state", task.error]);
  else facts.push(["messages", `${task.handled} handled, ${task.failed} failed`], [task.busy ? "at hand" : "last", task.command ?? "none"]);
  return make("div", {}, factList(facts),
    app.nets.has(name) ? link(`Show net ${name}`, () => app.open(name, null)) : null);
}

/** A place in a file: its folder is told on request. */
const inText = (at) => ["in the text", at.split("/").at(-1), at];
const factList = (facts) => make("dl", {}, ...facts.flatMap(([key, value, whole]) => [make("dt", {}, key), make("dd", { title: whole }, value)]));
const link = (text, go) => make("button", { class: "link", onclick: go }, text);
const jump = (net, name, app) => link(name, () => app.choose(`${net.name}/${name}`));
const between = (list) => list.flatMap((one, at) => (at === 0 ? [one] : [", ", one]));

function notesOf(net, node) {
  const notes = net.notes.filter((one) => one.node === node.name);
  return notes.length === 0 ? null : make("div", {}, ...notes.map((one) => make("p", { class: "words failed" }, one.message, make("span", { class: "soft" }, ` · ${one.at}`))));
}

/** How many tokens a place had, over time. */
function tokenHistory(net, place, app) {
  const points = net.history(place);
  const [from, to] = app.span();
  const most = Math.max(1, ...points.map(([, count]) => count));
  const x = (at) => (100 * (at - from)) / Math.max(1, to - from);
  const y = (count) => 40 - (34 * count) / most;
  let path = `M${x(points[0][0])} 40`;
  points.forEach(([at, count], index) => {
    const until = index + 1 < points.length ? points[index + 1][0] : to;
    path += `L${x(at).toFixed(2)} ${y(count).toFixed(1)}H${x(until).toFixed(2)}`;
  });
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("class", "history");
  svg.setAttribute("viewBox", "0 0 100 42");
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `At most ${most} tokens`);
  const line = document.createElementNS(svg.namespaceURI, "path");
  line.setAttribute("d", `${path}V40z`);
  svg.append(line);
  return svg;
}

function netPart(net, app) {
  const state = app.stateOf(net);
  const drawing = app.drawingOf(net);
  const lists = { running: [], enabled: [] };
  for (const node of drawing.nodes) {
    if (!("transition" in node.kind)) continue;
    const standing = nodeStanding(net, state, node);
    if (standing.state !== "waiting") lists[standing.state].push([node, standing]);
  }
  const marked = drawing.nodes.filter((node) => "place" in node.kind && state.places[node.kind.place] > 0);
  const rows = (list) => list.map(([node, standing]) => make("li", {}, jump(net, node.name, app), make("span", {}, standing.state === "running" ? elapsedText(standing, app) : standing.words === "enabled" ? "" : standing.words)));
  const symbols = (list) => list.map((one) => make("span", { class: "symbol" }, one));
  const answers = app.eventsOf(net).filter((event) => event.wrote !== null).slice(-3).map((event) => event.wrote);
  return make("section", {},
    make("h2", {}, net.name, make("small", {}, "net")),
    net.view.title === "" ? null : make("p", { class: "soft" }, net.view.title),
    net.gone !== null ? make("p", { class: "words failed" }, net.gone) : null,
    state.stopped !== null ? make("p", { class: "words failed" }, `stopped: ${state.stopped}`) : null,
    state.paused !== null ? make("p", { class: "words" }, `paused: ${state.paused}`) : null,
    app.control ? make("div", { class: "actions" },
      state.paused === null ? make("button", { onclick: () => app.order("pause", net, {}) }, "Pause net")
        : make("button", { onclick: () => app.order("resume", net, {}) }, "Release net"),
      make("button", { onclick: () => app.order("step", net, {}), disabled: state.paused === null }, "Step")) : null,
    lists.running.length > 0 ? make("ul", { "aria-label": "running" }, ...rows(lists.running)) : null,
    lists.enabled.length > 0 ? make("ul", { "aria-label": "enabled" }, ...rows(lists.enabled)) : null,
    net.view.commands.length > 0 ? make("p", {}, make("span", { class: "soft" }, "tape "), ...(state.in_progress ? [...symbols([state.in_progress]), " in progress "] : []),
      ...symbols(state.tape), ...(answers.length > 0 ? [make("span", { class: "soft" }, " answered "), ...symbols(answers)] : [])) : null,
    make("p", { class: "soft" }, "marked: ", ...(marked.length === 0 ? ["nothing"] : between(marked.slice(0, 24).map((node) => jump(net, node.name, app))))),
    net.skipped > 0 ? make("p", { class: "soft" }, `${net.skipped} events came too fast to be shown`) : null);
}

const elapsedText = (standing, app) => seconds(Math.max(0, app.now() - Math.min(...standing.running.map((one) => one.since_ns))), 1);

// -- lanes ---------------------------------------------------------------------------------

/** Actions over time: a lane for each transition that did something. */
export class Lanes {
  constructor(host, app) {
    [this.host, this.app] = [host, app];
    this.canvas = host.querySelector("canvas");
    this.rows = [];
    this.canvas.addEventListener("pointerdown", (event) => this.go(event));
    this.canvas.addEventListener("pointermove", (event) => event.buttons > 0 && this.go(event));
  }

  go(event) {
    const rect = this.canvas.getBoundingClientRect();
    const part = (event.clientX - rect.left - this.left) / (rect.width - this.left - 8);
    const [from, to] = this.app.span();
    if (part >= 0) this.app.goTo(from + Math.min(1, part) * (to - from));
    else {
      const row = this.rows[Math.floor((event.clientY - rect.top - 4) / LANE)];
      if (row) this.app.choose(row.key);
    }
  }

  draw() {
    const { app, canvas } = this;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.rows = [];
    for (const net of app.visibleNets()) {
      const shownOf = new Map(net.view.transitions.map((one) => [one.name, one.shown]));
      const drawn = new Map();
      for (const [transition, bars] of net.lanes()) {
        const name = shownOf.get(transition) ?? transition;
        if (!drawn.has(name)) drawn.set(name, []);
        drawn.get(name).push(...requestBars(net, transition, bars));
      }
      for (const [name, bars] of drawn) this.rows.push({ key: `${net.name}/${name}`, name, bars });
    }
    const width = this.host.clientWidth;
    const height = Math.max(this.host.clientHeight, this.rows.length * LANE + 8);
    const ratio = devicePixelRatio;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = `${height}px`;
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px ui-sans-serif, system-ui, 'DejaVu Sans', sans-serif";
    this.left = Math.min(150, width / 3);
    const [from, to] = app.span();
    const x = (at) => this.left + ((width - this.left - 8) * (at - from)) / Math.max(1, to - from);
    const colours = { started: colour("running"), completed: colour("running"), fired: colour("faint"), failed: colour("failed"), cancelled: colour("faint") };
    this.rows.forEach(({ key, name, bars }, row) => {
      const y = row * LANE + 4;
      if (row % 2 === 1) {
        pen.fillStyle = colour("wash");
        pen.globalAlpha = 0.5;
        pen.fillRect(0, y, width, LANE);
        pen.globalAlpha = 1;
      }
      pen.fillStyle = key === app.chosen ? colour("mark") : colour("soft");
      pen.fillText(clipped(pen, name, this.left - 16), 12, y + 12);
      for (const bar of bars) {
        const [a, b] = [x(bar.from), x(bar.to ?? to)];
        pen.fillStyle = colours[bar.phase] ?? colour("faint");
        if (bar.to === bar.from) pen.fillRect(a, y + 4, 1.5, LANE - 8);
        else pen.fillRect(a, y + 3.5, Math.max(2, b - a), LANE - 7);
      }
    });
    pen.fillStyle = colour("mark");
    pen.fillRect(x(Math.min(app.now(), to)) - 0.5, 0, 1.5, height);
  }
}

/** A request lasts from its start to the firing of its end; both are fired in one step. */
function requestBars(net, transition, bars) {
  const one = net.view.transitions[net.index.transitions.get(transition)];
  if (one?.part !== "start") return one?.part === "end" || one?.part === "fail" || one?.part === "back" ? [] : bars;
  const ends = net.events.filter((event) => net.view.transitions[net.index.transitions.get(event.transition)]?.shown === one.shown && event.transition !== one.name);
  let next = 0;
  return bars.map((bar) => {
    while (next < ends.length && ends[next].at_ns < bar.from) next += 1;
    const end = ends[next];
    next += end ? 1 : 0;
    const failed = end && net.view.transitions[net.index.transitions.get(end.transition)].part !== "end";
    return { from: bar.from, to: end?.at_ns ?? null, phase: failed ? "failed" : end ? "completed" : "started" };
  });
}

function clipped(pen, text, width) {
  if (pen.measureText(text).width <= width) return text;
  let short = text;
  while (short.length > 1 && pen.measureText(`${short}…`).width > width) short = short.slice(0, -1);
  return `${short}…`;
}

// -- events --------------------------------------------------------------------------------

const BY_HAND = new Set(["put", "taken", "paused", "resumed", "cancelled"]);

/** The latest events up to the moment shown; a click goes to the moment of one. */
export class Table {
  constructor(host, app) {
    this.app = app;
    this.body = host.querySelector("tbody");
    this.count = host.querySelector("#count");
    this.scroller = host.querySelector(".table");
    this.inputs = ["with", "without", "all-nets"].map((id) => host.querySelector(`#${id}`));
    for (const input of this.inputs) input.addEventListener("input", () => this.draw());
  }

  draw() {
    const { app } = this;
    const [wanted, unwanted, all] = this.inputs;
    const nets = all.checked ? [...app.nets.values()] : app.visibleNets();
    const seen = [wanted.value, unwanted.value, app.cursor !== null, ...nets.flatMap((net) => [net.name, net.base.seq, app.positionOf(net)])].join("\u0000");
    if (seen === this.seen) return;
    this.seen = seen;
    const found = [];
    for (const net of nets) {
      const until = app.positionOf(net);
      for (let at = until - 1; at >= 0 && found.length < 4 * MOST_ROWS * nets.length; at -= 1) {
        const event = net.events[at];
        if (passes(event, wanted.value, unwanted.value)) found.push({ net, event, at: at + 1 });
      }
    }
    found.sort((a, b) => b.event.at_ns - a.event.at_ns || b.event.seq - a.event.seq);
    const rows = found.slice(0, MOST_ROWS);
    this.count.textContent = found.length > MOST_ROWS ? `latest ${MOST_ROWS}` : `${rows.length}`;
    this.body.replaceChildren(...rows.map((row, index) => this.row(row, index === 0)));
  }

  row({ net, event, at }, first) {
    const sent = event.sent.map((one) => `${one.place}@${one.net}`);
    const put = [tokens(event.produced), ...sent].filter((one) => one !== "").join(" + ");
    const moved = event.consumed.length + event.produced.length + sent.length === 0 ? "" : `${tokens(event.consumed) || "–"} → ${put || "–"}`;
    const tape = [event.read === null ? "" : `${event.phase === "asked" ? "+" : "‹"} ${event.read}`, event.wrote === null ? "" : `› ${event.wrote}`].filter((one) => one !== "").join(" ");
    const cells = [seconds(event.at_ns), event.net, event.transition, event.phase, moved, tape, event.text];
    const paused = this.app.cursor !== null;
    return make("tr", { class: `${event.phase}${paused && first ? " now" : ""}${BY_HAND.has(event.phase) ? " by-hand" : ""}`, "data-seq": event.seq, tabindex: "0",
      title: [event.target === "" ? "" : `calls ${event.target}`, event.trace === "" ? "" : `trace ${event.trace}`].filter((one) => one !== "").join(", "),
      onclick: () => this.app.goToEvent(net, at), onkeydown: (key) => key.key === "Enter" && this.app.goToEvent(net, at) },
    ...cells.map((cell) => make("td", {}, cell)));
  }
}
