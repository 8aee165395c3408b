// The part of a drawing that is seen: panned, zoomed, walked over by mouse and keys.

/** Names are left out when they would be smaller than this, px. */
const SMALLEST_NAME = 5;
/** A name of 12 px is read easily at this scale, and what is under way is shown at least so large. */
const READABLE = 0.62;
const FOLLOWED = 0.8;
/** How long the view takes to what is under way now, ms. */
const GLIDE = 350;

/** A drawing of `nodes` by key, in `svg` within `host`; `on` is told what a person does. */
export class View {
  /** Left, top, width and height of nodes with their names. */
  bounds(nodes) {
    let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const node of nodes) {
      const letters = node.name.length * 6.6;
      const reach = { left: [letters + 30, 24], right: [24, letters + 30] }[node.label] ?? [letters / 2 + 8, letters / 2 + 8];
      left = Math.min(left, node.x - reach[0]);
      right = Math.max(right, node.x + reach[1]);
      top = Math.min(top, node.y - 40);
      bottom = Math.max(bottom, node.y + 40);
    }
    return Number.isFinite(left) ? { x: left, y: top, width: right - left, height: bottom - top } : { x: 0, y: 0, width: 100, height: 100 };
  }

  fit(nodes = [...this.nodes.values()].map((one) => one.node)) {
    this.whole = this.bounds([...this.nodes.values()].map((one) => one.node));
    const box = this.bounds(nodes);
    const grow = 1.06;
    this.look({ x: box.x - (box.width * (grow - 1)) / 2, y: box.y - (box.height * (grow - 1)) / 2, width: box.width * grow, height: box.height * grow });
  }

  /** Whether names can be read when all of it is seen. */
  get readable() {
    const { clientWidth: width, clientHeight: height } = this.host;
    return !this.whole || Math.min(width / this.whole.width, height / this.whole.height) >= READABLE;
  }

  /** Keeps what is under way in view, large enough to be read, until somebody looks elsewhere. */
  follow(nodes, now) {
    const glide = this.glide;
    if (glide) {
      const share = Math.min(1, (now - glide.begun) / GLIDE);
      const eased = share * share * (3 - 2 * share);
      const between = (side) => glide.from[side] + (glide.to[side] - glide.from[side]) * eased;
      this.look({ x: between("x"), y: between("y"), width: between("width"), height: between("height") });
      if (share === 1) this.glide = null;
      return;
    }
    if (nodes.length === 0) return;
    const { x, y, width, height } = this.bounds(nodes);
    const { box } = this;
    if (this.scale >= READABLE && x >= box.x && y >= box.y && x + width <= box.x + box.width && y + height <= box.y + box.height) return;
    const { clientWidth, clientHeight } = this.host;
    if (clientWidth === 0 || clientHeight === 0) return;
    // What does not fit is seen from its first node on: the first is the one that began last.
    const scale = Math.max(FOLLOWED, Math.min(1, clientWidth / (width * 1.1), clientHeight / (height * 1.1)));
    const [w, h] = [clientWidth / scale, clientHeight / scale];
    const at = (from, size, reach, first) => (size <= reach ? from + size / 2 : Math.min(from + size - reach / 2, Math.max(from + reach / 2, first)));
    const [cx, cy] = [at(x, width, w, nodes[0].x), at(y, height, h, nodes[0].y)];
    const to = { x: cx - w / 2, y: cy - h / 2, width: w, height: h };
    if (Math.abs(to.x - box.x) + Math.abs(to.y - box.y) < 2 && Math.abs(to.width - box.width) < 2) return;
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) this.look(to);
    else this.glide = { begun: now, from: { ...box }, to };
  }

  look(box) {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (width === 0 || height === 0) return;
    // Never larger than twice, so that a small net does not shout.
    const scale = Math.min(width / box.width, height / box.height, 1.9);
    const [w, h] = [width / scale, height / scale];
    this.scale = scale;
    const fits = Math.abs(w - box.width) < 1e-9 * w && Math.abs(h - box.height) < 1e-9 * h;
    // What fits stays to the bit: whoever looks at it sees no difference.
    this.box = fits ? { ...box } : { x: box.x + (box.width - w) / 2, y: box.y + (box.height - h) / 2, width: w, height: h };
    this.looked();
  }

  /** Another part is seen. */
  looked() {
    this.svg.setAttribute("viewBox", `${this.box.x} ${this.box.y} ${this.box.width} ${this.box.height}`);
    this.svg.classList.toggle("nameless", 12 * this.scale < SMALLEST_NAME);
    if (this.large) this.field.look(this, this.near);
    this.on.looked?.();
  }

  zoom(factor, [x, y] = [this.box.x + this.box.width / 2, this.box.y + this.box.height / 2]) {
    this.on.took?.();
    const scale = Math.min(6, Math.max(0.02, this.scale * factor));
    const part = this.scale / scale;
    this.scale = scale;
    this.box = { x: x - (x - this.box.x) * part, y: y - (y - this.box.y) * part, width: this.box.width * part, height: this.box.height * part };
    this.looked();
  }

  pan(dx, dy) {
    this.on.took?.();
    this.box.x += dx / this.scale;
    this.box.y += dy / this.scale;
    this.looked();
  }

  center(key) {
    const shown = this.nodes.get(key);
    if (!shown) return;
    const { x, y } = shown.node;
    const inside = x > this.box.x + 40 && x < this.box.x + this.box.width - 40 && y > this.box.y + 40 && y < this.box.y + this.box.height - 40;
    if (!inside) this.pan((x - this.box.x - this.box.width / 2) * this.scale, (y - this.box.y - this.box.height / 2) * this.scale);
  }

  /** The node under a pointer. */
  under(event) {
    if (!this.large) return event.target.closest?.(".node")?.dataset.key ?? null;
    const rect = this.svg.getBoundingClientRect();
    return this.field.at(this.box.x + (event.clientX - rect.left) / this.scale, this.box.y + (event.clientY - rect.top) / this.scale);
  }

  navigate() {
    let drag = null;
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      const rect = this.svg.getBoundingClientRect();
      const at = [this.box.x + (event.clientX - rect.left) / this.scale, this.box.y + (event.clientY - rect.top) / this.scale];
      if (event.ctrlKey || Math.abs(event.deltaY) >= Math.abs(event.deltaX)) this.zoom(Math.exp(-event.deltaY * 0.0016), at);
      else this.pan(event.deltaX, 0);
    }, { passive: false });
    this.svg.addEventListener("pointerdown", (event) => {
      const key = this.under(event);
      drag = { x: event.clientX, y: event.clientY, moved: false, node: key !== null && this.on.movable(key) ? key : null };
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (drag === null || event.buttons === 0) return;
      const [dx, dy] = [event.clientX - drag.x, event.clientY - drag.y];
      if (!drag.moved && Math.hypot(dx, dy) < 4) return;
      if (!drag.moved) this.svg.setPointerCapture(event.pointerId);
      if (drag.node === null) this.pan(-dx, -dy);
      else this.move(drag.node, dx / this.scale, dy / this.scale);
      drag = { ...drag, x: event.clientX, y: event.clientY, moved: true };
    });
    this.svg.addEventListener("pointerup", (event) => {
      const was = drag;
      drag = null;
      if (was?.moved) {
        if (was.node !== null) this.on.moved(was.node);
        return;
      }
      this.on.select(this.under(event));
    });
    this.svg.addEventListener("dblclick", (event) => {
      const key = this.under(event);
      if (key !== null) this.on.open(key);
    });
  }

  /** The node that an arrow key leads to from `key`. */
  neighbour(key, [dx, dy]) {
    const from = this.nodes.get(key)?.node;
    if (!from) return this.nodes.keys().next().value ?? null;
    let best = null;
    for (const shown of this.nodes.values()) {
      const [x, y] = [shown.node.x - from.x, shown.node.y - from.y];
      const ahead = x * dx + y * dy;
      if (ahead <= 4) continue;
      const cost = ahead + 2.5 * Math.abs(x * dy - y * dx);
      if (best === null || cost < best.cost) best = { cost, key: shown.key };
    }
    return best?.key ?? key;
  }
}
