// The page: what is shown of which net at which moment, and who is told of what a person does.

import { Minimap, Picture } from "./draw.js";
import { Net, seconds } from "./model.js";
import { Lanes, Table, make, showSide } from "./panels.js";

const $ = (id) => document.getElementById(id);
/** Side, lanes and table are drawn anew at most so often, ms. */
const PANEL_EVERY = 120;
/** The same for nets of many nodes. */
const PANEL_EVERY_LARGE = 400;
const LARGE = 300;
const PRESENT_EVERY = 500;
const RETRY = 1000;

class App {
  constructor() {
    this.nets = new Map();
    this.displays = [];
    this.tasks = new Map();
    this.shown = null;
    this.chosen = null;
    /** The moment shown: null is the present; else `{ at_ns, net, position }`. */
    this.cursor = null;
    this.playing = false;
    this.control = false;
    this.detail = "written";
    this.hops = false;
    this.mode = "live";
    this.asked = 0;
    this.offset = null;
    this.picture = new Picture($("stage"), {
      select: (key) => this.choose(key),
      open: (key) => this.openNode(key),
      looked: () => this.minimap?.update(),
    });
    this.minimap = new Minimap($("stage"), this.picture);
    this.lanes = new Lanes($("lanes"), this);
    this.table = new Table($("events"), this);
    this.controls();
    this.keys();
    new ResizeObserver(() => { if (this.shown !== null) { this.picture.look(this.picture.box); this.stale = true; } }).observe($("stage"));
    requestAnimationFrame(() => this.frame());
  }

  // -- what comes -----------------------------------------------------------------------

  take(message) {
    const net = this.nets.get(message.net);
    switch (message.kind) {
      case "hello": this.hello(message); break;
      case "net": this.addNet(message); break;
      case "events": if (net) this.events(net, message.events); break;
      case "state": if (net) { net.gone = null; this.jump(net, message); } break;
      case "gone": if (net) { net.gone = message.reason; this.changed(); this.tabs(); } break;
      case "breakpoints": if (net) { net.breakpoints = message.breakpoints; this.changed(); } break;
      case "notes": this.notes(message.notes); break;
      case "task": this.tasks.set(message.task.name, message.task); this.stale = true; break;
      case "answer": if (!message.ok) this.say(message.text); break;
      case "end": this.mode = "ended"; this.changed(); break;
      default: break;
    }
  }

  hello(message) {
    document.title = `${message.app} · nets`;
    $("app").textContent = message.app;
    this.mode = message.mode;
    this.control = message.control;
    this.displays = message.displays;
    this.nets.clear();
    this.tasks.clear();
    this.wanted = message.nets;
    this.picked = false;
  }

  addNet(message) {
    const net = new Net(message);
    net.gone = message.gone;
    net.breakpoints = message.breakpoints;
    for (const one of net.view.transitions) { /* one.shown names its node */ one.net = net.name; }
    for (const entry of message.entries) {
      if (entry.state) net.jump(entry.state, entry.skipped);
      else net.follow([entry]);
    }
    this.nets.set(net.name, net);
    // Events carry the time of the app; this page only knows when they came.
    this.arrived(message.now_ns);
    if (this.wanted.every((name) => this.nets.has(name)) && !this.picked) this.ready();
  }

  ready() {
    this.picked = true;
    const asked = new URLSearchParams(location.hash.slice(1));
    const name = this.shown !== null && this.known(this.shown) ? this.shown : asked.get("net");
    const busiest = [...this.nets.values()].sort((a, b) => b.view.commands.length - a.view.commands.length || b.view.transitions.length - a.view.transitions.length)[0];
    this.tabs();
    this.open(this.known(name) ? name : busiest?.name ?? null, asked.get("node"));
    if (asked.has("t")) this.goTo(Number(asked.get("t")) * 1e9);
    else if (this.mode === "record") this.goTo(this.span()[0]);
    this.fillNames();
  }

  known(name) {
    return this.nets.has(name) || this.displays.some((one) => one.name === name);
  }

  events(net, events) {
    const count = net.follow(events);
    if (net.gone !== null) { net.gone = null; this.tabs(); }
    this.arrived(net.head.at_ns);
    this.latest = performance.now();
    if (this.cursor === null && this.visibleNets().includes(net)) this.picture.travel(net, events.slice(-count));
    this.changed();
  }

  jump(net, { state, skipped, fresh }) {
    if (fresh) net.reset(state);
    else net.jump(state, skipped);
    this.arrived(state.at_ns);
    this.tabs();
    this.changed();
  }

  notes(notes) {
    for (const net of this.nets.values()) net.notes = notes.filter((one) => one.net === net.name);
    if (this.shown !== null) this.draw();
  }

