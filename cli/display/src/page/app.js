// The page: what is shown of which net at which moment, and who is told of what a person does.

import { Attention } from "./attention.js";
import { Picture } from "./draw.js";
import { Fork, fold, linksBetween, sideBySide, subnetsOf } from "./fold.js";
import { listen } from "./keys.js";
import { Loads } from "./loads.js";
import { Minimap } from "./minimap.js";
import { called, Net, seconds } from "./model.js";
import { Overview, jobWords } from "./overview.js";
import { make, showSide } from "./panels.js";
import { Panes } from "./panes.js";
import { Plots } from "./plots.js";
import { SummaryPane } from "./summary.js";
import { Lanes, Table } from "./tables.js";
import { busyNet, whyOf } from "./why.js";

const $ = (id) => document.getElementById(id);
/** Side, lanes and table are drawn anew at most so often, ms. */
const PANEL_EVERY = 120;
/** The same for nets of many nodes, or of many events. */
const PANEL_EVERY_LARGE = 400;
const MANY_NODES = 300;
const MANY_EVENTS = 4000;
const PRESENT_EVERY = 500;
const RETRY = 1000;
/** A task that is looked at is asked how it is so often, ms. */
const ASK_EVERY = 1000;

class App extends Attention {
  constructor() {
    super();
    this.nets = new Map();
    this.displays = [];
    /** What is known of tasks, and the names of those of which more can be told. */
    this.tasks = new Map();
    this.appTasks = [];
    this.loads = new Loads();
    /** How the app stands as a whole. */
    this.standing = { chassis: [], warnings: [] };
    this.shown = null;
    this.chosen = null;
    /** The moment shown: null is the present; else `{ at_ns, net, position }`. */
    this.cursor = null;
    this.playing = false;
    this.control = false;
    this.detail = "written";
    this.hops = false;
    /** Whether what is under way is kept in view. */
    this.active = false;
    /** The subnets that are drawn as one node, by net. */
    this.folded = new Map();
    /** What a person plays through: copies of nets, by name. */
    this.forks = new Map();
    /** The task that is looked at. */
    this.task = null;
    /** When each task was last asked why it waits, ms. */
    this.askedWhy = new Map();
    /** What a person fills in for the next breakpoint of a place. */
    this.predicate = { sign: ">=", tokens: "1" };
    /** What is typed for the tape of each net, and what became of what was put there: `{ net, line, told }`. */
    this.typed = new Map();
    this.commands = new Map();
    /** Who waits for the answer to a command that a handle has put, by its number. */
    this.calls = new Map();
    /** What the address asks for, until it is there or a person does something: nets come one by one. */
    this.wish = new URLSearchParams(location.hash.slice(1));
    this.touched = false;
    for (const kind of ["pointerdown", "keydown"]) addEventListener(kind, () => { this.touched = true; this.wish = null; }, { capture: true });
    this.mode = "live";
    this.asked = 0;
    this.offset = null;
    this.picture = new Picture($("stage"), {
      select: (key) => this.choose(key),
      open: (key) => this.openNode(key),
      looked: () => this.minimap?.update(),
      took: () => this.followActive(false),
      movable: (key) => this.control && this.forks.size === 0 && !this.paned() && !("fold" in this.picture.nodes.get(key).node.kind),
      moved: (key) => this.keep(key),
    });
    this.picture.nodes ??= new Map();
    this.minimap = new Minimap($("stage"), this.picture);
    this.overview = new Overview($("cell"), this);
    this.summary = new SummaryPane($("summary"), this);
    /** The net that is opened as soon as it is known. */
    this.awaited = null;
    /** Whether scene or pictures are shown. */
    this.whole = false;
    this.lanes = new Lanes($("lanes"), this);
    this.plots = new Plots($("plots"), this);
    this.table = new Table($("events"), this);
    this.panes = new Panes(this);
    this.controls();
    listen(this);
    new ResizeObserver(() => this.resized()).observe($("stage"));
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
      case "drawing": if (net) { [net.written, net.full] = [message.written, message.full]; this.draw(true); } break;
      case "layouts": this.panes.layouts = message.layouts; this.tabs(); break;
      case "displays": this.displays = [...message.displays, ...this.displays.filter((one) => one.paned)]; if (this.shown !== null) this.draw(true); break;
      case "notes": this.notes(message.notes); break;
      case "scene": this.overview.scene(message); this.seen(message.steps.at(-1)); break;
      case "moved": this.overview.moved(message); this.seen(message.step); break;
      case "dark": this.overview.dark(message); this.stale = true; break;
      case "picture": this.overview.picture(message.picture); this.seen(null); break;
      case "summary": this.summary.take(message); break;
      case "unsummed": this.summary.lost(message); break;
      case "left": this.leave(message.net); break;
      case "load": this.loads.take(message); this.stale = true; break;
      case "standing": this.standing = message.standing; this.stale = true; break;
      case "task": this.tasks.set(message.task.name, message.task); this.stale = true; break;
      case "answer": this.answered(message); break;
      case "end": this.mode = "ended"; this.changed(); break;
      default: break;
    }
  }

  hello(message) {
    document.title = `${message.app} · CTOS`;
    this.overview.reset();
    this.hasScene = message.scenes > 0;
    $("app").textContent = message.app;
    this.mode = message.mode;
    this.control = message.control;
    this.displays = message.displays;
    this.panes.layouts = message.layouts;
    this.overview.handles.show(message.handles);
    this.overview.plans.show(message.plans ?? []);
    this.summary.reset(message.summaries ?? []);
    this.nets.clear();
    this.forks.clear();
    $("fork").setAttribute("aria-pressed", "false");
    this.tasks.clear();
    // Events that come anew may have other positions, but the same moments.
    if (this.cursor !== null) this.cursor.net = null;
    /** When the app began, ns since 1970; of a record it is not known. */
    this.origin = message.origin_ns ?? null;
    // It may be another run of the app, whose clock began anew.
    this.offset = null;
    this.wanted = message.nets;
    this.appTasks = message.tasks;
    this.picked = false;
    if (this.summary.known) {
      if (this.shown === null) this.panes.open("summary");
      this.awaited = this.wish?.get("net") ?? (this.panes.built === "net" ? this.shown : null);
      if (this.awaited !== null && !this.wanted.includes(this.awaited)) this.ask("follow", { net: this.awaited });
      this.tabs();
    } else if (this.wanted.length === 0 && this.hasScene) this.openWhole();
    // Nets come later: the scene does not wait for them.
    else if (this.hasScene && this.shown === null && !this.wish?.has("net") && !this.wish?.has("layout")) this.panes.open("overview");
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
    // A net may come later than the page, or come back as another one.
    const late = this.nets.has(net.name) || !this.wanted.includes(net.name);
    this.nets.set(net.name, net);
    this.forks.delete(net.name);
    if (this.cursor?.net === net.name) this.cursor.net = null;
    // Events carry the time of the app; this page only knows when they came.
    this.arrived(message.now_ns);
    if (this.awaited === net.name) {
      this.awaited = null;
      this.tabs();
      this.open(net.name, this.wish?.get("node") ?? null);
    } else if (this.summary.known) this.tabs();
    else if (this.wanted.every((name) => this.nets.has(name)) && (late || !this.picked)) this.ready();
  }

  ready() {
    this.picked = true;
    const wish = this.wish;
    const wished = this.known(wish?.get("net"));
    this.tabs();
    $("names").replaceChildren();
    if (!wished && this.touched && this.known(this.shown)) return this.stay();
    this.open(wished ? wish.get("net") : this.mainNet()?.name ?? null, wish?.get("node") ?? null);
    if (this.panes.openLayout(wish?.get("layout"))) { /* it is shown */ } else if (!wish?.has("net") && this.hasScene) this.openWhole();
    if (wished) [this.wish, this.touched] = [null, true];
    for (const key of wish?.getAll("plot") ?? []) if (!this.plots.has(key)) this.plots.toggle(key);
    if (wish?.has("t")) this.goTo(Number(wish.get("t")) * 1e9);
    else if (this.mode === "record") this.goTo(this.span()[0]);
  }

  /** The nets have come anew: what a person looks at stays, as far as it is still there. */
  stay() {
    this.draw(true);
    if (this.chosen !== null && !this.picture.nodes.has(this.chosen)) this.choose(null);
  }

  known(name) {
    return this.nets.has(name) || this.displays.some((one) => one.name === name) || this.pane(name);
  }

  /** Whether `name` is that of several nets side by side, `dispatcher+motion`: it is then a display, which nobody has written. */
  pane(name) {
    const nets = (name ?? "").split("+").map((one) => this.nets.get(one));
    if (nets.length < 2 || nets.includes(undefined)) return false;
    const drawings = sideBySide(nets.map((net) => net.written));
    const parts = nets.map((net, at) => ({ net: net.name, drawing: drawings[at] }));
    this.displays.push({ name, title: "side by side", paned: true, parts });
    return true;
  }

  /** Whether nets are shown side by side. */
  paned() {
    return this.displays.some((one) => one.name === this.shown && one.paned);
  }

  /** Shows these nets side by side; one alone is shown as ever. */
  openBeside(names) {
    this.displays = this.displays.filter((one) => !one.paned);
    if (names.length > 0) this.open(names.join("+"), null);
  }

  /** A net is shown beside the others, or is not any more. */
  addBeside(name) {
    const names = this.visibleNets().map((net) => net.name);
    this.openBeside(names.includes(name) ? names.filter((one) => one !== name) : [...names, name]);
  }

  toggleBeside() {
    const paned = this.paned();
    this.openBeside(paned ? [this.visibleNets()[0].name] : [...this.nets.keys()]);
  }

  events(net, events) {
    const count = net.follow(events);
    const forgotten = this.mode === "live" ? net.forget() : 0;
    if (forgotten > 0 && this.cursor?.net === net.name) this.cursor.position = Math.max(0, this.cursor.position - forgotten);
    if (net.gone !== null) { net.gone = null; this.tabs(); }
    this.arrived(net.head.at_ns);
    this.latest = performance.now();
    if (this.cursor === null && this.visibleNets().includes(net)) this.picture.travel(net, events.slice(-count));
    this.changed();
  }

  /** The scene has changed, or a picture has come. */
  seen(step) {
    if (step) this.arrived(step.at_ns);
    this.stale = true;
    if (!this.hasScene) {
      this.hasScene = true;
      this.tabs();
    }
    if (!this.panes.cell && this.whole !== this.panes.wantsCell()) this.panes.arrange();
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
    if (this.shown !== null) this.draw(true);
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

  // -- what is shown --------------------------------------------------------------------

  visibleNets() {
    const display = this.displays.find((one) => one.name === this.shown);
    const names = display ? display.parts.map((part) => part.net) : [this.shown];
    return names.map((name) => this.forks.get(name) ?? this.nets.get(name)).filter((net) => net !== undefined);
  }

  drawingOf(net) {
    const display = this.displays.find((one) => one.name === this.shown);
    const drawing = display?.parts.find((part) => part.net === net.name)?.drawing ?? (net.real ?? net)[this.detail];
    const folded = this.folded.get(net.name);
    return folded?.size > 0 ? fold(drawing, folded) : drawing;
  }

  /** What tasks sum up. */
  openSummary() {
    this.panes.open("summary");
    this.tabs();
    this.remember();
  }

  /** Shows a net, which may not be followed yet. */
  follow(name) {
    if (this.known(name)) this.open(name, null);
    else if (this.ask("follow", { net: name })) this.awaited = name;
  }

  /** A net is not followed any more. */
  leave(name) {
    this.nets.delete(name);
    this.forks.delete(name);
    if (this.shown === name) {
      [this.shown, this.chosen] = [null, null];
      this.openSummary();
    } else this.tabs();
  }

  /** The overview: the scene, the pictures, and the net of the task. */
  openWhole() {
    const main = this.mainNet();
    if (main !== undefined) this.open(main.name, null);
    this.panes.open("overview");
    if (main !== undefined) this.fitWhole();
    this.tabs();
    this.remember();
  }

  open(name, key) {
    if (name === null || !this.known(name)) return;
    this.followActive(false);
    this.panes.open("net");
    this.shown = name;
    this.chosen = null;
    this.task = null;
    this.draw();
    if (key !== null && this.picture.nodes.has(key)) this.choose(key);
    this.tabs();
    this.remember();
  }

  openNode(key) {
    const shown = this.picture.nodes.get(key);
    if (shown?.kind === "remote") this.open(shown.node.kind.remote[0], shown.node.kind.remote.join("/"));
    else if (shown?.kind === "fold") this.toggleFold(shown.net, shown.node.name);
    else if (shown?.kind === "transition") {
      const task = shown.net.view.transitions[shown.node.kind.transition[0][0]].task;
      if (this.nets.has(task)) this.open(task, null);
    }
  }

  goToNode(net, name) {
    if (this.keyOf(net, name) === null) this.open(net.name, null);
    const key = this.keyOf(net, name);
    if (key !== null) this.choose(key);
  }

  /** The drawn node that is called `name`, or in detail one of the parts of the request of that name; `null` when neither is drawn. */
  keyOf(net, name) {
    const key = `${net.name}/${name}`;
    if (this.picture.nodes.has(key)) return key;
    const isPart = ({ net: other, kind, node }) => other.name === net.name && kind === "transition" && node.kind.transition[0].some((number) => net.view.transitions[number].shown === name);
    return [...this.picture.nodes.values()].find(isPart)?.key ?? null;
  }

  draw(keep = false) {
    if (this.shown === null) return;
    const parts = this.visibleNets().map((net) => ({ net, drawing: this.drawingOf(net) }));
    this.picture.show(parts, linksBetween(parts), keep);
    this.picture.select(this.chosen);
    if (this.hops) this.picture.focus(this.chosen);
    this.minimap.show();
    this.changed();
  }

  choose(key) {
    // What is filled in for a node goes with it.
    if (document.activeElement?.matches("#side input, #side select")) document.activeElement.blur();
    this.chosen = key;
    this.task = null;
    this.picture.select(key);
    if (key !== null) this.followActive(false);
    if (key !== null) this.picture.center(key);
    if (this.hops) this.picture.focus(key);
    this.asking = null;
    this.changed();
    this.remember();
  }

  /** Looks at a task; its transitions lead back. */
  lookAt(task) {
    this.task = task;
    this.asking = null;
    this.changed();
  }

  /** Asks how a task is, not too often. */
  askTask(task) {
    const now = performance.now();
    if (this.asking?.task === task && now - this.asking.at < ASK_EVERY) return;
    this.asking = { task, at: now };
    this.ask("task", { task });
  }

  /** Draws a subnet as one node, or whole again. */
  toggleFold(net, subnet) {
    const folded = this.folded.get(net.name) ?? new Set();
    if (!folded.delete(subnet)) folded.add(subnet);
    this.folded.set(net.name, folded);
    this.chosen = null;
    this.draw();
  }

  /** The subnets of a net, and whether each is folded. */
  subnets(net) {
    const folded = this.folded.get(net.name);
    return subnetsOf((net.real ?? net)[this.detail]).map((name) => [name, folded?.has(name) ?? false]);
  }

  foldChosen() {
    const shown = this.chosen === null ? null : this.picture.nodes.get(this.chosen);
    if (!shown) return;
    const subnet = shown.kind === "fold" ? shown.node.name : shown.node.name.split(".").slice(0, -1).join(".");
    if (subnet !== "") this.toggleFold(shown.net, subnet);
  }

  /** Begins to play through what would happen from the moment shown, or ends it. */
  toggleFork() {
    if (this.forks.size > 0) this.forks.clear();
    else for (const net of this.visibleNets()) this.forks.set(net.name, new Fork(net, this.stateOf(net)));
    const key = this.chosen;
    this.cursor = null;
    this.playing = false;
    $("fork").setAttribute("aria-pressed", String(this.forks.size > 0));
    this.draw(true);
    if (key !== null) this.choose(key);
  }

  /** Tells where a person put a node. */
  keep(key) {
    const { net, node } = this.picture.nodes.get(key);
    const display = this.displays.some((one) => one.name === this.shown) ? this.shown : null;
    this.ask("move", { net: net.name, node: node.name, display, at: [Math.round(node.x), Math.round(node.y)] });
  }

  nudge(by) {
    if (this.chosen === null || !this.control || this.paned()) return;
    this.picture.move(this.chosen, by[0] * 10, by[1] * 10);
    this.keep(this.chosen);
  }

  tabs() {
    const go = (event, name) => (event.shiftKey && this.nets.has(name) ? this.addBeside(name) : this.open(name, null));
    const tab = (name, title, mark) => make("button", { role: "tab", "aria-selected": String(this.panes.layout === null && this.panes.built === "net" && name === this.shown), title, onclick: (event) => go(event, name) }, name, mark);
    $("beside").setAttribute("aria-pressed", String(this.paned()));
    const mark = (net) => (net.gone !== null ? make("span", { class: "gone" }, " gone") : null);
    $("tabs").replaceChildren(
      ...(this.summary.known ? [make("button", { role: "tab", "aria-selected": String(this.panes.layout === null && this.panes.built === "summary"), title: "How all is, in counts and states (m)", onclick: () => this.openSummary() }, "summary")] : []),
      ...(this.hasScene ? [make("button", { role: "tab", "aria-selected": String(this.panes.layout === null && this.panes.built === "overview"), title: "The scene, the pictures of the cameras and a net (o)", onclick: () => this.openWhole() }, "overview")] : []),
      ...this.panes.tabs(),
      ...this.displays.map((one) => tab(one.name, one.title, null)),
      ...[...this.nets.values()].map((net) => tab(net.name, net.view.title, mark(net))));
  }

  /** The tasks that can be looked at. */
  taskNames() {
    return new Set([...this.appTasks, ...[...this.nets.values()].flatMap((net) => net.view.transitions.map((one) => one.task))]);
  }

  /** What can be found, once somebody looks for something. */
  fillNames() {
    if ($("names").childElementCount > 0) return;
    const names = [...this.appTasks];
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
    if (this.taskNames().has(text.trim())) this.lookAt(text.trim());
    else if (best === null) this.say(`nothing is called ${text}`);
    else if (this.picture.nodes.has(best.key)) this.choose(best.key);
    else this.open(best.net, best.key);
  }

  /** Puts a command on the tape of a net. */
  command(net, line) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "" || !this.order("command", net, { words })) return;
    this.commands.set(this.asked, { net: net.name, line: words.join(" "), told: null });
    this.changed();
  }

  /** Puts a command on the tape of a net for a handle, which is told the answer, and whether that is the good one. */
  put(name, words, told) {
    const net = this.nets.get(name);
    if (!net || !this.order("command", net, { words })) return false;
    const [good] = net.view.commands.find((one) => one.symbol === words[0])?.answers ?? [];
    this.calls.set(this.asked, (ok, text) => told(text, ok && text.split(":")[0] === good));
    return true;
  }

  answered({ id, ok, text }) {
    const command = this.commands.get(id);
    const call = this.calls.get(id);
    this.calls.delete(id);
    if (call) call(ok, text);
    else if (command) [command.told, command.ok] = [text, ok];
    else if (!ok) this.say(text);
    this.changed();
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
      : this.forks.size > 0 ? ["what if: nothing of this happens", "paused"]
      : this.mode === "record" ? ["recorded", "paused"]
      : this.cursor !== null ? ["looking back; recording goes on", "paused"]
      : this.mode === "ended" ? ["ended", ""]
      : gone ? [`${gone.name} is gone`, "lost"]
      : paused ? [`${paused.name} stands still`, "paused"] : ["live", "live"];
    const pill = $("status");
    if (pill.textContent !== text) { pill.textContent = text; pill.className = `pill ${look}`; }
  }

  /** Says in one line why the whole waits. */
  why() {
    const first = busyNet(this.nets, this.visibleNets(), (net) => this.stateOf(net));
    const present = this.mode === "live" && this.cursor === null;
    const nowOf = (task) => {
      if (!present || !this.taskNames().has(task)) return null;
      const now = performance.now();
      if (now - (this.askedWhy.get(task) ?? -Infinity) > ASK_EVERY) {
        this.askedWhy.set(task, now);
        this.ask("task", { task });
      }
      return this.tasks.get(task)?.now;
    };
    const text = this.nets.size === 0 && this.summary.known ? "a click on an item shows its net" : this.nets.size === 0 ? (this.wanted?.length === 0 ? "this app has no nets" : "waiting for the nets of the app")
      : first === null || this.forks.size > 0 ? "nothing is under way" : whyOf(first, this.nets, (net) => this.stateOf(net), nowOf, this.now());
    if ($("why").textContent !== text) $("why").textContent = text;
  }

  /** Says how far the whole job is. */
  job() {
    const job = this.overview.job();
    $("job").hidden = job === null;
    if (job === null) return;
    const words = jobWords(job);
    if ($("job-words").textContent !== words) $("job-words").textContent = words;
    $("job").title = job.words;
    [$("job-bar").max, $("job-bar").value] = [job.total, job.done];
  }

  frame() {
    const now = performance.now();
    if (this.playing) this.play(now);
    this.picture.tick(now);
    if (this.active && this.shown !== null) this.picture.follow(this.activeNodes(), now);
    if (this.whole) this.overview.tick(now);
    if (this.shown !== null || this.whole) {
      if (this.dirty) {
        this.dirty = false;
        if (this.shown !== null) this.picture.update((net) => this.stateOf(net), this.now());
        if (this.shown !== null && now - (this.mapped ?? 0) > PANEL_EVERY) {
          this.mapped = now;
          this.minimap.update();
        }
        this.firstDrawn ??= performance.now();
        this.drawnAt = performance.now();
      } else if (this.shown !== null && this.cursor === null && this.mode === "live") this.picture.fillBars(this.now());
      const busy = this.cursor === null && this.mode === "live" && this.picture.running?.length > 0;
      // The present goes on also while nothing happens.
      const idle = this.cursor === null && this.mode === "live" && now - (this.panelled ?? 0) > PRESENT_EVERY;
      if (idle || ((this.stale || busy) && now - (this.panelled ?? 0) > (this.picture.nodes.size > MANY_NODES || (this.whole && this.overview.view.quality < 1) || this.visibleNets().some((net) => net.events.length > MANY_EVENTS) ? PANEL_EVERY_LARGE : PANEL_EVERY))) {
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
    const panes = this.panes.shown;
    if (panes.has("lanes")) this.lanes.draw();
    this.plots.draw();
    if (panes.has("events")) this.table.draw();
    this.why();
    this.job();
    const [from, to] = this.span();
    $("clock").textContent = seconds(this.now());
    this.older();
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
    $("fit").onclick = () => this.fit();
    $("active").onclick = () => this.followActive(!this.active);
    $("near").onclick = () => this.toggleNear();
    $("full").onclick = () => this.toggleDetail();
    $("help").onclick = () => $("keys").showModal();
    $("link").onclick = () => { this.remember(); navigator.clipboard?.writeText(location.href).then(() => this.say("the link is copied")); };
    $("scrub").oninput = () => {
      const [from, to] = this.span();
      this.playing = false;
      this.goTo(from + (Number($("scrub").value) / 1000) * (to - from));
    };
    $("narrow").onclick = () => this.zoomTime(0.5);
    $("wide").onclick = () => this.zoomTime(2);
    $("fork").onclick = () => this.toggleFork();
    $("beside").onclick = () => this.toggleBeside();
    $("search").onfocus = () => this.fillNames();
    $("search").onchange = () => this.find($("search").value);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.picture.looked(); this.changed(); });
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

  byKey(what) {
    const shown = this.chosen === null ? null : this.picture.nodes.get(this.chosen);
    if (!shown) return;
    if (shown.net.real) {
      if (shown.kind === "transition" && what === "fire") this.playOn(shown.net, shown.node, false);
      return;
    }
    if (!this.control) return;
    if (shown.kind === "transition") {
      const transition = called(shown.net.view.transitions[shown.node.kind.transition[0][0]]);
      const armed = shown.net.breakpoints.some((one) => one.transition === transition);
      this.order(what === "break" && armed ? "clear" : what, shown.net, { transition });
    } else if (shown.kind === "place" && what === "break") {
      const place = shown.node.name;
      const armed = shown.net.breakpoints.some((one) => one.place === place);
      this.order(armed ? "clear" : "break", shown.net, { place });
    }
  }

  /** Fires in a copy what a person chose, or ends its action. */
  playOn(fork, node, failed) {
    const numbers = node.kind.transition[0];
    const names = numbers.map((number) => fork.view.transitions[number].name);
    const running = fork.head.running.find((one) => names.includes(one.transition));
    const number = numbers.find((one) => fork.may(one));
    if (running) fork.end(running, failed);
    else if (number !== undefined) fork.fire(number, failed);
    this.picture.travel(fork, fork.events.slice(-1));
    this.changed();
  }

  /** Takes back what was done last in the copy. */
  undo() {
    const forks = [...this.forks.values()].filter((fork) => fork.events.length > 0);
    forks.sort((a, b) => b.head.at_ns - a.head.at_ns)[0]?.undo();
    this.changed();
  }

  order(what, net, more) {
    // A button that was shown for the net itself, and clicked when its copy had taken its place.
    if (this.forks.size > 0) return false;
    return this.ask(what, { net: net.name, ...more });
  }

  /** Whether there is somebody to ask. */
  ask(what, more) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.asked += 1;
    this.socket.send(JSON.stringify({ kind: what, id: this.asked, ...more }));
    return true;
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
      for (const command of this.commands.values()) command.told ??= "nobody knows here: the connection was lost";
      for (const call of this.calls.values()) call(false, "nobody knows what became of it: the connection was lost");
      this.calls.clear();
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
