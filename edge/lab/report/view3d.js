// A 3-D scene on a plain canvas, without WebGL, so that it looks the same on a computer without a
// graphics card. The ground is looked up for each pixel, points go through a depth buffer, and
// lines and text are on top.
"use strict";

const canvas = document.querySelector("#view");
const context = canvas.getContext("2d");
// Downward angle, and the distance as a multiple of the trajectory's extent.
const VIEWS = { behind: [0.55, 1.9], above: [1.5, 2.2] };
const LEAST_EXTENT_M = 8;
const NEAR_M = 0.2;
const eye = {};
const shown = { boxes: true, words: true, lines: DATA.lines.map(() => true), at: 0 };
let ground, cloud, pixels, depth, width, height, focal, basis;

// Unpacks base64 text of zlib-compressed bytes.
async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// A colour as 0xAABBGGRR, the byte order of a canvas.
const packed = ([r, g, b]) => (255 << 24) | (b << 16) | (g << 8) | r;

function resize() {
  const scale = Math.min(devicePixelRatio || 1, 1.5);
  width = canvas.width = Math.round(canvas.clientWidth * scale);
  height = canvas.height = Math.round(canvas.clientHeight * scale);
  focal = 0.9 * Math.max(width, height);
  pixels = context.createImageData(width, height);
  depth = new Float32Array(width * height);
}

// The eye looks at (x, y, z) from `far` metres away, `pitch` above; it stays above the ground.
function aim() {
  const [cy, sy] = [Math.cos(eye.yaw), Math.sin(eye.yaw)];
  const [cp, sp] = [Math.cos(eye.pitch), Math.sin(eye.pitch)];
  const forward = [-cp * cy, -cp * sy, -sp];
  basis = {
    forward, right: [-sy, cy, 0], down: [sp * cy, sp * sy, -cp],
    at: [eye.x - eye.far * forward[0], eye.y - eye.far * forward[1], eye.z - eye.far * forward[2]],
  };
}

// A point as (right, down, forward) from the eye.
function seen(x, y, z) {
  const { forward: f, right: r, down: d, at } = basis;
  const [u, v, w] = [x - at[0], y - at[1], z - at[2]];
  return [u * r[0] + v * r[1], u * d[0] + v * d[1] + w * d[2], u * f[0] + v * f[1] + w * f[2]];
}

const onScreen = ([a, b, c]) => [width / 2 + (focal * a) / c, height / 2 + (focal * b) / c];

function drawGround(out, background) {
  const { forward: f, right: r, down: d, at } = basis;
  const { columns, rows, cell, origin, level } = DATA.ground;
  const fall = at[2] - level;
  for (let v = 0, k = 0; v < height; v++) {
    const b = (v + 0.5 - height / 2) / focal;
    const dz = f[2] + b * d[2];
    if (dz >= 0) {
      out.fill(background, k, k + width);
      depth.fill(Infinity, k, k + width);
      k += width;
      continue;
    }
    const far = -fall / dz;
    for (let u = 0; u < width; u++, k++) {
      const a = (u + 0.5 - width / 2) / focal;
      const x = (at[0] + far * (f[0] + a * r[0] + b * d[0]) - origin[0]) / cell;
      const y = (at[1] + far * (f[1] + a * r[1] + b * d[1]) - origin[1]) / cell;
      const inside = x >= 0 && y >= 0 && x < columns && y < rows;
      out[k] = inside ? ground.colours[ground.cells[(y | 0) * columns + (x | 0)]] : background;
      depth[k] = inside ? far : Infinity;
    }
  }
}

function drawCloud(out) {
  const { forward: f, right: r, down: d, at } = basis;
  const { xyz, colour } = cloud;
  for (let i = 0, k = 0; i < colour.length; i++) {
    const u = xyz[k++] - at[0], v = xyz[k++] - at[1], w = xyz[k++] - at[2];
    const c = u * f[0] + v * f[1] + w * f[2];
    if (c < NEAR_M) continue;
    const px = (width / 2 + (focal * (u * r[0] + v * r[1])) / c) | 0;
    const py = (height / 2 + (focal * (u * d[0] + v * d[1] + w * d[2])) / c) | 0;
    const size = Math.min(Math.max(Math.ceil((0.07 * focal) / c), 1), 6);
    for (let y = Math.max(py, 0); y < Math.min(py + size, height); y++) {
      for (let x = Math.max(px, 0); x < Math.min(px + size, width); x++) {
        const at = y * width + x;
        // Draw points a little nearer, so that the ground does not hide what stands on it.
        if (c - 0.1 < depth[at]) {
          depth[at] = c - 0.1;
          out[at] = colour[i];
        }
      }
    }
  }
}

