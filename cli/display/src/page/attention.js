// What of the nets a person is shown without asking: the net of the task as a whole, and in it what is under way.

import { Moments } from "./moments.js";

/** What has `nets` by name and a `picture` of one, which is kept where something happens. */
export class Attention extends Moments {
  /** The net of the task as a whole: the one that asks most other nets. Of several the one with most commands. */
  mainNet() {
    const asks = (net) => new Set(net.view.transitions.map((one) => one.task).filter((task) => task !== net.name && this.nets.has(task))).size;
    return [...this.nets.values()].sort((a, b) => asks(b) - asks(a) || b.view.commands.length - a.view.commands.length || b.view.transitions.length - a.view.transitions.length)[0];
  }

  /** What is under way, the latest first; where nothing is, what may fire, and then where tokens are. */
  activeNodes() {
    const all = [...this.picture.nodes.values()];
    const running = all.filter((one) => one.state === "running");
    const names = (one) => (one.node.kind.transition?.[0] ?? []).map((number) => one.net.view.transitions[number].name);
    const latest = (one) => Math.max(0, ...this.stateOf(one.net).running.filter((action) => names(one).includes(action.transition)).map((action) => action.since_ns));
    if (running.length > 0) return running.sort((a, b) => latest(b) - latest(a)).map((one) => one.node);
    const enabled = all.filter((one) => one.state === "enabled");
    return (enabled.length > 0 ? enabled : all.filter((one) => one.count > 0)).map((one) => one.node);
  }

  /** The net has more room, or less. As long as nobody has looked at a part of it, it is fitted in again. */
  resized() {
    if (this.shown === null) return;
    this.picture.glide = null;
    if (this.fits) this.fitWhole();
    else this.picture.look(this.picture.box);
    this.changed();
  }

  /** Shows all of the net where its names can be read then, and else what is under way. */
  fitWhole() {
    this.picture.fit();
    this.followActive(!this.picture.readable);
    this.fits = true;
  }

  followActive(on) {
    [this.active, this.fits] = [on, false];
    if (!on) this.picture.glide = null;
    document.getElementById("active").setAttribute("aria-pressed", String(on));
  }

  /** Shows all of the net. */
  fit() {
    this.followActive(false);
    this.picture.fit();
  }
}
