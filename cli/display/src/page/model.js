// A net as it is after each of its events, for any moment that is known. Knows nothing of the page.

/** So many events stand between two states that are kept for jumping. */
const STRIDE = 128;

/** A net that is watched for long forgets its oldest events: it keeps between these two numbers. Records are kept whole. */
const MOST_KEPT = 20000;
const LEFT_KEPT = 15000;

/** A copy of a state that shares nothing with it. */
export function copy(state) {
  return {
    ...state,
    places: state.places.slice(),
    running: state.running.map((one) => ({ ...one })),
    tape: state.tape.slice(),
    ended: state.ended.slice(),
    failed: state.failed.slice(),
    busy_ns: state.busy_ns.slice(),
    data: state.data.slice(),
  };
}

/** The numbers of places, transitions and values of data by their names. */
export function indexOf(view) {
  const index = (list) => new Map(list.map((one, number) => [one.name, number]));
  return { places: index(view.places), transitions: index(view.transitions), data: index(view.data) };
}

/** Changes `state` by one event. The rules are those of `pnt::stream::Replica`. */
export function apply(state, event, index) {
  for (const [name, tokens] of event.consumed) state.places[index.places.get(name)] -= tokens;
  for (const [name, tokens] of event.produced) state.places[index.places.get(name)] += tokens;
  for (const [name, value] of event.data) state.data[index.data.get(name)] = value;
  state.seq = event.seq;
  state.at_ns = event.at_ns;
  const number = index.transitions.get(event.transition);
  if (event.phase === "started") {
    const { transition, firing, at_ns } = event;
    state.running.push({ transition, firing, since_ns: at_ns });
  } else if (event.firing !== null) {
    const at = state.running.findIndex((one) => one.firing === event.firing);
    if (at >= 0) {
      state.busy_ns[number] += event.at_ns - state.running[at].since_ns;
      state.running.splice(at, 1);
    }
  }
  if (event.phase === "fired" || event.phase === "completed") state.ended[number] += 1;
  if (event.phase === "failed") state.failed[number] += 1;
  if (event.phase === "asked") state.tape.push(event.read);
  else if (event.read !== null) {
    if (event.phase === "failed" || event.phase === "cancelled") {
      state.in_progress = null;
      state.tape.unshift(event.read);
    } else if (state.tape.length > 0) state.in_progress = state.tape.shift();
  }
  if (event.wrote !== null) state.in_progress = null;
  if (event.phase === "paused") state.paused = event.text;
  if (event.phase === "resumed") state.paused = null;
  if (event.phase === "stopped") state.stopped = event.text;
}

