// Solids as triangles and lines, and the matrices that place them. A matrix has 16 numbers, column after column.

/** Facets around a round thing. */
const AROUND = 18;
/** Rows of facets of half a ball. */
const CAP = 4;
/** A smaller ball is a bead, without shadow: there may be many, m. */
const BEAD = 0.02;

export const unit4 = () => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export function times(a, b) {
  const made = new Array(16);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      let sum = 0;
      for (let at = 0; at < 4; at += 1) sum += a[at * 4 + row] * b[column * 4 + at];
      made[column * 4 + row] = sum;
    }
  }
  return made;
}

/** The point `[x, y, z]` by a matrix, with what it is divided by. */
export function point4(m, [x, y, z]) {
  return [0, 1, 2, 3].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row]);
}

export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const plus = (a, b, by = 1) => [a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]];
export const inner = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit3 = (a) => { const length = norm(a) || 1; return [a[0] / length, a[1] / length, a[2] / length]; };

/** A frame at `at`, turned by the quaternion `turn`. */
export function placed([px, py, pz], [x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    px, py, pz, 1,
  ];
}

export const scaled = (m, [x, y, z]) => m.map((value, at) => value * (at < 4 ? x : at < 8 ? y : at < 12 ? z : 1));

/** A frame at `a` whose z axis leads to `b`. */
function along(a, b) {
  const z = unit3(minus(b, a));
  const aside = Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const x = unit3(cross(aside, z));
  const y = cross(z, x);
  return [...x, 0, ...y, 0, ...z, 0, ...a, 1];
}

/** The rods and cones of an arrow from the origin along `way`, m, each as the frame that makes it of `arrowParts`. */
export function arrowFrames(way, radius, twoHeads) {
  const length = norm(way);
  const at = (from, size) => scaled(along(plus([0, 0, 0], way, from / length), plus([0, 0, 0], way, from / length + 1)), size);
  const head = Math.min(5 * radius, length / (twoHeads ? 2 : 1));
  const wide = Math.min(2.4 * radius, head);
  const cones = twoHeads ? [length - head, Math.max(0, length - 1.8 * head)] : [length - head];
  return [["rod", at(0, [radius, radius, Math.max(0, length - head)])], ...cones.map((from) => ["cone", at(from, [wide, wide, head])])];
}

/** What is seen from `eye` towards `to`, z up. */
export function looking(eye, to) {
  const back = unit3(minus(eye, to));
  const right = unit3(cross([0, 0, 1], back));
  const up = cross(back, right);
  return [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -inner(right, eye), -inner(up, eye), -inner(back, eye), 1];
}

export function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

// -- meshes: corners of six numbers, position and normal, and the order in which triangles have them --------------

function grid(rows, columns, corner) {
  const made = { corners: [], order: [] };
  for (let row = 0; row <= rows; row += 1) for (let column = 0; column <= columns; column += 1) made.corners.push(...corner(row / rows, column / columns));
  const at = (row, column) => row * (columns + 1) + column;
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      const quad = [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)];
      for (const one of [0, 1, 2, 0, 2, 3]) made.order.push(quad[one]);
    }
  }
  return made;
}

/** Several meshes as one. */
export function joined(meshes) {
  const made = { corners: [], order: [] };
  for (const { corners, order } of meshes) {
    const first = made.corners.length / 6;
    for (const number of corners) made.corners.push(number);
    for (const one of order) made.order.push(first + one);
  }
  return made;
}

const roundTo = (share) => [Math.cos(2 * Math.PI * share), Math.sin(2 * Math.PI * share)];

/** A capsule along z from 0 to `length`, m. */
function capsule(length, radius, coarse) {
  const [rows, columns] = radius < BEAD ? [3, 6] : [[2 * CAP + 1, AROUND], [5, 10], [3, 8]][coarse];
  // The rows of both caps, and one of the tube between them.
  return grid(rows, columns, (v, u) => {
    const row = Math.round(v * rows);
    const upper = row > (rows - 1) / 2;
    const angle = length === 0 ? Math.PI * (v - 0.5) : (Math.PI / (rows - 1)) * (upper ? row - 1 - (rows - 1) / 2 : row - (rows - 1) / 2);
    const [x, y] = roundTo(u);
    const [r, z] = [Math.cos(angle), Math.sin(angle)];
    return [radius * r * x, radius * r * y, radius * z + (upper ? length : 0), r * x, r * y, z];
  });
}

