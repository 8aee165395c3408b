// Handles: what a person takes hold of in the scene or beside it, and the commands that this puts on the tapes of nets.

import { make } from "./panels.js";
import { minus, norm, plus } from "./solids.js";

const HANDLE_SVG = "http://www.w3.org/2000/svg";
/** A command is put when the one before is answered, and not sooner than this after it, ms. */
const PUT_EVERY = 100;
/** A number that was chosen is shown for so long while the app says another one, ms. */
const STANDS = 15000;
/** A pull or a deflection counts for so long, s: whose page is gone pulls no more. */
const COUNTS_S = 0.5;
/** A newton is so long, m, as the arrows of sensors; nobody pulls harder, N. */
const NEWTON = 0.01;
const HARDEST = 30;
/** What an arrow key does: px of the scene, and a part of the whole deflection. */
const KEY_PX = 20;
const KEY_SHARE = 0.6;
/** A shorter way is no command, m. */
const SHORTEST = 5e-4;
const ARROW_KEYS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, -1, 0], ArrowDown: [0, 1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };

const rounded = (numbers) => numbers.map((one) => String(Number(one.toFixed(4))));

/** What all handles have: they are held, and while they are they put commands. */
class Handle {
  /** Of a description as the file of displays has it. */
  constructor(handles, told) {
    Object.assign(this, { handles, told, held: null, waits: false, due: false, putAt: -Infinity, value: [0, 0, 0] });
  }

  get name() {
    return this.told.name;
  }

