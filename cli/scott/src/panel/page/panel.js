// A panel: every control asks one line of text. What stands on it comes from panel.json.

import { $, ask, card, el, filled, get, order, poll, short, state } from "./base.js";
import { jog, poses } from "./pendant.js";
import { plot } from "./plot.js";

/** A slider with its number; `moved` is called with the value while it moves, `done` when it has been moved. */
function slider({ name, range, value, unit }, done) {
  const [low, high] = range;
  const step = 10 ** Math.floor(Math.log10((high - low) / 200));
  const start = value ?? (low + high) / 2;
  const id = "s" + Math.random().toString(36).slice(2);
  const track = el("input", { type: "range", id, min: low, max: high, step, value: start });
  const number = el("input", { type: "number", min: low, max: high, step: "any", value: short(start), "aria-label": name });
  track.addEventListener("input", () => { number.value = short(Number(track.value)); });
  track.addEventListener("change", () => done());
  number.addEventListener("change", () => { track.value = number.value; done(); });
  const row = el("div", { class: "row" }, el("label", { for: id, title: name }, name), track,
    el("span", { class: "field" }, number, el("span", { class: "unit" }, unit ?? "")));
  return { row, get: () => Number(number.value), set: (to) => { track.value = to; number.value = short(to); } };
}

const makers = {
  jog,
  plot,
  poses,

  button({ label, ask: line, stop, help }) {
    const button = el("button", { type: "button", class: stop ? "stop" : "", title: stop ? false : help }, label);
    if (stop && help) button.append(el("small", {}, help));
    button.addEventListener("click", async () => {
      // What stops must never wait for what it stops.
      if (!stop) button.disabled = true;
      await order(line);
      button.disabled = false;
    });
    return button;
  },

  sliders({ label, ask: line, values, go, from }) {
    const send = () => order(filled(line, Object.fromEntries(values.map((value, i) => [value.name, sliders[i].get()]))));
    const sliders = values.map((value) => slider(value, () => { if (!go) send(); }));
    const fill = async () => {
      const reply = from ? await ask(from) : null;
      if (reply?.ret === 0) sliders.forEach((one, i) => { if (i < reply.floats.length) one.set(reply.floats[i]); });
    };
    fill().catch((error) => state(error.message, true));
    const rows = sliders.map((one) => one.row);
    if (go) {
      const button = el("button", { type: "button", class: "go" }, go);
      button.addEventListener("click", async () => { button.disabled = true; await send(); await fill().catch(() => {}); button.disabled = false; });
      rows.push(button);
    }
    return card(label, "", ...rows);
  },

  readout({ label, ask: line, every_s, floats, unit }) {
    const text = el("div", {});
    const numbers = el("div", { class: "numbers" });
    poll(line, every_s, (reply) => {
      text.textContent = reply.text;
      const [first, last] = floats ?? [1, 0];
      numbers.textContent = reply.floats.slice(first - 1, last).map((one) => one.toFixed(4)).join("  ") + (last ? ` ${unit}` : "");
    });
    return card(label, "", el("div", { class: "readout" }, text, numbers));
  },

  value({ label, unit }) {
    return el("div", { class: "fact" }, el("h2", {}, label),
      el("span", { class: "numbers shown" }, "–"), el("span", { class: "unit" }, ` ${unit}`));
  },

  joystick({ label, ask: line, span, every_s, unit }) {
    const knob = el("b");
    const stick = el("div", { class: "stick", tabindex: 0, role: "application", "aria-label": `${label}: arrow keys move, letting go stops` }, knob);
    let at = null, busy = false;
    const show = () => {
      const [x, y] = at ?? [0, 0];
      knob.style.transform = `translate(${x * 3.6}rem, ${-y * 3.6}rem)`;
    };
    setInterval(async () => {
      if (!at || busy) return;
      busy = true;
      await order(filled(line, { x: (at[0] * span).toFixed(6), y: (at[1] * span).toFixed(6) }));
      busy = false;
    }, every_s * 1000);
    const to = (event) => {
      const box = stick.getBoundingClientRect();
      let x = ((event.clientX - box.left) / box.width) * 2 - 1, y = 1 - ((event.clientY - box.top) / box.height) * 2;
      const far = Math.max(1, Math.hypot(x, y));
      at = [x / far, y / far];
      show();
    };
    const off = () => { at = null; show(); };
    stick.addEventListener("pointerdown", (event) => { stick.setPointerCapture(event.pointerId); to(event); });
    stick.addEventListener("pointermove", (event) => { if (at) to(event); });
    for (const name of ["pointerup", "pointercancel", "blur", "keyup"]) stick.addEventListener(name, off);
    const keys = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    stick.addEventListener("keydown", (event) => {
      if (event.key in keys) { at = keys[event.key]; show(); event.preventDefault(); }
    });
    return card(label, `± ${span} ${unit}`, stick);
  },

  options({ object, label, class: info, dump }) {
    if (!info) return card(label ?? object, "", el("p", { class: "help" }, `nothing is known about the class of ${object}`));
    const now = values(dump ?? "");
    const set = (option, text) => order(`${object} CTRL -${option.name} ${text}`);
    const rows = info.options.flatMap((option) => [control(option, now[option.name], set), el("p", { class: "help" }, option.help)]);
    const plain = info.forms.filter((form) => !form.placeholder && form.floats === 0 && form.text);
    const buttons = plain.map((form) => el("button", { type: "button", title: form.help, onclick: () => order(`${object} EXEC ${form.text}`) }, form.text));
    return card(label ?? object, info.about, ...rows, ...buttons);
  },
};

