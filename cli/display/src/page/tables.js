// Actions over time, and the table of events.

import { colours } from "./field.js";
import { make, tokens } from "./panels.js";
import { passes, seconds, told, valueOf } from "./model.js";

/** The table shows no more rows than this; filters find the others. While the present goes on it shows fewer, and
 * those often. */
const MOST_ROWS = 150;
const LIVE_ROWS = 40;
const LANE = 17;

// -- lanes ---------------------------------------------------------------------------------

/** Actions over time: a lane for each transition that did something, or for each task. Below them, what data has changed. */
export class Lanes {
  constructor(host, app) {
    [this.host, this.app] = [host, app];
    this.canvas = host.querySelector("canvas");
    this.rows = [];
    /** The canvas is as large as what is seen of the lanes; this makes the rest to scroll over. */
    this.rest = make("div", {});
    host.append(this.rest);
    host.addEventListener("scroll", () => this.paint());
    this.tasks = document.getElementById("by-task");
    this.tasks.onclick = () => this.byTask();
    this.canvas.addEventListener("pointerdown", (event) => this.go(event));
    this.canvas.addEventListener("pointermove", (event) => event.buttons > 0 && this.go(event));
  }

  go(event) {
    const rect = this.canvas.getBoundingClientRect();
    const part = (event.clientX - rect.left - this.left) / (rect.width - this.left - 8);
    const [from, to] = this.app.window();
    if (part >= 0) this.app.goTo(from + Math.min(1, part) * (to - from));
    else {
      const row = this.rows[Math.floor((event.clientY - rect.top - 4 + this.host.scrollTop) / LANE)];
      if (row?.task) this.app.lookAt(row.task);
      else if (row?.key) this.app.choose(row.key);
    }
  }

  byTask() {
    this.tasks.setAttribute("aria-pressed", String(this.tasks.getAttribute("aria-pressed") !== "true"));
    this.draw();
  }

  draw() {
    const { app } = this;
    const byTask = this.tasks.getAttribute("aria-pressed") === "true";
    const rows = new Map();
    for (const net of app.visibleNets()) {
      for (const [transition, bars] of net.lanes()) {
        const one = net.view.transitions[net.index.transitions.get(transition)];
        // Local actions are done by the net's own task.
        const task = one.task ?? (one.target === "" ? null : net.name);
        if (byTask && task === null) continue;
        const [key, name] = byTask ? [task, task] : [`${net.name}/${one.shown}`, one.shown];
        if (!rows.has(key)) rows.set(key, { key, name, task: byTask ? task : null, bars: [] });
        rows.get(key).bars.push(...requestBars(net, transition, bars));
      }
    }
    for (const net of byTask ? [] : app.visibleNets()) {
      for (const [name, spans] of net.changes()) {
        const data = net.view.data[net.index.data.get(name)];
        rows.set(`${net.name} ${name}`, { key: null, name, task: null, bars: [], spans: spans.map((span) => ({ ...span, text: valueOf(data, span.value) })) });
      }
    }
    this.rows = [...rows.values()];
    this.paint();
  }

  /** How wide the names are. */
  leftOf(width) {
    return Math.min(150, width / 3);
  }

