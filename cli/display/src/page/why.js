// Why the whole waits: from the command in progress along requests, nets and tasks to whoever is at work. Knows nothing of
// the page.

import { nodeStanding, seconds } from "./model.js";

/** Nobody reads a longer chain. */
const LONGEST_CHAIN = 8;

/** The net whose command is in progress; of several, one that is shown, or the first. */
export function busyNet(nets, shown, stateOf) {
  const busy = [...nets.values()].filter((net) => stateOf(net).in_progress !== null);
  return busy.find((net) => shown.includes(net)) ?? busy[0] ?? null;
}

/** What has gone on longest in a net: the drawn node and since when; `null` when nothing does. */
function longest(net, state) {
  let found = null;
  for (const node of net.written.nodes) {
    if (!("transition" in node.kind)) continue;
    const standing = nodeStanding(net, state, node);
    if (standing.state !== "running" || standing.running.length === 0) continue;
    const since_ns = Math.min(...standing.running.map((one) => one.since_ns));
    if (found === null || since_ns < found.since_ns) found = { node, since_ns };
  }
  return found;
}

/** How long a node's action takes on average, ns; 0 when that is not known. */
function averageOf(net, state, node) {
  const parts = node.kind.transition[0];
  const sum = (list) => parts.reduce((all, number) => all + list[number], 0);
  return sum(state.busy_ns) / Math.max(1, sum(state.ended) + sum(state.failed));
}

/**
 * The chain from `first` on, in words: "dispatcher waits for motion, which waits for planner: 1.2 s to go". `nowOf` tells of a
 * task what it does now, as far as that is known.
 */
export function whyOf(first, nets, stateOf, nowOf, now_ns) {
  const parts = [];
  const say = (words) => parts.push(parts.length === 0 ? `${first.name} ${words}` : `which ${words}`);
  let [name, time] = [first.name, ""];
  for (const seen = new Set(); !seen.has(name) && seen.size < LONGEST_CHAIN;) {
    seen.add(name);
    const net = nets.get(name);
    const task = nowOf(name);
    const wait = task?.waits[0];
    if (net === undefined) {
      if (task?.until_ns) time = `${seconds(Math.max(0, task.until_ns - now_ns), 1)} to go`;
      if (wait === undefined && task?.at) say(task.at);
      if (wait === undefined) break;
      say(`waits for ${wait.to}`);
      name = wait.to;
      continue;
    }
    const state = stateOf(net);
    const halted = state.stopped !== null ? `has stopped: ${state.stopped}` : state.paused !== null ? `is paused: ${state.paused}` : null;
    const at = halted === null ? longest(net, state) : null;
    if (at === null) {
      say(halted ?? "goes on");
      break;
    }
    const [elapsed, average] = [now_ns - at.since_ns, averageOf(net, state, at.node)];
    time = average > elapsed ? `about ${seconds(average - elapsed, 1)} to go` : `for ${seconds(Math.max(0, elapsed), 1)}`;
    // A function of the net's own task may ask others in its turn.
    const to = net.view.transitions[at.node.kind.transition[0][0]].task ?? wait?.to;
    say(to === undefined ? `is at ${at.node.name}` : `waits for ${to}`);
    if (to === undefined) break;
    name = to;
  }
  return time === "" ? parts.join(", ") : `${parts.join(", ")}: ${time}`;
}