const tube = grid(1, AROUND, (v, u) => { const [x, y] = roundTo(u); return [x, y, 2 * v - 1, x, y, 0]; });
const disc = (side) => grid(1, AROUND, (v, u) => { const [x, y] = roundTo(-side * u); return [x * v, y * v, side, 0, 0, side]; });
const can = joined([tube, disc(1), disc(-1)]);
/** A cone along z, its tip at 1. */
const cone = joined([grid(1, AROUND, (v, u) => { const [x, y] = roundTo(u); return [x * (1 - v), y * (1 - v), v, x * 0.7, y * 0.7, 0.7]; }), grid(1, AROUND, (v, u) => { const [x, y] = roundTo(u); return [x * v, y * v, 0, 0, 0, -1]; })]);
/** A rod along z, from 0 to 1. */
const rod = grid(1, AROUND, (v, u) => { const [x, y] = roundTo(u); return [x, y, v, x, y, 0]; });
export const arrowParts = { rod, cone };
const cube = joined([0, 1, 2].flatMap((axis) => [-1, 1].map((side) => grid(1, 1, (v, u) => {
  const corner = [0, 0, 0];
  const normal = [0, 0, 0];
  [corner[axis], normal[axis]] = [side, side];
  corner[(axis + 1) % 3] = 2 * u - 1;
  corner[(axis + 2) % 3] = (2 * v - 1) * side;
  return [...corner, ...normal];
}))));

/** A mesh by a matrix, which scales along its axes at most: these normals stay at right angles. */
function moved({ corners, order }, m) {
  const made = [];
  for (let at = 0; at < corners.length; at += 6) {
    const [x, y, z, nx, ny, nz] = corners.slice(at, at + 6);
    made.push(...point4(m, [x, y, z]).slice(0, 3), ...unit3([0, 1, 2].map((row) => m[row] * nx + m[4 + row] * ny + m[8 + row] * nz)));
  }
  return { corners: made, order };
}

/** The surface of a solid, in the frame of its part, seen from outside: fine (0), coarse (1), or as is enough for a shadow (2). */
export function surface(solid, coarse = 0) {
  if (solid.capsule) {
    const { a, b, radius } = solid.capsule;
    const length = norm(minus(b, a));
    if (coarse === 2 && radius < BEAD) return joined([]);
    return length < 1e-9 ? moved(capsule(0, radius, coarse), placed(a, [0, 0, 0, 1])) : moved(capsule(length, radius, coarse), along(a, b));
  }
  if (solid.block) return moved(cube, scaled(placed(solid.block.pose.at, solid.block.pose.turn), solid.block.half));
  if (solid.cylinder) {
    const { pose, half, radius } = solid.cylinder;
    return moved(can, scaled(placed(pose.at, pose.turn), [radius, radius, half]));
  }
  if (solid.hull) {
    const { pose, corners, triangles } = solid.hull;
    return moved(joined(triangles.map((one) => facet(one.map((corner) => corners[corner])))), placed(pose.at, pose.turn));
  }
  return joined([]);
}

/** A triangle, each of whose corners has its normal. */
function facet([a, b, c]) {
  const normal = unit3(cross(minus(b, a), minus(c, a)));
  return { corners: [a, b, c].flatMap((corner) => [...corner, ...normal]), order: [0, 1, 2] };
}

// -- lines ----------------------------------------------------------------------------------

function circle(frame, radius, z) {
  const points = [];
  for (let at = 0; at <= AROUND; at += 1) {
    const [x, y] = roundTo(at / AROUND);
    points.push(point4(frame, [radius * x, radius * y, z]).slice(0, 3));
  }
  return points.slice(1).flatMap((point, at) => [points[at], point]);
}

const sides = (frame, radius, from, to) => [0, 0.25, 0.5, 0.75].flatMap((share) => {
  const [x, y] = roundTo(share);
  return [from, to].map((z) => point4(frame, [radius * x, radius * y, z]).slice(0, 3));
});

