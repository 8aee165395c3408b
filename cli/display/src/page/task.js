// A task: what it handled last, as it says itself and as nets know it, what the log says of it, and which
// transitions ask it.

import { seconds } from "./model.js";

/** The last messages that are shown. */
const MOST = 8;

/** What nets sent to a task up to the moment shown, latest first: `{ net, event, at, end }`, where `end` is the event that
 * ended it, if one did. */
export function messagesTo(task, nets, positionOf) {
  const found = [];
  for (const net of nets) {
    const calls = new Set(net.view.transitions.filter((one) => one.task === task).map((one) => one.name));
    if (calls.size === 0) continue;
    const until = positionOf(net);
    let count = 0;
    for (let at = until - 1; at >= 0 && count < MOST; at -= 1) {
      const event = net.events[at];
      if (!calls.has(event.transition) || (event.phase !== "started" && event.phase !== "fired")) continue;
      found.push({ net, event, at: at + 1, end: endOf(net, event, at, until) });
      count += 1;
    }
  }
  found.sort((a, b) => b.event.at_ns - a.event.at_ns);
  return found.slice(0, MOST);
}

/** What a task handled up to `now_ns`, as it tells itself, latest first. */
export function lastOf(task, now_ns) {
  return (task?.messages ?? []).filter((one) => one.at_ns <= now_ns).slice(-MOST).reverse();
}

/** What the log said of a task up to `now_ns`, latest first, in words. */
export function linesOf(task, now_ns) {
  const said = (task?.lines ?? []).filter((one) => one.at_ns <= now_ns).slice(-MOST).reverse();
  return said.map(({ at_ns, level, text }) => ({ at_ns, words: level === "info" ? "" : level, more: text, failed: level === "error" }));
}

/** A message as the task tells it, in words, at `now_ns`. */
export function ofTask({ from, command, at_ns, took_ns, failed }, now_ns) {
  const ended = took_ns !== null && at_ns + took_ns <= now_ns;
  const how = !ended ? `for ${brief(now_ns - at_ns)}` : failed === null ? `done in ${brief(took_ns)}` : `failed after ${brief(took_ns)}: ${failed}`;
  return { words: command, more: `from ${from}, ${how}`, failed: ended && failed !== null };
}

/** A duration, in the unit that a person would choose. */
const brief = (ns) => (ns < 0 ? brief(0) : ns >= 1e8 ? seconds(ns, 2) : ns >= 1e5 ? `${(ns / 1e6).toFixed(1)} ms` : `${(ns / 1e3).toFixed(0)} µs`);

/** The event that ended what `event` began: of the same firing, or the next end of the same request. */
function endOf(net, event, at, until) {
  const of = (name) => net.view.transitions[net.index.transitions.get(name)];
  const one = of(event.transition);
  const ends = event.firing !== null ? (other) => other.firing === event.firing
    : (other) => other.transition !== "" && of(other.transition).shown === one.shown && ["end", "fail", "back"].includes(of(other.transition).part);
  for (let next = at + 1; next < until; next += 1) if (ends(net.events[next])) return net.events[next];
  return null;
}

/** A message as the net knows it that sent it, in words, at `now_ns`. */
export function ofNet({ net, event, end }, now_ns) {
  const of = (name) => net.view.transitions[net.index.transitions.get(name)];
  const words = event.target.split(".").at(-1) || of(event.transition).shown;
  const part = end === null ? null : of(end.transition).part;
  const failed = end !== null && (["failed", "cancelled"].includes(end.phase) || ["fail", "back"].includes(part));
  const how = end === null ? `for ${brief(now_ns - event.at_ns)}` : `${failed ? "failed after" : "done in"} ${brief(end.at_ns - event.at_ns)}`;
  return { at_ns: event.at_ns, words, more: `from ${net.name}, ${how}`, failed };
}

/** The nodes of other nets that put tokens into a place: it is one place for all of them. */
export function sendersTo(net, place, nets) {
  const found = new Map();
  for (const other of nets) {
    for (const one of other.view.transitions) {
      const sends = [...one.sends, ...one.fail_sends].some((arc) => arc.net === net && arc.place === place);
      if (sends) found.set(`${other.name}/${one.shown}`, { net: other, name: one.shown });
    }
  }
  return [...found.values()];
}

/** The nodes whose transitions send to a task: `{ net, name }`. */
export function callers(task, nets) {
  const found = new Map();
  for (const net of nets) for (const one of net.view.transitions) if (one.task === task) found.set(`${net.name}/${one.shown}`, { net, name: one.shown });
  return [...found.values()];
}
