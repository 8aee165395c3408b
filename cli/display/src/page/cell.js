// What is known of the scene and of pictures, for any moment. Knows nothing of the page.

import { lastAtMost } from "./model.js";

/** So many steps stand between two states that are kept for jumping. */
const STEPS_STRIDE = 64;
/** A scene that is watched for long forgets its oldest steps, and a camera its oldest pictures. */
const MOST_STEPS = 24000;
const LEFT_STEPS = 20000;
const MOST_PICTURES = 400;
/** So many steps back the way of a tool is shown. */
const TRAIL = 500;

/** What one task shows of the scene. A row is the index of a part, its origin, its turn as x, y, z, w, then its numbers. */
export class SceneTrack {
  constructor(source, steps, gone) {
    this.source = source;
    this.gone = gone;
    this.steps = [];
    this.kept = [];
    this.head = { at_ns: 0, view: { layer: "measured", parts: [] }, rows: [], said: null, position: 0 };
    steps.forEach((step) => this.take(step));
  }

  take(step) {
    this.head = SceneTrack.after(this.head, step);
    this.steps.push(step);
    this.head.position = this.steps.length;
    if (this.steps.length % STEPS_STRIDE === 1) this.kept.push(this.head);
    if (this.steps.length > MOST_STEPS) this.forget(this.steps.length - LEFT_STEPS);
  }

  static after(state, step) {
    const rows = step.view ? [] : state.rows.slice();
    for (const row of step.moved) rows[row[0]] = row;
    return { at_ns: step.at_ns, view: step.view ?? state.view, rows, said: step.said ?? state.said };
  }

  forget(cut) {
    const first = this.stateOf(cut);
    this.steps = this.steps.slice(cut);
    const later = this.kept.filter((one) => one.position > cut).map((one) => ({ ...one, position: one.position - cut }));
    this.kept = [{ ...first, position: 0 }, ...later];
    this.head = { ...this.head, position: this.steps.length };
  }

  /** The state after the first `position` steps; null before the first. */
  stateOf(position) {
    if (position >= this.steps.length) return this.head;
    const at = lastAtMost(this.kept, position, (one) => one.position);
    if (at < 0) return null;
    let state = this.kept[at];
    for (let next = state.position; next < position; next += 1) state = { ...SceneTrack.after(state, this.steps[next]), position: next + 1 };
    return state;
  }

  /** The state at a moment, null when it is not known; `null` as the moment is the present. */
  at(at_ns) {
    if (this.steps.length === 0) return null;
    if (at_ns === null) return this.head;
    const position = lastAtMost(this.steps, at_ns, (step) => step.at_ns) + 1;
    if (this.last?.position !== position || this.last?.of !== this.steps) this.last = { position, of: this.steps, state: this.stateOf(position) };
    return this.last.state;
  }

  /** Where a part was, up to a state. */
  trail(part, state) {
    const points = [];
    for (let at = Math.max(0, state.position - TRAIL); at < state.position; at += 1) {
      const row = this.steps[at].moved.find((one) => one[0] === part);
      if (row) points.push(row.slice(1, 4));
    }
    return points;
  }

  get span() {
    return this.steps.length === 0 ? [Infinity, -Infinity] : [this.steps[0].at_ns, this.head.at_ns];
  }
}

/** The pictures of all cameras. */
export class Pictures {
  constructor() {
    this.cameras = new Map();
  }

  take(picture) {
    const all = this.cameras.get(picture.camera) ?? [];
    this.cameras.set(picture.camera, all);
    if (all.at(-1)?.number === picture.number) all.pop();
    all.push(picture);
    if (all.length > MOST_PICTURES) all.shift();
  }

  /** The last picture of a camera up to a moment, null when there is none. */
  at(camera, at_ns) {
    const all = this.cameras.get(camera) ?? [];
    return all[at_ns === null ? all.length - 1 : lastAtMost(all, at_ns, (one) => one.at_ns)] ?? null;
  }
}

/** How far the whole job is at a moment, and how long it will take, ns; null when nobody says. */
export function jobOf(tracks, at_ns) {
  for (const track of tracks) {
    const state = track.at(at_ns);
    const job = state?.said?.job;
    if (!job || job.total === 0) continue;
    const begun = track.steps.findLast((step) => step.said?.job && (step.said.job.done === 0 || step.said.job.total !== job.total) && step.at_ns <= state.at_ns) ?? track.steps.find((step) => step.said?.job);
    const last = track.steps.findLast((step) => step.said?.job && step.at_ns <= state.at_ns);
    const [made, took] = [job.done - begun.said.job.done, last.at_ns - begun.at_ns];
    const left = made > 1 && took > 0 ? ((job.total - job.done) * took) / made : null;
    return { ...job, left, since: last.at_ns };
  }
  return null;
}

/** A number with its unit, as a person reads it: angles in degrees. */
export function measure(value, unit) {
  if (value === null || value === undefined) return "not known";
  const turned = unit.startsWith("rad");
  const shown = turned ? (value * 180) / Math.PI : value;
  const digits = unit === "m" || unit === "rad" ? 2 : 1;
  const text = unit === "m" ? `${(shown * 1000).toFixed(1)} mm` : `${shown.toFixed(digits)}${turned ? "°" : ` ${unit}`}${unit === "rad/s" ? "/s" : ""}`;
  return text.replace(/^-(0(\.0+)?)(?![\d.])/, "$1").replace("-", "−");
}
