// Cameras in the scene: the picture of each in its pyramid, and the scene as a camera sees it.

import { inner, times } from "./solids.js";

const PICTURE = [`#version 300 es
in vec3 at; in vec2 spot;
uniform mat4 seen; uniform mat4 frame;
out vec2 texel;
void main() {
  texel = spot;
  gl_Position = seen * frame * vec4(at, 1.0);
}`, `#version 300 es
precision highp float;
in vec2 texel;
uniform sampler2D picture;
out vec4 ink;
void main() {
  ink = vec4(texture(picture, texel).rgb, 1.0);
}`];

const NEAR = 0.02;
const FAR = 40;

/** The pyramid of a part that is a camera; undefined of others. */
export const pyramidOf = (part) => part.solids.map((solid) => solid.frustum).find((one) => one !== undefined);

/**
 * What is seen from the frame of a camera, whose x is right, y down and z forward, with all of its picture in an area of that
 * `aspect`. The corners of its pyramid are left above, right above, right below, left below.
 */
export function seenFrom(frame, corners, aspect) {
  const [x, y, z, t] = [0, 4, 8, 12].map((at) => frame.slice(at, at + 3));
  const view = [x[0], -y[0], -z[0], 0, x[1], -y[1], -z[1], 0, x[2], -y[2], -z[2], 0, -inner(x, t), inner(y, t), inner(z, t), 1];
  const depth = corners[0][2];
  let [left, right, top, bottom] = [corners[0][0] / depth, corners[2][0] / depth, -corners[0][1] / depth, -corners[2][1] / depth];
  const own = (right - left) / (top - bottom);
  if (aspect > own) {
    const [middle, half] = [(left + right) / 2, ((top - bottom) * aspect) / 2];
    [left, right] = [middle - half, middle + half];
  } else {
    const [middle, half] = [(top + bottom) / 2, (right - left) / aspect / 2];
    [top, bottom] = [middle + half, middle - half];
  }
  const lens = [2 / (right - left), 0, 0, 0, 0, 2 / (top - bottom), 0, 0,
    (right + left) / (right - left), (top + bottom) / (top - bottom), -(FAR + NEAR) / (FAR - NEAR), -1, 0, 0, (-2 * FAR * NEAR) / (FAR - NEAR), 0];
  return times(lens, view);
}

/** Draws pictures into pyramids. */
export class Sights {
  /** For a `view`, which has `gl`, `program` and `buffer`. */
  constructor(view) {
    this.view = view;
    this.look = view.program(PICTURE);
    const { gl } = view;
    this.look.at.picture = gl.getUniformLocation(this.look.program, "picture");
    this.textures = new Map();
    this.planes = new WeakMap();
  }

  /** The texture of the latest picture of a camera that is decoded; null before the first. */
  textureOf(camera, picture) {
    const { gl } = this.view;
    let one = this.textures.get(camera);
    if (!one) {
      one = { texture: gl.createTexture(), wanted: null, ready: false };
      this.textures.set(camera, one);
    }
    if (one.wanted !== picture) {
      one.wanted = picture;
      const image = new Image();
      image.src = `data:image/png;base64,${picture.png}`;
      image.decode().then(() => {
        if (one.wanted !== picture) return;
        gl.bindTexture(gl.TEXTURE_2D, one.texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
        for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
        one.ready = true;
        this.view.stale = true;
      }, () => { /* what is no picture is not drawn */ });
    }
    return one.ready ? one.texture : null;
  }

  planeOf(part, corners) {
    if (!this.planes.has(part)) {
      const [a, b, c, d] = corners;
      const texels = [[a, 0, 0], [b, 1, 0], [c, 1, 1], [a, 0, 0], [c, 1, 1], [d, 0, 1]];
      this.planes.set(part, this.view.buffer(new Float32Array(texels.flatMap(([at, u, v]) => [...at, u, v])), 5));
    }
    return this.planes.get(part);
  }

  /** Draws the picture of each camera of `parts` whose `pictures` has one. Behind everything, it is a backdrop. */
  paint(parts, pictures, seen, behind) {
    const { gl } = this.view;
    for (const one of parts) {
      const pyramid = pyramidOf(one.part);
      const picture = pyramid && pictures.get(pyramid.camera);
      const texture = picture ? this.textureOf(pyramid.camera, picture) : null;
      if (texture === null) continue;
      gl.useProgram(this.look.program);
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(this.look.at.picture, 0);
      gl.uniformMatrix4fv(this.look.at.seen, false, seen);
      gl.uniformMatrix4fv(this.look.at.frame, false, one.frame);
      if (behind) gl.depthMask(false);
      this.view.draw(this.planeOf(one.part, pyramid.corners), gl.TRIANGLES);
      gl.depthMask(true);
    }
  }
}
