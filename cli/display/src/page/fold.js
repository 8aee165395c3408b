// Subnets drawn as one node each, arcs between nets, and what a net would do if. Knows nothing of the page.

import { Net, standing } from "./model.js";

/** The instances of subnets in a drawing: nodes `left.grip` and `left.open` are of `left`. */
export function subnetsOf(drawing) {
  const names = new Set();
  for (const { name, kind } of drawing.nodes) {
    const parts = "remote" in kind ? [] : name.split(".");
    for (let depth = 1; depth < parts.length; depth += 1) names.add(parts.slice(0, depth).join("."));
  }
  return [...names].sort();
}

/** Drawings of nets beside each other, each as its author laid it out: in rows of two, or of three when there are no more. */
export function sideBySide(drawings) {
  const [columns, gap] = [drawings.length <= 3 ? drawings.length : 2, 140];
  let [left, top, bottom] = [0, 0, 0];
  return drawings.map((drawing, at) => {
    if (at % columns === 0) [left, top] = [0, at === 0 ? 0 : bottom + gap];
    const [xs, ys] = [drawing.nodes.map((node) => node.x), drawing.nodes.map((node) => node.y)];
    const [dx, dy] = [left - Math.min(...xs), top - Math.min(...ys)];
    left = Math.max(...xs) + dx + gap;
    bottom = Math.max(bottom, Math.max(...ys) + dy);
    return {
      ...drawing,
      nodes: drawing.nodes.map((node) => ({ ...node, x: node.x + dx, y: node.y + dy })),
      arcs: drawing.arcs.map((arc) => ({ ...arc, via: arc.via.map(([x, y]) => [x + dx, y + dy]) })),
    };
  });
}

/** The drawing with each of the subnets in `folded` as one node in the middle of its own. */
export function fold(drawing, folded) {
  const into = ({ name, kind }) => ("remote" in kind ? undefined : [...folded].sort((a, b) => a.length - b.length).find((one) => name.startsWith(`${one}.`)));
  const nodes = [];
  const boxes = new Map();
  const place = drawing.nodes.map((node) => {
    const subnet = into(node);
    if (subnet === undefined) return nodes.push(node) - 1;
    if (!boxes.has(subnet)) {
      const box = { name: subnet, kind: { fold: [[], []] }, x: 0, y: 0, count: 0, label: "below", lying: false, pinned: false };
      boxes.set(subnet, [nodes.push(box) - 1, box]);
    }
    const [at, box] = boxes.get(subnet);
    const [places, transitions] = box.kind.fold;
    if ("place" in node.kind) places.push(node.kind.place);
    else transitions.push(node.kind.transition);
    [box.x, box.y, box.count] = [box.x + node.x, box.y + node.y, box.count + 1];
    return at;
  });
  for (const [, box] of boxes.values()) [box.x, box.y] = [Math.round(box.x / box.count), Math.round(box.y / box.count)];
  const seen = new Set();
  const ofBox = new Set([...boxes.values()].map(([at]) => at));
  const arcs = drawing.arcs.map((arc) => {
    const [from, to] = [place[arc.from], place[arc.to]];
    return { ...arc, from, to, via: ofBox.has(from) || ofBox.has(to) ? [] : arc.via };
  }).filter(({ from, to, way }) => {
    const ends = `${from} ${to} ${way}`;
    if (from === to || (seen.has(ends) && (ofBox.has(from) || ofBox.has(to)))) return false;
    return seen.add(ends);
  });
  return { nodes, arcs };
}

/** Arcs from transitions to places of other nets that are shown too. Where such a place is part of a request, they lead to
 * the request. `instead` is the node that stands for the place in the drawing of its sender. */
