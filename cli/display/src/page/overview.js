// The overview of the app: the scene, the pictures of cameras, and all of it in words.

import { Pictures, SceneTrack, jobOf, measure } from "./cell.js";
import { Handles } from "./handles.js";
import { seconds } from "./model.js";
import { make } from "./panels.js";
import { Plans } from "./plans.js";
import { numberKey } from "./plots.js";
import { SceneView, partsAt, vectorsOf } from "./scene.js";
import { pyramidOf } from "./sight.js";

const PICTURE_SVG = "http://www.w3.org/2000/svg";
/** The window around a spot is so many pixels of the camera wide. */
const WINDOW = 24;
/** The table of parts is filled at most so often, ms. */
const TABLE_EVERY = 200;
const KEY_TURN = 0.12;
/** What may be left out of the scene: its name, what that is, and the kinds of parts. The first are shown unless somebody does not want them. */
const LAYERS = [
  ["forces", "What force-torque sensors read: 1 cm for a newton, 10 cm for a newton metre", ["force"], true],
  ["guards", "What guards forbid", ["guard"], true],
  ["paths", "Ways that are planned", ["path"], true],
  ["margins", "How far guards keep everything from the arm, and what is nearest to it", ["margin", "nearest"], false],
  ["contacts", "What touches the arms, as the simulator says", ["contact"], true],
];
/** After so long without a change, ms. */
const SHARPEN_AFTER = 400;
/** A distance is written beside what is nearer than this, m. */
const WRITTEN = 0.5;