// Draws a line through points, clipped at the eye.
function polyline(points, colour, breadth, casing) {
  context.beginPath();
  for (let i = 1; i < points.length; i++) {
    let [p, q] = [seen(...points[i - 1]), seen(...points[i])];
    if (p[2] < NEAR_M && q[2] < NEAR_M) continue;
    const cut = (a, b) => {
      const t = (NEAR_M - a[2]) / (b[2] - a[2]);
      return [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), NEAR_M];
    };
    if (p[2] < NEAR_M) p = cut(p, q);
    if (q[2] < NEAR_M) q = cut(q, p);
    context.moveTo(...onScreen(p));
    context.lineTo(...onScreen(q));
  }
  context.lineCap = context.lineJoin = "round";
  if (casing) {
    context.strokeStyle = "rgba(255, 255, 255, .85)";
    context.lineWidth = breadth + 3;
    context.stroke();
  }
  context.strokeStyle = colour;
  context.lineWidth = breadth;
  context.stroke();
}

function drawBox(box) {
  const [c, s] = [Math.cos(box.heading), Math.sin(box.heading)];
  const corner = (i, j, k) => {
    const [x, y] = [(i * box.size[0]) / 2, (j * box.size[1]) / 2];
    return [
      box.at[0] + c * x - s * y, box.at[1] + s * x + c * y, box.at[2] + (k * box.size[2]) / 2,
    ];
  };
  const around = [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]];
  for (const k of [-1, 1]) polyline(around.map(([i, j]) => corner(i, j, k)), box.colour, 1.2);
  for (const [i, j] of around.slice(1)) {
    polyline([corner(i, j, -1), corner(i, j, 1)], box.colour, 1.2);
  }
}

function say(text, point, colour) {
  const at = seen(...point);
  if (at[2] < NEAR_M) return;
  const [x, y] = onScreen(at);
  const size = Math.round(12.5 * (width / canvas.clientWidth));
  context.font = `600 ${size}px system-ui, sans-serif`;
  const breadth = context.measureText(text).width;
  context.fillStyle = "rgba(20, 24, 31, .78)";
  context.fillRect(x - breadth / 2 - 4, y - size - 4, breadth + 8, size + 6);
  context.fillStyle = colour;
  context.fillText(text, x - breadth / 2, y - 4);
}

// The robot's pose at the slider's position; its start pose without a trajectory.
function robotAt() {
  const [x, y, yaw] = DATA.start;
  return DATA.poses[Math.min(shown.at, DATA.poses.length - 1)] || [x, y, DATA.ground.level, yaw];
}

function drawRobot() {
  const [x, y, z, heading] = robotAt();
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  const shape = [[0.6, 0], [-0.45, 0.4], [-0.25, 0], [-0.45, -0.4], [0.6, 0]];
  const path = shape.map(([a, b]) => [x + c * a - s * b, y + s * a + c * b, z + 0.25]);
  polyline(path, "#14181f", 3, true);
}

function draw() {
  aim();
  const out = new Uint32Array(pixels.data.buffer);
  drawGround(out, ground.background);
  drawCloud(out);
  context.putImageData(pixels, 0, 0);
  if (shown.boxes) DATA.boxes.forEach(drawBox);
  DATA.lines.forEach((line, k) => {
    if (shown.lines[k]) polyline(line.points, line.colour, line.breadth, true);
  });
  drawRobot();
  if (shown.words) {
    const far = (box) => seen(...box.at)[2];
    for (const box of [...DATA.boxes].sort((a, b) => far(b) - far(a))) {
      const top = box.at[2] + box.size[2] / 2;
      say(`${box.id} ${box.label}`, [box.at[0], box.at[1], top + 0.2], box.bright);
    }
  }
  canvas.dataset.drawn = Number(canvas.dataset.drawn || 0) + 1;
}

let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    draw();
  });
}

