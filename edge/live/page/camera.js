// Draws the camera image with boxes and the letters of the choice scorer.

import { $, colour, colourOf, fitted, picture, say } from "./dom.js";

let shot = null;
let image = null;
let targets = [];
let taken_ms = 0;

export const seq = () => shot?.seq ?? 0;

export async function show(next) {
  image = await picture("jpeg", next.jpeg);
  shot = next;
  taken_ms = Date.now();
  draw();
}

export function name(wanted) {
  targets = wanted;
}

export function age() {
  const old_s = shot === null ? 0 : (Date.now() - taken_ms) / 1000;
  const size = shot === null ? "no image yet" : shot.size.join(" × ");
  say("camera-note", old_s > 2 ? `no new image for ${old_s.toFixed(0)} s` : size);
  $("camera").style.opacity = old_s > 2 ? 0.45 : 1;
}

export function draw() {
  const { context, width, height } = fitted($("camera"));
  if (image === null) return;
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
