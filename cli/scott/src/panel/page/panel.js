// A panel: every control asks one line of text. What stands on it comes from panel.json.

const token = location.hash.slice(1);
const $ = (id) => document.getElementById(id);

/** Makes an element. */
function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== false && value != null) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children);
  return node;
}

/** Asks a line; the reply. */
async function ask(line) {
  const response = await fetch("ask", { method: "POST", body: line, headers: { "x-scott-token": token } });
  if (!response.ok) throw new Error(await response.text());
  return response.json();
}

/** Says how it stands with the app. */
function state(text, bad = false) {
  $("state").textContent = text;
  $("state").className = bad ? "bad" : "";
}

/** A reply in words. */
function words(reply) {
  const parts = [reply.text, (reply.floats ?? []).map(short).join(" "), (reply.ints ?? []).join(" ")];
  return parts.filter((part) => part).join("  ");
}

/** A number as a person reads it. */
function short(number) {
  if (typeof number !== "number") return String(number);
  return Number.isInteger(number) ? String(number) : number.toFixed(Math.abs(number) < 10 ? 4 : 2);
}

/** Asks a line that a person wants asked, and notes what comes of it. */
async function order(line) {
  const answer = el("span", { class: "answer" }, "…");
  const entry = el("li", {}, line + "\n", answer);
  $("log").prepend(entry);
  while ($("log").children.length > 30) $("log").lastChild.remove();
  try {
    const reply = await ask(line);
    const reports = (reply.reports ?? []).map((report) => report.text).join("; ");
    answer.textContent = reply.ret === 0 ? words(reply) || "done" : "";
    if (reports) answer.append(el("span", { class: "bad" }, (reply.ret === 0 ? "  " : "") + reports));
    return reply;
  } catch (error) {
    answer.replaceChildren(el("span", { class: "bad" }, error.message));
    state(error.message, true);
    return null;
  }
}

/** Asks a line again and again, one at a time, as long as the page is seen. */
function poll(line, every, take) {
  const next = async () => {
    if (!document.hidden) {
      try {
        const reply = await ask(line);
        if (reply.ret === 0) { take(reply); state("connected"); }
        else state((reply.reports?.[0] ?? {}).text ?? "an error", true);
      } catch (error) { state(error.message, true); }
    }
    setTimeout(next, every * 1000);
  };
  next();
}

/** Puts values into a line. */
function filled(line, values) {
  return line.replace(/\{(\w+)\}/g, (all, name) => (name in values ? String(values[name]) : all));
}

function card(title, small, ...children) {
  return el("section", {}, el("h2", {}, title, small ? el("small", {}, small) : ""), ...children);
}

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
  button({ label, ask: line, stop }) {
    const button = el("button", { type: "button", class: stop ? "stop" : "" }, label);
    button.addEventListener("click", async () => {
      // What stops must never wait for what it stops.
      if (!stop) button.disabled = true;
      await order(line);
      button.disabled = false;
    });
    if (stop) document.addEventListener("keydown", (event) => { if (event.key === "Escape") button.click(); });
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
    return card(label, "", el("div", { class: "readout" }, el("span", { class: "numbers shown" }, "–"), el("span", { class: "unit" }, ` ${unit}`)));
  },

  plot({ label, ask: line, every_s, floats: [first, last], names, unit }) {
    const NS = "http://www.w3.org/2000/svg";
    const svg = (tag, attributes) => {
      const node = document.createElementNS(NS, tag);
      for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
      return node;
    };
    const count = last - first + 1;
    const area = svg("svg", { class: "plot", role: "img", "aria-label": label });
    const paths = Array.from({ length: count }, (_, i) => svg("path", { class: `s${(i % 6) + 1}` }));
    const zero = svg("line", { class: "axis" });
    const top = svg("text", { x: 4, y: 12 });
    const bottom = svg("text", { x: 4 });
    area.append(zero, ...paths, top, bottom);
    const shown = Array.from({ length: count }, () => el("span"));
    const legend = el("ul", { class: "legend" }, ...shown.map((span, i) =>
      el("li", {}, el("i", { class: `s${(i % 6) + 1}` }), `${names[i] ?? i + 1} `, span)));
    const seconds = 30;
    const points = [];
    poll(line, every_s, (reply) => {
      const now = performance.now() / 1000;
      points.push([now, reply.floats.slice(first - 1, last)]);
      while (points.length && points[0][0] < now - seconds) points.shift();
      const { width, height } = area.getBoundingClientRect();
      const all = points.flatMap((point) => point[1]);
      const low = Math.min(...all), high = Math.max(...all);
      const margin = Math.max((high - low) * 0.08, 0.02);
      const y = (value) => height - 4 - ((value - low + margin) / (high - low + 2 * margin)) * (height - 8);
      const x = (time) => width - ((now - time) / seconds) * width;
      paths.forEach((path, i) => path.setAttribute("d", points.map((point, n) =>
        `${n ? "L" : "M"}${x(point[0]).toFixed(1)} ${y(point[1][i]).toFixed(1)}`).join("")));
      for (const [name, value] of Object.entries({ x1: 0, x2: width, y1: y(0), y2: y(0) })) zero.setAttribute(name, value);
      top.textContent = `${short(high + margin)} ${unit}`;
      bottom.textContent = `${short(low - margin)} ${unit}`;
      bottom.setAttribute("y", height - 6);
      shown.forEach((span, i) => { span.textContent = short(reply.floats[first - 1 + i]); });
    });
    const section = card(label, `${seconds} s`, area, legend);
    section.classList.add("wide");
    return section;
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
        const response = await fetch(`follows.json?n=${number}`, { headers: { "x-scott-token": token } });
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
  for (const node of document.querySelectorAll("main button, main input, main select")) node.disabled = true;
  for (const stick of document.querySelectorAll(".stick")) { stick.removeAttribute("tabindex"); stick.inert = true; }
  $("why").textContent = why;
}

const number = Number(new URLSearchParams(location.search).get("n")) || 0;
const response = await fetch(`panel.json?n=${number}`, { headers: { "x-scott-token": token } });
if (!response.ok) {
  state(await response.text(), true);
} else {
  const panel = await response.json();
  $("title").textContent = panel.title;
  document.title = `${panel.title} · ${panel.name}`;
  state("connected");
  tabs(panel);
  let bar = null;
  const nodes = [];
  for (const widget of panel.widgets) {
    const node = makers[widget.kind](widget);
    nodes.push(node);
    if (widget.kind !== "button") { bar = null; $("widgets").append(node); continue; }
    // Buttons that follow each other stand in one row.
    if (!bar) $("widgets").append(bar = el("section", { class: "bar" }));
    bar.append(node);
  }
  if (!panel.control) lookOn(panel.why);
  if (panel.follows) follow(nodes, panel);
}
