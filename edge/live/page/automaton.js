// Draws the mission's automaton as a graph: columns by the longest path from the start.

import { $, make, once, say } from "./dom.js";

const [COLUMN, ROW, RADIUS] = [118, 62, 14];
export const NONE = { nodes: [], arrows: [], note: "" };

export const show = once(({ nodes, arrows, note }) => {
  say("note", nodes.length < 2 ? "" : `The graph: ${note}`);
  if (nodes.length < 2) return $("automaton").replaceChildren();
  const places = layOut(nodes, arrows);
  const xs = places.map((p) => p[0]);
  const ys = places.map((p) => p[1]);
  const top = Math.min(...ys) - 34;
  const wide = Math.max(...xs) + 2 * RADIUS + 16;
  const high = Math.max(...ys) + 44 - top;
  const drawing = make("svg:svg", { viewBox: `-34 ${top} ${wide + 34} ${high}`, role: "img", "aria-label": "Automaton" });
  drawing.style.maxWidth = `${1.35 * (wide + 34)}px`;
  drawing.append(heads());
  drawing.append(make("svg:path", { class: "edge", d: `M -32 0 H ${-RADIUS - 6}`, "marker-end": "url(#head-other)" }));
  const labels = arrows.map((arrow) => drawArrow(drawing, arrow, places, arrows));
  nodes.forEach((node, i) => drawing.append(state(node, places[i])));
  drawing.append(...labels);
  $("automaton").replaceChildren(drawing);
});

function heads() {
  const kinds = ["other", "visited", "plan"].map((role) =>
    make("svg:marker", { id: `head-${role}`, viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 8, markerHeight: 8, markerUnits: "userSpaceOnUse", orient: "auto" },
      make("svg:path", { class: `head ${role}`, d: "M0 0 L8 4 L0 8 z" })));
  return make("svg:defs", {}, ...kinds);
}

// Columns by the longest path from the first node, without back edges; rows near those of neighbours.
function layOut(nodes, arrows) {
  const rank = nodes.map(() => 0);
  const back = arrowsBack(nodes, arrows);
  for (let round = 0; round < nodes.length; round++) {
    for (const a of arrows) if (!back.has(a)) rank[a.target] = Math.max(rank[a.target], rank[a.source] + 1);
  }
  const columns = [];
  nodes.forEach((_, i) => (columns[rank[i]] ??= []).push(i));
  const y = nodes.map(() => 0);
  const spread = (column) => column.forEach((i, k) => (y[i] = (k - (column.length - 1) / 2) * ROW));
  columns.forEach(spread);
  for (let sweep = 0; sweep < 8; sweep++) {
    for (const column of columns) {
      const wanted = new Map(column.map((i) => [i, mean(neighbours(i, arrows).map((j) => y[j]), y[i])]));
      column.sort((a, b) => wanted.get(a) - wanted.get(b));
      spread(column);
    }
  }
  return nodes.map((_, i) => [rank[i] * COLUMN, y[i] - y[0]]);
}

function arrowsBack(nodes, arrows) {
  const back = new Set();
  const done = new Set();
  const open = new Set();
  const visit = (i) => {
    open.add(i);
    for (const a of arrows.filter((a) => a.source === i)) {
      if (open.has(a.target)) back.add(a);
      else if (!done.has(a.target)) visit(a.target);
    }
    open.delete(i);
    done.add(i);
  };
  nodes.forEach((_, i) => done.has(i) || visit(i));
  return back;
}

const neighbours = (i, arrows) =>
  arrows.flatMap((a) => (a.source === i ? [a.target] : a.target === i ? [a.source] : []));
const mean = (values, otherwise) =>
  values.length ? values.reduce((a, b) => a + b) / values.length : otherwise;

// Draws an arrow and returns its label, which is drawn on top.
function drawArrow(drawing, arrow, places, arrows) {
  const [x0, y0] = places[arrow.source];
  const [x1, y1] = places[arrow.target];
  const paired = arrows.some((a) => a.source === arrow.target && a.target === arrow.source);
  const far = Math.abs(x1 - x0) > 1.5 * COLUMN || x1 <= x0 || paired;
  const length = Math.hypot(x1 - x0, y1 - y0) || 1;
  const bend = far ? (x1 > x0 ? -1 : 1) * Math.min(24 + 0.16 * length, 64) : 0;
  const [nx, ny] = [-(y1 - y0) / length, (x1 - x0) / length];
  const [mx, my] = [(x0 + x1) / 2 + nx * bend * Math.sign(x1 - x0 || 1), (y0 + y1) / 2 + ny * bend * Math.sign(x1 - x0 || 1)];
  const start = towards([x0, y0], [mx, my], RADIUS);
  const end = towards([x1, y1], [mx, my], RADIUS + 3);
  const path = make("svg:path", {
    class: `edge ${arrow.role}`, d: `M ${start} Q ${mx} ${my} ${end}`, "marker-end": `url(#head-${arrow.role})`,
  });
  path.append(make("svg:title", { text: arrow.title }));
  drawing.append(path);
  const [lx, ly] = [(x0 + 2 * mx + x1) / 4, (y0 + 2 * my + y1) / 4];
  return drawLines(arrow.lines, lx, ly - 7 * (arrow.lines.length - 1) - (bend ? 0 : 9), `label ${arrow.role}`, 13);
}

function towards([x, y], [tx, ty], by) {
  const away = Math.hypot(tx - x, ty - y) || 1;
  return [x + ((tx - x) / away) * by, y + ((ty - y) / away) * by];
}

function drawLines(lines, x, y, kind, leading) {
  const text = make("svg:text", { class: kind });
  lines.forEach((line, k) => text.append(make("svg:tspan", { x, y: y + k * leading, text: line })));
  return text;
}

function state(node, [x, y]) {
  const kind = [node.current && "current", node.dead && "dead"].filter(Boolean).join(" ");
  const group = make("svg:g", { class: kind }, make("svg:title", { text: node.title }));
  group.append(make("svg:circle", { cx: x, cy: y, r: RADIUS }));
  if (node.accepting) group.append(make("svg:circle", { class: "inner", cx: x, cy: y, r: RADIUS - 3.5 }));
  group.append(make("svg:text", { class: "name", x, y, text: String(node.state) }));
  const lines = [...node.forbidden, ...(node.hidden ? [`+ ${node.hidden}`] : [])];
  group.append(drawLines(lines, x, y + RADIUS + 8, "label forbidden", 11));
  return group;
}
