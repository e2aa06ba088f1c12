// Draws the image of each camera with boxes and the letters of the choice scorer.

import { $, colour, colourOf, fitted, picture, say } from "./dom.js";

const STALE_MS = 2000;
let targets = [];

export function name(wanted) {
  targets = wanted;
}

class View {
  shot = null;
  image = null;
  taken_ms = 0;

  constructor(id) {
    this.id = id;
    this.canvas = $(id);
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  async show(shot) {
    this.image = await picture("jpeg", shot.jpeg);
    this.shot = shot;
    this.taken_ms = Date.now();
    this.canvas.hidden = false;
    this.draw();
  }

  // Returns the size of the image, or for how long there was none.
  age() {
    if (this.shot === null) return null;
    const old_ms = Date.now() - this.taken_ms;
    this.canvas.style.opacity = old_ms > STALE_MS ? 0.45 : 1;
    return old_ms > STALE_MS ? `no new image for ${(old_ms / 1000).toFixed(0)} s` : this.shot.size.join(" × ");
  }

  draw() {
    const { context, width, height } = fitted(this.canvas);
    if (this.image === null) return;
    const { shot, image } = this;
    const scale = Math.min(width / image.width, height / image.height);
    const [w, h] = [image.width * scale, image.height * scale];
    const [x0, y0] = [(width - w) / 2, (height - h) / 2];
    context.drawImage(image, x0, y0, w, h);
    const boxes = shot.boxes.map(({ xyxy, ...box }) => ({
      ...box, x: x0 + xyxy[0] * w, y: y0 + xyxy[1] * h, x1: x0 + xyxy[2] * w, y1: y0 + xyxy[3] * h,
    }));
    context.font = "600 12px system-ui, sans-serif";
    context.textBaseline = "middle";
    const most = x0 + w;
    for (const box of boxes.filter((b) => !b.wanted)) frame(context, box, "#ffffffa0", 1, most);
    for (const box of boxes.filter((b) => b.wanted)) frame(context, box, colourOf(box.label, targets), 2.5, most);
    let last = -Infinity; // from left to right, so that none covers the previous one
    for (const [letter, u, v] of shot.letters) {
      last = Math.max(x0 + u * w, last + 21);
      disc(context, letter, last, y0 + v * h);
    }
  }
}

const views = [new View("camera"), new View("camera2")];

// Gets the images that are new by their numbers, which `shots` has by camera.
export async function update(shots, get) {
  for (const view of views) {
    const newest = shots[view.id];
    if (newest === undefined || newest === view.shot?.seq) continue;
    const shot = await get(`live/${view.id}`);
    if (shot) await view.show(shot);
  }
  say("camera-note", views.map((view) => view.age()).filter(Boolean).join(" · ") || "no image yet");
}

export const draw = () => views.forEach((view) => view.draw());

function frame(context, box, ink, line, most) {
  context.strokeStyle = ink;
  context.lineWidth = line;
  context.strokeRect(box.x, box.y, box.x1 - box.x, box.y1 - box.y);
  const text = `${box.label} ${box.score.toFixed(2)}`;
  const wide = context.measureText(text).width + 8;
  const y = box.y > 18 ? box.y - 17 : box.y;
  const x = Math.max(Math.min(box.x - line / 2, most - wide), 0);
  const solid = line > 2;
  context.fillStyle = solid ? ink : "#0b0e12a0";
  context.fillRect(x, y, wide, 17);
  context.fillStyle = solid ? "#fff" : "#ffffffd0";
  context.fillText(text, x + 4, y + 9);
}

export function disc(context, letter, x, y, radius = 10) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = "#fff";
  context.fill();
  context.lineWidth = 1.5;
  context.strokeStyle = "#000";
  context.stroke();
  context.fillStyle = "#000";
  context.font = `700 ${1.3 * radius}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(letter, x, y + 0.5);
  context.textAlign = "start";
}
