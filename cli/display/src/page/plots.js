// Numbers over time, on the time axis of the lanes: what is measured at parts of the scene, and tokens in places.

import { measure } from "./cell.js";
import { colours } from "./field.js";
import { OF_TASK, durations } from "./loads.js";
import { make } from "./panels.js";

const PLOT_HEIGHT = 54;
/** The lanes' axis ends so far from the right edge. */
const PLOT_RIGHT = 8;

const encoded = (...names) => names.map(encodeURIComponent).join("/");

/** What names a number of a part. */
export const numberKey = (source, part, number) => `number/${encoded(source, part, number)}`;

/** What names the tokens of a place. */
export const placeKey = (net, place) => `tokens/${encoded(net, place)}`;

/** What names a number of a task: `queue`, `rate` or `time`. */
export const taskKey = (task, what) => `task/${encoded(task, what)}`;

/** What names how long the actions of a node of a net take. */
export const durationKey = (net, node) => `duration/${encoded(net, node)}`;

/** What a plot is called: `kind` and the names of its key. */
function titleOf(kind, names) {
  if (kind === "number") return `${names[1]} · ${names[2]}`;
  if (kind === "task") return `${names[0]} · ${OF_TASK[names[1]]?.[2] ?? names[1]}`;
  if (kind === "duration") return `${names[1]} · time`;
  return `${names[1]} of ${names[0]}`;
}

/** Where a number of a part stands in the parts of a view: the part, and the place in its rows; null when it does not. */
function cellOf(view, part, number) {
  const index = view.parts.findIndex((one) => one.name === part);
  const at = index < 0 ? -1 : view.parts[index].numbers.findIndex((one) => one.name === number);
  return at < 0 ? null : { index, at: 8 + at, unit: view.parts[index].numbers[at].unit };
}

/** Moments and what a number was from then on. */
function pointsOfNumber(track, part, number) {
  const points = [];
  let cell = null;
  for (const step of track.steps) {
    if (step.view) cell = cellOf(step.view, part, number);
    else cell ??= cellOf(track.head.view, part, number);
    if (cell === null) continue;
    const row = step.moved.find((one) => one[0] === cell.index);
    const value = row?.[cell.at];
    if (value !== null && value !== undefined) points.push([step.at_ns, value]);
  }
  return points;
}

export class Plots {
  /** In `host`, for `app`, which has `now`, `window`, `nets`, `loads`, `overview`, `lanes` and `changed`. */
  constructor(host, app) {
    [this.host, this.app] = [host, app];
    this.rows = new Map();
  }

  get keys() {
    return [...this.rows.keys()];
  }

  has(key) {
    return this.rows.has(key);
  }

  /** Shows a plot, or takes it away. */
  toggle(key) {
    if (!this.rows.delete(key)) this.rows.set(key, this.row(key));
    this.place();
  }

  /** Shows these plots, and no others. */
  show(keys) {
    this.rows = new Map(keys.map((key) => [key, this.rows.get(key) ?? this.row(key)]));
    this.place();
  }

  place() {
    this.host.replaceChildren(...[...this.rows.values()].map((row) => row.element));
    this.host.hidden = this.rows.size === 0;
    document.body.classList.toggle("plotted", this.rows.size > 0);
    this.app.panes.arrange();
    this.app.remember();
  }

  row(key) {
    const [kind, ...names] = key.split("/").map(decodeURIComponent);
    const title = titleOf(kind, names);
    const value = make("output", {});
    const canvas = make("canvas", { role: "img" });
    const element = make("div", { class: "plot" },
      make("div", { class: "what" }, make("span", { title: names.join(", ") }, title), value,
        make("button", { class: "link", "aria-label": `Remove the plot of ${title}`, title: "Remove this plot", onclick: () => this.toggle(key) }, "✕")), canvas);
    const go = (event) => {
      const box = canvas.getBoundingClientRect();
      const [from, to] = this.app.window();
      const part = (event.clientX - box.left) / Math.max(1, box.width - PLOT_RIGHT);
      this.app.goTo(from + Math.min(1, Math.max(0, part)) * (to - from));
    };
    canvas.addEventListener("pointerdown", go);
    canvas.addEventListener("pointermove", (event) => event.buttons > 0 && go(event));
    return { element, canvas, value, title, kind, names };
  }