  /** The clock of the app goes on between events. */
  arrived(at_ns) {
    const offset = at_ns - performance.now() * 1e6;
    if (this.offset === null || offset > this.offset) this.offset = offset;
  }

  /** Something is to be shown that is not yet. */
  changed() {
    this.dirty = true;
    this.stale = true;
  }

  // -- moments --------------------------------------------------------------------------

  span() {
    let [from, to] = [Infinity, -Infinity];
    for (const net of this.nets.values()) {
      const [first, last] = net.span;
      from = Math.min(from, first);
      to = Math.max(to, last);
    }
    if (this.mode === "live" && this.offset !== null) to = Math.max(to, performance.now() * 1e6 + this.offset);
    return Number.isFinite(from) ? [from, to] : [0, 1];
  }

  /** The moment shown, ns. */
  now() {
    return this.cursor === null ? this.span()[1] : this.cursor.at_ns;
  }

  positionOf(net) {
    if (this.cursor === null) return net.events.length;
    return this.cursor.net === net.name ? this.cursor.position : net.positionAt(this.cursor.at_ns);
  }

  stateOf(net) {
    if (this.cursor === null) return net.head;
    const position = this.positionOf(net);
    if (net.shownState?.position !== position || net.shownState.of !== net.events) net.shownState = { position, of: net.events, state: net.stateAt(position) };
    return position >= net.events.length ? net.head : net.shownState.state;
  }

  eventsOf(net) {
    return net.events.slice(Math.max(0, this.positionOf(net) - 200), this.positionOf(net));
  }

  goTo(at_ns) {
    const [from, to] = this.span();
    const at = Math.min(to, Math.max(from, at_ns));
    const net = this.visibleNets()[0];
    this.cursor = { at_ns: at, net: null, position: 0 };
    if (net === undefined) this.cursor = null;
    this.changed();
    this.remember();
  }

  goToEvent(net, position) {
    this.playing = false;
    this.cursor = { at_ns: position > 0 ? net.events[position - 1].at_ns : net.base.at_ns, net: net.name, position };
    this.changed();
    this.remember();
  }

  step(by) {
    const net = this.visibleNets()[0];
    if (net === undefined) return;
    const position = Math.min(net.events.length, Math.max(0, this.positionOf(net) + by));
    const before = this.positionOf(net);
    this.goToEvent(net, position);
    if (position > before) this.picture.travel(net, net.events.slice(before, position));
  }

  live() {
    this.cursor = null;
    this.playing = false;
    this.changed();
    this.remember();
  }

  togglePlay() {
    if (this.cursor === null) { this.goTo(this.now()); this.playing = false; return; }
    this.playing = !this.playing;
    if (this.playing && this.cursor.at_ns >= this.span()[1]) this.goTo(this.span()[0]);
    this.cursor.net = null;
    this.played = performance.now();
    this.changed();
  }

  play(now) {
    const before = this.visibleNets().map((net) => [net, this.positionOf(net)]);
    const at = this.cursor.at_ns + (now - this.played) * 1e6 * Number($("speed").value);
    this.played = now;
    const [, to] = this.span();
    if (at >= to) {
      if (this.mode === "live") return this.live();
      this.playing = false;
    }
    this.cursor = { at_ns: Math.min(at, to), net: null, position: 0 };
    for (const [net, position] of before) {
      const after = this.positionOf(net);
      if (after > position) this.picture.travel(net, net.events.slice(position, after));
    }
    this.changed();
  }

  remember() {
    const values = new URLSearchParams();
    if (this.shown !== null) values.set("net", this.shown);
    if (this.cursor !== null) values.set("t", (this.cursor.at_ns / 1e9).toFixed(6));
    if (this.chosen !== null) values.set("node", this.chosen);
    globalThis.history.replaceState(null, "", `#${values}`);
  }

  // -- what is shown --------------------------------------------------------------------

  visibleNets() {
    const display = this.displays.find((one) => one.name === this.shown);
    if (display) return display.parts.map((part) => this.nets.get(part.net)).filter((net) => net !== undefined);
    const net = this.nets.get(this.shown);
    return net ? [net] : [];
  }

  drawingOf(net) {
    const display = this.displays.find((one) => one.name === this.shown);
    return display?.parts.find((part) => part.net === net.name)?.drawing ?? net[this.detail];
  }

  open(name, key) {
    if (name === null || !this.known(name)) return;
    this.shown = name;
    this.chosen = null;
    this.draw();
    if (key !== null && this.picture.nodes.has(key)) this.choose(key);
    this.tabs();
    this.remember();
  }

  openNode(key) {
    const shown = this.picture.nodes.get(key);
    if (shown?.kind === "remote") this.open(shown.node.kind.remote[0], shown.node.kind.remote.join("/"));
    else if (shown?.kind === "transition") {
      const task = shown.net.view.transitions[shown.node.kind.transition[0][0]].task;
      if (this.nets.has(task)) this.open(task, null);
    }
  }

