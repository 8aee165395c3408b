// A teach pendant: joints and tool are jogged while a button is held, and positions are kept under names.

import { ask, card, el, filled, note, order, poll, said, short, state } from "./base.js";

/** How often the joints are looked at, s. */
const OFTEN = 0.15;
/** How often the poses are, s. */
const SELDOM = 2;
/** Numbers that `slots` answers for each joint. */
const PER_JOINT = 6;
/** A joint this near to a limit, as part of its range, is shown so. */
const NEAR = 0.05;
/** So near, rad or m, is at a pose. */
const HERE = 2e-3;

/** Buttons that move something while they are held: small steps, one after the other, none after the button is let go. */
export function jog({ label, ask: line, begin, slots, axes, from, step }, { control }) {
  const body = el("div", { class: "jog" });
  const stopped = el("p", { class: "help stopped" });
  let rows = [], held = null, begun = !begin, running = Promise.resolve();

  const steps = async (mine) => {
    if (held === mine && !begun) begun = (await order(begin))?.ret === 0;
    while (held === mine) {
      const by = rows.map((row) => (row === mine.row ? mine.sign * (row.unit === "rad" ? step.turn : step.slide) : 0));
      const asked = filled(line, { by: `${by.length} ${by.join(" ")}` });
      try {
        const reply = await ask(asked);
        if (reply.ret === 0) continue;
        note(asked)(reply);
      } catch (error) { state(error.message, true); }
      off();
    }
  };
  const off = () => {
    held?.button.classList.remove("held");
    held = null;
  };
  const on = (row, sign, button) => {
    off();
    const mine = held = { row, sign, button };
    button.classList.add("held");
    // The step before ends first.
    running = running.then(() => steps(mine));
  };
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") off(); });
  document.addEventListener("visibilitychange", off);
  addEventListener("blur", off);

  const holds = (row, sign) => {
    const button = el("button", { type: "button", disabled: !control, "aria-label": `${row.name} ${sign < 0 ? "back" : "on"}`,
      title: "held, it goes on by small steps" }, sign < 0 ? "−" : "+");
    button.addEventListener("pointerdown", (event) => { button.setPointerCapture(event.pointerId); on(row, sign, button); });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur", "keyup"]) button.addEventListener(name, off);
    button.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) on(row, sign, button);
    });
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    return button;
  };
  const add = (name, unit, effort) => {
    const row = { name, unit, number: el("span", { class: "number" }), mark: el("b"), effort: el("span", { class: "effort" }), load: el("b") };
    row.range = el("div", { class: "range", hidden: !slots }, row.mark);
    row.drive = el("div", { class: "drive", hidden: !slots, title: "torque, as part of the most" }, row.load);
    row.node = el("div", { class: "axis-row" }, el("span", { class: "name" }, name), holds(row, -1),
      el("div", { class: "middle" }, el("div", { class: "said" }, row.number, row.effort), row.range, row.drive), holds(row, 1));
    row.effortUnit = effort;
    rows.push(row);
    body.append(row.node);
  };

  const show = (reply) => {
    const lines = reply.text.split("\n");
    const joints = reply.floats.length / PER_JOINT;
    if (rows.length !== joints) {
      off();
      rows = [];
      body.replaceChildren();
      for (const joint of lines.slice(0, joints)) add(...joint.split(", "));
    }
    rows.forEach((row, i) => {
      const [position, error, torque, low, high, most] = reply.floats.slice(i * PER_JOINT, (i + 1) * PER_JOINT);
      const part = (position - low) / (high - low);
      row.number.textContent = `${short(position)} ${row.unit}`;
      row.number.title = `setpoint less position: ${(error * 1e3).toFixed(3)} m${row.unit}`;
      row.mark.style.left = `${100 * Math.min(1, Math.max(0, Number.isFinite(part) ? part : 0.5))}%`;
      row.range.title = `${short(low)} to ${short(high)} ${row.unit}`;
      row.node.classList.toggle("near", part < NEAR || part > 1 - NEAR);
      row.effort.textContent = `${torque.toFixed(1)} ${row.effortUnit}`;
      const load = Math.min(1, Math.abs(torque) / most) || 0;
      row.load.style.width = `${100 * load}%`;
      row.drive.classList.toggle("near", load > 1 - NEAR);
    });
    stopped.textContent = lines.slice(joints).join("; ");
  };
  if (slots) poll(slots, OFTEN, show);
  else {
    for (const { name, unit } of axes) add(name, unit);
    if (from) poll(from, OFTEN, ({ floats }) => rows.forEach((row, i) => {
      const at = axes[i].float;
      row.number.textContent = at ? `${short(floats[at - 1])} ${row.unit}` : row.unit;
    }));
  }
  return card(label, `${step.turn} rad, ${step.slide * 1e3} mm a step`, body, stopped);
}

/** Positions with names: recorded here, kept in a dictionary's file, gone to. */
export function poses({ label, beginning, dictionary, ask: line, from, joints, finds }, { control }) {
  const list = el("ul", { class: "poses" });
  const name = el("input", { type: "text", placeholder: "name", "aria-label": "name of a pose", autocomplete: "off", spellcheck: "false", pattern: "[A-Za-z][\\w\\-]*", required: true });
  const record = el("button", { type: "submit", class: "go" }, "Record");
  const form = el("form", { class: "record" }, name, record);
  let known = "", entries = [], now = [];

  const mark = () => {
    for (const { node, position } of entries) {
      const here = now.length > 0 && position.every((one, i) => Math.abs(one - now[i]) < HERE);
      node.classList.toggle("here", here);
    }
  };
  const entry = (pose, position) => {
    const go = el("button", { type: "button", class: "to", disabled: !control }, pose);
    go.addEventListener("click", async () => {
      go.disabled = true;
      await order(filled(line, { name: pose }));
      go.disabled = false;
    });
    const remove = el("button", { type: "button", class: "remove", disabled: !control, "aria-label": `remove ${pose}`, title: "remove" }, "×");
    remove.addEventListener("click", () => change(`-remove ${beginning}${pose}`));
    const numbers = position.map((one) => one.toFixed(2)).join("  ");
    return { position, node: el("li", {}, go, el("span", { class: "numbers" }, numbers), remove) };
  };
  const take = (reply) => {
    if (reply.text === known) return;
    known = reply.text;
    const found = known.split("\n").map((text) => text.split(" "));
    const of = found.filter((words) => words.length === joints + 1 && !words[0].slice(beginning.length).includes("."));
    entries = of.map(([word, ...numbers]) => entry(word.slice(beginning.length), numbers.map(Number)));
    list.replaceChildren(...entries.map(({ node }) => node));
    mark();
  };
  const change = async (words) => {
    await order(`${dictionary} CTRL ${words} -save`);
    await ask(finds).then(take).catch((error) => state(error.message, true));
  };
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const reply = await ask(from).catch((error) => ({ ret: 7, reports: [{ text: error.message }] }));
    if (reply.ret !== 0) { state(said(reply), true); return; }
    await change(`-add ${beginning}${name.value} '${reply.floats.slice(0, joints).join(" ")}'`);
    name.value = "";
  });
  poll(finds, SELDOM, take);
  poll(from, OFTEN, ({ floats }) => { now = floats; mark(); });
  return card(label, "", list, form);
}
