// Draws the map: occupancy, robot, candidates and goal.

import { disc } from "./camera.js";
import { $, colour, colourOf, fitted, once, picture, say } from "./dom.js";

const MARGIN_M = 0.6;
const NEAR_PX = 16;
const NAMED_PX = 45; // px per metre from which objects have names
const SAME_PX = 6;
const N_SCORES = 6; // number of best frontiers that are shown with scores
const [LEAST, MOST] = [4, 400]; // px per metre
// Viridis, from low to high.
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

const canvas = $("map");
const view = { x: 0, y: 0, scale: 60, follow: false, fitted: true };
const shown = {
  map: null, layer: null, now: null, trail: [], targets: [], radius_m: 0.2, plan: null,
  site: [], objects: [], rooms: [], draft: [],
};
let due = false;

export function draw() {
  if (!due) {
    due = true;
    requestAnimationFrame(() => {
      due = false;
      paint();
    });
  }
}

export function update(part) {
  Object.assign(shown, part);
  draw();
}

export async function showMap(grid) {
  const levels = ["unknown", "free", "near", "wall"].map((name) => rgb(colour(name)));
  const level = (v) => (v === 255 ? 0 : v === 0 ? 1 : v < 100 ? 2 : 3);
  shown.map = await coloured(grid, (v) => [...levels[level(v)], 255]);
  shown.grid = grid;
  if (view.fitted) fit();
  draw();
}

// Draws the same map in new colours of the page.
export const recolour = () => shown.grid && showMap(shown.grid);

export async function showLayer(grid) {
  shown.layer = grid && (await coloured(grid, (v) => [...ramp(v / 255), v === 0 ? 0 : 165]));
  draw();
}

async function coloured(grid, paintOf) {
  const [width, height] = grid.size;
  if (width === 0 || height === 0) return null;
  const sheet = new OffscreenCanvas(width, height);
  const context = sheet.getContext("2d", { willReadFrequently: true });
  context.drawImage(await picture("png", grid.png), 0, 0);
  const pixels = context.getImageData(0, 0, width, height);
  const table = new Uint32Array(256);
  const bytes = new Uint8ClampedArray(table.buffer);
  for (let v = 0; v < 256; v++) bytes.set(paintOf(v), 4 * v);
  const words = new Uint32Array(pixels.data.buffer);
  for (let i = 0; i < words.length; i++) words[i] = table[words[i] & 0xff];
  context.putImageData(pixels, 0, 0);
  return { ...grid, sheet };
}

const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.length > 4 ? hex.slice(i, i + 2) : hex[(i + 1) / 2].repeat(2), 16));

function ramp(share) {
  const at = Math.min(share, 1) * (RAMP.length - 1);
  const i = Math.min(Math.floor(at), RAMP.length - 2);
  return RAMP[i].map((low, k) => Math.round(low + (at - i) * (RAMP[i + 1][k] - low)));
}

// -- view ----------------------------------------------------------------

const toScreen = ([x, y]) => [
  canvas.clientWidth / 2 + (x - view.x) * view.scale,
  canvas.clientHeight / 2 - (y - view.y) * view.scale,
];
const toMap = (px, py) => [
  view.x + (px - canvas.clientWidth / 2) / view.scale,
  view.y - (py - canvas.clientHeight / 2) / view.scale,
];

export function fit() {
  view.fitted = true;
  if (!shown.map) return;
  const [w, h] = shown.map.size.map((n) => n * shown.map.resolution_m);
  const [x, y] = shown.map.origin_xy_m;
  [view.x, view.y] = [x + w / 2, y + h / 2];
  const room = [canvas.clientWidth / (w + 2 * MARGIN_M), canvas.clientHeight / (h + 2 * MARGIN_M)];
  view.scale = Math.min(Math.max(Math.min(...room), LEAST), MOST);
  draw();
}

export function zoom(by, px = canvas.clientWidth / 2, py = canvas.clientHeight / 2) {
  const [x, y] = toMap(px, py);
  view.scale = Math.min(Math.max(view.scale * by, LEAST), MOST);
  view.fitted = false;
  if (!view.follow) {
    const [nx, ny] = toMap(px, py);
    pan(x - nx, y - ny);
  }
  draw();
}

function pan(dx, dy) {
  view.x += dx;
  view.y += dy;
  view.fitted = false;
  draw();
}

export function centre([x, y]) {
  follow(false);
  pan(x - view.x, y - view.y);
}

export const isSame = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]) * view.scale < SAME_PX;

export function follow(on) {
  view.follow = on;
  if (on) view.fitted = false;
  $("follow").setAttribute("aria-pressed", String(on));
  draw();
}

