// Polls the service, each resource at its own rate, and shows the data.

import { forget, get, Refused, token } from "./api.js";
import * as automaton from "./automaton.js";
import * as camera from "./camera.js";
import * as controls from "./controls.js";
import { $, make, once } from "./dom.js";
import * as map from "./map.js";
import * as panels from "./panels.js";
import * as site from "./site.js";
import * as task from "./task.js";

const [NOW_MS, MAP_MS, MISSION_MS, GONE_MS] = [200, 500, 1000, 1000];
const state = { seen_ms: 0, now: null, layers: [] };
const failed = new Map(); // error message by round

// Runs a round periodically, never twice at a time, and not while the page is hidden.
function every(period_ms, round) {
  const again = async () => {
    const begun = performance.now();
    let rest = period_ms;
    if (!document.hidden && !controls.asking()) {
      try {
        await round();
        failed.delete(round);
      } catch (error) {
        handleError(error, round);
        rest = GONE_MS;
      }
    }
    setTimeout(again, Math.max(rest - (performance.now() - begun), 20));
  };
  again();
}

function handleError(error, round) {
  if (error instanceof Refused && error.status === 401) {
    // An answer to a previous token must not ask for a new one.
    if (error.bearer === token.get()) controls.askForToken(error.bearer !== null);
  } else if (error instanceof Refused) {
    failed.set(round, error.message);
    panels.faulty(error.message, round === now);
  } else if (error instanceof TypeError || error.name === "TimeoutError") {
    // No connection, or no answer.
    panels.gone(state.seen_ms);
  } else {
    throw error;
  }
}

async function now() {
  const data = await get("live/now");
  state.now = data;
  state.seen_ms = Date.now();
  panels.header(data);
  failed.delete(now);
  panels.showState(data, [...failed.values()][0]);
  controls.show(data);
  site.allow(data.controls);
  task.show(data.status?.task ?? null);
  map.update({ now: data.status, radius_m: data.radius_m });
}

// The plan of a task is long: get it only when it has changed.
async function plan() {
  const number = state.now?.status?.task?.number;
  if (number === undefined || number === task.number()) return;
  const data = await get("live/task");
  if (data) task.showPlan(data);
}

// Places change seldom: get them only when they have changed.
async function sites() {
  if (!site.isOld(state.now?.status?.site)) return;
  const data = await get("live/site");
  if (data) site.show(data);
}

async function memory() {
  const data = await get("live/memory");
  if (data) site.showMemory(data);
}

async function shots() {
  await camera.update(state.now?.shots ?? {}, get);
}

async function mission() {
  const data = await get("live/mission");
  if (!data || !state.now) return;
  const { now } = state;
  const idle = now.status?.phase === "idle";
  const driven = Boolean(now.status?.task);
  panels.mission({ mission: data.mission, steps: data.steps, done: panels.isDone(now.status), idle, driven });
  automaton.show(idle || driven ? automaton.NONE : data.automaton);
  panels.latency(data.latency);
  panels.log({ events: data.events, n_events: data.n_events });
  panels.health({ service: now.service, health: data.health, controller: now.status?.controller ?? "silent" });
  camera.name(data.targets);
  map.update({ trail: data.trail, targets: data.targets });
  offer(data.layers);
}

const offer = once((layers) => {
  const chosen = $("layer").value;
  state.layers = layers;
  $("layer").replaceChildren(make("option", { value: "", text: "none" }), ...layers.map((name) => make("option", { value: name, text: name })));
  $("layer").value = layers.includes(chosen) ? chosen : "";
});

async function maps() {
  const grid = await get("live/map");
  if (grid) await map.showMap(grid);
  const at = state.layers.indexOf($("layer").value);
  if (at < 0) return map.showLayer(null);
  const layer = await get(`live/layers/${at}`);
  if (layer && layer.name === $("layer").value) await map.showLayer(layer);
}

$("layer").addEventListener("change", () => {
  state.layers.forEach((_, i) => forget(`live/layers/${i}`));
  map.showLayer(null);
});
$("fit").addEventListener("click", () => {
  map.follow(false);
  map.fit();
});
$("follow").addEventListener("click", () => map.follow($("follow").getAttribute("aria-pressed") !== "true"));
$("zoom-in").addEventListener("click", () => map.zoom(1.3));
$("zoom-out").addEventListener("click", () => map.zoom(1 / 1.3));

// -- light and dark -----------------------------------------------------------------------------

const dark = matchMedia("(prefers-color-scheme: dark)");
function scheme() {
  document.documentElement.dataset.scheme = localStorage.getItem("edge-scheme") ?? (dark.matches ? "dark" : "light");
  map.recolour();
  camera.draw();
}
$("scheme").addEventListener("click", () => {
  localStorage.setItem("edge-scheme", document.documentElement.dataset.scheme === "dark" ? "light" : "dark");
  scheme();
});
dark.addEventListener("change", scheme);
scheme();

every(NOW_MS, now);
every(NOW_MS, shots);
every(NOW_MS, plan);
every(NOW_MS, sites);
every(MISSION_MS, memory);
every(MISSION_MS, mission);
every(MAP_MS, maps);
