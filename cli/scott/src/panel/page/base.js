// What all widgets of a panel share: elements, lines that are asked, and numbers as a person reads them.

const token = location.hash.slice(1);
export const $ = (id) => document.getElementById(id);

/** Makes an element. */
export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== false && value != null) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children);
  return node;
}

/** Asks the server for one of its files. */
export function get(path) {
  return fetch(path, { headers: { "x-scott-token": token } });
}

/** Asks a line; the reply. */
export async function ask(line) {
  const response = await fetch("ask", { method: "POST", body: line, headers: { "x-scott-token": token } });
  if (!response.ok) throw new Error(await response.text());
  return response.json();
}

/** Says how it stands with the app. */
export function state(text, bad = false) {
  $("state").textContent = text;
  $("state").className = bad ? "bad" : "";
}

/** What was said of a reply, in words. */
export function said(reply) {
  return (reply.reports ?? []).map((report) => report.text).join("; ");
}

/** A reply in words. */
function words(reply) {
  const parts = [reply.text, (reply.floats ?? []).map(short).join(" "), (reply.ints ?? []).join(" ")];
  return parts.filter((part) => part).join("  ");
}

/** A number as a person reads it. */
export function short(number) {
  if (typeof number !== "number") return String(number);
  return Number.isInteger(number) ? String(number) : number.toFixed(Math.abs(number) < 10 ? 4 : 2);
}

/** Notes a line and what comes of it. */
export function note(line) {
  const answer = el("span", { class: "answer" }, "…");
  $("log").prepend(el("li", {}, line + "\n", answer));
  while ($("log").children.length > 30) $("log").lastChild.remove();
  return (reply) => {
    const reports = said(reply);
    answer.textContent = reply.ret === 0 ? words(reply) || "done" : "";
    if (reports) answer.append(el("span", { class: "bad" }, (reply.ret === 0 ? "  " : "") + reports));
  };
}

/** Asks a line that a person wants asked, and notes what comes of it. */
export async function order(line) {
  const noted = note(line);
  try {
    const reply = await ask(line);
    noted(reply);
    return reply;
  } catch (error) {
    noted({ ret: 7, reports: [{ text: error.message }] });
    state(error.message, true);
    return null;
  }
}

/** Lines that are asked again and again. */
const polled = new Map();

/** Asks a line again and again, one at a time, as long as the page is seen. Where several want the same, it is asked once for
 *  all. `failed` is told of an error; without it, it stands above the page. */
export function poll(line, every, take, failed) {
  const known = polled.get(line);
  if (known) {
    known.every = Math.min(known.every, every);
    known.takers.push([take, failed]);
    return;
  }
  const one = { every, takers: [[take, failed]] };
  polled.set(line, one);
  const wrong = (text) => {
    for (const [, failed] of one.takers) failed?.(text);
    if (one.takers.some(([, failed]) => !failed)) state(text, true);
  };
  const next = async () => {
    if (!document.hidden) {
      try {
        const reply = await ask(line);
        if (reply.ret === 0) {
          for (const [take] of one.takers) take(reply);
          state("connected");
        } else wrong(said(reply) || "an error");
      } catch (error) { wrong(error.message); }
    }
    setTimeout(next, one.every * 1000);
  };
  next();
}

/** Puts values into a line. */
export function filled(line, values) {
  return line.replace(/\{(\w+)\}/g, (all, name) => (name in values ? String(values[name]) : all));
}

export function card(title, small, ...children) {
  return el("section", {}, el("h2", {}, title, small ? el("small", {}, small) : ""), ...children);
}
