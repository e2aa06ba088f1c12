"""Style sheet of the HTML report; colours follow the reader's light or dark setting."""

from __future__ import annotations

CSS = """
:root { color-scheme: light dark; --bg: #f4f6f9; --card: #ffffff; --ink: #1c2430;
  --muted: #5c6675; --line: #dde2ea; --ok: #2b8a3e; --over: #c92a2a; --p50: #1c7ed6;
  --p95: #a5d0f5; --track: #edf0f4; --target: #d6225b; }
@media (prefers-color-scheme: dark) {
  :root { --bg: #14181f; --card: #1d232c; --ink: #e6eaf0; --muted: #98a2b3; --line: #323a46;
    --ok: #51cf66; --over: #ff6b6b; --p50: #4dabf7; --p95: #2b5d88; --track: #29303b;
    --target: #ff5c8d; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--bg); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px; }
header { display: flex; flex-wrap: wrap; align-items: center; gap: 6px 16px; }
h1 { font-size: 26px; margin: 0; }
h2 { font-size: 17px; margin: 0 0 12px; }
.badge { color: #fff; font-weight: 700; letter-spacing: .04em; padding: 4px 12px;
  border-radius: 8px; text-transform: uppercase; }
.reason { flex-basis: 100%; color: var(--muted); margin: 0; overflow-wrap: anywhere; }
section { background: var(--card); border: 1px solid var(--line); border-radius: 12px;
  padding: 18px 20px; margin-top: 18px; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(130px, 1fr)); gap: 12px;
  margin-top: 18px; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 12px;
  padding: 10px 14px; }
.tile b { display: block; font-size: 20px; font-variant-numeric: tabular-nums; }
.tile span, .note, footer { color: var(--muted); font-size: 13px; }
.picture img { display: block; width: 100%; height: auto; border-radius: 8px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 5px 10px; border-bottom: 1px solid var(--line); text-align: right;
  white-space: nowrap; }
th { color: var(--muted); font-weight: 600; font-size: 13px; }
th:first-child, td:first-child, th.bar { text-align: left; }
tr.tick td { font-weight: 700; border-bottom: 0; border-top: 2px solid var(--line); }
td.bar { width: 32%; min-width: 190px; }
td.bar svg { display: block; width: 100%; height: 16px; }
.track { fill: var(--track); } .p50 { fill: var(--p50); } .p95 { fill: var(--p95); }
.p95.over { fill: var(--over); opacity: .45; } .p50.over { fill: var(--over); }
.max { stroke: var(--muted); stroke-width: .6; }
.budget { stroke: var(--ink); stroke-width: .6; stroke-dasharray: 2.5 1.5; }
.ok { color: var(--ok); } .over { color: var(--over); }
.frames { display: grid; grid-template-columns: repeat(auto-fill, minmax(260px, 1fr)); gap: 14px; }
figure { margin: 0; } figure svg { width: 100%; height: auto; border-radius: 8px; display: block; }
figcaption { color: var(--muted); font-size: 13px; margin-top: 4px; }
.time { display: grid; grid-template-columns: max-content 1fr; gap: 3px 16px; margin: 0; }
.time dt { color: var(--muted); text-align: right; font-variant-numeric: tabular-nums; }
.time dd { margin: 0; overflow-wrap: anywhere; }
.time dd.reached { color: var(--ok); font-weight: 600; }
.time dd.failed { color: var(--over); font-weight: 600; }
.time dd.target { font-weight: 600; }
.story { display: grid; grid-template-columns: max-content 1fr; gap: 4px 16px; margin: 0 0 16px; }
.story dt { color: var(--muted); } .story dd { margin: 0; overflow-wrap: anywhere; }
.formula { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: 13.5px; }
.drawing { overflow-x: auto; margin-bottom: 18px; }
.pairs td { text-align: left; white-space: normal; overflow-wrap: anywhere; }
.pairs td:first-child { min-width: 8.5em; }
.pairs td:last-child { text-align: right; }
.columns { display: grid; align-items: start; gap: 18px;
  grid-template-columns: repeat(auto-fit, minmax(330px, 1fr)); }
.columns section { margin-top: 18px; min-width: 0; }
details { margin-top: 8px; }
details pre { overflow-x: auto; font-size: 12.5px; background: var(--track); padding: 12px;
  border-radius: 8px; }
a { color: var(--p50); }
summary { cursor: pointer; font-weight: 600; }
footer { margin-top: 18px; }
"""