/** The last position in `list` whose `key` is at most `value`; -1 when there is none. */
export function lastAtMost(list, value, key) {
  let low = 0;
  let high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (key(list[middle]) <= value) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** One net with all that is known of its past. */
export class Net {
  constructor({ view, written, full, base, notes = [] }) {
    this.view = view;
    this.written = written;
    this.full = full;
    this.notes = notes;
    this.index = indexOf(view);
    this.gone = null;
    this.breakpoints = [];
    this.reset(base);
  }

  get name() {
    return this.view.name;
  }

  /** Forgets the past; the net is as `base`. */
  reset(base) {
    this.base = copy(base);
    this.head = copy(base);
    this.events = [];
    this.jumps = [];
    this.kept = [{ position: 0, state: copy(base) }];
    this.skipped = 0;
    this.forgotten = 0;
  }

  /** Forgets what is older than the latest events, if there are too many; how many were forgotten. */
  forget() {
    if (this.events.length <= MOST_KEPT) return 0;
    const cut = this.events.length - LEFT_KEPT;
    this.base = copy(this.stateAt(cut));
    this.events = this.events.slice(cut);
    const later = (list) => list.filter((one) => one.position > cut).map((one) => ({ ...one, position: one.position - cut }));
    this.jumps = later(this.jumps);
    this.kept = [{ position: 0, state: copy(this.base) }, ...later(this.kept)];
    this.forgotten += cut;
    return cut;
  }

  /** The next events. Returns how many were new. */
  follow(events) {
    let count = 0;
    for (const event of events) {
      if (event.seq !== this.head.seq + 1) continue;
      apply(this.head, event, this.index);
      this.events.push(event);
      count += 1;
      if (this.events.length % STRIDE === 0) {
        this.kept.push({ position: this.events.length, state: copy(this.head) });
      }
    }
    return count;
  }

  /** The net is as `state`, and `skipped` events before that are not known. */
  jump(state, skipped) {
    this.skipped += skipped;
    this.head = copy(state);
    this.jumps.push({ position: this.events.length, at_ns: state.at_ns, skipped });
    this.kept.push({ position: this.events.length, state: copy(state) });
  }

  /** How many events there were up to `at_ns`. */
  positionAt(at_ns) {
    return lastAtMost(this.events, at_ns, (event) => event.at_ns) + 1;
  }

  /** The state after the first `position` known events. */
  stateAt(position) {
    if (position >= this.events.length) return this.head;
    const kept = this.kept[Math.max(0, lastAtMost(this.kept, position, (one) => one.position))];
    const state = copy(kept.state);
    for (let at = kept.position; at < position; at += 1) apply(state, this.events[at], this.index);
    return state;
  }

  /** When the first known moment is, and the last one. */
  get span() {
    return [this.base.at_ns, Math.max(this.head.at_ns, this.base.at_ns)];
  }

  /** From when to when the actions of each transition went on; the end of one that still does is null. */
  lanes() {
    const lanes = new Map();
    const open = new Map();
    const add = (transition, bar) => {
      if (!lanes.has(transition)) lanes.set(transition, []);
      lanes.get(transition).push(bar);
      return bar;
    };
    for (const one of this.base.running) {
      open.set(one.firing, add(one.transition, { from: one.since_ns, to: null, phase: "started" }));
    }
    this.events.forEach((event, position) => {
      if (event.transition === "") return;
      if (event.phase === "started") {
        open.set(event.firing, add(event.transition, { from: event.at_ns, to: null, phase: "started", position }));
      } else if (event.phase === "fired") {
        add(event.transition, { from: event.at_ns, to: event.at_ns, phase: "fired", position });
      } else if (open.has(event.firing)) {
        Object.assign(open.get(event.firing), { to: event.at_ns, phase: event.phase });
        open.delete(event.firing);
      }
    });
    return lanes;
  }

  /** From when to when declared data had each of its values, by name; only of data that has changed. The end of what it is
   * now is null. */
  changes() {
    const changes = new Map();
    this.events.forEach((event, position) => {
      for (const [name, value] of event.data) {
        if (!changes.has(name)) changes.set(name, [{ from: this.base.at_ns, to: null, value: this.base.data[this.index.data.get(name)], position: 0 }]);
        const spans = changes.get(name);
        spans.at(-1).to = event.at_ns;
        spans.push({ from: event.at_ns, to: null, value, position: position + 1 });
      }
    });
    return changes;
  }

  /** Tokens of a place over time: moments and what they were from then on. */
  history(place) {
    const number = this.index.places.get(place);
    const points = [[this.base.at_ns, this.base.places[number]]];
    let tokens = this.base.places[number];
    for (const event of this.events) {
      let moved = 0;
      for (const [name, count] of event.consumed) if (name === place) moved -= count;
      for (const [name, count] of event.produced) if (name === place) moved += count;
      if (moved !== 0) {
        tokens += moved;
        points.push([event.at_ns, tokens]);
      }
    }
    return points;
  }
}

/**
 * What a transition waits for, in words; `state` is "running", "enabled" or "waiting", and `free` says that only a guard or
 * the net itself may keep it from firing.
 * `transition` is one of the net's view.
 */
export function standing(net, state, transition) {
  const running = state.running.filter((one) => one.transition === transition.name);
  const place = (arc) => net.view.places[arc.place].name;
  const tokens = (arc) => state.places[arc.place];
  const some = (count) => (count === 1 ? "a token" : `${count} tokens`);
  const lacks = [];
  for (const arc of transition.inputs) {
    const missing = arc.weight - tokens(arc);
    if (missing > 0) lacks.push(`${some(missing)} missing in ${place(arc)}`);
  }
  for (const arc of transition.reads) {
    const missing = arc.weight - tokens(arc);
    if (missing > 0) lacks.push(`${some(missing)} to be seen in ${place(arc)}`);
  }
  for (const arc of transition.inhibitors) {
    if (tokens(arc) >= arc.weight) lacks.push(`${place(arc)} must be ${arc.weight === 1 ? "empty" : `below ${arc.weight}`}`);
  }
  if (transition.tape !== null && (state.in_progress !== null || state.tape[0] !== transition.tape)) {
    lacks.push(state.in_progress !== null
      ? `symbol ${transition.tape} is awaited, after the answer to ${state.in_progress}`
      : `symbol ${transition.tape} is awaited on the tape`);
  }
  const free = lacks.length === 0;
  if (running.length > 0) {
    const task = transition.task === null ? "" : ` at task ${transition.task}`;
    return { state: "running", running, free, words: `action ${transition.target} is pending${task}` };
  }
  if (lacks.length > 0) return { state: "waiting", running, free, words: lacks.join("; ") };
  if (state.stopped !== null) return { state: "waiting", running, free, words: "the net has stopped" };
  if (state.paused !== null) return { state: "enabled", running, free, words: `the net is paused: ${state.paused}` };
  if (transition.when !== null) return { state: "waiting", running, free, words: `guard ${transition.when} is false` };
  return { state: "enabled", running, free, words: "enabled" };
}

/** The standing of a drawn node, which may be the several parts of a request. */
export function nodeStanding(net, state, node) {
  const [parts, active] = node.kind.transition;
  const transitions = parts.map((number) => net.view.transitions[number]);
  if (active !== null && state.places[active] > 0) {
    const start = transitions[0];
    const running = runningSince(net, state, start);
    const task = start.task ?? "its coordinator";
    return { state: "running", running, words: `request ${node.name} is pending at ${task}` };
  }
  const standings = transitions.map((one) => standing(net, state, one));
  const found = standings.find((one) => one.state === "running") ?? standings.find((one) => one.state === "enabled");
  return found ?? standings[0];
}

/** The standing of a subnet that is drawn as one node. */
export function foldStanding(net, state, [places, transitions]) {
  const standings = transitions.map((transition) => nodeStanding(net, state, { name: "", kind: { transition } }));
  const count = (word) => standings.filter((one) => one.state === word).length;
  const tokens = places.reduce((sum, place) => sum + state.places[place], 0);
  const [running, enabled] = [count("running"), count("enabled")];
  return {
    state: running > 0 ? "running" : enabled > 0 ? "enabled" : "waiting", tokens,
    words: `${tokens} token${tokens === 1 ? "" : "s"}, ${running} running, ${enabled} enabled, of ${transitions.length} transitions`,
  };
}

/** When the request that `start` began was begun, as far as it is known. */
function runningSince(net, state, start) {
  const position = lastAtMost(net.events, state.seq, (event) => event.seq);
  for (let at = position; at >= 0; at -= 1) {
    const event = net.events[at];
    if (event.transition === start.name) return [{ transition: start.name, since_ns: event.at_ns }];
  }
  return [{ transition: start.name, since_ns: net.base.at_ns }];
}

/** A value of declared data as a person reads it; `data` is one of the net's view. */
export function valueOf({ kind }, value) {
  if (kind === "text") return `"${value}"`;
  return ["int", "float", "bool"].includes(kind) ? value : `${value} ${kind}`;
}

/** Seconds, as a person reads them. */
export function seconds(ns, digits = 3) {
  return `${(ns / 1e9).toFixed(digits)} s`;
}

/** What people call a transition: a request by its author's name, and its ends by their own. */
export function called(transition) {
  return transition.part === "start" ? transition.shown : transition.name;
}

/** What an event says to a person: the transition as its author wrote it, and what happened to it. The parts of a request
 * fire in one step each. */
export function told(net, event) {
  const one = net.view.transitions[net.index.transitions.get(event.transition)];
  if (one === undefined) return [event.transition, event.phase];
  const happened = event.phase === "fired" ? { start: "started", end: "completed", fail: "failed", back: "failed" }[one.part] : undefined;
  return [one.shown, happened ?? event.phase];
}

/** Whether an event has all of the words that are wanted and none of those that are not. */
export function passes(net, event, wanted, unwanted) {
  const text = [event.net, ...told(net, event), event.text, event.read ?? "", event.wrote ?? "", event.target,
    ...event.consumed.map(([place]) => place), ...event.produced.map(([place]) => place)].join(" ").toLowerCase();
  const words = (list) => list.toLowerCase().split(/\s+/).filter((word) => word !== "");
  return words(wanted).every((word) => text.includes(word)) && !words(unwanted).some((word) => text.includes(word));
}