const drawn = (name, attributes, ...children) => {
  const made = document.createElementNS(PICTURE_SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
};

/** `#rrggbb` or `rgb()` as three numbers up to 1. */
function rgbOf(name) {
  const text = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  return [1, 3, 5].map((at) => Number.parseInt(text.slice(at, at + 2), 16) / 255);
}

export class Overview {
  /** In `host`, for `app`, which has `now`, `cursor`, `mode` and `changed`. */
  constructor(host, app) {
    this.host = host;
    this.app = app;
    this.tracks = new Map();
    this.pictures = new Pictures();
    this.truth = false;
    this.chosen = null;
    this.shown = new Map();
    this.canvas = make("canvas", { tabindex: "0", role: "application", "aria-describedby": "parts" });
    this.label = make("div", { class: "label", hidden: true });
    this.missing = make("p", { class: "missing" });
    this.truthBox = make("input", { type: "checkbox", onchange: () => { this.truth = this.truthBox.checked; this.view.stale = true; this.changed(); } });
    this.truthLabel = make("label", { class: "truth", hidden: true, title: "What the simulator says, drawn as outlines. No robot knows it." }, this.truthBox, " simulator's truth");
    this.hidden = new Set(LAYERS.filter(([, , , shown]) => !shown).map(([name]) => name));
    this.layers = make("div", { class: "layers", role: "group", "aria-label": "What the scene shows" }, ...LAYERS.map(([name, title]) => this.layerBox(name, title)), this.truthLabel);
    this.distance = make("div", { class: "distance", hidden: true });
    this.stage = make("div", { class: "scene" }, this.canvas, this.label, this.distance, this.missing, this.layers);
    this.figures = make("div", { class: "pictures", "aria-label": "Pictures of the cameras" });
    this.plans = new Plans(this);
    host.replaceChildren(this.stage, this.plans.element, this.figures);
    this.view = new SceneView(this.canvas, () => this.colours());
    this.canvas.hidden = !this.view.works;
    this.missing.textContent = this.view.works ? "Nothing of the scene is known at this moment." : "This browser has no WebGL2, so the scene is not drawn. The table has all that is known of it.";
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.theme = null; this.view.stale = true; });
    new ResizeObserver(() => { this.view.stale = true; }).observe(this.stage);
    this.handles = new Handles(this, app);
    this.listen();
  }

  /** A box for one layer of the scene; it is there when there is something in it. */
  layerBox(name, title) {
    const box = make("input", { type: "checkbox", name, checked: this.hidden.has(name) ? null : "", onchange: () => {
      if (box.checked) this.hidden.delete(name);
      else this.hidden.add(name);
      this.view.stale = true;
      this.changed();
    } });
    return make("label", { title, hidden: true, "data-layer": name }, box, ` ${name}`);
  }

  /** The boxes of what there is. */
  showLayers(all) {
    for (const [name, , kinds] of LAYERS) this.layers.querySelector(`[data-layer=${name}]`).hidden = !all.some((one) => kinds.includes(one.part.kind));
  }

  /** Whether a part is wanted. What touches nothing is nowhere. */
  wanted(one) {
    if (one.part.kind === "contact" && vectorsOf(one).length === 0) return false;
    return !LAYERS.some(([name, , kinds]) => kinds.includes(one.part.kind) && this.hidden.has(name));
  }

  colours() {
    if (!this.theme) {
      const dark = matchMedia("(prefers-color-scheme: dark)").matches;
      this.theme = {
        paper: rgbOf("--paper"), soft: rgbOf("--soft"), faint: rgbOf("--faint"), mark: rgbOf("--mark"), running: rgbOf("--running"), truth: rgbOf("--enabled"),
        sky: dark ? [0.56, 0.6, 0.68] : [0.68, 0.69, 0.72], ground: dark ? [0.22, 0.22, 0.25] : [0.48, 0.47, 0.48], rim: dark ? 0.1 : 0.0,
        shadow: dark ? [0.045, 0.053, 0.07] : [0.86, 0.86, 0.865],
      };
    }
    return this.theme;
  }

  /** Which of both is wanted. */
  panes(scene, pictures, plan) {
    this.stage.hidden = !scene;
    this.wantsPictures = pictures;
    this.host.classList.toggle("alone", !scene);
    this.figures.hidden = !pictures || this.pictures.cameras.size === 0;
    this.plans.wanted = plan;
    this.plans.element.hidden = !plan || !this.plans.any;
    this.view.stale = true;
  }

  // -- what comes -----------------------------------------------------------------------

  reset() {
    this.tracks.clear();
    this.pictures = new Pictures();
    this.shown.clear();
    this.figures.replaceChildren();
    this.view.fitted = false;
  }

  scene({ source, steps, gone }) {
    this.tracks.set(source, new SceneTrack(source, steps, gone));
    this.changed();
  }

  moved({ source, step }) {
    if (!this.tracks.has(source)) this.tracks.set(source, new SceneTrack(source, [], null));
    const track = this.tracks.get(source);
    track.gone = null;
    track.take(step);
    this.changed();
  }

  dark({ source, reason }) {
    const track = this.tracks.get(source);
    if (track) track.gone = reason;
    this.changed();
  }

  picture(picture) {
    this.pictures.take(picture);
    this.changed();
  }

  changed() {
    this.due = true;
  }

  /** Whether there is anything to show. */
  get any() {
    return this.pictures.cameras.size > 0 || [...this.tracks.values()].some((track) => track.steps.length > 0);
  }

  /** Whether there is anything to draw. */
  get drawable() {
    return [...this.tracks.values()].some((track) => track.steps.some((step) => step.view?.parts.some((part) => part.solids.length > 0)));
  }

  get span() {
    const spans = [...this.tracks.values()].map((track) => track.span);
    return [Math.min(...spans.map(([from]) => from)), Math.max(...spans.map(([, to]) => to))];
  }

  /** The moment shown, `null` as the present. */
  moment() {
    return this.app.cursor === null && this.app.mode !== "record" ? null : this.app.now();
  }

  /** What is measured most first, the simulator last. */
  order() {
    const numbers = (track) => track.head.view.parts.filter((part) => part.numbers.length > 0).length - (track.head.view.layer === "truth" ? 1 : 0);
    return [...this.tracks.values()].sort((a, b) => numbers(b) - numbers(a));
  }

  parts() {
    const all = partsAt(this.order().filter((track) => !this.plans.tasks.has(track.source)), this.moment(), this.truth, this.chosen, this.handles.parts);
    this.showLayers(all);
    return all.filter((one) => this.wanted(one));
  }

  job() {
    return jobOf(this.tracks.values(), this.moment());
  }

  // -- what is shown --------------------------------------------------------------------

  /** Draws what has changed, as often as the page is drawn. */
  tick(now) {
    this.handles.tick(now);
    const moment = this.moment();
    if (moment !== this.at) [this.at, this.due] = [moment, true];
    const [gap, painted] = [now - (this.ticked ?? now), this.painted];
    [this.ticked, this.painted] = [now, false];
    if (painted) this.view.pace(gap);
    if (!this.due && !this.view.stale) {
      // What stands still is drawn with all its pixels.
      if (this.view.coarse && now - this.moving > SHARPEN_AFTER) this.paint(this.parts(), 1);
      return;
    }
    [this.painted, this.moving] = [true, now];
    if (this.due) this.showPictures(moment);
    this.plans.draw(moment);
    this.due = false;
    const parts = this.parts();
    const truth = [...this.tracks.values()].some((track) => track.head.view.layer === "truth");
    this.truthLabel.hidden = !truth;
    this.missing.hidden = this.view.works && parts.length > 0;
    this.paint(parts);
    this.name(parts);
    this.far(parts);
    this.handles.place(parts);
    if (now - (this.told ?? 0) > TABLE_EVERY) {
      this.told = now;
      const words = this.words(parts);
      if (this.canvas.getAttribute("aria-label") !== words) this.canvas.setAttribute("aria-label", words);
    }
  }

  paint(parts = this.parts(), quality = this.view.quality) {
    const tools = parts.filter((one) => one.part.kind === "tool" && !one.truth);
    const trails = tools.map((one) => one.track.trail(one.row[0], one.track.at(this.moment())));
    const pictures = new Map([...this.pictures.cameras.keys()].map((camera) => [camera, this.pictures.at(camera, this.moment())]));
    this.view.paint(parts, trails, pictures, quality);
  }

  /** The chosen part has its name beside it. */
  name(parts) {
    const one = parts.find(({ key }) => key === this.chosen);
    const at = one && this.view.works ? this.view.where(one.row.slice(1, 4)) : null;
    this.label.hidden = !at;
    if (!at) return;
    const number = one.part.numbers[0];
    this.label.textContent = number ? `${one.part.name} · ${number.name} ${measure(one.row[8], number.unit)}` : one.part.name;
    const [width, height] = [this.stage.clientWidth, this.stage.clientHeight];
    this.label.style.transform = `translate(${Math.round(Math.min(width - 150, Math.max(6, at[0] + 12)))}px, ${Math.round(Math.min(height - 30, Math.max(6, at[1] - 26)))}px)`;
  }

  /** The least distance stands beside its line. */
  far(parts) {
    const near = parts.filter((one) => one.part.kind === "nearest" && one.row[8] !== null && one.row[8] < WRITTEN);
    const one = near.sort((a, b) => a.row[8] - b.row[8])[0];
    const [arrow] = one ? vectorsOf(one) : [];
    const at = arrow && this.view.works ? this.view.where([0, 1, 2].map((axis) => one.row[1 + axis] + arrow.way[0] * one.frame[axis] / 2 + arrow.way[1] * one.frame[4 + axis] / 2 + arrow.way[2] * one.frame[8 + axis] / 2)) : null;
    this.distance.hidden = !at;
    if (!at) return;
    this.distance.textContent = measure(one.row[8], "m");
    this.distance.style.transform = `translate(${Math.round(at[0] + 8)}px, ${Math.round(at[1] - 9)}px)`;
  }

  /** What the drawing shows, in a sentence. */
  words(parts) {
    if (parts.length === 0) return "The scene: nothing is known at this moment.";
    const said = [...this.tracks.values()].map((track) => track.at(this.moment())?.said?.words).filter(Boolean);
    const tool = parts.find((one) => one.part.kind === "tool");
    const where = tool ? ` Its tool is at ${tool.row.slice(1, 4).map((value) => value.toFixed(2)).join(", ")} m.` : "";
    return `The scene, with ${parts.length} parts.${where} ${said.join("; ")}`.trim();
  }

  choose(key) {
    this.chosen = key;
    this.view.stale = true;
    this.changed();
    this.app.changed();
  }

  showPictures(moment) {
    const cameras = [...this.pictures.cameras.keys()].sort();
    const own = new Map();
    for (const camera of cameras) {
      let figure = this.shown.get(camera);
      if (!figure) {
        figure = { element: make("figure", {}), of: undefined };
        this.shown.set(camera, figure);
        this.figures.append(figure.element);
      }
      own.set(camera, figure);
      const picture = this.pictures.at(camera, moment);
      if (figure.of !== picture) {
        figure.of = picture;
        figure.element.replaceChildren(...(picture === null ? [make("div", { class: "none" }), make("figcaption", {}, make("b", {}, camera), make("span", { class: "soft" }, "no picture yet at this moment"))] : pictureOf(picture)));
      }
    }
    this.figures.hidden = !this.wantsPictures || cameras.length === 0;
  }

  /** What stands at the side: the chosen part, and all that is known of the scene. */
  side() {
    const moment = this.moment();
    const parts = this.parts();
    const chosen = parts.find(({ key }) => key === this.chosen);
    const sections = [];
    if (chosen) sections.push(this.partSection(chosen));
    for (const track of this.order()) {
      if (this.plans.tasks.has(track.source)) continue;
      const state = track.at(moment);
      const said = state?.said?.words ?? "";
      const named = parts.filter((one) => one.track === track && one.part.name !== "");
      const ways = named.filter((one) => one.part.kind.startsWith("way"));
      const own = named.filter((one) => !ways.includes(one) && one.part.kind !== "margin");
      if (track.gone === null && named.length === 0 && said === "") continue;
      const title = [track.source, state?.view.layer === "truth" ? make("small", {}, "simulator's truth") : own.length > 0 ? make("small", {}, "measured") : null];
      sections.push(make("section", {}, make("h2", {}, ...title.filter((one) => one !== null)),
        track.gone !== null ? make("p", { class: "words failed" }, track.gone) : null,
        said !== "" ? make("p", { class: `words${state.said.fault ? " failed" : ""}` }, said) : null,
        own.length > 0 ? this.table(own) : null,
        ways.length > 0 ? this.ways(ways) : null));
    }
    const first = sections.map((section) => section.querySelector("table:not(.ways)")).find((table) => table !== null);
    if (first) first.id = "parts";
    return sections;
  }

  table(own) {
    const rows = own.map((one) => {
      const [number, error] = one.part.numbers;
      const cells = number ? [measure(one.row[8], number.unit), error?.name === "error" ? measure(one.row[9], error.unit) : ""] : [one.part.kind, ""];
      return make("tr", { class: one.chosen ? "now" : null },
        make("th", { scope: "row" }, make("button", { class: "link", "aria-pressed": String(one.chosen), onclick: () => this.choose(one.chosen ? null : one.key) }, ...one.part.name.split(/(?<=[._])/).flatMap((word) => [word, document.createElement("wbr")]))),
        ...cells.map((text) => make("td", {}, text)),
        make("td", {}, one.row.slice(1, 4).map((value) => value.toFixed(2).replace("-", "−")).join(" ")));
    });
    return make("table", { class: "parts" },
      make("thead", {}, make("tr", {}, ...["part", "joint", "error", "at, m"].map((text) => make("th", { scope: "col", title: text === "at, m" ? "where the frame of its joint is" : null }, text)))),
      make("tbody", {}, ...rows));
  }

  /** What Coordinators believe of the ways of each step; the one that was chosen last stands out. */
  ways(ways) {
    let before = null;
    const rows = ways.flatMap((one) => {
      const at = one.part.name.lastIndexOf(": ");
      const [step, name] = [one.part.name.slice(0, at), one.part.name.slice(at + 2)];
      const chosen = one.part.kind === "way, chosen";
      const [chance, cost, trials] = one.row.slice(8);
      const row = make("tr", { class: chosen ? "now" : null, title: chosen ? "chosen last" : null },
        make("th", { scope: "row" }, name),
        ...[`${(100 * chance).toFixed(0)} %`, `${cost.toFixed(1)} s`, trials.toFixed(0)].map((text) => make("td", {}, text)));
      const head = step === before ? [] : [make("tr", {}, make("th", { scope: "rowgroup", colspan: "4" }, make("b", {}, step)))];
      before = step;
      return [...head, row];
    });
    return make("table", { class: "parts ways" },
      make("thead", {}, make("tr", {}, ...["ways", "success", "cost", "tried"].map((text) => make("th", { scope: "col" }, text)))),
      make("tbody", {}, ...rows));
  }

  partSection(one) {
    const facts = [["kind", one.part.kind]];
    if (one.part.parent) facts.push(["carried by", one.part.parent]);
    const plot = (name) => {
      const key = numberKey(one.track.source, one.part.name, name);
      return make("button", { class: "link", "aria-pressed": String(this.app.plots.has(key)), "aria-label": `Plot ${name}`, title: "Show it over time", onclick: () => this.app.plots.toggle(key) }, "plot");
    };
    one.part.numbers.forEach((number, at) => facts.push([number.name, make("span", {}, `${measure(one.row[8 + at], number.unit)} `, plot(number.name))]));
    facts.push(["at", `${one.row.slice(1, 4).map((value) => value.toFixed(3)).join(", ")} m`]);
    return make("section", { class: "chosen" }, make("h2", {}, one.part.name, make("small", {}, one.truth ? "simulator's truth" : one.part.kind)),
      make("dl", {}, ...facts.flatMap(([key, value]) => [make("dt", {}, key), make("dd", {}, value)])),
      make("div", { class: "actions" }, this.looks("followed", one, "Follow", "Keep it in the middle (f)"),
        pyramidOf(one.part) ? this.looks("from", one, "See from here", "The scene as this camera sees it, over its picture (c)") : null));
  }

  /** A button that looks at a part in another way, or ends that. */
  looks(how, one, text, title) {
    return make("button", { "aria-pressed": String(this.view[how] === one.key), title, onclick: () => this.look(how, one.key) }, text);
  }

  look(how, key) {
    this.view[how] = this.view[how] === key ? null : key;
    this.view.stale = true;
    this.changed();
    this.app.changed();
  }

  // -- what a person does ---------------------------------------------------------------

  listen() {
    const { canvas, view } = this;
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      held = { x: event.clientX, y: event.clientY, far: 0, shifts: event.button !== 0 || event.shiftKey };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (held === null) return;
      const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
      held = { ...held, x: event.clientX, y: event.clientY, far: held.far + Math.abs(dx) + Math.abs(dy) };
      if (held.shifts) view.shift(dx, dy);
      else view.turn(-dx * 0.008, dy * 0.008);
    });
    canvas.addEventListener("pointerup", (event) => {
      const box = canvas.getBoundingClientRect();
      if (held !== null && held.far < 4 && !held.shifts) this.choose(view.pick(this.parts(), [event.clientX - box.x, event.clientY - box.y]));
      held = null;
    });
    canvas.addEventListener("pointercancel", () => { held = null; });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => { view.dolly(Math.exp(event.deltaY * 0.001)); event.preventDefault(); }, { passive: false });
    const keys = {
      ArrowLeft: () => view.turn(-KEY_TURN, 0), ArrowRight: () => view.turn(KEY_TURN, 0), ArrowUp: () => view.turn(0, KEY_TURN), ArrowDown: () => view.turn(0, -KEY_TURN),
      "+": () => view.dolly(0.85), "=": () => view.dolly(0.85), "-": () => view.dolly(1.18), 0: () => view.fit(this.parts().filter((one) => !one.truth)),
      f: () => this.chosen !== null && this.look("followed", this.chosen), c: () => this.chosen !== null && this.look("from", this.chosen),
      Enter: () => this.next(1), Backspace: () => this.next(-1), Escape: () => this.choose(null),
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
      if (event.shiftKey && event.key.startsWith("Arrow")) view.shift(...{ ArrowLeft: [24, 0], ArrowRight: [-24, 0], ArrowUp: [0, 24], ArrowDown: [0, -24] }[event.key]);
      else keys[event.key]();
      event.preventDefault();
      event.stopPropagation();
    });
  }

  /** Chooses the next part, or the one before. */
  next(by) {
    const keys = this.parts().map((one) => one.key);
    if (keys.length === 0) return;
    const at = keys.indexOf(this.chosen);
    this.choose(keys[(at < 0 && by < 0 ? keys.length : at) + by] ?? (by > 0 ? keys[0] : keys.at(-1)));
  }
}

