// The keys of the page.

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const byId = (id) => document.getElementById(id);

/** Has the page do what keys say. */
export function listen(app) {
  const beside = (by) => {
    const all = [...app.displays.map((one) => one.name), ...app.nets.keys()];
    app.open(all[(all.indexOf(app.shown) + by + all.length) % all.length], null);
  };
  const orders = {
    " ": () => app.togglePlay(), ",": () => app.step(-1), ".": () => app.step(1), l: () => app.live(), "<": () => app.zoomTime(0.5), ">": () => app.zoomTime(2),
    "[": () => beside(-1), "]": () => beside(1), n: () => app.toggleNear(), a: () => app.toggleBeside(), d: () => app.toggleDetail(), s: () => app.foldChosen(),
    m: () => app.summary.known && app.openSummary(), o: () => app.hasScene && app.openWhole(), w: () => app.toggleFork(), u: () => app.undo(),
    "+": () => app.picture.zoom(1.25), "=": () => app.picture.zoom(1.25), "-": () => app.picture.zoom(0.8), 0: () => app.fit(), v: () => app.followActive(!app.active),
    "/": () => byId("search").focus(), "?": () => byId("keys").showModal(), Escape: () => app.choose(null),
    Enter: () => app.chosen !== null && app.openNode(app.chosen), f: () => app.byKey("fire"), b: () => app.byKey("break"),
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const typing = event.target.closest?.("input:not([type=range]):not([type=checkbox]), select, dialog");
    if (typing) {
      if (event.key === "Escape") event.target.blur();
      return;
    }
    const arrow = ARROWS[event.key];
    if (arrow && event.target.type !== "range") {
      if (event.shiftKey) app.nudge(arrow);
      else app.choose(app.picture.neighbour(app.chosen, arrow));
      event.preventDefault();
    } else if (event.key in orders && !((event.key === " " || event.key === "Enter") && event.target.closest?.("button, tr"))) {
      orders[event.key]();
      event.preventDefault();
    }
  });
}