  /** Has an element be held by mouse, finger and keys. */
  listen(element) {
    element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.held = { pointer: event.pointerId, element, from: [event.clientX, event.clientY], last: [event.clientX, event.clientY] };
      element.setPointerCapture(event.pointerId);
      element.focus({ preventScroll: true });
      this.take(event);
      event.preventDefault();
      event.stopPropagation();
    });
    element.addEventListener("pointermove", (event) => {
      if (this.held?.pointer !== event.pointerId) return;
      this.take(event);
      this.held.last = [event.clientX, event.clientY];
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur", "keyup"]) element.addEventListener(kind, () => this.letGo());
    element.addEventListener("keydown", (event) => {
      if (!(event.key in ARROW_KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
      this.held ??= { element, key: event.key };
      this.press(ARROW_KEYS[event.key], element);
      event.preventDefault();
      event.stopPropagation();
    });
  }

  letGo() {
    if (this.held === null) return;
    this.held = null;
    this.release();
    this.handles.overview.view.stale = true;
  }

  /** A pull or a deflection from now on; what is held is said anew until it is let go. */
  set(value) {
    this.value = value;
    this.due = true;
    this.handles.overview.view.stale = true;
  }

  release() {
    this.set([0, 0, 0]);
  }

  /** Puts the next command, if there is one. */
  tick(now) {
    if (this.waits || now - this.putAt < PUT_EVERY || !(this.due || (this.held && this.again))) return;
    const words = this.words();
    this.due = false;
    if (words === null) return;
    this.waits = this.handles.app.put(this.told.net, [this.told.command, ...words], (text, good) => {
      this.waits = false;
      if (good) return;
      this.refused();
      this.handles.app.say(text);
    });
    this.putAt = now;
  }

  /** The command that was put has failed. */
  refused() { /* What is held is said anew. */ }
}

/** A handle at a part of the scene. */
class PartHandle extends Handle {
  constructor(handles, told) {
    super(handles, told);
    this.button = make("button", { class: `handle ${told.gives}`, hidden: true, title: told.title, "aria-label": `${told.name}: ${told.title}`, "data-handle": told.name });
    this.arrow = document.createElementNS(HANDLE_SVG, "path");
    this.arrow.setAttribute("class", `pull ${told.gives}`);
    this.amountBox = make("output", { class: "pulled", hidden: true });
    this.listen(this.button);
  }

  get elements() {
    return [this.button, this.amountBox];
  }

  /** Puts itself where its part is; `at` is null where that is not seen. */
  show(at) {
    this.at = at;
    const { view, stage } = this.handles.overview;
    const spot = at === null ? null : view.where(at);
    const seen = spot !== null && spot[0] > 0 && spot[1] > 0 && spot[0] < stage.clientWidth && spot[1] < stage.clientHeight;
    // What is held stays held, wherever it goes.
    this.button.hidden = !seen && this.held === null;
    this.arrow.setAttribute("d", "");
    this.amountBox.hidden = true;
    if (spot === null) return;
    this.button.style.transform = `translate(${spot[0].toFixed(1)}px, ${spot[1].toFixed(1)}px)`;
    if (this.held === null) return;
    const tip = this.tip(spot);
    const way = [tip[0] - spot[0], tip[1] - spot[1]];
    const length = Math.hypot(...way);
    if (length < 6) return;
    const [x, y] = way.map((one) => one / length);
    const side = (by) => `L${(tip[0] - 10 * x + by * y).toFixed(1)} ${(tip[1] - 10 * y - by * x).toFixed(1)}`;
    this.arrow.setAttribute("d", `M${spot.join(" ")}L${tip.join(" ")}M${(tip[0] - 10 * x + 5 * y).toFixed(1)} ${(tip[1] - 10 * y - 5 * x).toFixed(1)}L${tip.join(" ")}${side(-5)}`);
    this.amountBox.hidden = false;
    this.amountBox.textContent = this.amount();
    this.amountBox.style.transform = `translate(${Math.round(tip[0] + 10)}px, ${Math.round(tip[1] + 6)}px)`;
  }
}

/** Drags a part: each command says how much further. */
class Drag extends PartHandle {
  /** In the plane of the view, from where the pointer was. */
  take(event) {
    const [x, y] = this.held.last;
    this.by(event.clientX - x, event.clientY - y);
  }

  press([x, y]) {
    this.by(x * KEY_PX, y * KEY_PX);
  }

  by(dx, dy) {
    if (this.at) this.set(plus(this.value, this.handles.overview.view.along(this.at, dx, dy)));
  }

  // What is left of the way is said as well.
  release() {
    this.due = true;
  }

  words() {
    if (norm(this.value) < SHORTEST) return null;
    const words = rounded(this.value);
    this.value = [0, 0, 0];
    return words;
  }

  /** Where the pointer has it. */
  tip(spot) {
    const box = this.handles.overview.canvas.getBoundingClientRect();
    return this.held.last ? [this.held.last[0] - box.x, this.held.last[1] - box.y] : spot;
  }

  amount() {
    return this.name;
  }
}

/** Puts a part elsewhere on its level, once, when it is let go. */
class Put extends Drag {
  take(event) {
    const box = this.handles.overview.canvas.getBoundingClientRect();
    this.aim([event.clientX - box.x, event.clientY - box.y]);
  }

  press([x, y]) {
    const spot = this.at && this.handles.overview.view.where(plus(this.at, this.value));
    if (spot) this.aim([spot[0] + x * KEY_PX, spot[1] + y * KEY_PX]);
  }

  aim(spot) {
    const place = this.at && this.handles.overview.view.onLevel(plus(this.at, this.value), spot);
    if (place) this.set(minus(place, this.at));
  }

  words() {
    if (this.held !== null || norm(this.value) < SHORTEST) return null;
    const [x, y] = rounded(this.value);
    this.value = [0, 0, 0];
    return [this.told.part.split("/").slice(1).join("/"), x, y];
  }
}

/** Pulls at a part: a force that follows the pointer. */
class Pull extends PartHandle {
  again = true;

  take(event) {
    const [x, y] = this.held.from;
    this.by(event.clientX - x, event.clientY - y);
  }

  press([x, y]) {
    this.by(x * 2 * KEY_PX, y * 2 * KEY_PX);
  }

  by(dx, dy) {
    if (!this.at) return;
    const force = this.handles.overview.view.along(this.at, dx, dy).map((one) => one / NEWTON);
    const size = norm(force);
    this.set(size > HARDEST ? force.map((one) => (one * HARDEST) / size) : force);
  }

  words() {
    return [...rounded(this.value), String(this.held ? COUNTS_S : 0)];
  }

  tip() {
    return this.handles.overview.view.where(plus(this.at, this.value, NEWTON)) ?? this.handles.overview.view.where(this.at);
  }

  amount() {
    return `${norm(this.value).toFixed(1)} N`;
  }
}

/** A pad: across the ground as it is seen, and up and down. */
class Pad extends Handle {
  again = true;

  constructor(handles, told) {
    super(handles, told);
    const knob = (kind, title) => make("button", { class: kind, title, "aria-label": `${told.name}: ${title}`, "data-handle": `${told.name}-${kind}` }, make("i", {}));
    this.across = knob("across", "Right, left, away and near, as the scene is seen. Drag, or arrow keys");
    this.lift = knob("lift", "Up and down. Drag, or page up and page down");
    this.element = make("div", { class: "pad", role: "group", hidden: true, title: told.title, "aria-label": told.name }, make("span", {}, told.name), this.across, this.lift);
    for (const element of [this.across, this.lift]) this.listen(element);
    this.deflect([0, 0, 0]);
  }

  take(event) {
    const box = this.held.element.getBoundingClientRect();
    const share = (at, from, size) => Math.min(1, Math.max(-1, (2 * (at - from)) / size - 1));
    const [x, y] = [share(event.clientX, box.x, box.width), share(event.clientY, box.y, box.height)];
    this.deflect(this.held.element === this.lift ? [0, 0, -y] : [x, y, 0]);
  }

  press([x, y, z], element) {
    const up = element === this.lift ? z - y : z;
    this.deflect((element === this.lift ? [0, 0, up] : [x, y, z]).map((one) => one * KEY_SHARE));
  }

  release() {
    this.deflect([0, 0, 0]);
  }

  /** So far to the right, near and up, each from -1 to 1. */
  deflect([x, y, z]) {
    const long = Math.max(1, Math.hypot(x, y));
    const { azimuth } = this.handles.overview.view.camera;
    const [right, near] = [[-Math.sin(azimuth), Math.cos(azimuth), 0], [Math.cos(azimuth), Math.sin(azimuth), 0]];
    this.set(plus(plus([0, 0, z], right, x / long), near, y / long));
    const put = (knob, [right, down]) => { knob.style.left = `${50 + 40 * right}%`; knob.style.top = `${50 + 40 * down}%`; };
    put(this.across.firstChild, [x / long, y / long]);
    put(this.lift.firstChild, [0, -z]);
  }

  words() {
    return [...rounded(this.value), "0", "0", "0", String(this.held ? COUNTS_S : 0)];
  }
}

/** What stands beside the scene and puts a command when somebody is done with it. */
class Knob extends Handle {
  /** Names are written with spaces. */
  get label() {
    return this.name.replaceAll("_", " ");
  }

  release() { /* Nothing is held. */ }

  /** Shows how it is now; null where nobody says. */
  is() { /* A button is as it is. */ }
}

/** A button. */
class Press extends Knob {
  constructor(handles, told) {
    super(handles, told);
    this.element = make("button", { class: "knob", title: told.title, "data-handle": told.name, onclick: () => { this.due = true; } }, this.label.replace(/^./, (first) => first.toUpperCase()));
  }

  words() {
    return [];
  }
}

/** A number: a slider, or a box to tick. */
class Amount extends Knob {
  constructor(handles, told) {
    super(handles, told);
    const [least, most] = told.range;
    const step = told.step ?? (most - least) / 100;
    this.ticked = step === most - least;
    this.input = this.ticked ? make("input", { type: "checkbox", "data-handle": told.name }) : make("input", { type: "range", min: String(least), max: String(most), step: String(step), "data-handle": told.name });
    this.output = make("output", {});
    this.chosen = null;
    this.element = make("label", { class: "knob", title: told.title }, make("span", {}, this.label), this.input, this.ticked ? null : this.output);
    // While it is moved it shows where it is; the command is put once it is let go.
    this.input.addEventListener("input", () => { this.moved = true; this.element.classList.remove("unset"); this.tell(this.at); });
    this.input.addEventListener("change", () => { this.due = true; });
    this.is(null);
  }

  get at() {
    return this.ticked ? this.told.range[this.input.checked ? 1 : 0] : Number(this.input.value);
  }

  tell(value) {
    this.output.textContent = value === null ? "as configured" : String(Number(value.toFixed(3)));
  }

  is(value) {
    if (this.moved || this.due || this.waits) return;
    // An app takes up what was chosen in its own time.
    if (this.chosen !== null && this.chosen !== value && performance.now() < this.putAt + STANDS) return;
    this.chosen = null;
    this.tell(value);
    this.element.classList.toggle("unset", value === null);
    if (this.ticked) this.input.checked = value === this.told.range[1];
    else if (value !== null && Number(this.input.value) !== value) this.input.value = String(value);
  }

  words() {
    this.moved = false;
    const words = rounded([this.at]);
    this.chosen = Number(words[0]);
    return words;
  }

  refused() {
    this.chosen = null;
  }
}

const KINDS = { way: Drag, place: Put, force: Pull, axes: Pad, press: Press, number: Amount };

/** The handles of an app. */
export class Handles {
  /** In the scene of `overview`, for `app`, which has `put`, `say`, `control`, `mode`, `cursor` and `forks`. */
  constructor(overview, app) {
    this.overview = overview;
    this.app = app;
    this.all = [];
    this.parts = new Set();
    this.layer = make("div", { class: "handles" });
    this.arrows = document.createElementNS(HANDLE_SVG, "svg");
    this.arrows.setAttribute("class", "pulls");
    this.pads = make("div", { class: "pads" });
    this.knobs = make("div", { class: "knobs", role: "group", "aria-label": "What people want", hidden: true });
    overview.stage.append(this.arrows, this.layer, this.pads);
  }

  /** These are all of them. */
  show(told) {
    for (const one of this.all) one.letGo();
    /** Those of several parts, and the parts that have one of them by now. */
    this.patterns = told.filter((one) => one.part?.endsWith("*"));
    this.grown = new Set();
    this.all = told.filter((one) => !this.patterns.includes(one)).map((one) => new KINDS[one.gives](this, one));
    /** The keys of parts that have one: they are seen whoever tells of them. */
    this.parts = new Set(told.map((one) => one.part).filter(Boolean));
    const inScene = this.all.filter((one) => one instanceof PartHandle);
    const pads = this.all.filter((one) => one instanceof Pad);
    this.layer.replaceChildren(...inScene.flatMap((one) => one.elements));
    this.arrows.replaceChildren(...inScene.map((one) => one.arrow));
    this.pads.replaceChildren(...pads.map((one) => one.element));
    const knobs = this.all.filter((one) => one instanceof Knob);
    this.knobs.replaceChildren(...[Press, Amount].flatMap((kind) => knobs.filter((one) => one instanceof kind)).map((one) => one.element));
    // Nobody has touched anything yet.
    for (const one of this.all) one.due = false;
  }

  /** Each part that one of the patterns means gets a handle of its own. */
  grow(parts) {
    for (const { key } of parts) {
      const told = this.grown.has(key) ? null : this.patterns.find((one) => key.startsWith(one.part.slice(0, -1)));
      if (!told) continue;
      this.grown.add(key);
      const one = new KINDS[told.gives](this, { ...told, name: `${told.name} ${key.split("/").slice(1).join("/")}`, part: key });
      this.all.push(one);
      this.layer.append(...one.elements);
      this.arrows.append(one.arrow);
    }
  }

  /** Whether somebody may take hold of anything now. */
  get allowed() {
    const { app, overview } = this;
    return app.control && app.mode === "live" && app.cursor === null && app.forks.size === 0 && !overview.view.through;
  }

  /** Puts each where it is among the parts that are seen. */
  place(parts) {
    const { allowed } = this;
    this.knobs.hidden = !allowed || this.knobs.childElementCount === 0;
    this.grow(parts);
    for (const one of this.all) {
      if (!allowed) one.letGo();
      if (one instanceof Pad) one.element.hidden = !allowed;
      else if (one instanceof Knob) one.is(this.numberOf(one.told.shows));
      else one.show((allowed && parts.find(({ key }) => key === one.told.part)?.row.slice(1, 4)) || null);
    }
  }

  /** The number of a part of the scene, by `TASK/PART/NAME`; null where it is not known. */
  numberOf(shows) {
    const [task, name, number] = shows?.split("/") ?? [];
    const state = this.overview.tracks.get(task)?.at(this.overview.moment());
    const index = state?.view.parts.findIndex((part) => part.name === name) ?? -1;
    const at = index < 0 ? -1 : state.view.parts[index].numbers.findIndex((one) => one.name === number);
    return at < 0 ? null : (state.rows[index]?.[8 + at] ?? null);
  }

  tick(now) {
    for (const one of this.all) one.tick(now);
  }
}