// -- drawing ------------------------------------------------------------------------------

function paint() {
  const now = shown.now;
  if (view.follow && now?.pose) [view.x, view.y] = now.pose;
  const { context, width, height } = fitted(canvas);
  sheet(context, shown.map, false);
  sheet(context, shown.layer, true);
  for (const room of shown.rooms) outline(context, room);
  for (const { properties, geometry } of shown.site) {
    if (geometry.type === "Polygon") zone(context, properties, geometry.coordinates[0].map(toScreen));
  }
  scaleBar(context, height);
  line(context, trail(now), colour("trail"), 2.5);
  for (const { properties, geometry } of shown.site) {
    if (properties.kind === "place") place(context, properties, toScreen(geometry.coordinates));
  }
  draft(context);
  if (!now) return;
  for (const one of remembered()) known(context, one);
  for (const room of shown.rooms) roomTitle(context, room);
  if (now.task && shown.plan) trajectory(context, shown.plan, now.task.index);
  line(context, now.path.map(toScreen), colour("path"), 2.5, [7, 5]);
  const open = now.candidates.filter((c) => c.kind !== "instance");
  open.sort((a, b) => (a.score ?? -1) - (b.score ?? -1)); // the best on top
  const best = Math.max(open.at(-1)?.score ?? 0, 1e-9);
  open.forEach((c, i) => frontier(context, c, best, i >= open.length - N_SCORES));
  for (const thing of now.instances) instance(context, thing);
  if (now.goal) goal(context, now.goal);
  if (now.pose) robot(context, now.pose);
}

function sheet(context, grid, smooth) {
  if (!grid) return;
  const [x, y] = toScreen(grid.origin_xy_m);
  const px = grid.resolution_m * view.scale;
  context.save();
  context.translate(x, y);
  context.scale(px, -px); // row 0 is the lowest y
  context.imageSmoothingEnabled = smooth || px < 1;
  context.drawImage(grid.sheet, 0, 0);
  context.restore();
}

// A jump of the pose is not drawn as a driven path.
function trail(now) {
  const places = now?.pose ? [...shown.trail, now.pose] : shown.trail;
  return places.map((at, i) => {
    const before = places[i - 1];
    const jumped = before && Math.hypot(at[0] - before[0], at[1] - before[1]) > 1.5;
    return [...toScreen(at), jumped];
  });
}

// Draws the coarse and the refined trajectory; the driven part is pale.
function trajectory(context, { coarse, trajectory: poses }, index) {
  const places = poses.map(toScreen);
  line(context, coarse.map(toScreen), colour("coarse"), 2, [3, 5]);
  context.globalAlpha = 0.35;
  line(context, places.slice(0, index + 1), colour("trajectory"), 5);
  context.globalAlpha = 0.85;
  line(context, places.slice(Math.max(index, 0)), colour("trajectory"), 5);
  context.globalAlpha = 1;
  if (!poses.length) return;
  const [[x, y], heading] = [places.at(-1), poses.at(-1)[2]];
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  line(context, [[x - 11 * c - 7 * s, y + 11 * s - 7 * c], [x, y], [x - 11 * c + 7 * s, y + 11 * s + 7 * c]], colour("trajectory"), 4);
}

function line(context, places, ink, width, dash = []) {
  context.beginPath();
  for (const [x, y, jumped] of places) jumped ? context.moveTo(x, y) : context.lineTo(x, y);
  context.strokeStyle = ink;
  context.lineWidth = width;
  context.lineJoin = context.lineCap = "round";
  context.setLineDash(dash);
  context.stroke();
  context.setLineDash([]);
}

function frontier(context, c, best, showScore) {
  const [x, y] = toScreen(c.xy_m);
  const share = Math.max(c.score ?? 0, 0) / best;
  context.globalAlpha = c.blocked ? 0.35 : 0.45 + 0.55 * share;
  context.beginPath();
  context.arc(x, y, 4 + 4 * share, 0, 2 * Math.PI);
  context.fillStyle = c.blocked ? colour("muted") : colour("frontier");
  context.fill();
  context.globalAlpha = 1;
  if (c.letter) disc(context, c.letter, x, y - 15, 9);
  else if (showScore && c.score > 0) label(context, c.score.toPrecision(2), x + 10, y, colour("frontier"));
}

function instance(context, thing) {
  const [x, y] = toScreen(thing.xy_m);
  const rejected = thing.state === "rejected";
  const ink = rejected ? colour("muted") : colourOf(thing.label, shown.targets);
  const half = thing.state === "tentative" || rejected ? 5 : 7;
  context.fillStyle = ink;
  context.fillRect(x - half, y - half, 2 * half, 2 * half);
  context.strokeStyle = colour("card");
  context.lineWidth = 1.5;
  context.strokeRect(x - half, y - half, 2 * half, 2 * half);
  if (thing.state !== "tentative") label(context, rejected ? `no ${thing.label}` : thing.label, x + half + 4, y, ink);
}

