// Numbers of tasks and transitions over time: what waits for a task, how much it handles, and how long actions take.

import { told } from "./model.js";

/** So many moments of the app's tasks are kept: an hour. */
const MOMENTS = 3600;

/** What can be plotted of a task: its words, how a value is told, and the words where there is little room. */
export const OF_TASK = {
  queue: ["messages waiting", String, "waiting"],
  rate: ["messages handled a second", (value) => value.toFixed(value < 10 ? 1 : 0), "a second"],
  time: ["time of a message", (value) => `${(1e3 * value).toFixed(value < 0.01 ? 2 : 0)} ms`, "time"],
};

export class Loads {
  constructor() {
    this.moments = [];
  }

  /** How all tasks are at a moment: for each its name, what waits, what it has handled, and for how long, s. */
  take({ at_ns, tasks }) {
    this.moments.push({ at_ns, tasks: new Map(tasks.map(([name, ...counts]) => [name, counts])) });
    if (this.moments.length > MOMENTS) this.moments.shift();
  }

  /** Moments and what a number of a task was from then on. */
  points(name, what) {
    const points = [];
    let before = null;
    for (const { at_ns, tasks } of this.moments) {
      const now = tasks.get(name);
      if (now === undefined) continue;
      const [queue, handled, busy] = now;
      // A task that began anew counts anew.
      const since = before !== null && handled >= before.handled ? { handled: handled - before.handled, busy: busy - before.busy, s: (at_ns - before.at_ns) / 1e9 } : null;
      if (what === "queue") points.push([at_ns, queue]);
      else if (what === "rate" && since !== null && since.s > 0) points.push([at_ns, since.handled / since.s]);
      else if (what === "time" && since !== null && since.handled > 0) points.push([at_ns, Math.max(0, since.busy) / since.handled]);
      before = { at_ns, handled, busy };
    }
    return points;
  }
}

/** When actions of a node of a net ended, and how long each took, s. */
export function durations(net, name) {
  const begun = new Map();
  const points = [];
  for (const event of net.events) {
    const [shown, happened] = told(net, event);
    if (shown !== name) continue;
    // A request has one action at a time, whose parts are firings of their own.
    const action = event.phase === "fired" ? name : event.firing;
    if (happened === "started") begun.set(action, event.at_ns);
    else if (["completed", "failed", "cancelled"].includes(happened) && begun.has(action)) {
      points.push([event.at_ns, (event.at_ns - begun.get(action)) / 1e9]);
      begun.delete(action);
    }
  }
  return points;
}