/** The outline of a solid in the frame of its part: ends of lines, two by two. */
export function outline(solid) {
  if (solid.capsule) {
    const { a, b, radius } = solid.capsule;
    const length = norm(minus(b, a));
    const frame = length < 1e-9 ? placed(a, [0, 0, 0, 1]) : along(a, b);
    const standing = [[0, 0, 1], [1, 0, 0]].flatMap((aside) => {
      const across = times(frame, along([0, 0, 0], aside));
      return aside[0] === 0 ? [] : circle(across, radius, 0);
    });
    return length < 1e-9 ? [...circle(frame, radius, 0), ...standing] : [...circle(frame, radius, 0), ...circle(frame, radius, length), ...sides(frame, radius, 0, length)];
  }
  if (solid.block) {
    const frame = scaled(placed(solid.block.pose.at, solid.block.pose.turn), solid.block.half);
    const corner = (bits) => point4(frame, [0, 1, 2].map((axis) => ((bits >> axis) & 1 ? 1 : -1))).slice(0, 3);
    const edges = [];
    for (let bits = 0; bits < 8; bits += 1) for (const axis of [1, 2, 4]) if ((bits & axis) === 0) edges.push(corner(bits), corner(bits | axis));
    return edges;
  }
  if (solid.cylinder) {
    const { pose, half, radius } = solid.cylinder;
    const frame = placed(pose.at, pose.turn);
    return [...circle(frame, radius, -half), ...circle(frame, radius, half), ...sides(frame, radius, -half, half)];
  }
  if (solid.hull) {
    const { pose, corners, triangles } = solid.hull;
    const frame = placed(pose.at, pose.turn);
    const ends = corners.map((corner) => point4(frame, corner).slice(0, 3));
    return edgesOf(corners, triangles).flatMap((edge) => edge.map((corner) => ends[corner]));
  }
  if (solid.frustum) {
    const { corners } = solid.frustum;
    return corners.flatMap((corner, at) => [[0, 0, 0], corner, corner, corners[(at + 1) % 4]]);
  }
  return [];
}

/** The edges of a convex surface at which it bends: between triangles whose normals differ. */
function edgesOf(corners, triangles) {
  const bends = new Map();
  for (const one of triangles) {
    const [a, b, c] = one.map((corner) => corners[corner]);
    const normal = unit3(cross(minus(b, a), minus(c, a)));
    for (const at of [0, 1, 2]) {
      const edge = [one[at], one[(at + 1) % 3]].sort((from, to) => from - to);
      const known = bends.get(edge.join(" ")) ?? { edge, normal, bent: false };
      bends.set(edge.join(" "), { ...known, bent: known.bent || inner(known.normal, normal) < 1 - 1e-6 });
    }
  }
  return [...bends.values()].filter((one) => one.bent).map((one) => one.edge);
}

/** A ball around a solid, in the frame of its part: centre and radius, m. */
export function ballOf(solid) {
  if (solid.capsule) {
    const { a, b, radius } = solid.capsule;
    return [plus(a, minus(b, a), 0.5), norm(minus(b, a)) / 2 + radius];
  }
  if (solid.block) return [solid.block.pose.at, norm(solid.block.half)];
  if (solid.cylinder) return [solid.cylinder.pose.at, Math.hypot(solid.cylinder.half, solid.cylinder.radius)];
  if (solid.hull) return [solid.hull.pose.at, Math.max(...solid.hull.corners.map(norm))];
  if (solid.frustum) return [[0, 0, 0], 0.1];
  return null;
}

/** How far along a ray a solid is met, in the frame of its part; null where it is missed. */
export function hit(solid, from, way) {
  if (solid.capsule) {
    const { a, b, radius } = solid.capsule;
    const axis = minus(b, a);
    let best = null;
    // The nearest of some balls along the axis: good enough to point at something.
    const count = Math.max(1, Math.ceil((2 * norm(axis)) / radius));
    for (let at = 0; at <= count; at += 1) {
      const met = hitBall(plus(a, axis, at / count), radius, from, way);
      if (met !== null && (best === null || met < best)) best = met;
    }
    return best;
  }
  const around = ballOf(solid);
  return around === null ? null : hitBall(around[0], around[1], from, way);
}

function hitBall(centre, radius, from, way) {
  const to = minus(centre, from);
  const near = inner(to, way);
  const off = inner(to, to) - near * near;
  return off > radius * radius || near < 0 ? null : near - Math.sqrt(radius * radius - off);
}
