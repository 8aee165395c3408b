// The moment that is shown: the present, or one that a person goes to, plays from, or links to.

const byName = (id) => document.getElementById(id);

/** What has a moment: nets by name, some of which are seen, and a picture of them. `cursor` is null at the present, else
 * `{ at_ns, net, position }`. */
export class Moments {
  span() {
    let [from, to] = [Infinity, -Infinity];
    for (const net of this.nets.values()) {
      const [first, last] = net.span;
      from = Math.min(from, first);
      to = Math.max(to, last);
    }
    const [first, last] = this.overview.span;
    [from, to] = [Math.min(from, first), Math.max(to, last)];
    if (this.mode === "live" && this.offset !== null) to = Math.max(to, performance.now() * 1e6 + this.offset);
    return Number.isFinite(from) ? [from, to] : [0, 1];
  }

  /** The moment shown, ns. */
  now() {
    return this.cursor === null ? this.span()[1] : this.cursor.at_ns;
  }

  /** The time that lanes and plots show: all of it, or a part with the moment in it. */
  window() {
    const [from, to] = this.span();
    const wide = this.wide ?? Infinity;
    if (wide >= to - from) return [from, to];
    const at = this.now();
    let begin = this.begin ?? at - wide / 2;
    if (this.cursor === null) begin = to - wide;
    else if (at < begin || at > begin + wide) begin = at - wide / 2;
    this.begin = Math.min(to - wide, Math.max(from, begin));
    return [this.begin, this.begin + wide];
  }

  /** Shows less time, or more, around the moment. */
  zoomTime(by) {
    const [from, to] = this.window();
    const [first, last] = this.span();
    const wide = Math.max(1e7, (to - from) * by);
    const at = Math.min(to, Math.max(from, this.now()));
    this.wide = wide >= last - first ? null : wide;
    this.begin = at - ((at - from) / Math.max(1, to - from)) * wide;
    this.changed();
  }

  positionOf(net) {
    if (this.cursor === null) return net.events.length;
    return this.cursor.net === net.name ? this.cursor.position : net.positionAt(this.cursor.at_ns);
  }

  stateOf(net) {
    if (this.cursor === null) return net.head;
    const position = this.positionOf(net);
    if (net.shownState?.position !== position || net.shownState.of !== net.events) net.shownState = { position, of: net.events, state: net.stateAt(position) };
    return position >= net.events.length ? net.head : net.shownState.state;
  }

  eventsOf(net) {
    return net.events.slice(Math.max(0, this.positionOf(net) - 200), this.positionOf(net));
  }

  /** Says so where the past that is shown is not all there was. */
  older() {
    // What comes before the first firing is no past.
    const began = ({ forgotten, base }) => forgotten > 0 || base.running.length > 0 || [...base.ended, ...base.failed].some((count) => count > 0);
    const before = this.visibleNets().map((net) => net.real ?? net).filter(began).reduce((sum, net) => sum + net.base.seq, 0);
    const text = before === 0 ? "" : this.mode === "record" ? `the record begins after ${before} events` : `${before} earlier events: only in a record`;
    const mark = byName("older");
    if (mark.textContent !== text) [mark.textContent, mark.hidden] = [text, text === ""];
  }

  goTo(at_ns) {
    const [from, to] = this.span();
    const at = Math.min(to, Math.max(from, at_ns));
    const net = this.visibleNets()[0];
    this.cursor = { at_ns: at, net: null, position: 0 };
    if (net === undefined && !this.whole) this.cursor = null;
    this.changed();
    this.remember();
  }

  goToEvent(net, position) {
    this.playing = false;
    this.cursor = { at_ns: position > 0 ? net.events[position - 1].at_ns : net.base.at_ns, net: net.name, position };
    this.changed();
    this.remember();
  }

  step(by) {
    const net = this.visibleNets()[0];
    if (net === undefined) return;
    const position = Math.min(net.events.length, Math.max(0, this.positionOf(net) + by));
    const before = this.positionOf(net);
    this.goToEvent(net, position);
    if (position > before) this.picture.travel(net, net.events.slice(before, position));
  }

  live() {
    this.cursor = null;
    this.playing = false;
    this.changed();
    this.remember();
  }

  togglePlay() {
    if (this.cursor === null) { this.goTo(this.now()); this.playing = false; return; }
    this.playing = !this.playing;
    if (this.playing && this.cursor.at_ns >= this.span()[1]) this.goTo(this.span()[0]);
    this.cursor.net = null;
    this.played = performance.now();
    this.changed();
  }

  play(now) {
    const before = this.visibleNets().map((net) => [net, this.positionOf(net)]);
    const at = this.cursor.at_ns + (now - this.played) * 1e6 * Number(byName("speed").value);
    this.played = now;
    const [, to] = this.span();
    if (at >= to) {
      if (this.mode === "live") return this.live();
      this.playing = false;
    }
    this.cursor = { at_ns: Math.min(at, to), net: null, position: 0 };
    for (const [net, position] of before) {
      const after = this.positionOf(net);
      if (after > position) this.picture.travel(net, net.events.slice(position, after));
    }
    this.changed();
  }

  remember() {
    // The address is not lost before what it asks for is there.
    if (this.wish?.has("net") && !this.known(this.wish.get("net"))) return;
    const values = new URLSearchParams();
    if (this.panes.layout !== null) values.set("layout", this.panes.layout);
    else if (this.panes.built !== "net") values.set("view", this.panes.built);
    else if (this.shown !== null) values.set("net", this.shown);
    if (this.cursor !== null) values.set("t", (this.cursor.at_ns / 1e9).toFixed(6));
    if (this.chosen !== null) values.set("node", this.chosen);
    for (const key of this.plots.keys) values.append("plot", key);
    globalThis.history.replaceState(null, "", `#${values}`);
  }
}
