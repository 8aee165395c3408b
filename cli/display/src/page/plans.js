// Plans: what a task shows, seen from above and flat, with its words, and what people want.

import { make } from "./panels.js";

const PLAN_SVG = "http://www.w3.org/2000/svg";
/** So many of the last words are listed. */
const WORDS_SHOWN = 6;
/** Around what is drawn, m; and how large names are in their parts. */
const MARGIN_M = 0.01;
const NAME_SHARE = 0.3;
/** A part that is surer than this is not marked. */
const SURE = 0.8;

const planned = (name, attributes, ...children) => {
  const made = document.createElementNS(PLAN_SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
};

const short = (...numbers) => numbers.map((one) => Number(one.toFixed(4)));

/** A solid of a part at `[x, y]`, seen from above; y goes up. */
function flat(solid, [x, y], colour, row) {
  const fill = `rgb(${colour.join(" ")})`;
  if (solid.block) {
    const { pose, half } = solid.block;
    const [left, top] = [x + pose.at[0] - half[0], -(y + pose.at[1]) - half[1]];
    return planned("rect", { x: short(left), y: short(top), width: short(2 * half[0]), height: short(2 * half[1]), fill });
  }
  if (solid.cylinder) {
    const { pose, radius } = solid.cylinder;
    return planned("circle", { cx: short(x + pose.at[0]), cy: short(-(y + pose.at[1])), r: radius, fill });
  }
  if (solid.vector) {
    const { first, scale } = solid.vector;
    const [dx, dy] = row.slice(8 + first, 10 + first).map((one) => one * scale);
    const far = Math.hypot(dx, dy);
    if (!(far > 0)) return null;
    const [u, v, tip] = [dx / far, dy / far, 0.018];
    const [ex, ey] = [x + dx, y + dy];
    const back = (side) => short(ex - tip * u - side * tip * 0.6 * v, -(ey - tip * v + side * tip * 0.6 * u)).join(" ");
    return planned("path", { class: "way", d: `M${short(x, -y).join(" ")}L${short(ex, -ey).join(" ")}M${back(1)}L${short(ex, -ey).join(" ")}L${back(-1)}`, stroke: fill });
  }
  return null;
}

/** A part seen from above: its solids, a ring where its number `king` is not 0, and its name where it has a `confidence`. */
function partOf(part, row) {
  const number = (name) => {
    const at = part.numbers.findIndex((one) => one.name === name);
    return at < 0 ? undefined : row[8 + at];
  };
  const at = row.slice(1, 3);
  const solids = part.solids.map((solid) => flat(solid, at, part.colour, row)).filter((one) => one !== null);
  const [confidence, king] = [number("confidence"), number("king")];
  const words = confidence === undefined ? part.name : `${part.name}: ${confidence === null ? "not seen yet" : `${(100 * confidence).toFixed(0)} % sure`}`;
  const group = planned("g", { class: `part ${part.kind.replaceAll(" ", "-")}${king > 0 ? " king" : ""}`, "data-part": part.name }, planned("title", {}, words), ...solids);
  const [round] = part.solids.filter((solid) => solid.cylinder);
  if (king > 0 && round) group.append(planned("circle", { class: "crown", cx: short(at[0]), cy: short(-at[1]), r: round.cylinder.radius * 0.55 }));
  const [block] = part.solids.filter((solid) => solid.block);
  if (confidence !== undefined && block) {
    const [half] = block.block.half;
    group.append(planned("text", { x: short(at[0] - half * 0.95), y: short(-at[1] - half * (1 - 0.9 * NAME_SHARE)), "font-size": half * NAME_SHARE }, part.name));
    if (confidence !== null && confidence < SURE) group.append(planned("rect", { class: "unsure", x: short(at[0] - half * 0.92), y: short(-at[1] - half * 0.92), width: half * 1.84, height: half * 1.84 }));
    // How sure it is, as a line at its lower edge.
    if (confidence !== null) group.append(planned("path", { class: "sure", d: `M${short(at[0] - half, -at[1] + half * 0.92).join(" ")}h${short(2 * half * confidence)}` }));
  }
  return group;
}

/** The plans of an app, and what people want. */
export class Plans {
  /** Beside the scene of `overview`, whose handles without a part stand below the plans. */
  constructor(overview) {
    this.overview = overview;
    this.wanted = false;
    this.all = [];
    /** The tasks that are drawn flat, and not in the scene. */
    this.tasks = new Set();
    this.list = make("div", {});
    this.element = make("div", { class: "plans", hidden: true, "aria-label": "Plans, and what people want" }, this.list, overview.handles?.knobs ?? null);
  }

  get any() {
    return this.all.length > 0 || this.overview.handles.knobs.childElementCount > 0;
  }

  /** These are all of them. */
  show(told) {
    this.tasks = new Set(told.map((one) => one.task));
    this.element.append(this.overview.handles.knobs);
    this.all = told.map((one) => {
      const picture = planned("svg", { class: "plan", role: "img" });
      const words = make("p", { class: "words" });
      const heard = make("ol", { class: "heard", "aria-label": "What was said last" });
      const element = make("section", { "data-plan": one.name }, make("h2", {}, one.title || one.name), picture, words, heard);
      return { told: one, picture, words, heard, element, state: undefined };
    });
    this.list.replaceChildren(...this.all.map((one) => one.element));
    this.element.hidden = !this.wanted || !this.any;
  }

  /** As all of it is at a moment; null: now. */
  draw(moment) {
    if (!this.wanted) return;
    for (const one of this.all) {
      const state = this.overview.tracks.get(one.told.task)?.at(moment) ?? null;
      if (state !== one.state) this.fill(one, state);
      this.listen(one, moment);
    }
  }

  fill(one, state) {
    one.state = state;
    const parts = (state?.view.parts ?? []).map((part, index) => [part, state.rows[index]]).filter(([part, row]) => row && part.solids.length > 0 && !row.slice(0, 8).includes(null));
    one.picture.replaceChildren(...parts.map(([part, row]) => partOf(part, row)));
    const said = state?.said?.words || "nothing is known at this moment";
    one.words.textContent = said;
    one.picture.setAttribute("aria-label", `${one.told.title}: ${said}`);
    if (parts.length === 0) return;
    // All that is there has room in it.
    const reach = ([part, row]) => Math.max(...part.solids.map((solid) => solid.block?.half[0] ?? solid.cylinder?.radius ?? 0));
    const edge = (axis, side) => Math.max(...parts.map((pair) => side * pair[1][1 + axis] + reach(pair)));
    const [left, right, low, high] = [edge(0, -1), edge(0, 1), edge(1, -1), edge(1, 1)].map((far) => far + MARGIN_M);
    one.picture.setAttribute("viewBox", [-left, -high, left + right, low + high].map((number) => number.toFixed(3)).join(" "));
  }

  /** The last different words of a task, the newest first. */
  listen(one, moment) {
    const track = this.overview.tracks.get(one.told.words);
    const state = track?.at(moment) ?? null;
    if (state === one.heardState) return;
    one.heardState = state;
    const words = [];
    for (let at = (state?.position ?? 0) - 1; at >= 0 && words.length < WORDS_SHOWN; at -= 1) {
      const said = track.steps[at]?.said?.words;
      if (said && said !== words.at(-1)) words.push(said);
    }
    const text = words.join("\n");
    if (text === one.heardText) return;
    one.heardText = text;
    one.heard.replaceChildren(...words.map((said) => make("li", {}, said)));
  }
}
