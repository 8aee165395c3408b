// The whole net small, with the part that is seen.

import { colours } from "./field.js";

const WIDTH = 150;
const HEIGHT = 110;

export class Minimap {
  constructor(host, picture) {
    this.picture = picture;
    this.canvas = document.createElement("canvas");
    this.canvas.className = "minimap";
    this.canvas.setAttribute("aria-hidden", "true");
    host.append(this.canvas);
    this.canvas.addEventListener("pointerdown", (event) => this.go(event));
    this.canvas.addEventListener("pointermove", (event) => event.buttons > 0 && this.go(event));
  }

  go(event) {
    const { whole, box } = this.picture;
    const rect = this.canvas.getBoundingClientRect();
    const x = whole.x + ((event.clientX - rect.left) / rect.width) * whole.width;
    const y = whole.y + ((event.clientY - rect.top) / rect.height) * whole.height;
    this.picture.pan((x - box.x - box.width / 2) * this.picture.scale, (y - box.y - box.height / 2) * this.picture.scale);
  }

  /** Another net. */
  show() {
    const { whole } = this.picture;
    this.scale = Math.min(WIDTH / whole.width, HEIGHT / whole.height);
    const [width, height] = [whole.width * this.scale, whole.height * this.scale];
    const ratio = devicePixelRatio;
    this.canvas.width = Math.ceil(width * ratio);
    this.canvas.height = Math.ceil(height * ratio);
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.update();
  }

  update() {
    const { whole, box, nodes } = this.picture;
    if (!this.scale || !whole) return;
    const inside = box.x <= whole.x && box.y <= whole.y && box.x + box.width >= whole.x + whole.width && box.y + box.height >= whole.y + whole.height;
    this.canvas.classList.toggle("needless", inside);
    if (inside) return;
    const palette = colours();
    const pen = this.canvas.getContext("2d");
    const scale = this.scale * devicePixelRatio;
    pen.setTransform(scale, 0, 0, scale, -whole.x * scale, -whole.y * scale);
    pen.clearRect(whole.x, whole.y, whole.width, whole.height);
    const size = Math.max(2.4 / this.scale, 14);
    for (const { node, count, state } of nodes.values()) {
      pen.fillStyle = count > 0 ? palette.token : palette[state] ?? palette.faint;
      pen.fillRect(node.x - size / 2, node.y - size / 2, size, size);
    }
    pen.strokeStyle = palette.mark;
    pen.lineWidth = 1.5 / this.scale;
    pen.strokeRect(box.x, box.y, box.width, box.height);
  }
}
