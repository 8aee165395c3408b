// What stands beside the net: the chosen node or task, and what goes on.

import { OF_TASK } from "./loads.js";
import { called, nodeStanding, seconds, valueOf } from "./model.js";
import { durationKey, placeKey, taskKey } from "./plots.js";
import { standingSection } from "./standing.js";
import { callers, lastOf, linesOf, messagesTo, ofNet, ofTask, sendersTo } from "./task.js";

/** Commands by hand whose answers are shown. */
const COMMANDS_SHOWN = 3;

/** Nodes of a kind that are listed. */
const MOST_LISTED = 24;

export function make(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export const tokens = (list) => list.map(([place, count]) => (count === 1 ? place : `${count} ${place}`)).join(" + ");

// -- the side ------------------------------------------------------------------------------

/** Fills the side: `app` has the chosen key, nets, states and what may be done. */
export function showSide(host, app) {
  // What a person fills in stays until that is done.
  if (host.contains(document.activeElement) && document.activeElement.matches("input, select")) return;
  const shown = app.chosen === null ? null : app.picture.nodes.get(app.chosen);
  if (app.whole && app.chosen === null && app.task === null) return host.replaceChildren(...[standingSection(app.standing, app)].filter((part) => part !== null), ...app.overview.side(), ...app.visibleNets().map((net) => overviewPart(net, app)).filter((part) => part !== null));
  const parts = [app.task !== null ? make("section", {}, make("h2", {}, app.task, make("small", {}, "task")), taskPart(app.task, app)) : null,
    shown && app.task === null ? nodePart(shown, app) : null, ...app.visibleNets().map((net) => netPart(net, app))];
  host.replaceChildren(...parts.filter((part) => part !== null));
}

function nodePart(shown, app) {
  const { net, node, kind } = shown;
  if (kind === "remote") {
    const [other, place] = node.kind.remote;
    return make("section", {}, make("h2", {}, place, make("small", {}, `place of net ${other}`)),
      link(`Show net ${other}`, () => app.open(other, `${other}/${place}`)));
  }
  if (kind === "fold") {
    return make("section", {}, make("h2", {}, node.name, make("small", {}, "subnet")), make("p", { class: `words ${shown.state}` }, shown.standing.words),
      make("div", { class: "actions" }, make("button", { onclick: () => app.toggleFold(net, node.name) }, "Unfold")));
  }
  return kind === "place" ? placePart(net, node, app) : transitionPart(net, node, app);
}

function placePart(net, node, app) {
  const place = net.view.places[node.kind.place];
  const state = app.stateOf(net);
  const count = state.places[node.kind.place];
  const facts = [["tokens", withPlot(String(count), "plot", placeKey(net.name, place.name), app, net.real)], ["at the start", String(place.tokens)]];
  if (place.capacity !== null) facts.push(["at most", String(place.capacity)]);
  if (place.data !== null && !net.view.data.some((data) => data.place === node.kind.place)) facts.push(["says whether valid", place.data]);
  net.view.data.forEach((data, number) => data.place === node.kind.place && facts.push([data.name, valueOf(data, state.data[number])]));
  facts.push(inText(place.at));
  const takers = net.view.transitions.filter((one) => one.inputs.some((arc) => arc.place === node.kind.place));
  const senders = sendersTo(net.name, place.name, [...app.nets.values()]);
  return make("section", {},
    make("h2", {}, place.name, make("small", {}, "place")),
    tokenHistory(net, place.name, app),
    factList(facts), notesOf(net, node),
    app.control && !net.real ? make("div", { class: "actions" },
      make("button", { onclick: () => app.order("put", net, { place: place.name }) }, "Put a token"),
      make("button", { onclick: () => app.order("take", net, { place: place.name }), disabled: count === 0 }, "Take one")) : null,
    app.control && !net.real ? predicates(net, place.name, app) : null,
    senders.length > 0 ? make("p", { class: "soft" }, "put from ", ...between(senders.map(({ net: other, name }) => link(`${other.name}/${name}`, () => app.goToNode(other, name))))) : null,
    takers.length > 0 ? make("p", { class: "soft" }, "taken by ", ...between(takers.map((one) => jump(net, one.shown, app)))) : null);
}

function transitionPart(net, node, app) {
  const parts = node.kind.transition[0];
  const transition = net.view.transitions[parts[0]];
  const state = app.stateOf(net);
  const standing = nodeStanding(net, state, node);
  const sum = (list) => parts.reduce((all, number) => all + list[number], 0);
  // A request counts when it has ended.
  const request = parts.length > 1;
  const ended = request ? state.ended[parts[1]] : sum(state.ended);
  const failed = request ? state.ended[parts[2]] ?? 0 : sum(state.failed);
  const facts = [];
  if (transition.target !== "") facts.push(["calls", transition.target]);
  if (transition.tape !== null) facts.push(["reads", transition.tape]);
  const writes = parts.map((number) => net.view.transitions[number].write).filter((one) => one !== null);
  if (writes.length > 0) facts.push(["writes", writes.join(", ")]);
  if (transition.when !== null) facts.push(["when", transition.when]);
  facts.push(["completed", String(ended)]);
  if (failed > 0) facts.push(["failed", String(failed)]);
  if (sum(state.busy_ns) > 0) facts.push(["on average", withPlot(seconds(sum(state.busy_ns) / Math.max(1, sum(state.ended) + sum(state.failed))), "plot", durationKey(net.name, node.name), app, net.real)]);
  if (transition.within_ms > 0) facts.push(["limit", seconds(transition.within_ms * 1e6)]);
  if (transition.priority > 0) facts.push(["priority", String(transition.priority)]);
  facts.push(inText(transition.at));
  return make("section", {},
    make("h2", {}, node.name, make("small", {}, request ? "request" : "transition")),
    make("p", { class: `words ${standing.state}` }, standing.words, elapsed(standing, app)),
    factList(facts), notesOf(net, node),
    net.real ? whatIf(net, node, standing, app) : null,
    app.control && !net.real ? make("div", { class: "actions" },
      make("button", { onclick: () => app.order("fire", net, { transition: transition.name }), disabled: standing.state === "running" }, "Fire"),
      transition.target === "" ? null : make("button", { onclick: () => app.order("cancel", net, { transition: transition.name }), disabled: standing.state !== "running", title: "End the action as failed" }, "Fail"),
      transition.target === "" ? null : make("button", { onclick: () => app.order("complete", net, { transition: transition.name }), disabled: standing.state !== "running", title: "End the action as completed, without its results" }, "Succeed"),
      breakButton(net, app, called(transition))) : null,
    transition.task !== null ? taskPart(transition.task, app) : null);
}

function elapsed(standing, app) {
  if (standing.running.length === 0) return null;
  const since = Math.min(...standing.running.map((one) => one.since_ns));
  return make("span", { class: "soft" }, ` · ${seconds(Math.max(0, app.now() - since), 1)}`);
}

/** The breakpoints of a place, and a form for one more: what it waits for. */
function predicates(net, place, app) {
  const set = net.breakpoints.filter((one) => one.place === place);
  const kept = app.predicate;
  const input = (name, attributes, ...children) => make(name, { ...attributes, onchange: (event) => { kept[attributes.name] = event.target.value; } }, ...children);
  const signs = [[">=", "at least"], ["=", "exactly"], ["<=", "at most"]];
  return make("form", { class: "predicate", "aria-label": `Breakpoints at ${place}`, onsubmit: (event) => {
    event.preventDefault();
    app.order("break", net, { place, when: `${kept.sign}${Math.max(0, Math.round(Number(kept.tokens) || 0))}` });
    document.activeElement.blur();
  } },
  make("span", { class: "soft" }, "stop at"),
  input("select", { name: "sign", "aria-label": "Comparison" }, ...signs.map(([sign, words]) => make("option", { value: sign, selected: sign === kept.sign }, words))),
  input("input", { name: "tokens", type: "number", min: "0", step: "1", value: kept.tokens, "aria-label": "Tokens" }),
  make("button", {}, "Set"),
  ...set.map((one) => make("button", { type: "button", class: "set", title: "Clear this breakpoint", onclick: () => app.order("clear", net, { breakpoint: one.at }) }, `${one.at} ✕`)));
}

function breakButton(net, app, transition) {
  const armed = net.breakpoints.some((one) => one.transition === transition);
  return make("button", { "aria-pressed": String(armed), onclick: () => app.order(armed ? "clear" : "break", net, { transition }) }, "Breakpoint");
}

/** What can be played in a copy of the net. */
function whatIf(net, node, standing, app) {
  const numbers = node.kind.transition[0];
  const acts = standing.state === "running" || numbers.some((number) => net.view.transitions[number].target !== "");
  const may = standing.state === "running" || numbers.some((number) => net.may(number));
  return make("div", { class: "actions" },
    make("button", { disabled: !may, onclick: () => app.playOn(net, node, false) }, standing.state === "running" ? "It ends well" : "Fire"),
    acts ? make("button", { disabled: !may, onclick: () => app.playOn(net, node, true) }, "It fails") : null,
    make("button", { disabled: net.events.length === 0, onclick: () => app.undo() }, "Take back"));
}

/** How a task is, what it handled last, what the log says of it, and what asks it. */
function taskPart(name, app) {
  const task = app.tasks.get(name);
  const nets = [...app.nets.values()];
  if (app.mode === "live" && app.cursor === null) app.askTask(name);
  const facts = app.task === name ? [] : [["task", link(name, () => app.lookAt(name))]];
  if (task?.on) facts.push(["on", task.on]);
  if (task?.error) facts.push(["state", task.error]);
  else if (task?.now) {
    facts.push(["state", task.now.doing ?? "is idle"], ["messages", `${task.now.handled} handled, ${task.now.failed} failed, ${task.now.queued} waiting`]);
    if (app.mode === "live") facts.push(["over time", make("span", {}, ...between(Object.entries(OF_TASK).map(([what, [words]]) => plotLink(words, taskKey(name, what), app))))]);
    if (task.now.restarts > 0) facts.push(["restarted", `${task.now.restarts} times`]);
  }
  const row = ({ at_ns, words, more, failed, go }) => make("li", { class: failed ? "failed" : null },
    make("button", { class: "link", title: "Go to this moment", onclick: go }, seconds(at_ns)),
    make("span", {}, words, make("span", { class: "soft" }, ` ${more}`)));
  const list = (title, rows) => (rows.length === 0 ? [] : [make("p", { class: "soft" }, title), make("ul", { class: "messages", "aria-label": title }, ...rows.map(row))]);
  const handled = lastOf(task, app.now()).map((one) => ({ ...ofTask(one, app.now()), at_ns: one.at_ns, go: () => app.goTo(one.at_ns) }));
  // A net's task handles tokens; what they ask it for, the nets know that sent them.
  const sent = app.nets.has(name) || handled.length === 0 ? messagesTo(name, nets, (net) => app.positionOf(net)) : [];
  const asked = sent.map((one) => ({ ...ofNet(one, app.now()), go: () => app.goToEvent(one.net, one.at) }));
  const lines = linesOf(task, app.now()).map((one) => ({ ...one, go: () => app.goTo(one.at_ns) }));
  const by = callers(name, nets);
  return make("div", {}, factList(facts),
    ...list("asked by nets", asked), ...list("last messages", handled),
    ...list("log", lines),
    task?.left_out > 0 ? make("p", { class: "soft" }, `${task.left_out} earlier messages are in the record only`) : null,
    by.length > 0 ? make("p", { class: "soft" }, "sent by ", ...between(by.map(({ net, name: node }) => link(app.visibleNets().includes(net) ? node : `${net.name}/${node}`, () => app.goToNode(net, node))))) : null,
    app.nets.has(name) ? link(`Show net ${name}`, () => app.open(name, null)) : null);
}

/** A button that shows a plot, or takes it away. */
function plotLink(text, key, app) {
  const button = link(text, () => app.plots.toggle(key));
  button.setAttribute("aria-pressed", String(app.plots.has(key)));
  return button;
}

/** A fact with its plot; what a person plays through has none. */
const withPlot = (text, word, key, app, played) => (played ? text : make("span", {}, `${text} `, plotLink(word, key, app)));

/** A place in a file: its folder is told on request. */
const inText = (at) => ["in the text", at.split("/").at(-1), at];
const factList = (facts) => make("dl", {}, ...facts.flatMap(([key, value, whole]) => [make("dt", {}, key), make("dd", { title: whole }, value)]));
const link = (text, go) => make("button", { class: "link", onclick: go }, text);
const jump = (net, name, app) => link(name, () => app.goToNode(net, name));
const between = (list) => list.flatMap((one, at) => (at === 0 ? [one] : [", ", one]));

function notesOf(net, node) {
  const notes = net.notes.filter((one) => one.node === node.name);
  return notes.length === 0 ? null : make("div", {}, ...notes.map((one) => make("p", { class: "words failed" }, one.message, make("span", { class: "soft" }, ` · ${one.at}`))));
}

/** How many tokens a place had, over time. */
function tokenHistory(net, place, app) {
  const points = net.history(place);
  const [from, to] = app.span();
  const most = Math.max(1, ...points.map(([, count]) => count));
  const x = (at) => (100 * (at - from)) / Math.max(1, to - from);
  const y = (count) => 40 - (34 * count) / most;
  let path = `M${x(points[0][0])} 40`;
  points.forEach(([at, count], index) => {
    const until = index + 1 < points.length ? points[index + 1][0] : to;
    path += `L${x(at).toFixed(2)} ${y(count).toFixed(1)}H${x(until).toFixed(2)}`;
  });
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("class", "history");
  svg.setAttribute("viewBox", "0 0 100 42");
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `At most ${most} tokens`);
  const line = document.createElementNS(svg.namespaceURI, "path");
  line.setAttribute("d", `${path}V40z`);
  svg.append(line);
  return svg;
}