  /** The lanes that are seen. */
  paint() {
    const { app, canvas } = this;
    const { clientWidth: width, clientHeight: height } = this.host;
    const ratio = devicePixelRatio;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = `${height}px`;
    }
    this.rest.style.height = `${Math.max(0, this.rows.length * LANE + 8 - height)}px`;
    const top = this.host.scrollTop;
    const pen = canvas.getContext("2d");
    const colour = colours();
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px ui-sans-serif, system-ui, 'DejaVu Sans', sans-serif";
    this.left = this.leftOf(width);
    const [from, to] = app.window();
    const [, end] = app.span();
    const x = (at) => this.left + ((width - this.left - 8) * (at - from)) / Math.max(1, to - from);
    const looks = { started: colour.running, completed: colour.running, failed: colour.failed };
    const first = Math.floor(top / LANE);
    this.rows.slice(first, first + Math.ceil(height / LANE) + 1).forEach(({ key, name, bars, spans }, index) => {
      const y = (first + index) * LANE + 4 - top;
      if ((first + index) % 2 === 1) {
        pen.fillStyle = colour.wash;
        pen.globalAlpha = 0.5;
        pen.fillRect(0, y, width, LANE);
        pen.globalAlpha = 1;
      }
      pen.fillStyle = key !== null && (key === app.chosen || key === app.task) ? colour.mark : colour.soft;
      pen.fillText(clipped(pen, name, this.left - 16), 12, y + 12);
      for (const bar of bars) {
        const until = bar.to ?? end;
        if (until < from || bar.from > to) continue;
        const [a, b] = [Math.max(this.left, x(bar.from)), Math.min(x(until), width - 8)];
        pen.fillStyle = looks[bar.phase] ?? colour.faint;
        if (bar.to === bar.from) pen.fillRect(a, y + 4, 1.5, LANE - 8);
        else pen.fillRect(a, y + 3.5, Math.max(2, b - a), LANE - 7);
        // Without colour: what failed has a cross on it.
        if (bar.phase === "failed") pen.fillText("✕", b + 1, y + 12);
      }
      // A value from one change to the next, as far as there is room for it.
      for (const span of spans ?? []) {
        const until = span.to ?? end;
        if (until < from || span.from > to) continue;
        const [a, b] = [Math.max(this.left, x(span.from)), Math.min(x(until), width - 8)];
        pen.fillStyle = colour.faint;
        pen.fillRect(a, y + 3, 1, LANE - 6);
        pen.fillRect(a, y + LANE - 4, Math.max(1, b - a), 1);
        pen.fillStyle = colour.soft;
        if (b - a > 14) pen.fillText(clipped(pen, span.text, b - a - 6), a + 4, y + 11);
      }
    });
    pen.fillStyle = colour.mark;
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

/** Whether a place is part of a request, and no request comes in by it. */
function hides(net, place) {
  return net.view.places[net.index.places.get(place)]?.wiring === true && !place.startsWith("I_");
}

/** Whether tokens go to another net only because a request is made of that. */
function wires(net, event, { place, net: to }) {
  const one = net.view.transitions[net.index.transitions.get(event.transition)];
  return [...(one?.sends ?? []), ...(one?.fail_sends ?? [])].some((arc) => arc.wiring && arc.place === place && arc.net === to);
}

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
    this.scroller.classList.toggle("one", nets.length === 1);
    const seen = [wanted.value, unwanted.value, app.cursor !== null, app.detail, ...nets.flatMap((net) => [net.name, net.base.seq, app.positionOf(net)])].join("\u0000");
    if (seen === this.seen) return;
    this.seen = seen;
    const found = [];
    for (const net of nets) {
      const until = app.positionOf(net);
      for (let at = until - 1; at >= 0 && found.length < MOST_ROWS * nets.length + 1; at -= 1) {
        const event = net.events[at];
        if (passes(net, event, wanted.value, unwanted.value)) found.push({ net, event, at: at + 1 });
      }
    }
    found.sort((a, b) => b.event.at_ns - a.event.at_ns || b.event.seq - a.event.seq);
    const most = app.cursor === null && app.mode === "live" ? LIVE_ROWS : MOST_ROWS;
    const rows = found.slice(0, most);
    const unfiltered = wanted.value === "" && unwanted.value === "";
    this.count.textContent = found.length > most ? `latest ${most}`
      : rows.length === 0 && unfiltered && app.cursor !== null ? "none until this moment: ▶ goes on" : `${rows.length}`;
    this.body.replaceChildren(...rows.map((row, index) => this.row(row, index === 0)));
  }

  row({ net, event, at }, first) {
    // As in the drawing: what requests are made of is shown with the detail.
    const full = this.app.detail === "full";
    const seen = ([place]) => full || !hides(net, place);
    const [taken, produced] = [event.consumed.filter(seen), event.produced.filter(seen)];
    const sent = event.sent.filter((one) => full || !wires(net, event, one)).map((one) => `${one.place}@${one.net}`);
    const put = [tokens(produced), ...sent].filter((one) => one !== "").join(" + ");
    const moved = taken.length + produced.length + sent.length === 0 ? "" : `${tokens(taken) || "–"} → ${put || "–"}`;
    const read = event.read === null ? "" : `${event.phase === "asked" ? "+ " : ""}${event.read}`;
    const [transition, phase] = told(net, event);
    const cells = [seconds(event.at_ns), event.net, transition, phase, moved, read, event.wrote ?? "", event.text];
    const paused = this.app.cursor !== null;
    return make("tr", { class: `${phase}${paused && first ? " now" : ""}${BY_HAND.has(phase) ? " by-hand" : ""}`, "data-seq": event.seq, tabindex: "0",
      title: [event.target === "" ? "" : `calls ${event.target}`, event.trace === "" ? "" : `trace ${event.trace}`].filter((one) => one !== "").join(", "),
      onclick: () => this.app.goToEvent(net, at), onkeydown: (key) => key.key === "Enter" && this.app.goToEvent(net, at) },
    ...cells.map((cell) => make("td", {}, cell)));
  }
}