/** A picture with what was found in it. */
function pictureOf(picture) {
  const [width, height] = picture.taken;
  const by = Math.max(1, Math.floor(width / picture.size[0]));
  const image = () => drawn("image", { href: `data:image/png;base64,${picture.png}`, x: -0.5, y: -0.5, width: picture.size[0] * by, height: picture.size[1] * by, preserveAspectRatio: "none" });
  const good = (mark) => (mark.sd === null ? null : Math.max(...mark.sd));
  const drawing = picture.drawing ?? null;
  const spots = drawing ? [drawing.said] : picture.marks.map((mark) => `a spot at column ${mark.at[0].toFixed(1)}, row ${mark.at[1].toFixed(1)}${good(mark) === null ? "" : `, good to ${good(mark).toFixed(2)} px`}`);
  const what = spots.length === 0 ? "nothing found in it" : spots.join("; ");
  const parts = [image(), ...picture.marks.map(({ at: [u, v] }) => drawn("g", { class: "spot", transform: `translate(${u} ${v})` },
    drawn("circle", { r: width / 28 }), drawn("path", { d: `M${-width / 14} 0h${width / 28}M${width / 28} 0h${width / 28}M0 ${-width / 14}v${width / 28}M0 ${width / 28}v${width / 28}` })))];
  if (drawing) parts.push(...drawing.outlines.flatMap(outlineOf));
  const first = picture.marks[0];
  if (first) {
    // The window stands where the spot is not.
    const [u, v] = first.at;
    const size = width * 0.3;
    const [x, y] = [u > width / 2 ? width * 0.03 : width * 0.67, v > height / 2 ? width * 0.03 : height - width * 0.33];
    const sd = first.sd ?? [0, 0];
    parts.push(drawn("svg", { class: "near", x, y, width: size, height: size, viewBox: `${u - WINDOW / 2} ${v - WINDOW / 2} ${WINDOW} ${WINDOW}` }, image(),
      drawn("ellipse", { cx: u, cy: v, rx: 3 * sd[0], ry: 3 * sd[1] }), drawn("path", { d: `M${u - 9} ${v}h6m6 0h6M${u} ${v - 9}v6m0 6v6` })),
    drawn("rect", { class: "frame", x, y, width: size, height: size }));
  }
  const view = drawing ? around(drawing.outlines.flatMap(({ corners }) => corners), width, height) : [-0.5, -0.5, width, height];
  const whole = drawn("svg", { class: drawing ? "picture read" : "picture", role: "img", viewBox: view.join(" "), "aria-label": `Picture ${picture.number} of ${picture.camera}: ${what}`, "data-number": picture.number }, ...parts);
  if (drawing) return [whole, make("figcaption", { title: "Light discs yellow, dark ones red, a king in two rings; what is unsure is framed, with its confidence in percent" }, make("b", {}, picture.camera), make("span", { class: "soft" }, ` ${drawing.said} · ${seconds(picture.at_ns, 2)}`))];
  const spot = first ? `spot at ${first.at[0].toFixed(1)}, ${first.at[1].toFixed(1)} px${good(first) === null ? "" : `\u00a0±\u00a0${good(first).toFixed(2)}`}` : "nothing found";
  return [whole, make("figcaption", {}, make("b", {}, picture.camera), make("span", { class: "soft", title: "The ring in the window has three times the predicted standard deviation" }, ` ${spot} · ${seconds(picture.at_ns, 2)}`))];
}