  draw() {
    const parts = this.visibleNets().map((net) => ({ net, drawing: this.drawingOf(net) }));
    this.picture.show(parts);
    this.picture.select(this.chosen);
    if (this.hops) this.picture.focus(this.chosen);
    this.minimap.show();
    this.changed();
  }

  choose(key) {
    this.chosen = key;
    this.picture.select(key);
    if (key !== null) this.picture.center(key);
    if (this.hops) this.picture.focus(key);
    const task = key === null ? null : this.taskOf(key);
    if (task) this.ask("task", { task });
    this.changed();
    this.remember();
  }

  taskOf(key) {
    const shown = this.picture.nodes.get(key);
    return shown?.kind === "transition" ? shown.net.view.transitions[shown.node.kind.transition[0][0]].task : null;
  }

  tabs() {
    const tab = (name, title, mark) => make("button", { role: "tab", "aria-selected": String(name === this.shown), title, onclick: () => this.open(name, null) }, name, mark);
    const mark = (net) => (net.gone !== null ? make("span", { class: "gone" }, " gone") : null);
    $("tabs").replaceChildren(
      ...this.displays.map((one) => tab(one.name, one.title, null)),
      ...[...this.nets.values()].map((net) => tab(net.name, net.view.title, mark(net))));
  }

  fillNames() {
    const names = [];
    for (const net of this.nets.values()) for (const node of net.written.nodes) names.push(`${net.name}/${node.name}`);
    $("names").replaceChildren(...names.slice(0, 3000).map((name) => make("option", { value: name })));
  }

  find(text) {
    const wanted = text.trim().toLowerCase();
    if (wanted === "") return;
    let best = null;
    for (const net of this.nets.values()) {
      for (const node of net.written.nodes) {
        const key = `${net.name}/${node.name}`;
        const task = "transition" in node.kind ? net.view.transitions[node.kind.transition[0][0]].task ?? "" : "";
        const rank = key.toLowerCase() === wanted || node.name.toLowerCase() === wanted ? 0 : node.name.toLowerCase().startsWith(wanted) ? 1 : key.toLowerCase().includes(wanted) ? 2 : task.toLowerCase().includes(wanted) ? 3 : 9;
        if (rank < 9 && (best === null || rank < best.rank)) best = { rank, net: net.name, key };
      }
    }
    if (best === null) this.say(`nothing is called ${text}`);
    else if (this.picture.nodes.has(best.key)) this.choose(best.key);
    else this.open(best.net, best.key);
  }

  say(text) {
    const banner = $("banner");
    banner.textContent = text;
    banner.hidden = false;
    clearTimeout(this.silence);
    this.silence = setTimeout(() => { banner.hidden = true; }, 5000);
  }

  status() {
    const gone = this.visibleNets().find((net) => net.gone !== null);
    const paused = this.visibleNets().find((net) => this.stateOf(net).paused !== null);
    const [text, look] = this.lost ? ["connection lost, trying again", "lost"]
      : this.mode === "record" ? ["recorded", "paused"]
      : this.cursor !== null ? ["looking back; recording goes on", "paused"]
      : this.mode === "ended" ? ["ended", ""]
      : gone ? [`${gone.name} is gone`, "lost"]
      : paused ? [`${paused.name} stands still`, "paused"] : ["live", "live"];
    const pill = $("status");
    if (pill.textContent !== text) { pill.textContent = text; pill.className = `pill ${look}`; }
  }

  frame() {
    const now = performance.now();
    if (this.playing) this.play(now);
    if (this.shown !== null) {
      if (this.dirty) {
        this.dirty = false;
        this.picture.update((net) => this.stateOf(net), this.now());
        this.minimap.update();
        this.drawnAt = performance.now();
      } else if (this.cursor === null && this.mode === "live") this.picture.fillBars(this.now());
      const busy = this.cursor === null && this.mode === "live" && this.picture.running?.length > 0;
      // The present goes on also while nothing happens.
      const idle = this.cursor === null && this.mode === "live" && now - (this.panelled ?? 0) > PRESENT_EVERY;
      if (idle || ((this.stale || busy) && now - (this.panelled ?? 0) > (this.picture.nodes.size > LARGE ? PANEL_EVERY_LARGE : PANEL_EVERY))) {
        this.panelled = now;
        this.stale = false;
        this.panels();
      }
    }
    this.status();
    requestAnimationFrame(() => this.frame());
  }