/** What a person can put on the tape of a net beside the scene. */
function overviewPart(net, app) {
  const part = commandPart(net, app);
  return part === null ? null : make("section", {}, make("h2", {}, net.name, make("small", {}, "net")), part);
}

/** A form for a command on the net's tape, and what became of the last ones. */
function commandPart(net, app) {
  if (!app.control || net.real || net.view.commands.length === 0) return null;
  const known = `commands of ${net.name}`;
  const put = [...app.commands.values()].filter((one) => one.net === net.name).slice(-COMMANDS_SHOWN).reverse();
  const line = make("input", { name: "line", list: known, value: app.typed.get(net.name) ?? "", placeholder: `${net.view.commands[0].symbol} …`, title: "A command and its arguments, with spaces between them",
    "aria-label": `Command for the tape of ${net.name}`, autocomplete: "off", spellcheck: "false", oninput: (event) => app.typed.set(net.name, event.target.value) });
  return make("div", {},
    make("form", { class: "command", onsubmit: (event) => {
      event.preventDefault();
      app.command(net, line.value);
      document.activeElement.blur();
    } },
    line, make("datalist", { id: known }, ...net.view.commands.map(({ symbol }) => make("option", { value: symbol }))),
    make("button", { title: "Put the command on the tape" }, "Put")),
    put.length === 0 ? null : make("ul", { class: "answers", "aria-label": "answered" }, ...put.map((one) => make("li", { class: one.ok === false ? "failed" : null },
      make("span", { class: "symbol" }, one.line), make("span", {}, one.told ?? "not answered yet")))));
}

