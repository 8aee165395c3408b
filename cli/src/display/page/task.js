// A task as nets see it: how it is, what nets asked of it last, and which transitions do.

import { seconds } from "./model.js";

/** The last messages that are shown. */
const MOST = 10;

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

/** The event that ended what `event` began: of the same firing, or the next end of the same request. */
function endOf(net, event, at, until) {
  const of = (name) => net.view.transitions[net.index.transitions.get(name)];
  const one = of(event.transition);
  const ends = event.firing !== null ? (other) => other.firing === event.firing
    : (other) => other.transition !== "" && of(other.transition).shown === one.shown && ["end", "fail", "back"].includes(of(other.transition).part);
  for (let next = at + 1; next < until; next += 1) if (ends(net.events[next])) return net.events[next];
  return null;
}

/** How a message went, in words. */
export function outcome(net, { event, end }, now_ns) {
  if (end === null) return `for ${seconds(Math.max(0, now_ns - event.at_ns), 1)}`;
  const part = net.view.transitions[net.index.transitions.get(end.transition)].part;
  const failed = end.phase === "failed" || end.phase === "cancelled" || part === "fail" || part === "back";
  return `${failed ? "failed after" : "done in"} ${seconds(end.at_ns - event.at_ns, 2)}`;
}

/** The nodes whose transitions send to a task: `{ net, name }`. */
export function callers(task, nets) {
  const found = new Map();
  for (const net of nets) for (const one of net.view.transitions) if (one.task === task) found.set(`${net.name}/${one.shown}`, { net, name: one.shown });
  return [...found.values()];
}