export function linksBetween(parts) {
  const links = new Map();
  for (const { net, drawing } of parts) {
    for (const node of drawing.nodes) {
      if (!("transition" in node.kind)) continue;
      const transitions = node.kind.transition[0].map((number) => net.view.transitions[number]);
      const sends = transitions.flatMap((one) => [
        ...one.sends.map((arc) => ({ ...arc, way: one.part === "fail" ? "fail" : "output" })),
        ...one.fail_sends.map((arc) => ({ ...arc, way: "fail" }))]);
      for (const { net: other, place, weight, way } of sends) {
        const part = parts.find((one) => one.net.name === other && one.net !== net);
        const to = part && nodeOf(part, place);
        if (!to) continue;
        const [from, end] = [`${net.name}/${node.name}`, `${other}/${to}`];
        const known = links.get(`${from} ${end}`);
        if (!known || known.way === "fail") links.set(`${from} ${end}`, { from, to: end, way, weight, instead: `${net.name}/${place}@${other}` });
      }
    }
  }
  return [...links.values()];
}

function nodeOf({ net, drawing }, place) {
  const number = net.index.places.get(place);
  const own = drawing.nodes.find((node) => node.kind.place === number);
  const takes = (node) => "transition" in node.kind && node.kind.transition[0].some((one) => net.view.transitions[one].inputs.some((arc) => arc.place === number));
  return (own ?? drawing.nodes.find(takes))?.name;
}

/** A copy of a net at a moment, which a person plays on; nothing of it happens to the net. */
export class Fork extends Net {
  constructor(net, state) {
    super({ view: net.view, written: net.written, full: net.full, base: { ...state, paused: null, stopped: null }, notes: net.notes });
    this.real = net;
  }

  /** Whether a person may fire a transition here: guards are asked of nobody, and hold. */
  may(number) {
    return standing(this, this.head, this.view.transitions[number]).free;
  }

  /** Fires a transition, as if its action went well, or failed. */
  fire(number, failed = false) {
    const one = this.view.transitions[number];
    const tokens = (arcs) => arcs.map(({ place, weight }) => [this.view.places[place].name, weight]);
    const emptied = one.resets.map(({ place }) => {
      const taken = one.inputs.filter((arc) => arc.place === place).reduce((sum, arc) => sum + arc.weight, 0);
      return [this.view.places[place].name, Math.max(0, this.head.places[place] - taken)];
    });
    this.note({
      transition: one.name, phase: failed ? "failed" : "fired", target: one.target, text: "what if",
      consumed: [...tokens(one.inputs), ...emptied], produced: failed && !one.branches ? tokens(one.inputs) : tokens(failed ? one.fails : one.outputs),
      sent: (failed ? one.fail_sends : one.sends).map(({ net, place, weight }) => ({ net, place, tokens: weight })),
      read: failed && !one.branches ? null : one.tape, wrote: failed ? null : one.write,
    }, failed && one.branches && one.tape !== null);
  }

  /** Ends an action that goes on. */
  end({ transition, firing }, failed) {
    const one = this.view.transitions[this.index.transitions.get(transition)];
    const arcs = failed ? (one.branches ? one.fails : one.inputs) : one.outputs;
    this.note({
      transition, firing, phase: failed ? "failed" : "completed", target: one.target, text: "what if",
      produced: arcs.map(({ place, weight }) => [this.view.places[place].name, weight]), wrote: failed ? null : one.write,
    });
  }

  /** Puts a symbol on the input tape. */
  ask(symbol) {
    this.note({ transition: "", phase: "asked", read: symbol, text: "what if" });
  }

  note(event, reads = false) {
    const plain = { seq: this.head.seq + 1, at_ns: this.head.at_ns + 1e6, net: this.name, firing: null, consumed: [], produced: [], sent: [], read: null, wrote: null, target: "", trace: "", data: [] };
    // What a failure names as read goes back to the tape; a branch keeps it read.
    if (reads) this.follow([{ ...plain, ...event, phase: "fired", wrote: null }]);
    else this.follow([{ ...plain, ...event }]);
  }

  /** Takes the last thing back. */
  undo() {
    const events = this.events.slice(0, -1);
    this.reset(this.base);
    this.follow(events);
  }
}
