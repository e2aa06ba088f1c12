// Commands to the robot; they need the token.

import { post, token } from "./api.js";
import { $, make, say } from "./dom.js";
import { isDone } from "./panels.js";

const CONFIRM_MS = 3000;
let stopped = false; // the button releases a stopped robot
let resumes = false; // the button resumes a paused mission, or ends a wait
let asks = false; // the button confirms the object that the robot asks about

export function show({ controls, status, service }) {
  $("controls").hidden = $("swap").hidden = $("ask").hidden = !controls;
  $("readonly").hidden = controls;
  const paused = status?.paused ?? false;
  if (status && stopped !== Boolean(status.stopped)) {
    stopped = !stopped;
    say("stop", stopped ? "Release" : "Stop");
  }
  proposals(controls ? (status?.proposals ?? []) : []);
  resumes = paused || status?.phase === "waiting";
  asks = !paused && Boolean(status?.question);
  say("pause", paused ? "Resume" : asks ? "Confirm" : resumes ? "Go on" : "Pause");
  $("pause").disabled = $("cancel").disabled = isDone(status);
  $("new").disabled = $("send").disabled = service.state === "starting" || service.state === "stopping";
}

// What agents ask for; a button decides on one. The texts are an agent's: only ever shown as text.
let shown = "";
function proposals(waiting) {
  const ids = waiting.map((one) => one.id).join();
  if (ids === shown) return;
  shown = ids;
  $("proposals").replaceChildren(...waiting.map((one) => {
    const row = make("li", { text: `Agent ${one.by} asks within ${Math.round(one.left_s)} s: ${one.text} (${one.understood}) ` });
    for (const [verb, name] of [["allow", "Allow"], ["deny", "Deny"]]) {
      const button = make("button", { text: name, type: "button" });
      button.addEventListener("click", () => ask("confirm/request", { do: verb, id: one.id }, `${name}: ${one.text}`));
      row.append(button);
    }
    return row;
  }));
}

let hide = 0;
export function toast(text) {
  say("toast", text);
  $("toast").hidden = false;
  clearTimeout(hide);
  hide = setTimeout(() => ($("toast").hidden = true), 5000);
}

async function ask(key, request, done) {
  try {
    await post(key, request);
    if (done) toast(done);
  } catch (error) {
    toast(error.message);
  }
}

const mission = (verb) => ask("mission/request", { do: verb });

$("pause").addEventListener("click", () => mission(asks ? "confirm" : resumes ? "resume" : "pause"));

// Needs two clicks, so that one by mistake does not end a mission or a stop.
const timers = {}; // by button, so that each asks for its own second click
function confirmed(button, name) {
  clearTimeout(timers[button]);
  const again = $(button).textContent !== name;
  say(button, again ? name : `Really ${name.toLowerCase()}?`);
  if (!again) timers[button] = setTimeout(() => say(button, name), CONFIRM_MS);
  return again;
}
$("cancel").addEventListener("click", () => confirmed("cancel", "Cancel") && mission("cancel"));

// One click stops.
$("stop").addEventListener("click", async () => {
  if (!stopped) await ask("stop/request", { why: "button on the page" }, "Stopped until Release.");
  else if (confirmed("stop", "Release")) await ask("release/request", {}, "Released.");
});

$("lock").addEventListener("click", () => {
  token.forget();
  location.reload();
});

$("swap").addEventListener("submit", (event) => {
  event.preventDefault();
  const model = $("model").value.trim();
  ask("models/request", { do: "use", model }, `Loading ${model}; the current model runs until it is ready.`);
  $("model").value = "";
});

const EXAMPLES = {
  instruction: "find the sofa, then the bed",
  formula: "F (sofa & F bed)",
  task: "go around the left of the sofa, then stop at the bed",
};
const dialog = $("new-dialog");
const chosen = () => new FormData(dialog.querySelector("form")).get("as");
const example = () => ($("words").placeholder = EXAMPLES[chosen()]);
dialog.querySelector(".choice").addEventListener("change", example);
example();
$("new").addEventListener("click", () => {
  clearError();
  dialog.showModal();
});
$("new-close").addEventListener("click", () => dialog.close());
dialog.querySelector("form").addEventListener("submit", (event) => {
  event.preventDefault();
  begin({ [chosen()]: $("words").value });
});

function clearError() {
  $("new-error").hidden = true;
  $("readings").replaceChildren();
}

// If an instruction is ambiguous or its meaning uncertain, the user chooses.
function offer(request, readings) {
  say("new-error", readings.length > 1
    ? "This can be read in several ways. Which one do you mean?"
    : "Is this what you mean?");
  $("readings").replaceChildren(...readings.map((text, i) => {
    const button = make("button", { text: `${i + 1}. ${text}`, type: "button" });
    button.addEventListener("click", () => begin({ ...request, reading: i + 1 }));
    return button;
  }));
}

$("words").addEventListener("input", clearError);

async function begin(request) {
  $("new-ok").disabled = true;
  say("new-ok", "Understanding…");
  clearError();
  try {
    const answer = await post("mission/request", { do: "new", ...request });
    $("words").value = "";
    dialog.close();
    toast(textOf(answer));
  } catch (error) {
    if (error.readings?.length) offer(request, error.readings);
    else say("new-error", error.message);
    $("new-error").hidden = false;
  } finally {
    $("new-ok").disabled = false;
    say("new-ok", "Start");
  }
}

// Returns the answer to a question, or the mission that was started.
const textOf = (answer) => answer.text || `Started: ${answer.english ?? answer.instruction}`;

$("ask").addEventListener("submit", async (event) => {
  event.preventDefault();
  const request = { instruction: $("sentence").value };
  $("answer").className = "";
  say("answer", "…");
  try {
    say("answer", textOf(await post("mission/request", { do: "new", ...request })));
    $("sentence").value = "";
  } catch (error) {
    say("answer", error.message);
    $("answer").className = "error";
    if (error.readings?.length) choose(request, error.readings);
  }
});

function choose(request, readings) {
  $("words").value = request.instruction;
  offer(request, readings);
  $("new-error").hidden = false;
  say("answer", "");
  dialog.showModal();
}

// -- the token ----------------------------------------------------------------------------------

export function askForToken(wrong) {
  if ($("token-dialog").open) return;
  $("token-error").hidden = !wrong;
  $("token-dialog").showModal();
}

$("token-dialog").addEventListener("cancel", (event) => event.preventDefault());
$("token-dialog").querySelector("form").addEventListener("submit", () => {
  token.set($("token").value.trim());
  $("token").value = "";
});
export const asking = () => $("token-dialog").open;