  panels() {
    // What a person is using stays.
    if (!$("side").contains(document.activeElement) || !$("side").matches(":active")) {
      const focused = document.activeElement?.textContent;
      const had = $("side").contains(document.activeElement);
      showSide($("side"), this);
      if (had) [...$("side").querySelectorAll("button")].find((one) => one.textContent === focused)?.focus();
    }
    this.lanes.draw();
    this.table.draw();
    const [from, to] = this.span();
    $("clock").textContent = seconds(this.now());
    if (document.activeElement !== $("scrub") || this.cursor === null || this.playing) $("scrub").value = String((1000 * (this.now() - from)) / Math.max(1, to - from));
    $("play").textContent = this.cursor === null || this.playing ? "❚❚" : "▶";
    $("live").disabled = this.mode === "record";
    $("live").setAttribute("aria-pressed", String(this.cursor === null && this.mode !== "record"));
  }

  // -- what a person does ---------------------------------------------------------------

  controls() {
    $("back").onclick = () => this.step(-1);
    $("next").onclick = () => this.step(1);
    $("play").onclick = () => this.togglePlay();
    $("live").onclick = () => this.live();
    $("fit").onclick = () => this.picture.fit();
    $("near").onclick = () => this.toggleNear();
    $("full").onclick = () => this.toggleDetail();
    $("help").onclick = () => $("keys").showModal();
    $("link").onclick = () => { this.remember(); navigator.clipboard?.writeText(location.href).then(() => this.say("the link is copied")); };
    $("scrub").oninput = () => {
      const [from, to] = this.span();
      this.playing = false;
      this.goTo(from + (Number($("scrub").value) / 1000) * (to - from));
    };
    $("search").onchange = () => this.find($("search").value);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.changed());
  }

  toggleNear() {
    this.hops = !this.hops;
    $("near").setAttribute("aria-pressed", String(this.hops));
    this.picture.focus(this.hops ? this.chosen : null);
    if (!this.hops) this.picture.fit();
  }

  toggleDetail() {
    this.detail = this.detail === "written" ? "full" : "written";
    $("full").setAttribute("aria-pressed", String(this.detail === "full"));
    this.draw();
  }

  keys() {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const names = () => [...this.displays.map((one) => one.name), ...this.nets.keys()];
    const beside = (by) => {
      const all = names();
      const next = all[(all.indexOf(this.shown) + by + all.length) % all.length];
      this.open(next, null);
    };
    const orders = {
      " ": () => this.togglePlay(), ",": () => this.step(-1), ".": () => this.step(1), l: () => this.live(),
      "[": () => beside(-1), "]": () => beside(1), n: () => this.toggleNear(), d: () => this.toggleDetail(),
      "+": () => this.picture.zoom(1.25), "=": () => this.picture.zoom(1.25), "-": () => this.picture.zoom(0.8), 0: () => this.picture.fit(),
      "/": () => $("search").focus(), "?": () => $("keys").showModal(), Escape: () => this.choose(null),
      Enter: () => this.chosen !== null && this.openNode(this.chosen), f: () => this.byKey("fire"), b: () => this.byKey("break"),
    };
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const typing = event.target.closest?.("input:not([type=range]):not([type=checkbox]), select, dialog");
      if (typing) { if (event.key === "Escape") event.target.blur(); return; }
      const arrow = arrows[event.key];
      if (arrow && event.target.type !== "range") {
        this.choose(this.picture.neighbour(this.chosen, arrow));
        event.preventDefault();
      } else if (event.key in orders && !((event.key === " " || event.key === "Enter") && event.target.closest?.("button, tr"))) {
        orders[event.key]();
        event.preventDefault();
      }
    });
  }

  byKey(what) {
    const shown = this.chosen === null ? null : this.picture.nodes.get(this.chosen);
    if (!shown || !this.control) return;
    if (shown.kind === "transition") {
      const transition = shown.net.view.transitions[shown.node.kind.transition[0][0]].name;
      const armed = shown.net.breakpoints.some((one) => one.transition === transition);
      this.order(what === "break" && armed ? "clear" : what, shown.net, { transition });
    } else if (shown.kind === "place" && what === "break") {
      const place = shown.node.name;
      const armed = shown.net.breakpoints.some((one) => one.place === place);
      this.order(armed ? "clear" : "break", shown.net, { place });
    }
  }

  order(what, net, more) {
    this.ask(what, { net: net.name, ...more });
  }

  ask(what, more) {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    this.asked += 1;
    this.socket.send(JSON.stringify({ kind: what, id: this.asked, ...more }));
  }

  connect() {
    const address = new URL("ws", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = location.search;
    address.hash = "";
    const socket = new WebSocket(address);
    this.socket = socket;
    socket.onopen = () => { this.lost = false; };
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = (event) => {
      if (this.mode !== "ended") this.lost = true;
      if (event.reason) this.say(event.reason);
      setTimeout(() => this.connect(), RETRY);
    };
  }
}

const app = new App();
// For tests and for the curious.
globalThis.nets = app;
const run = $("run").textContent.trim();
if (run === "") app.connect();
else for (const message of JSON.parse(run)) app.take(message);
