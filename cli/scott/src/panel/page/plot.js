// Numbers over time: floats of an answer, or of the records of a snapshot buffer.

import { card, el, order, poll, short } from "./base.js";

const NS = "http://www.w3.org/2000/svg";
/** Whole numbers that `shmem_r` answers for each record. */
const PER_RECORD = 6;
/** Of records within such a time only the least and the largest numbers are shown, s. */
const TOGETHER = 0.025;

function svg(tag, attributes) {
  const node = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

/** The records of an answer that are newer than number `after`: number, time (s) and floats. */
function records({ floats, ints }, after) {
  const count = ints.length / PER_RECORD;
  const width = floats.length / count;
  const all = Array.from({ length: count }, (_, i) => ({
    number: ints[i * PER_RECORD], time: ints[i * PER_RECORD + 1] / 1e9, floats: floats.slice(i * width, (i + 1) * width),
  }));
  // A buffer that was made anew begins to count anew.
  const anew = all.length && all.at(-1).number < after;
  return { anew, rows: anew ? all : all.filter(({ number }) => number > after) };
}

/** A plot; a click on a name in its legend hides that line, and shows it again. */
export function plot({ label, ask: line, every_s, floats: [first, last], less, records: recorded, begin, scale, names, unit }, { control }) {
  const count = last - first + 1;
  const seconds = recorded ? 10 : 30;
  const area = svg("svg", { class: "plot", role: "img", "aria-label": label });
  const paths = Array.from({ length: count }, (_, i) => svg("path", { class: `s${(i % 6) + 1}` }));
  const zero = svg("line", { class: "axis" });
  const top = svg("text", { x: 4, y: 12 });
  const bottom = svg("text", { x: 4 });
  area.append(zero, ...paths, top, bottom);
  const shown = Array.from({ length: count }, () => el("span"));
  const hidden = new Set();
  const legend = el("ul", { class: "legend" }, ...shown.map((span, i) => {
    const button = el("button", { type: "button", class: "shows", "aria-pressed": "true", title: "hide or show this line" },
      el("i", { class: `s${(i % 6) + 1}` }), `${names[i] ?? i + 1} `, span);
    button.addEventListener("click", () => {
      if (!hidden.delete(i)) hidden.add(i);
      button.setAttribute("aria-pressed", String(!hidden.has(i)));
      draw();
    });
    return el("li", {}, button);
  }));
  const why = el("p", { class: "help nothing" });

  const points = [];
  let after = -1;
  const value = (floats, i) => (floats[first - 1 + i] - (less ? floats[less[0] - 1 + i] : 0)) * scale;
  const add = (time, floats) => {
    const values = paths.map((_, i) => value(floats, i));
    const point = points.at(-1);
    if (recorded && point && time - point.time < TOGETHER) {
      values.forEach((one, i) => {
        point.low[i] = Math.min(point.low[i], one);
        point.high[i] = Math.max(point.high[i], one);
        point.last[i] = one;
      });
    } else points.push({ time, low: values, high: [...values], last: [...values] });
    shown.forEach((span, i) => { span.textContent = Number.isFinite(values[i]) ? short(values[i]) : "–"; });
  };
  const draw = () => {
    const now = points.at(-1)?.time;
    if (now === undefined) return;
    while (points[0].time < now - seconds) points.shift();
    const { width, height } = area.getBoundingClientRect();
    const seen = paths.map((_, i) => i).filter((i) => !hidden.has(i));
    let low = Infinity, high = -Infinity;
    for (const point of points) for (const i of seen) {
      low = Math.min(low, point.low[i]);
      high = Math.max(high, point.high[i]);
    }
    if (!Number.isFinite(high - low)) [low, high] = [0, 0];
    const margin = Math.max((high - low) * 0.08, 0.02);
    const y = (one) => height - 4 - ((one - low + margin) / (high - low + 2 * margin)) * (height - 8);
    const x = (time) => width - ((now - time) / seconds) * width;
    paths.forEach((path, i) => {
      // From the one end of what it was to the other, where it is last.
      const ends = ({ low, high, last }) => (high[i] - last[i] < last[i] - low[i] ? [low[i], high[i]] : [high[i], low[i]]);
      const at = (point) => [...new Set(ends(point))].map((one) => `${x(point.time).toFixed(1)} ${y(one).toFixed(1)}`).join("L");
      // Nothing is drawn over a time of which nothing is known.
      const known = (n) => n > 0 && (!recorded || points[n].time - points[n - 1].time < 4 * TOGETHER);
      path.setAttribute("d", hidden.has(i) ? "" : points.map((point, n) => `${known(n) ? "L" : "M"}${at(point)}`).join(""));
    });
    for (const [name, number] of Object.entries({ x1: 0, x2: width, y1: y(0), y2: y(0) })) zero.setAttribute(name, number);
    top.textContent = `${short(high + margin)} ${unit}`;
    bottom.textContent = `${short(low - margin)} ${unit}`;
    bottom.setAttribute("y", height - 6);
  };
  const nothing = (text) => {
    why.textContent = text;
    section.classList.toggle("empty", points.length === 0);
  };
  const take = (reply) => {
    if (recorded) {
      const { anew, rows } = records(reply, after);
      if (anew) points.length = 0;
      for (const row of rows) add(row.time, row.floats);
      after = rows.at(-1)?.number ?? after;
    } else if (reply.floats.length >= last) add(performance.now() / 1000, reply.floats);
    nothing(points.length ? "" : "There are no such numbers.");
    draw();
  };
  const section = card(label, `${seconds} s`, area, legend, why);
  section.classList.add("wide", "empty");
  const begun = begin && control ? order(begin) : Promise.resolve();
  begun.then(() => poll(line, every_s, take, recorded ? nothing : undefined));
  return section;
}
