// The machine's page: a row for each valve, worst first, and the alarms of all.

import { showAlarms } from "/static/alarms.js";
import { announce, ORDER, setLight } from "/static/light.js";
import { listen } from "/static/stream.js";
import { digits, fill, make, setText, texts } from "/static/text.js";

const rows = new Map();
const shown = new Map();
let alarms = {};
const place = document.getElementById("valves");
const filter = document.getElementById("filter");
const body = make("tbody");
let order = "";

function table() {
  const c = texts.columns;
  const names = [c.state, c.valve, c.margin, c.shakes, c.natural, c.waiting, c.summary];
  const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
  return make("table", { class: "wide" }, head, body);
}

export function marginText(margin) {
  if (margin === null) return texts.margin_none;
  return fill(margin < 0 ? texts.margin_below : texts.margin_above, { n: digits(Math.abs(margin)) });
}

function rowOf(row) {
  let found = shown.get(row.name);
  if (!found) {
    const c = texts.columns;
    const cell = (label, kind) => make("td", { "data-label": label, class: kind });
    found = { light: make("td"), margin: cell(c.margin, "number"), shakes: cell(c.shakes, "number"), natural: cell(c.natural, "number"), waiting: cell(c.waiting, "number"), summary: cell(null, "summary") };
    found.summary.lang = "en";
    const name = make("th", { scope: "row" }, make("a", { href: `/valve/${row.name}` }, row.name));
    found.row = make("tr", { "data-valve": row.name }, found.light, name, found.margin, found.shakes, found.natural, found.waiting, found.summary);
    shown.set(row.name, found);
  }
  setLight(found.light, row.condition);
  const known = row.condition !== "no_word";
  setText(found.margin, known ? marginText(row.margin) : "");
  setText(found.shakes, row.shakes === null ? "" : digits(row.shakes) + " Hz");
  setText(found.natural, row.natural === null ? "" : digits(row.natural) + " Hz");
  setText(found.waiting, row.waiting ? String(row.waiting) : "");
  setText(found.summary, row.summary ?? "");
  return found.row;
}

function show() {
  const wish = filter.value.trim().toLowerCase();
  const wanted = [...rows.values()].filter((row) => row.name.toLowerCase().includes(wish));
  const rank = (row) => ORDER.indexOf(row.condition);
  wanted.sort((a, b) => rank(a) - rank(b) || a.name.localeCompare(b.name, undefined, { numeric: true }));
  const made = wanted.map(rowOf);
  const now = wanted.map((row) => row.name).join(" ");
  if (now !== order || !body.childElementCount) {
    const focused = body.contains(document.activeElement) ? document.activeElement : null;
    order = now;
    body.replaceChildren(...made);
    focused?.focus({ preventScroll: true });
  }
  if (rows.size && !place.querySelector("table")) place.replaceChildren(table());
  if (!rows.size) place.replaceChildren(make("p", { class: "note" }, texts.no_valves));
  counts();
  const entries = Object.entries(alarms).flatMap(([valve, list]) => list.map((alarm) => [valve, alarm]));
  showAlarms(document.getElementById("alarms"), entries, { withValve: true });
}

function counts() {
  const numbers = {};
  for (const row of rows.values()) numbers[row.condition] = (numbers[row.condition] ?? 0) + 1;
  const list = document.getElementById("counts");
  const text = JSON.stringify(numbers);
  if (list.dataset.shown === text) return;
  list.dataset.shown = text;
  list.replaceChildren(...ORDER.filter((one) => numbers[one]).map((one) => {
    const item = make("li", {}, `${numbers[one]} × `);
    const holder = make("span");
    setLight(holder, one);
    item.append(holder);
    return item;
  }));
}

export function start() {
  filter.addEventListener("input", show);
  listen("/stream/machine", {
    machine: (data) => {
      if (data.whole) {
        rows.clear();
        alarms = {};
      }
      for (const row of data.rows) {
        const before = rows.get(row.name)?.condition;
        if (before && before !== row.condition) announce(row.name, row.condition);
        rows.set(row.name, row);
      }
      alarms = { ...alarms, ...data.alarms };
      show();
    },
  }, () => {
    for (const row of rows.values()) Object.assign(row, { condition: "no_word", margin: null, shakes: null, natural: null, summary: null });
    if (rows.size) show();
  });
}
