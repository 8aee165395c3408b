// What stands on the page together: panes, by a built-in layout, one that was saved, or as a person chose.

import { make } from "./panels.js";

/** The layouts that every app has. */
const BUILT_IN = { overview: ["scene", "plan", "pictures", "net", "side"], net: ["net", "side", "lanes", "events"], summary: ["summary"] };

export class Panes {
  /** For `app`, which has `overview`, `plots`, `nets` and what it shows. */
  constructor(app) {
    this.app = app;
    /** Those of the app: name, title, panes, net, plots. */
    this.layouts = [];
    /** The one that is shown; null: a built-in one. */
    this.layout = null;
    this.built = "net";
    /** The panes as a person chose them. */
    this.chosen = null;
    this.menu = document.getElementById("panes");
    this.form = this.menu.querySelector("form");
    this.form.addEventListener("change", (event) => event.target.type === "checkbox" && this.choose());
    this.form.addEventListener("submit", (event) => { event.preventDefault(); this.save(); });
    addEventListener("pointerdown", (event) => { if (!this.menu.contains(event.target)) this.menu.open = false; });
    this.listenShare();
  }

  /** The share of the scene in the height that it has together with the net, per cent: by mouse and by keys. */
  listenShare() {
    const bar = document.getElementById("share");
    const main = bar.parentElement;
    const set = (percent) => {
      const share = Math.min(85, Math.max(15, percent));
      bar.setAttribute("aria-valuenow", String(Math.round(share)));
      main.style.setProperty("--share", `${share}fr`);
      main.style.setProperty("--rest", `${100 - share}fr`);
    };
    bar.addEventListener("pointerdown", (event) => { bar.setPointerCapture(event.pointerId); event.preventDefault(); });
    bar.addEventListener("pointermove", (event) => {
      if (event.buttons === 0) return;
      const box = main.getBoundingClientRect();
      set((100 * (event.clientY - box.top)) / Math.max(1, box.height));
    });
    bar.addEventListener("keydown", (event) => {
      const by = { ArrowUp: -5, ArrowDown: 5 }[event.key];
      if (by === undefined) return;
      set(Number(bar.getAttribute("aria-valuenow")) + by);
      event.preventDefault();
      event.stopPropagation();
    });
    set(54);
  }

  /** The panes that are shown. */
  get shown() {
    const layout = this.layouts.find((one) => one.name === this.layout);
    const panes = new Set(this.chosen ?? layout?.panes ?? BUILT_IN[this.built]);
    if (!this.chosen && !layout && this.built === "overview" && this.app.plots.keys.length > 0) panes.add("lanes");
    return panes;
  }

  /** Shows a built-in layout. */
  open(built) {
    [this.built, this.layout, this.chosen] = [built, null, null];
    this.arrange();
  }

  /** Shows a layout of the app. */
  openLayout(name) {
    const layout = this.layouts.find((one) => one.name === name);
    if (!layout) return false;
    const { app } = this;
    if (layout.net && app.known(layout.net)) app.open(layout.net, null);
    app.plots.show(layout.plots ?? []);
    [this.layout, this.chosen] = [name, null];
    this.arrange();
    app.tabs();
    app.remember();
    return true;
  }

  choose() {
    const boxes = [...this.form.querySelectorAll("input[type=checkbox]")];
    const chosen = boxes.filter((box) => box.checked).map((box) => box.name);
    if (chosen.length > 0) this.chosen = chosen;
    this.arrange();
  }

  /** Keeps what is shown beside the app. */
  save() {
    const name = this.form.elements.layout.value.trim();
    if (name === "") return;
    const { app } = this;
    app.ask("layout", { name, layout: { panes: [...this.shown], net: app.paned() ? null : app.shown, plots: app.plots.keys } });
    this.menu.open = false;
  }

  /** Whether scene or pictures are to be shown. An overview of nothing leaves the room to the net. */
  wantsCell() {
    const { app, shown } = this;
    const own = this.chosen !== null || this.layout !== null || app.nets.size === 0;
    return (shown.has("scene") && (own || app.overview.drawable)) || (shown.has("pictures") && (own || app.overview.pictures.cameras.size > 0)) || (shown.has("plan") && app.overview.plans.any);
  }

  arrange() {
    const { app, shown } = this;
    const place = (id, pane) => { document.getElementById(id).hidden = !pane; };
    const cell = this.wantsCell();
    app.whole = cell;
    document.body.classList.toggle("whole", cell);
    place("cell", cell);
    const summary = shown.has("summary") && app.summary.known;
    place("summary", summary);
    document.body.classList.toggle("summed", summary);
    place("time", !summary || shown.size > 1);
    const net = shown.has("net") && (app.nets.size > 0 || !cell);
    place("share", cell && net);
    app.overview.panes(shown.has("scene"), shown.has("pictures"), shown.has("plan"));
    place("stage", net);
    place("side", shown.has("side"));
    place("lanes", shown.has("lanes"));
    place("events", shown.has("events"));
    place("axis", shown.has("lanes") || app.plots.keys.length > 0);
    const below = shown.has("lanes") || shown.has("events") || app.plots.keys.length > 0;
    place("bottom", below);
    document.body.classList.toggle("below", below);
    for (const box of this.form.querySelectorAll("input[type=checkbox]")) box.checked = shown.has(box.name);
    document.getElementById("keep").hidden = !app.control;
    app.overview.changed();
    app.changed();
  }

  /** The tabs of the layouts of the app. */
  tabs() {
    return this.layouts.map(({ name, title }) => make("button", { role: "tab", "aria-selected": String(this.layout === name), title: title ?? "a layout of panes", onclick: () => this.openLayout(name) }, name));
  }
}