/** The words of a dump, by option. */
function values(dump) {
  const found = {};
  let name = null;
  for (const word of dump.match(/"(?:[^"\\]|\\.)*"|\S+/g) ?? []) {
    if (/^-[A-Za-z]/.test(word)) found[name = word.slice(1)] = [];
    else if (name) found[name].push(word.replace(/^"|"$/g, ""));
  }
  return found;
}

/** The control of one option: what its kind wants. */
function control(option, now, set) {
  const value = (now ?? [])[0] ?? option.default ?? "";
  const plain = (node) => el("div", { class: "row plain" }, el("label", { title: option.help }, option.name), node);
  const range = option.range?.map(Number);
  const narrow = range && Number.isFinite(range[0]) && Number.isFinite(range[1]) && range[1] - range[0] <= 1e5;
  switch (option.kind) {
    case "flag":
      return plain(el("input", { type: "checkbox", checked: value === "on", "aria-label": option.name, onchange: (event) => set(option, event.target.checked ? "on" : "off") }));
    case "choice":
      return plain(el("select", { "aria-label": option.name, onchange: (event) => set(option, event.target.value) },
        ...option.choices.map((choice) => el("option", { selected: choice === value }, choice))));
    case "float": case "int":
      if (narrow && !option.choices.length) {
        const one = slider({ name: option.name, range, value: Number(value), unit: option.unit },
          () => set(option, option.kind === "int" ? Math.round(one.get()) : one.get()));
        return one.row;
      }
      return plain(el("input", { type: "text", value, "aria-label": option.name, onchange: (event) => set(option, event.target.value) }));
    case "floats": case "ints": {
      const inputs = option.parameters.map((name, i) => el("input", { type: "number", step: "any", placeholder: name, "aria-label": `${option.name} ${name}`, value: (now ?? [])[i] ?? "",
        onchange: () => { if (inputs.every((input) => input.value !== "")) set(option, inputs.map((input) => input.value).join(" ")); } }));
      const row = plain(el("span", { class: "numbers" }, ...inputs));
      row.classList.add("several");
      return row;
    }
    case "word":
      return plain(el("input", { type: "text", value, "aria-label": option.name, onchange: (event) => set(option, JSON.stringify(event.target.value)) }));
    default:
      if (option.parameters.length) return plain(el("input", { type: "text", placeholder: option.parameters.join(" "), "aria-label": option.name, onchange: (event) => set(option, event.target.value) }));
      return plain(el("button", { type: "button", onclick: () => set(option, "") }, option.name));
  }
}

$("line").addEventListener("submit", (event) => {
  event.preventDefault();
  if ($("ask").value.trim()) order($("ask").value.trim());
  $("ask").select();
});

/** The panels that there are, when there are several. */
function tabs({ panels, number }) {
  if (panels.length < 2) return;
  $("tabs").append(...panels.map((title, i) =>
    el("a", { href: `?n=${i}${location.hash}`, "aria-current": i === number && "page" }, title)));
}

/** Has widgets show what follows from the panel's values, and stand still while their condition is not met. */
function follow(nodes, { number, every_s, widgets, control }) {
  const next = async () => {
    if (!document.hidden) {
      let told = [];
      try {
        const response = await get(`follows.json?n=${number}`);
        if (!response.ok) throw new Error(await response.text());
        told = await response.json();
      } catch (error) { state(error.message, true); }
      nodes.forEach((node, i) => {
        const { when } = widgets[i];
        if (when && control) {
          // What is not known is not met.
          node.inert = !(told[i]?.on ?? false);
          node.classList.toggle("off", node.inert);
          node.title = node.inert ? `only when ${when}` : "";
        }
        const shown = node.querySelector(".shown");
        if (shown) shown.textContent = told[i]?.shown ?? "–";
      });
    }
    setTimeout(next, every_s * 1000);
  };
  next();
}

/** A page that only looks on: what would change something stands still. */
function lookOn(why) {
  document.body.classList.add("look");
  $("line").remove();
  for (const node of document.querySelectorAll("#stops button, main :is(button:not(.shows), input, select)")) node.disabled = true;
  for (const stick of document.querySelectorAll(".stick")) { stick.removeAttribute("tabindex"); stick.inert = true; }
  $("why").textContent = why;
}

const number = Number(new URLSearchParams(location.search).get("n")) || 0;
const response = await get(`panel.json?n=${number}`);
if (!response.ok) {
  state(await response.text(), true);
} else {
  const panel = await response.json();
  $("title").textContent = panel.title;
  document.title = `${panel.title} · ${panel.name}`;
  state("connected");
  tabs(panel);
  // Widgets of these kinds that follow each other stand in one row.
  const rows = { button: "bar", value: "bar facts" };
  let row = null;
  const nodes = [];
  for (const widget of panel.widgets) {
    const node = makers[widget.kind](widget, panel);
    nodes.push(node);
    // What stops something is always seen.
    if (widget.stop) { $("stops").append(node); continue; }
    const kind = rows[widget.kind];
    if (!kind) { row = null; $("widgets").append(node); continue; }
    if (row?.className !== kind) $("widgets").append(row = el("section", { class: kind }));
    row.append(node);
  }
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") $("stops").firstElementChild?.click(); });
  if (!panel.control) lookOn(panel.why);
  if (panel.follows) follow(nodes, panel);
}