/** An outline that somebody has drawn over a picture, with what stands in its middle. */
function outlineOf({ corners, colour, strength, width, text }) {
  const line = drawn("polygon", { class: "outline", points: corners.map((at) => at.join(",")).join(" "), stroke: `rgb(${colour.join(" ")})`, "stroke-width": width, "stroke-opacity": strength });
  if (text === "") return [line];
  const [left, top, across, down] = box(corners);
  const words = drawn("text", { class: "outlined", x: left + across / 2, y: top + down / 2, "font-size": 0.6 * Math.min(across, down) });
  words.textContent = text;
  return [line, words];
}

function box(corners) {
  const [us, vs] = [0, 1].map((axis) => corners.map((at) => at[axis]));
  const [left, top] = [Math.min(...us), Math.min(...vs)];
  return [left, top, Math.max(...us) - left, Math.max(...vs) - top];
}

/** The part of a picture around what is drawn over it: left, top, width and height. */
function around(corners, width, height) {
  if (corners.length === 0) return [-0.5, -0.5, width, height];
  const [left, top, across, down] = box(corners);
  const margin = 0.12 * Math.max(across, down);
  const [x, y] = [Math.max(-0.5, left - margin), Math.max(-0.5, top - margin)];
  return [x, y, Math.min(width - 0.5, left + across + margin) - x, Math.min(height - 0.5, top + down + margin) - y];
}

/** How far the job is, in words. */
export function jobWords(job) {
  const left = job.left === null || job.done >= job.total ? "" : ` · ${duration(job.left)} left`;
  return `${job.step} ${job.done} of ${job.total}${left}`;
}

function duration(ns) {
  const all = Math.round(ns / 1e9);
  return all < 60 ? `${all} s` : `${Math.floor(all / 60)} min ${String(all % 60).padStart(2, "0")} s`;
}
