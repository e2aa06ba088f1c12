// Draws a task: instruction, its meaning, the model's answers, and progress.

import { $, make, once, say } from "./dom.js";
import * as map from "./map.js";
import { pairs } from "./panels.js";

let plan = null;

export const number = () => plan?.number;

// `progress`: data that change all the time; null: no task.
export function show(progress) {
  $("task").hidden = !progress;
  for (const kind of ["coarse", "trajectory"]) {
    document.querySelector(`.legend .${kind}`).hidden = !progress || !plan?.[kind].length;
  }
  if (!progress) drop();
  else if (plan) facts(rowsOf(progress, plan));
}

export function showPlan(data) {
  plan = data;
  map.update({ plan });
  say("asked", plan.instruction);
  say("understood", plan.understood);
  rounds(plan.rounds);
  $("prompt-fold").hidden = !plan.prompt;
  say("prompt", plan.prompt);
}

function drop() {
  if (!plan) return;
  plan = null;
  map.update({ plan });
}

const facts = once((rows) => pairs("task-facts", rows));

function rowsOf(progress, s) {
  const rows = [["written by", s.writer]];
  if (s.steps.length > 1) rows.push(...s.steps.map((step) => [step.state, step.said]));
  if (s.missing.length) rows.push(["not seen yet", s.missing.join(", ")]);
  if (s.trajectory.length) rows.push(["driven", `${progress.driven_m.toFixed(1)} of ${s.length_m.toFixed(1)} m, ${s.time_s.toFixed(0)} s in total`]);
  if (s.refinements > 1) rows.push(["refined again", `${s.refinements - 1} times, because the map changed`]);
  return [...rows, ...s.notes.map((note) => ["note", note, "warn"])];
}

// Shows the answers; the newest is open.
const rounds = once((all) => {
  $("rounds").replaceChildren(...all.map((round, i) => {
    const outcome = round.error ? make("span", { class: "bad", text: "rejected" }) : make("span", { class: "ok", text: "accepted" });
    const parts = [
      round.answer && make("p", { text: round.answer }),
      round.code && make("pre", { class: "code", text: round.code }),
      round.printed && make("div", {}, make("small", { text: "printed" }), make("pre", { class: "code", text: round.printed })),
      round.error && make("p", { class: "error", text: round.error }),
    ].filter(Boolean);
    const fold = make("details", { class: "round" }, make("summary", { text: `Answer ${i + 1}: ` }, outcome), ...parts);
    fold.open = i === all.length - 1;
    return fold;
  }));
});