// Shows the entire trajectory (all objects without one), or the view of the robot at the slider's
// position.
function look(name) {
  const level = DATA.ground.level;
  shown.view = name;
  if (name === "robot") {
    const [x, y, z, yaw] = robotAt();
    const [far, ahead] = [6, 4];
    const at = { x: x + ahead * Math.cos(yaw), y: y + ahead * Math.sin(yaw), z: z + 1.4 };
    Object.assign(eye, at, { pitch: 0.06, far, yaw: yaw + Math.PI });
    return;
  }
  const centres = DATA.lines.length ? [] : DATA.boxes.map((box) => box.at);
  const points = [DATA.start, ...DATA.lines.flatMap((line) => line.points), ...centres];
  const span = (k) => {
    const values = points.map((point) => point[k]);
    return [Math.min(...values), Math.max(...values)];
  };
  const [[x0, x1], [y0, y1]] = [span(0), span(1)];
  const extent = Math.max(x1 - x0, y1 - y0, LEAST_EXTENT_M);
  const [pitch, times] = VIEWS[name];
  const middle = { x: (x0 + x1) / 2, y: (y0 + y1) / 2, z: level };
  Object.assign(eye, middle, { pitch, far: times * extent, yaw: DATA.start[2] + Math.PI });
}

function turn(dx, dy) {
  eye.yaw -= dx;
  eye.pitch = Math.min(Math.max(eye.pitch + dy, 0.04), 1.5);
  redraw();
}

function zoom(by) {
  eye.far = Math.min(Math.max(eye.far * by, 2), 150);
  redraw();
}

// Moves along the ground: the point under the finger stays there.
function pan(dx, dy) {
  const step = eye.far / focal;
  const [c, s] = [Math.cos(eye.yaw), Math.sin(eye.yaw)];
  eye.x += step * (s * dx - c * dy);
  eye.y += step * (-c * dx - s * dy);
  redraw();
}

const fingers = new Map();
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, event);
});
canvas.addEventListener("pointermove", (event) => {
  const before = fingers.get(event.pointerId);
  if (!before) return;
  const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
  const other = [...fingers.values()].find((one) => one.pointerId !== event.pointerId);
  if (other) {
    const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
    zoom(apart(before) / Math.max(apart(event), 1));
    pan(dx / 2, dy / 2);
  } else if (event.shiftKey || event.buttons & 2) pan(dx, dy);
  else turn(dx * 0.006, dy * 0.005);
  fingers.set(event.pointerId, event);
});
for (const kind of ["pointerup", "pointercancel"]) {
  canvas.addEventListener(kind, (event) => fingers.delete(event.pointerId));
}
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(event.deltaY * 0.0012));
}, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const act = {
    ArrowLeft: () => turn(-0.08, 0), ArrowRight: () => turn(0.08, 0),
    ArrowUp: () => turn(0, 0.06), ArrowDown: () => turn(0, -0.06),
    "+": () => zoom(0.85), "-": () => zoom(1.18),
  }[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});

function control(selector, act) {
  for (const element of document.querySelectorAll(selector)) {
    element.addEventListener("input", () => {
      act(element);
      redraw();
    });
  }
}
control("[data-line]", (box) => (shown.lines[box.dataset.line] = box.checked));
control("[data-show]", (box) => (shown[box.dataset.show] = box.checked));
control("#along", (slider) => {
  shown.at = Number(slider.value);
  document.querySelector("#when").textContent = DATA.when[shown.at];
  if (shown.view === "robot") look("robot");
});
for (const button of document.querySelectorAll("[data-view]")) {
  button.addEventListener("click", () => {
    look(button.dataset.view);
    redraw();
  });
}

function paint() {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  ground.background = packed(dark ? [29, 35, 44] : [232, 238, 245]);
  redraw();
}

(async () => {
  const points = new Int16Array(await unpack(DATA.cloud.xyz_cm));
  const kinds = new Uint8Array(await unpack(DATA.cloud.kind));
  const colours = DATA.cloud.colours.map(packed);
  ground = {
    cells: new Uint8Array(await unpack(DATA.ground.cells)),
    colours: DATA.ground.colours.map(packed),
  };
  cloud = {
    xyz: Float32Array.from(points, (value) => value / 100),
    colour: Int32Array.from(kinds, (kind) => colours[kind]),
  };
  resize();
  look("behind");
  paint();
  addEventListener("resize", () => {
    resize();
    redraw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
})();
