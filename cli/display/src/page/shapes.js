// The shapes of a net's drawing: nodes' edges, lines, tokens, ends of arcs. Knows no net.

import { BAR, RADIUS } from "./field.js";

const SVG = "http://www.w3.org/2000/svg";

export function element(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

const towards = ([x, y], [to_x, to_y], distance) => {
  const length = Math.hypot(to_x - x, to_y - y) || 1;
  return [x + ((to_x - x) / length) * distance, y + ((to_y - y) / length) * distance];
};

/** Where a line from a node to a point begins: on the node's edge. */
function edge(node, point) {
  if (!("transition" in node.kind || "fold" in node.kind)) return towards([node.x, node.y], point, RADIUS + 1.5);
  const [width, height] = "fold" in node.kind ? [44, 30] : node.lying ? [BAR.height, BAR.width] : [BAR.width, BAR.height];
  const [dx, dy] = [point[0] - node.x, point[1] - node.y];
  const part = Math.min((width / 2 + 2) / (Math.abs(dx) || 1e-9), (height / 2 + 2) / (Math.abs(dy) || 1e-9));
  return [node.x + dx * part, node.y + dy * part];
}

/** A line through points, its corners rounded. */
export function pathOf(points) {
  let path = "";
  points.forEach((point, at) => {
    const [x, y] = point;
    if (at === 0) path += `M${x} ${y}`;
    else if (at === points.length - 1) path += `L${x} ${y}`;
    else {
      const reach = (other) => Math.min(14, Math.hypot(other[0] - x, other[1] - y) / 2);
      const [bx, by] = towards(point, points[at - 1], reach(points[at - 1]));
      const [ax, ay] = towards(point, points[at + 1], reach(points[at + 1]));
      path += `L${bx.toFixed(1)} ${by.toFixed(1)}Q${x} ${y} ${ax.toFixed(1)} ${ay.toFixed(1)}`;
    }
  });
  return path;
}

const round = (points) => points.map(([x, y]) => [Math.round(x * 10) / 10, Math.round(y * 10) / 10]);

/** The line of an arc between two nodes, by the points on its way. */
export function pointsOf({ ends: [from, to], via }) {
  return round([edge(from, via[0] ?? [to.x, to.y]), ...via, edge(to, via.at(-1) ?? [from.x, from.y])]);
}

/** Where the weight of an arc stands. */
export function middleOf(points) {
  const at = Math.floor((points.length - 1) / 2);
  const [[x, y], [next_x, next_y]] = [points[at], points[at + 1]];
  return { x: (x + next_x) / 2, y: (y + next_y) / 2 - 4 };
}

/** The point at a part of the way along a line. */
export function alongPoints(points, part) {
  const lengths = points.slice(1).map(([x, y], at) => Math.hypot(x - points[at][0], y - points[at][1]));
  let left = part * lengths.reduce((sum, length) => sum + length, 0);
  let at = 0;
  while (at < lengths.length - 1 && left > lengths[at]) left -= lengths[at++];
  return towards(points[at], points[at + 1], left);
}

/** Up to five tokens are dots; more are a number. */
export function dots(count) {
  if (count === 0) return [];
  if (count > 5) return [element("text", { class: "count", y: 4 }, count > 999 ? `${Math.floor(count / 1000)}k` : String(count))];
  const at = [[], [[0, 0]], [[-4.2, 0], [4.2, 0]], [[0, -4.4], [-4.4, 3.4], [4.4, 3.4]], [[-4.2, -4.2], [4.2, -4.2], [-4.2, 4.2], [4.2, 4.2]], [[0, 0], [-5.2, -5.2], [5.2, -5.2], [-5.2, 5.2], [5.2, 5.2]]][count];
  const radius = [0, 5, 3.6, 3.2, 3, 2.7][count];
  return at.map(([cx, cy]) => element("circle", { cx, cy, r: radius }));
}

export function markers() {
  const marker = (id, size, ...shapes) => element("marker", { id, viewBox: "0 0 10 10", refX: id === "inhibit" ? 9 : 8.5, refY: 5, markerWidth: size, markerHeight: size, orient: "auto-start-reverse", markerUnits: "userSpaceOnUse" }, ...shapes);
  return element("defs", {},
    marker("arrow", 8, element("path", { class: "head", d: "M0 1.2 9 5 0 8.8z" })),
    marker("fail", 8, element("path", { class: "head fail", d: "M0 1.2 9 5 0 8.8z" })),
    marker("inhibit", 9, element("circle", { class: "head inhibit", cx: 5, cy: 5, r: 3.6 })),
    marker("read", 7, element("rect", { class: "head", x: 3, y: 3, width: 5, height: 5 })));
}
