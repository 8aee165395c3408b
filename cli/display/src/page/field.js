// Paints nets of many nodes on three canvases: what stands still below, what changes above it, breakpoints on top. Only
// nodes that have changed, and lie in the part that is seen, are painted again. Knows shapes and colours, no person.

export const RADIUS = 13;
export const BAR = { width: 8, height: 32 };
/** How far a node's halo and note reach, px. */
const REACH = 34;
const TURN = 2 * Math.PI;

/** The colours of the page, by their names in its style; read again when the scheme changes. */
export function colours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["paper", "panel", "ink", "soft", "faint", "rule", "wash", "token", "ring", "arc", "enabled", "enabled-wash", "running", "running-wash", "failed", "mark"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

export class Field {
  constructor(host) {
    this.canvases = ["still", "moving", "stops"].map((name) => {
      const canvas = document.createElement("canvas");
      canvas.className = `field ${name}`;
      canvas.hidden = true;
      host.append(canvas);
      return canvas;
    });
    this.host = host;
    this.arcs = [];
    this.nodes = [];
  }

  set shown(shown) {
    for (const canvas of this.canvases) canvas.hidden = !shown;
  }

  clear() {
    this.arcs = [];
    this.nodes = [];
  }

  /** Everything anew: another net, another part of it, other colours. */
  look({ box, scale }, near) {
    [this.box, this.scale, this.near] = [box, scale, near];
    this.palette = colours();
    const { clientWidth: width, clientHeight: height } = this.host;
    const ratio = devicePixelRatio;
    this.pens = this.canvases.map((canvas) => {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d");
      pen.setTransform(scale * ratio, 0, 0, scale * ratio, -box.x * scale * ratio, -box.y * scale * ratio);
      return pen;
    });
    const seen = ({ x, y }) => x > box.x - 90 && x < box.x + box.width + 90 && y > box.y - 50 && y < box.y + box.height + 50;
    this.seen = this.nodes.filter((shown) => seen(shown.node));
    this.still();
    this.paint(this.seen);
    this.stops();
  }

  /** Arcs and names. */
  still() {
    const { box, scale, palette, near } = this;
    const pen = this.pens[0];
    pen.lineWidth = Math.max(1.25, 0.6 / scale);
    const far = (key) => near !== null && !near.has(key);
    const within = (points) => points.some(([x, y]) => x > box.x - 40 && x < box.x + box.width + 40 && y > box.y - 40 && y < box.y + box.height + 40);
    const fails = { false: new Path2D(), true: new Path2D() };
    const heads = { false: new Path2D(), true: new Path2D() };
    for (const arc of this.arcs) {
      if (far(arc.from) || far(arc.to) || !within(arc.points)) continue;
      const path = fails[arc.way === "fail"];
      arc.points.forEach(([x, y], at) => (at === 0 ? path.moveTo(x, y) : path.lineTo(x, y)));
      if (scale > 0.25) head(heads[arc.way === "fail"], arc);
    }
    for (const failing of [false, true]) {
      pen.strokeStyle = pen.fillStyle = failing ? palette.failed : palette.arc;
      pen.setLineDash(failing ? [4, 3] : []);
      pen.stroke(fails[failing]);
      pen.fill(heads[failing]);
    }
    pen.setLineDash([]);
    if (12 * scale < 5) return;
    pen.font = "12px ui-sans-serif, system-ui, 'DejaVu Sans', sans-serif";
    pen.lineJoin = "round";
    pen.lineWidth = 3.5;
    pen.strokeStyle = palette.paper;
    for (const { node, kind, key, label } of this.seen) {
      if (far(key)) continue;
      pen.textAlign = { start: "left", end: "right", middle: "center" }[label.anchor];
      pen.fillStyle = kind === "transition" ? palette.ink : palette.soft;
      pen.strokeText(label.text, node.x + label.x, node.y + label.y);
      pen.fillText(label.text, node.x + label.x, node.y + label.y);
    }
  }

  /** Nodes as they are now. */
  paint(changed) {
    const pen = this.pens[1];
    const small = this.scale < 0.25;
    for (const shown of changed) {
      const { node } = shown;
      if (this.near !== null && !this.near.has(shown.key)) continue;
      pen.clearRect(node.x - REACH, node.y - REACH, 2 * REACH, 2 * REACH);
      pen.globalAlpha = shown.net.gone === null ? 1 : 0.35;
      if (shown.kind === "transition") this.transition(pen, shown, small);
      else if (shown.kind === "fold") this.fold(pen, shown);
      else this.place(pen, shown, small);
      pen.globalAlpha = 1;
    }
    if (changed.some(({ armed, stopped }) => armed !== stopped)) this.stops();
  }

  place(pen, { node, kind, count, chosen }, small) {
    const { palette } = this;
    if (chosen) ring(pen, node, RADIUS + 5, palette.mark, 2);
    pen.beginPath();
    pen.arc(node.x, node.y, RADIUS, 0, TURN);
    pen.fillStyle = small && count > 0 ? palette.token : palette.panel;
    pen.fill();
    ring(pen, node, RADIUS, count > 0 ? palette.token : kind === "remote" ? palette.faint : palette.ring, count > 0 ? 2.1 : 1.5);
    if (small || !(count > 0)) return;
    pen.fillStyle = palette.token;
    if (count === 1) {
      pen.beginPath();
      pen.arc(node.x, node.y, 5, 0, TURN);
      pen.fill();
    } else {
      pen.font = "650 12px ui-sans-serif, system-ui, 'DejaVu Sans', sans-serif";
      pen.textAlign = "center";
      pen.fillText(String(count), node.x, node.y + 4);
    }
  }

  transition(pen, { node, state, chosen, part = 0, net }, small) {
    const { palette } = this;
    const [width, height] = node.lying ? [BAR.height, BAR.width] : [BAR.width, BAR.height];
    const [x, y] = [node.x - width / 2, node.y - height / 2];
    const halo = chosen ? palette.mark : palette[state];
    if (halo && !small) {
      pen.strokeStyle = halo;
      pen.lineWidth = chosen ? 2 : 1.4;
      pen.setLineDash(!chosen && state === "enabled" ? [2, 3] : []);
      pen.strokeRect(x - 6, y - 6, width + 12, height + 12);
      pen.setLineDash([]);
    }
    const body = { enabled: palette.enabled, running: palette["running-wash"] }[state] ?? palette.ring;
    pen.fillStyle = small && state === "running" ? palette.running : body;
    pen.fillRect(x, y, width, height);
    if (state === "running") {
      pen.fillStyle = palette.running;
      if (node.lying) pen.fillRect(x, y, width * part, height);
      else pen.fillRect(x, y + height * (1 - part), width, height * part);
      pen.strokeStyle = palette.running;
      pen.lineWidth = 1.8;
      pen.strokeRect(x, y, width, height);
    }
    if (net.notes.some((one) => one.node === node.name)) dot(pen, node.x + 12, node.y - 14, 5, palette.running);
  }

  fold(pen, { node, state, count, chosen }) {
    const { palette } = this;
    pen.fillStyle = palette.panel;
    pen.fillRect(node.x - 22, node.y - 15, 44, 30);
    pen.strokeStyle = chosen ? palette.mark : palette[state] ?? palette.ring;
    pen.lineWidth = 2;
    pen.strokeRect(node.x - 22, node.y - 15, 44, 30);
    pen.font = "650 12px ui-sans-serif, system-ui, 'DejaVu Sans', sans-serif";
    pen.textAlign = "center";
    pen.fillStyle = palette.token;
    pen.fillText(count > 0 ? `● ${count}` : "…", node.x, node.y + 4);
  }

  /** Breakpoints: however small the drawing is, they can be seen, and no node beside them wipes them out. */
  stops() {
    const pen = this.pens[2];
    const { box, scale, near, palette } = this;
    pen.clearRect(box.x, box.y, pen.canvas.width / scale, pen.canvas.height / scale);
    for (const shown of this.seen) {
      shown.stopped = shown.armed;
      if (!shown.armed || (near !== null && !near.has(shown.key))) continue;
      const [x, y] = stopOf(shown);
      dot(pen, x, y, Math.max(4.5, 4 / scale), palette.failed);
    }
  }

  /** The node at a point, px of the drawing. */
  at(x, y) {
    const near = ({ node }) => Math.abs(node.x - x) < 18 && Math.abs(node.y - y) < 22;
    return this.seen?.find(near)?.key ?? null;
  }
}

/** Where the mark of a breakpoint at a node is. */
function stopOf({ node, kind }) {
  const [x, y] = { fold: [-22, -15], transition: node.lying ? [0, -12] : [-12, -20] }[kind] ?? [-14, -12];
  return [node.x + x, node.y + y];
}

function ring(pen, { x, y }, radius, colour, width) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.beginPath();
  pen.arc(x, y, radius, 0, TURN);
  pen.stroke();
}

function dot(pen, x, y, radius, colour) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.arc(x, y, radius, 0, TURN);
  pen.fill();
}

/** The end of an arc: an arrow, a square for what is only read, a circle for what must be empty. */
function head(path, { points, way }) {
  const [to_x, to_y] = points.at(-1);
  const [x, y] = points.at(-2);
  const length = Math.hypot(to_x - x, to_y - y) || 1;
  const [dx, dy] = [(to_x - x) / length, (to_y - y) / length];
  if (way === "inhibit") {
    path.moveTo(to_x - dx * 3 + 3.2, to_y - dy * 3);
    path.arc(to_x - dx * 3, to_y - dy * 3, 3.2, 0, TURN);
  } else if (way === "read") path.rect(to_x - dx * 2 - 2, to_y - dy * 2 - 2, 4, 4);
  else {
    path.moveTo(to_x, to_y);
    path.lineTo(to_x - dx * 7 + dy * 3, to_y - dy * 7 - dx * 3);
    path.lineTo(to_x - dx * 7 - dy * 3, to_y - dy * 7 + dx * 3);
    path.closePath();
  }
}
