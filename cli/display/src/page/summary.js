// What tasks sum up of those below them: facts, questions for a person, and groups of items, each a small mark.

import { make } from "./panels.js";

/** In a group with so many items that is shown alone, each has its name and state. */
const NAMED = 400;
const byNumber = new Intl.Collator("en", { numeric: true }).compare;

export class SummaryPane {
  constructor(host, app) {
    [this.host, this.app] = [host, app];
    this.sources = new Map();
    /** The one group that is shown, `[source, name]`; null: all of them. */
    this.alone = null;
  }

  get known() {
    return this.sources.size > 0;
  }

  reset(names) {
    this.host.replaceChildren();
    this.sources = new Map(names.map((name) => [name, new Source(name, this)]));
    this.host.append(...[...this.sources.values()].map((source) => source.box));
  }

  take({ source, step }) {
    const begun = performance.now();
    this.sources.get(source)?.take(step);
    /** How long the last change took to be shown, ms: for tests. */
    this.took = performance.now() - begun;
  }

  lost({ source, reason }) {
    this.sources.get(source)?.lost(reason);
  }

  /** Shows one group, or all. */
  show(alone) {
    this.alone = alone;
    for (const source of this.sources.values()) source.arrange();
    this.host.scrollTop = 0;
  }
}

/** What one task sums up. */
class Source {
  constructor(name, pane) {
    [this.name, this.pane] = [name, pane];
    this.groups = new Map();
    this.title = make("h2", {}, name);
    this.facts = make("dl", { class: "facts", "aria-label": `Facts of ${name}` });
    this.states = make("ul", { class: "states", "aria-label": "How many are how" });
    this.questions = make("ul", { class: "questions", "aria-label": "Questions for a person" });
    this.all = make("button", { class: "all", hidden: true, onclick: () => pane.show(null) }, "← all groups");
    this.areas = make("div", { class: "areas" });
    this.box = make("section", { "data-source": name }, this.title, this.facts, this.questions, this.states, this.all, this.areas);
  }

  lost(reason) {
    this.title.replaceChildren(this.name, make("small", { class: "gone" }, ` cannot be asked: ${reason}`));
  }

  take(step) {
    this.title.replaceChildren(this.name);
    if (step.whole) {
      this.groups.clear();
      this.areas.replaceChildren();
      this.questions.replaceChildren();
    }
    if (step.facts) showFacts(this.facts, step.facts);
    if (step.questions) this.ask(step.questions);
    let fresh = false;
    for (const [name, news] of Object.entries(step.groups)) {
      if (!this.groups.has(name)) {
        this.groups.set(name, new Group(name, this));
        fresh = true;
      }
      this.groups.get(name).take(news);
    }
    if (fresh) {
      const sorted = [...this.groups.keys()].sort(byNumber);
      this.areas.replaceChildren(...sorted.map((name) => this.groups.get(name).box));
      this.arrange();
    }
    if (Object.keys(step.groups).length > 0) this.count();
  }

  /** How many items are in each state, over the groups that are shown. */
  count() {
    const { alone } = this.pane;
    const counts = new Map();
    for (const group of this.groups.values()) {
      if (alone !== null && group.name !== alone[1]) continue;
      for (const { tone, count, state } of group.counts.values()) {
        const known = counts.get(state) ?? { tone, count: 0 };
        counts.set(state, { tone, count: known.count + count });
      }
    }
    const sorted = [...counts].filter(([, one]) => one.count > 0).sort((a, b) => byNumber(a[0], b[0]));
    this.states.replaceChildren(...sorted.map(([state, { tone, count }]) => make("li", {}, make("i", { class: `mark ${tone}` }), make("b", {}, String(count)), ` ${state}`)));
  }

  /** Shows all groups, or the one that a person has chosen. */
  arrange() {
    const { alone } = this.pane;
    const mine = alone?.[0] === this.name;
    this.box.hidden = alone !== null && !mine;
    this.all.hidden = !mine;
    for (const group of this.groups.values()) {
      const shown = !mine || group.name === alone[1];
      group.box.hidden = !shown;
      group.box.classList.toggle("alone", mine && shown && group.items.size <= NAMED);
    }
    this.count();
  }

  ask(questions) {
    const { app } = this.pane;
    const decide = (question, choice) => app.ask("decide", { task: this.name, key: question.key, choice });
    this.questions.replaceChildren(...questions.map((question) => make("li", { "data-key": question.key }, make("p", {}, question.text),
      app.control ? make("div", { class: "actions" }, ...question.choices.map((choice) => make("button", { onclick: () => decide(question, choice) }, choice)))
        : make("p", { class: "soft" }, "Boot with --allow-control, and open the page with its token, to decide it here."))));
  }
}

/** A group: its facts, and a mark for each item. */
class Group {
  constructor(name, source) {
    [this.name, this.source] = [name, source];
    this.items = new Map();
    /** By state: its look and how many items have it. */
    this.counts = new Map();
    this.facts = make("dl", { class: "facts" });
    this.marks = make("div", { class: "marks" });
    const head = make("button", { class: "name", title: `Show ${name} alone, with names`, onclick: () => source.pane.show([source.name, name]) }, name);
    this.box = make("article", { "data-group": name }, make("header", {}, head, this.facts), this.marks);
  }

  take(step) {
    if (step.facts) showFacts(this.facts, step.facts);
    let fresh = false;
    for (const [name, item] of Object.entries(step.items)) fresh = this.set(name, item) || fresh;
    if (!fresh) return;
    const sorted = [...this.items.keys()].sort(byNumber);
    this.marks.replaceChildren(...sorted.map((name) => this.items.get(name).mark));
  }

  /** Sets an item; whether it is a new one. */
  set(name, item) {
    const { app } = this.source.pane;
    const known = this.items.get(name);
    const mark = known?.mark ?? make("button", { "data-item": name }, make("i"), make("span", { class: "of" }), make("span", { class: "state" }));
    if (known) this.tally(known.item, -1);
    this.tally(item, 1);
    this.items.set(name, { item, mark });
    mark.className = item.is_new ? "item new" : "item";
    const [spot, of, state] = mark.children;
    spot.className = `mark ${item.tone}`;
    if (!known) of.textContent = name;
    state.textContent = item.state;
    mark.title = `${name}: ${item.state}${item.is_new ? ", has the new version" : ""}`;
    mark.onclick = () => (item.opens === null ? null : app.follow(item.opens));
    return !known;
  }

  tally({ state, tone }, by) {
    const known = this.counts.get(state) ?? { state, tone, count: 0 };
    this.counts.set(state, { state, tone, count: known.count + by });
  }
}

function showFacts(host, facts) {
  host.replaceChildren(...facts.map(({ name, value, tone }) => make("div", { class: tone, "data-fact": name }, make("dt", {}, name), make("dd", {}, value))));
}
