// Lists places, zones, rooms and remembered objects, and lets a person add and remove them.

import { post } from "./api.js";
import { toast } from "./controls.js";
import { $, make, once, say } from "./dom.js";
import * as map from "./map.js";

const CONFIRM_MS = 3000;
const HINTS = {
  place: "On the map, drag from the place to a point that the robot shall look at. Esc cancels.",
  room: "On the map, click into the room. Esc cancels.",
  zone: "On the map, click the corners, then double-click or press Done. Esc cancels.",
};
let [version, allowed, corners] = [undefined, false, null];

// True if a newer version of the site should be fetched.
export const isOld = (number) => number !== undefined && number !== version;

export function show(site) {
  version = site.number;
  map.update({ site: site.features });
  listSite({ features: site.features, allowed });
}

export function showMemory({ objects, rooms }) {
  map.update({ objects, rooms });
  listRooms(rooms);
  listObjects(objects.map((one) => ({ ...one, age_s: Math.round(one.age_s / 5) * 5 })));
}

export function allow(controls) {
  if (controls === allowed) return;
  allowed = controls;
  $("site-form").hidden = !controls;
  version = undefined; // list again, with buttons
}

// -- lists -----------------------------------------------------------------------------

const metres = ([x, y]) => `${x.toFixed(1)}, ${y.toFixed(1)}`;
const centre = (ring) => [0, 1].map((axis) => ring.reduce((sum, corner) => sum + corner[axis], 0) / ring.length);

const DETAILS = { keep_out: "keep out", stay_inside: "stay inside", room: "room name" };

const listSite = once(({ features }) => {
  $("site-list").replaceChildren(...features.map(({ properties, geometry }) => {
    const { kind, name } = properties;
    const at = geometry.type === "Point" ? geometry.coordinates : centre(geometry.coordinates[0].slice(1));
    const line = row(kind, name, DETAILS[kind] ?? metres(at), at);
    if (allowed && name !== "start") line.append(removeButton(name));
    return line;
  }));
});

const listRooms = once((rooms) => {
  $("rooms-note").hidden = !rooms.length;
  say("rooms-note", `Rooms (${rooms.length})`);
  $("rooms-list").replaceChildren(...rooms.map((room) =>
    row("mapped", map.titleOf(room), `${chance(room)}${room.area_m2.toFixed(0)} m²`, room.xy)));
});

// The likeliest kind of a room, with its probability.
function chance(room) {
  const [kind, p] = Object.entries(room.chance).reduce((best, one) => (one[1] > best[1] ? one : best), ["", 0]);
  return p ? `${kind} ${p.toFixed(2)}, ` : "";
}

const listObjects = once((objects) => {
  say("objects-note", objects.length ? `Remembered objects (${objects.length})` : "No remembered objects");
  $("objects-list").replaceChildren(...objects.map(({ name, xyz, confidence, age_s }) =>
    row("object", name, `${confidence.toFixed(2)}, ${age_s ? `${ago(age_s)} ago` : "now"}`, xyz)));
});

const ago = (s) => (s < 120 ? `${s} s` : s < 7200 ? `${Math.round(s / 60)} min` : `${Math.round(s / 3600)} h`);

// A row; a click on its name moves the map there.
function row(kind, name, detail, at) {
  const button = make("button", { type: "button", class: "quiet name", text: name, title: `at ${metres(at)}` });
  button.addEventListener("click", () => map.centre(at));
  return make("li", { class: kind }, button, make("small", { text: detail }));
}

// Needs two clicks, so that one by mistake removes nothing.
function removeButton(name) {
  const button = make("button", { type: "button", class: "quiet", text: "×", title: `Remove ${name}` });
  button.addEventListener("click", () => {
    if (button.textContent !== "×") return change({ do: "remove", name });
    button.textContent = "Remove?";
    setTimeout(() => (button.textContent = "×"), CONFIRM_MS);
  });
  return button;
}

// -- changes ---------------------------------------------------------------------------

async function change(request) {
  try {
    toast((await post("site/request", request)).text);
    return true;
  } catch (error) {
    toast(error.message);
    return false;
  }
}

async function add(properties, geometry) {
  if (await change({ do: "set", feature: { type: "Feature", properties, geometry } })) $("site-name").value = "";
}

const drawn = () => ({ kind: $("site-kind").value, name: $("site-name").value.trim() });

$("site-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const { kind, name } = drawn();
  if (corners) finish();
  else if (kind === "place") draw("place", placed);
  else if (kind === "room") draw("room", named);
  else if (kind !== "here") draw("zone", cornered, []);
  else if (await change({ do: "set", name })) $("site-name").value = "";
});
$("site-kind").addEventListener("change", stop);
$("map").addEventListener("dblclick", finish);
addEventListener("keydown", ({ key }) => key === "Escape" && stop());

function draw(how, take, first = null) {
  corners = first;
  map.pick(take);
  say("site-add", corners ? "Done" : "Add");
  say("site-hint", HINTS[how]);
}

function stop() {
  corners = null;
  map.pick(null);
  map.update({ draft: [] });
  say("site-add", "Add");
  say("site-hint", "");
}

// A place: from its position to a point that the robot is to look at.
function placed(from, to, isEnd) {
  map.update({ draft: [from, to] });
  if (!isEnd) return;
  const heading_deg = map.isSame(from, to) ? 0 : (Math.atan2(to[1] - from[1], to[0] - from[0]) * 180) / Math.PI;
  const { name } = drawn();
  stop();
  add({ kind: "place", name, heading_deg }, { type: "Point", coordinates: from });
}

function named(from, to, isEnd) {
  if (!isEnd) return;
  const { name } = drawn();
  stop();
  add({ kind: "room", name }, { type: "Point", coordinates: from });
}

function cornered(from, to, isEnd) {
  if (!isEnd || (corners.length && map.isSame(to, corners.at(-1)))) return;
  corners.push(to);
  map.update({ draft: corners });
}

function finish() {
  if (!corners) return;
  if (corners.length < 3) return toast("A zone needs at least three corners.");
  const ring = [...corners, corners[0]];
  stop();
  add(drawn(), { type: "Polygon", coordinates: [ring] });
}