  /** What a row shows: its points, its unit, and how a value is written. */
  dataOf({ kind, names: [owner, name, number] }) {
    if (kind === "number") {
      const track = this.app.overview.tracks.get(owner);
      const unit = track ? cellOf(track.head.view, name, number)?.unit ?? "" : "";
      return { points: track ? pointsOfNumber(track, name, number) : [], written: (value) => measure(value, unit), steps: false };
    }
    if (kind === "task") return { points: this.app.loads.points(owner, name), written: OF_TASK[name]?.[1] ?? String, steps: true };
    const net = this.app.nets.get(owner);
    if (kind === "duration") return { points: net ? durations(net, name) : [], written: (value) => measure(value, "s"), steps: true };
    const points = net?.index.places.has(name) ? net.history(name) : [];
    return { points, written: String, steps: true };
  }

  draw() {
    if (this.rows.size === 0) return;
    this.host.style.setProperty("--left", `${this.app.lanes.leftOf(this.host.clientWidth)}px`);
    for (const row of this.rows.values()) this.paint(row, this.dataOf(row));
  }

  paint({ canvas, value, title }, { points, written, steps }) {
    const [width, height] = [canvas.clientWidth, PLOT_HEIGHT];
    const ratio = devicePixelRatio;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = `${height}px`;
    }
    const pen = canvas.getContext("2d");
    const colour = colours();
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const [from, to] = this.app.window();
    const end = Math.max(1, width - PLOT_RIGHT);
    const x = (at) => (end * (at - from)) / Math.max(1, to - from);
    const begin = points.findLastIndex(([at]) => at <= from);
    const stop = points.findIndex(([at]) => at > to);
    const seen = points.slice(Math.max(0, begin), stop < 0 ? points.length : stop + 1);
    const now = this.app.now();
    const last = points.findLast(([at]) => at <= now);
    const text = last ? written(last[1]) : "not known";
    if (value.textContent !== text) value.textContent = text;
    if (seen.length === 0) {
      canvas.setAttribute("aria-label", `${title}: nothing is known at this time`);
      return;
    }
    const values = seen.map(([, one]) => one);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const span = high - low || Math.abs(high) || 1;
    const y = (one) => height - 11 - ((height - 22) * (one - low + (high === low ? span / 2 : 0))) / span;
    pen.strokeStyle = colour.rule;
    pen.lineWidth = 1;
    pen.beginPath();
    for (const one of new Set([low, high])) {
      pen.moveTo(0, Math.round(y(one)) + 0.5);
      pen.lineTo(end, Math.round(y(one)) + 0.5);
    }
    pen.stroke();
    pen.strokeStyle = colour.running;
    pen.lineWidth = 1.5;
    pen.beginPath();
    // A column of pixels has the lowest and the highest value in it, in their order.
    let column = null;
    const flush = () => {
      if (column === null) return;
      for (const one of column.ends) pen.lineTo(column.x, y(one));
    };
    let before = null;
    for (const [at, one] of seen) {
      const place = Math.round(Math.max(0, x(at)) * ratio) / ratio;
      if (steps && before !== null) {
        flush();
        column = null;
        pen.lineTo(place, y(before));
      }
      if (column?.x === place) {
        const [first] = column.ends;
        const all = [...column.ends, one];
        column.ends = [first, Math.min(...all), Math.max(...all), one];
      } else {
        flush();
        column = { x: place, ends: [one] };
      }
      before = one;
    }
    flush();
    // What it was last it still is.
    pen.lineTo(Math.max(0, x(Math.min(to, Math.max(now, seen.at(-1)[0])))), y(seen.at(-1)[1]));
    pen.stroke();
    pen.font = "10.5px ui-sans-serif, system-ui, 'DejaVu Sans', sans-serif";
    pen.fillStyle = colour.soft;
    pen.fillText(written(high), 3, 10);
    if (high !== low) pen.fillText(written(low), 3, height - 2);
    pen.fillStyle = colour.mark;
    if (now >= from && now <= to) pen.fillRect(x(now) - 0.5, 0, 1.5, height);
    canvas.setAttribute("aria-label", `${title}: from ${written(low)} to ${written(high)}; ${text} at the moment shown`);
  }
}
