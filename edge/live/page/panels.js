// Draws header, banner, mission, latency, log and health.

import { $, clock, make, once, say } from "./dom.js";

// True if there is no mission, or it has ended.
export const isDone = (status) => !status || ["idle", "reached", "failed"].includes(status.phase);

function badge(kind, text) {
  say("phase", text);
  $("phase").className = `badge ${kind}`;
}

export function banner(kind, text) {
  $("banner").hidden = !text;
  $("banner").className = kind;
  say("banner", text);
}

export function header({ robot, status, service }) {
  document.body.classList.remove("gone");
  say("robot", robot);
  document.title = status ? `${status.phase}: ${robot}` : `${service.state}: ${robot}`;
  if (!status) return badge("", service.state);
  const at = isDone(status) ? status.phase : (status.task?.phase ?? status.phase);
  const phase = status.stopped ? "stopped" : status.paused && !isDone(status) ? "paused" : at;
  badge(phase, phase);
  say("instruction", phase === "idle" ? "No mission yet" : status.instruction);
  const now = isDone(status) || !status.target ? "" : `now: ${status.target}`;
  say("reason", [now, status.reason].filter(Boolean).join("; "));
  say("elapsed", duration(status.elapsed_s));
  say("driven", `${status.path_m.toFixed(1)} m`);
  say("beat", `${status.tick_hz.toFixed(0)} Hz`);
}

function duration(s) {
  const pad = (n) => String(Math.floor(n)).padStart(2, "0");
  return s >= 3600 ? `${Math.floor(s / 3600)}:${pad((s / 60) % 60)}:${pad(s % 60)}` : `${Math.floor(s / 60)}:${pad(s % 60)}`;
}

// Shows the most important problem.
export function showState({ service, silent_s, status }, fault) {
  const why = service.why.join("; ");
  if (service.state === "starting") return banner("info", `Starting: ${why.replace(/^starting:? ?/, "") || "…"}`);
  if (fault) return faulty(fault, false);
  if (service.state === "stopping") return banner("warn", "The service is stopping.");
  if (silent_s !== null && silent_s > 3) return banner("bad", `The service hangs: its loop has not run for ${silent_s.toFixed(0)} s.`);
  if (status?.stopped) return banner("bad", `Stopped: ${status.stopped}. No goal is sent until somebody releases the robot.`);
  if (!service.ready) return banner("warn", `Not ready: ${why}.`);
  if (status?.paused && !isDone(status)) return banner("info", "Paused: the robot holds its position until the mission is resumed.");
  if (status && status.controller === "silent" && status.goal) return banner("warn", "No motion controller answers: a goal counts as reached when the robot stops there.");
  banner("", "");
}

// The service answers with an error; `blind`: there are no current data.
export function faulty(why, blind) {
  if (blind) stale("error");
  banner("bad", `The service answered with an error: ${why}`);
}

function stale(text) {
  document.body.classList.add("gone");
  badge("gone", text);
}

export function gone(since_ms) {
  stale("no answer");
  const s = Math.round((Date.now() - since_ms) / 1000);
  banner("bad", since_ms ? `The service does not answer: last seen ${clock(since_ms / 1000)}, ${s} s ago. Trying again…` : "The service does not answer. Trying again…");
}

export function pairs(id, rows) {
  $(id).replaceChildren(...rows.flatMap(([name, text, kind]) => [
    make("dt", { text: name }), make("dd", kind ? { text, class: kind } : { text }),
  ]));
}

// While idle there is a mission that only prepares the detector; it is not shown. The mission of a task
// only has its targets: `task.js` shows the task.
export const mission = once(({ mission: m, steps, done, idle, driven }) => {
  say("what", driven ? "Task" : "Mission");
  say("english", idle ? "The robot waits for a mission." : driven ? "" : m.english);
  say("formula", idle || driven ? "" : m.formula);
  say("translated", idle ? "" : driven ? "" : `state ${m.state} of ${m.states}, by ${m.translated_by}`);
  const rows = done || driven ? [] : [["plan", m.plan.join(" → ") || "nothing left to reach"], ["why", m.why]];
  if (m.reached.length && !driven) rows.push(["reached", m.reached.join(", "), "ok"]);
  if (m.failed.length) rows.push(["failed", m.failed.join(", "), "bad"]);
  if (m.forbidden.length) rows.push(["must not be reached now", m.forbidden.join(", "), "warn"]);
  for (const warning of m.warnings) rows.push(["note", warning, "warn"]);
  pairs("plan", rows);
  times("steps", steps.map((step) => ({ ...step, kind: step.kind })));
});

function times(id, lines) {
  $(id).replaceChildren(...lines.map(({ t_s, text, kind }) =>
    make("li", { class: kind ?? "" }, make("time", { text: clock(t_s) }), make("span", { text }))));
}