function netPart(net, app) {
  const state = app.stateOf(net);
  const drawing = app.drawingOf(net);
  const lists = { running: [], enabled: [] };
  const subnets = app.subnets(net).slice(0, MOST_LISTED);
  for (const node of drawing.nodes) {
    if (!("transition" in node.kind)) continue;
    const standing = nodeStanding(net, state, node);
    if (standing.state !== "waiting") lists[standing.state].push([node, standing]);
  }
  const marked = drawing.nodes.filter((node) => "place" in node.kind && state.places[node.kind.place] > 0);
  const more = (list) => (list.length > MOST_LISTED ? [make("li", { class: "soft" }, `and ${list.length - MOST_LISTED} more`)] : []);
  const rows = (list) => [...list.slice(0, MOST_LISTED).map(([node, standing]) => make("li", {}, jump(net, node.name, app), make("span", {}, standing.state === "running" ? elapsedText(standing, app) : standing.words === "enabled" ? "" : standing.words))), ...more(list)];
  const symbols = (list) => list.slice(0, MOST_LISTED).map((one) => make("span", { class: "symbol" }, one));
  const answers = app.eventsOf(net).filter((event) => event.wrote !== null).slice(-3).map((event) => event.wrote);
  return make("section", {},
    make("h2", {}, net.name, make("small", {}, "net")),
    net.view.title === "" ? null : make("p", { class: "soft" }, net.view.title),
    net.gone !== null ? make("p", { class: "words failed" }, net.gone) : null,
    state.stopped !== null ? make("p", { class: "words failed" }, `stopped: ${state.stopped}`) : null,
    state.paused !== null ? make("p", { class: "words" }, `paused: ${state.paused}`) : null,
    app.control && !net.real ? make("div", { class: "actions" },
      state.paused === null ? make("button", { onclick: () => app.order("pause", net, {}) }, "Pause net")
        : make("button", { onclick: () => app.order("resume", net, {}) }, "Release net"),
      make("button", { onclick: () => app.order("step", net, {}), disabled: state.paused === null }, "Step")) : null,
    net.real ? make("div", { class: "actions" }, ...net.view.commands.map(({ symbol }) => make("button", { onclick: () => { net.ask(symbol); app.changed(); } }, `Put ${symbol}`)),
      make("button", { disabled: net.events.length === 0, onclick: () => app.undo() }, "Take back")) : null,
    subnets.length > 0 ? make("div", { class: "actions", role: "group", "aria-label": "Subnets" },
      ...subnets.map(([name, folded]) => make("button", { "aria-pressed": String(folded), title: "Draw this subnet as one node (s)", onclick: () => app.toggleFold(net, name) }, `${folded ? "▸" : "▾"} ${name}`))) : null,
    lists.running.length > 0 ? make("ul", { "aria-label": "running" }, ...rows(lists.running)) : null,
    lists.enabled.length > 0 ? make("ul", { "aria-label": "enabled" }, ...rows(lists.enabled)) : null,
    net.view.commands.length > 0 ? make("p", {}, make("span", { class: "soft" }, "tape "), ...(state.in_progress ? [...symbols([state.in_progress]), " in progress "] : []),
      ...symbols(state.tape), state.tape.length === 0 && !state.in_progress ? "empty" : "", ...(answers.length > 0 ? [make("span", { class: "soft" }, " answered "), ...symbols(answers)] : [])) : null,
    commandPart(net, app),
    net.view.data.length > 0 ? make("div", { "aria-label": "data" }, factList(net.view.data.slice(0, MOST_LISTED).map((data, number) => [data.name, valueOf(data, state.data[number])]))) : null,
    make("p", { class: "soft" }, "marked: ", ...(marked.length === 0 ? ["nothing"] : between(marked.slice(0, MOST_LISTED).map((node) => jump(net, node.name, app)))),
      ...(lists.running.length > 0 ? ["; taken by ", ...between(lists.running.slice(0, MOST_LISTED).map(([node]) => jump(net, node.name, app)))] : [])),
    net.skipped > 0 ? make("p", { class: "soft" }, `${net.skipped} events came too fast to be shown`) : null);
}

const elapsedText = (standing, app) => seconds(Math.max(0, app.now() - Math.min(...standing.running.map((one) => one.since_ns))), 1);