// Objects that are not drawn as objects of the mission.
function remembered() {
  const drawn = new Set(shown.now?.instances.map((one) => one.label));
  return shown.objects.filter((one) => !drawn.has(one.name));
}

function known(context, { name, xyz }) {
  const [x, y] = toScreen(xyz);
  context.fillStyle = colour("card");
  context.strokeStyle = colour("thing");
  context.lineWidth = 1.5;
  context.fillRect(x - 3.5, y - 3.5, 7, 7);
  context.strokeRect(x - 3.5, y - 3.5, 7, 7);
  if (view.scale >= NAMED_PX) label(context, name, x + 7, y, colour("thing"), 500);
}

function zone(context, { kind, name }, ring) {
  const ink = colour(kind);
  line(context, ring, ink, 2, [8, 4]);
  context.globalAlpha = 0.14;
  context.fillStyle = ink;
  context.fill();
  context.globalAlpha = 1;
  const [x, y] = ring.reduce((best, at) => (at[1] < best[1] ? at : best)); // the highest corner
  label(context, name, x + 5, y + 11, ink);
}

export const titleOf = ({ name, kinds, id }) => name || kinds.join(" and ") || `room ${id}`;

function outline(context, room) {
  if (!room.polygon.length) return;
  const ring = [...room.polygon, room.polygon[0]].map(toScreen);
  line(context, ring, colour("room"), 1.5, [2, 4]);
}

function roomTitle(context, room) {
  const [x, y] = toScreen(room.xy);
  const p = Math.max(...Object.values(room.chance));
  const title = room.name || !room.kinds.length ? titleOf(room) : `${titleOf(room)} ${Math.round(100 * p)} %`;
  context.textAlign = "center";
  label(context, title, x, y, colour("room"));
  context.textAlign = "start";
}

function place(context, { name, heading_deg }, [x, y]) {
  const ink = colour("place");
  const heading = (heading_deg * Math.PI) / 180;
  line(context, [[x, y], [x + 15 * Math.cos(heading), y - 15 * Math.sin(heading)]], ink, 3);
  context.beginPath();
  context.arc(x, y, 5.5, 0, 2 * Math.PI);
  context.fillStyle = ink;
  context.fill();
  context.lineWidth = 1.5;
  context.strokeStyle = colour("card");
  context.stroke();
  label(context, name, x - 5, y + 15, ink);
}

function draft(context) {
  const ring = shown.draft.map(toScreen);
  line(context, ring, colour("accent"), 2.5);
  for (const [x, y] of ring) {
    context.beginPath();
    context.arc(x, y, 4, 0, 2 * Math.PI);
    context.fillStyle = colour("accent");
    context.fill();
  }
}

function label(context, text, x, y, ink, weight = 600) {
  context.font = `${weight} 12px system-ui, sans-serif`;
  context.textBaseline = "middle";
  context.lineJoin = "round";
  context.lineWidth = 3.5;
  context.strokeStyle = colour("card");
  context.strokeText(text, x, y);
  context.fillStyle = ink;
  context.fillText(text, x, y);
}

function goal(context, { pose, candidate_xy_m }) {
  const [x, y] = toScreen(pose);
  const ink = colour("goal");
  line(context, [[x, y], toScreen(candidate_xy_m)], ink, 1.2, [2, 4]);
  context.strokeStyle = ink;
  context.lineWidth = 3;
  context.beginPath();
  context.arc(x, y, 9, 0, 2 * Math.PI);
  context.stroke();
  const [c, s] = [Math.cos(pose[2]), Math.sin(pose[2])];
  line(context, [[x + 9 * c, y - 9 * s], [x + 19 * c, y - 19 * s]], ink, 3);
}

function robot(context, [px, py, yaw]) {
  const [x, y] = toScreen([px, py]);
  const radius = Math.max(shown.radius_m * view.scale, 8);
  context.save();
  context.translate(x, y);
  context.rotate(-yaw);
  context.beginPath();
  context.arc(0, 0, radius, 0, 2 * Math.PI);
  context.fillStyle = colour("robot");
  context.fill();
  context.lineWidth = 2;
  context.strokeStyle = colour("card");
  context.stroke();
  context.beginPath();
  context.moveTo(0.72 * radius, 0);
  context.lineTo(-0.45 * radius, 0.5 * radius);
  context.lineTo(-0.2 * radius, 0);
  context.lineTo(-0.45 * radius, -0.5 * radius);
  context.closePath();
  context.fillStyle = colour("card");
  context.fill();
  context.restore();
}