export const log = once(({ events, n_events }) => {
  times("log", [...events].reverse());
  say("log-note", n_events > events.length ? `newest ${events.length} of ${n_events}` : `${n_events}`);
});

export function latency({ stages, tick, deadline_ms, slowdown }) {
  const limit = slowdown === null ? "deadline" : "budget"; // budgets of stages exist once this computer is calibrated
  const head = ["", "", "p95", limit, "dropped"].map((text) => make("th", { text }));
  const rows = [...Object.entries(stages), ["tick", tick]].map(([name, row]) => {
    const cells = [
      make("td", { text: row.in_tick ? name : `${name} *`, title: row.in_tick ? "" : "runs in the background, not in the tick" }),
      make("td", { class: "gauge" }, ...(row.budget_ms === null ? [] : [gauge(row)])),
      make("td", { text: row.n ? ms(row.p95_ms) : "–", class: row.verdict === "over" ? "bad" : "" }),
      make("td", { text: row.budget_ms === null ? "–" : ms(row.budget_ms) }),
      make("td", { text: String(row.drops) }),
    ];
    return make("tr", { class: name === "tick" ? "tick" : "" }, ...cells);
  });
  $("latency").replaceChildren(make("tr", {}, ...head), ...rows);
  say("latency-note", `ms; ${tick.overruns} of ${tick.count} ticks over ${deadline_ms} ms`);
}

// The budget is at two thirds of the width.
function gauge(row) {
  const share = (value) => `${(100 * Math.min(value / row.budget_ms, 1.5)) / 1.5}%`;
  const bars = [["", row.p95_ms], ["p50", row.p50_ms]].map(([kind, value]) => {
    const bar = make("i", { class: kind });
    bar.style.width = share(value);
    return bar;
  });
  return make("div", { class: `track ${row.verdict}` }, ...bars, make("b"));
}

const ms = (value) => (value >= 10 ? value.toFixed(0) : value.toPrecision(2));

export const health = once(({ service, health: h, controller }) => {
  const rows = [["service", service.ready ? `${service.state}, ready` : `${service.state}: ${service.why.join("; ")}`, service.ready ? "ok" : "warn"]];
  const { detector, loop, checkpoint, swap, load_shedding: shedding, scorers, inputs, plausibility } = h;
  for (const [name, input] of Object.entries(inputs?.topics ?? {})) rows.push([name, ...inputOf(input)]);
  for (const [name, message] of Object.entries(plausibility?.failed ?? {})) rows.push([name, message, "warn"]);
  rows.push(["detector", `${detector.model}: ${detector.state}${detector.detail ? `, ${detector.detail}` : ""}`, level(detector.state)]);
  rows.push(["images", `${detector.done} searched, ${detector.failed} failed, ${detector.replaced} skipped`]);
  rows.push(["loop", `${loop.state}, ${loop.failed} errors${loop.last_error ? `: ${loop.last_error}` : ""}`, level(loop.state)]);
  rows.push(["controller", controller, controller === "answers" ? "ok" : "warn"]);
  if (swap?.state && swap.state !== "idle") rows.push(["model swap", `${swap.state}${swap.detail ? `: ${swap.detail}` : ""}`]);
  if (shedding) rows.push(["load shedding", shedding.level ? shedding.why : shedding.distress || "none", shedding.level ? "warn" : "ok"]);
  for (const [name, scorer] of Object.entries(scorers ?? {})) rows.push([name, scorer.model ?? "in use"]);
  if (checkpoint) rows.push(["checkpoint", Object.values(checkpoint).filter((v) => typeof v === "string").join(", ")]);
  pairs("health", rows);
});

// Describes an input, or why it has no data.
function inputOf({ name, where, needed, state, why, hz, age_s, dropped }) {
  const description = {
    ok: hz ? `${hz.toFixed(hz < 10 ? 1 : 0)} Hz` : `${age_s?.toFixed(0)} s ago`,
    missing: where.endsWith(name) ? "no message yet" : `no message yet on ${where}`,
    silent: `silent for ${age_s?.toFixed(0)} s`,
    dropped: `all are dropped: ${why}`,
    unused: "not needed",
  }[state];
  const drops = Object.entries(dropped).filter(([reason]) => reason !== "superseded" && state !== "dropped");
  const lost = drops.map(([reason, n]) => `, ${n} ${reason}`).join("");
  const warning = state === "ok" && why ? `, ${why}` : "";
  return [description + lost + warning, state === "ok" && !why ? "ok" : needed && state !== "unused" ? "warn" : ""];
}

const level = (state) => (state === "ok" ? "ok" : "warn");
