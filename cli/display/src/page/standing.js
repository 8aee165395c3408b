// How the app stands as a whole: its chassis, and the last warnings of its log.

import { seconds } from "./model.js";
import { make } from "./panels.js";

/** Warnings that are listed. */
const LISTED = 4;
/** What is told twice within it is one warning, ns. */
const MOMENT = 1e9;

/** The section at the side, at the moment shown; nothing of a record without warnings. */
export function standingSection({ chassis, warnings }, app) {
  const past = app.cursor !== null || app.mode === "record";
  const now = app.now();
  const known = together(past ? warnings.filter((one) => one.at_ns <= now) : warnings);
  if (chassis.length === 0 && known.length === 0) return null;
  const head = past || chassis.length === 0 ? null : chassis.every((one) => one.fine) ? `all ${chassis.length} chassis are up` : `${chassis.filter((one) => !one.fine).length} of ${chassis.length} chassis not up`;
  return make("section", { class: "standing" },
    make("h2", {}, "app", head === null ? null : make("small", {}, head)),
    past ? null : make("ul", { class: "chassis", "aria-label": "Chassis" }, ...chassis.map(chip)),
    make("p", { class: "soft" }, known.length === 0 ? "no warnings" : `last warnings${known.length > LISTED ? `, ${LISTED} of ${known.length}` : ""}`),
    known.length === 0 ? null : make("ul", { class: "warnings", "aria-label": "Last warnings" }, ...known.slice(-LISTED).reverse().map((one) => warning(one, app))));
}

/** Several chassis may say the same within a moment: each text once, with all who say it. */
function together(warnings) {
  const all = new Map();
  for (const one of warnings) {
    const key = `${Math.round(one.at_ns / MOMENT)} ${one.text}`;
    if (all.has(key)) all.get(key).from.push(one.from);
    else all.set(key, { ...one, from: [one.from] });
  }
  return [...all.values()];
}

function chip(one) {
  const again = one.restarts === 0 ? null : `started again ${one.restarts === 1 ? "once" : `${one.restarts} times`}${one.last_end === null ? "" : `: ${one.last_end}`}`;
  return make("li", { class: one.fine ? null : "failed", title: `${one.tasks} tasks` },
    make("b", {}, one.name), make("span", {}, one.state), again === null ? null : make("span", { class: "why" }, again));
}

function warning(one, app) {
  return make("li", { class: one.level === "error" ? "failed" : null },
    make("button", { class: "link", title: "Go to this moment", onclick: () => app.goTo(one.at_ns) }, seconds(one.at_ns, 2)),
    make("span", {}, make("b", { title: one.from.join(", ") }, one.from.length === 1 ? one.from[0] : `${one.from.length} chassis`), ` ${one.text}`));
}
