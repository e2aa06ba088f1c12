"use strict";
const $ = (id) => document.getElementById(id);
const list = $("episodes");
const rows = [...list.children].map((row) => {
  const numbers = (text) => text.split(",").map((x) => (x === "" ? NaN : Number(x)));
  const data = row.dataset;
  return {
    row, i: Number(data.i), target: data.target, kinds: data.kinds.split("|"),
    spl: numbers(data.spl), path: numbers(data.path), shortest: Number(data.shortest),
  };
});

const keys = {
  "": (r) => r.i,
  difference: (r, a, b) => r.spl[a] - r.spl[b],
  spl: (r, a) => r.spl[a],
  path: (r, a) => r.path[a],
  shortest: (r) => r.shortest,
};

// r is a row of numbers; a, b, c are indices of arms. The kind of failure is empty if the arm
// succeeded, or did not run: then there is no SPL.
const failed = (r, c) => r.kinds[c] !== "";
const reached = (r, c) => !failed(r, c) && !Number.isNaN(r.spl[c]);
const outcomes = {
  "": () => true,
  failed: failed,
  reached: reached,
  lost: (r, a, b) => failed(r, a) && reached(r, b),
  some: (r) => r.kinds.some((kind) => kind !== ""),
  all: (r) => !r.spl.some((_, c) => reached(r, c)),
};

function show() {
  const a = Number($("a").value), b = Number($("b").value);
  const target = $("target").value, outcome = $("outcome").value;
  const wanted = outcome.startsWith("kind:")
    ? (r) => r.kinds[a] === outcome.slice(5) : (r) => outcomes[outcome](r, a, b);
  const key = keys[$("order").value], sign = $("reverse").checked ? -1 : 1;
  const order = (p, q) => {
    const x = key(p, a, b), y = key(q, a, b);
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y) || p.i - q.i;
    return sign * (x - y) || p.i - q.i;
  };
  let shown = 0;
  for (const r of rows) {
    r.row.hidden = !((target === "" || r.target === target) && wanted(r));
    shown += r.row.hidden ? 0 : 1;
  }
  list.append(...[...rows].sort(order).map((r) => r.row));
  $("count").value = `${shown} of ${rows.length} episodes`;
  let shownArms = 0;
  for (const box of document.querySelectorAll("[data-hide]")) {
    list.classList.toggle(`hide${box.dataset.hide}`, !box.checked);
    shownArms += box.checked ? 1 : 0;
  }
  list.style.setProperty("--n", Math.max(shownArms, 1));
}

$("controls").addEventListener("input", show);
list.addEventListener("click", (event) => {
  if (event.target.closest("svg")) event.target.closest("figure").classList.toggle("large");
});
show();