function scaleBar(context, height) {
  const metres = [0.2, 0.5, 1, 2, 5, 10, 20].find((m) => m * view.scale > 60) ?? 50;
  const [x, y, wide] = [14, height - 16, metres * view.scale];
  line(context, [[x, y - 5], [x, y], [x + wide, y], [x + wide, y - 5]], colour("muted"), 1.5);
  label(context, `${metres} m`, x + 4, y - 10, colour("muted"));
}

// -- input --------------------------------------------------------------------------------------

const fingers = new Map();
let picking = null; // takes both ends of a drag, in metres, while a person draws on the map
let pressed = null;

export function pick(take) {
  picking = take;
  canvas.classList.toggle("picking", Boolean(take));
}

canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
  pressed = fingers.size === 1 ? toMap(event.offsetX, event.offsetY) : null;
});
canvas.addEventListener("pointermove", (event) => {
  const at = [event.offsetX, event.offsetY];
  const before = fingers.get(event.pointerId);
  if (!before) return showTip(...at);
  const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
  if (others.length) {
    const apart = (p) => Math.hypot(p[0] - others[0][0], p[1] - others[0][1]) || 1;
    zoom(apart(at) / apart(before), (at[0] + others[0][0]) / 2, (at[1] + others[0][1]) / 2);
  } else if (picking && pressed) {
    picking(pressed, toMap(...at), false);
  } else if (Math.hypot(at[0] - before[0], at[1] - before[1]) > 0) {
    follow(false);
    pan((before[0] - at[0]) / view.scale, (at[1] - before[1]) / view.scale);
  }
  fingers.set(event.pointerId, at);
});
for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
  canvas.addEventListener(end, (event) => {
    fingers.delete(event.pointerId);
    if (end === "pointerup" && picking && pressed) picking(pressed, toMap(event.offsetX, event.offsetY), true);
    pressed = null;
    if (end === "pointerleave") $("tip").hidden = true;
  });
}
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(-0.0015 * event.deltaY), event.offsetX, event.offsetY);
}, { passive: false });
canvas.addEventListener("dblclick", () => picking || fit());
canvas.addEventListener("keydown", (event) => {
  const step = 60 / view.scale;
  const keys = {
    "+": () => zoom(1.25), "-": () => zoom(0.8), 0: fit, ArrowLeft: () => pan(-step, 0),
    ArrowRight: () => pan(step, 0), ArrowUp: () => pan(0, step), ArrowDown: () => pan(0, -step),
  };
  if (keys[event.key]) {
    event.preventDefault();
    keys[event.key]();
  }
});
new ResizeObserver(() => (view.fitted ? fit() : draw())).observe(canvas);

const tip = once((text) => say("tip", text));

// Describes what is under the pointer.
function showTip(px, py) {
  const now = shown.now;
  const things = now ? [...now.instances, ...now.candidates.filter((c) => c.kind !== "instance")] : [];
  things.push(...remembered().map((one) => ({ ...one, xy_m: one.xyz })));
  const away = (thing) => {
    const [x, y] = toScreen(thing.xy_m);
    return Math.hypot(x - px, y - py);
  };
  const [nearest] = things.filter((t) => away(t) < NEAR_PX).sort((a, b) => away(a) - away(b));
  $("tip").hidden = !nearest;
  if (!nearest) return;
  tip(nearest.name ? objectText(nearest) : nearest.label === undefined ? candidateText(nearest) : instanceText(nearest));
  $("tip").style.left = `${Math.min(px + 14, canvas.clientWidth - 190)}px`;
  $("tip").style.top = `${Math.min(py + 14, canvas.clientHeight - 90)}px`;
}

const objectText = (o) => `${o.name} #${o.id}\nconfidence ${o.confidence.toFixed(2)}, seen ${o.age_s.toFixed(0)} s ago`;
const instanceText = (t) => `${t.label} #${t.id}: ${t.state}\nconfidence ${t.score?.toFixed(2)}, ${t.hits} hits`;

function candidateText(c) {
  const score = c.score === null ? "no score" : `score ${c.score.toPrecision(3)}`;
  const way = c.path_m === null ? "no path" : `${c.path_m.toFixed(1)} m away`;
  const letter = c.letter ? `\n${c.letter}: probability ${c.p.toFixed(2)}` : "";
  return `${c.kind} #${c.id}${c.blocked ? " (blocked)" : ""}\n${score}, ${way}${letter}`;
}
