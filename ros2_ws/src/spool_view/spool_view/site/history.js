// History: the journals of all valves, searched, and the figures of the alarm system (ISA-18.2).

import { listen } from "/static/stream.js";
import { showBanner } from "/static/alarms.js";
import { clock, digits, fill, make, setText, texts } from "/static/text.js";

const byId = (id) => document.getElementById(id);
const words = byId("words");
const range = byId("history_range");
let asked = 0;

function table(names, rows) {
  const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
  const cells = rows.map((row) => make("tr", {}, ...row.map((cell, i) => make(i ? "td" : "th", i ? { "data-label": names[i] } : { scope: "row" }, cell))));
  return make("table", { class: "wide" }, head, make("tbody", {}, ...cells));
}

function entry(one) {
  const c = texts.columns;
  const text = [one.text, one.comment ? fill(texts.comment_is, { comment: one.comment }) : ""].filter(Boolean).join(" ");
  const more = [one.advice, one.snapshot ? fill(texts.recorded_as, { name: one.snapshot }) : ""].filter(Boolean);
  const cells = [
    make("th", { scope: "row" }, clock(one.time)),
    make("td", { "data-label": c.valve }, make("a", { href: `/valve/${one.valve}#at=${one.time}`, title: texts.course_then }, one.valve)),
    make("td", { "data-label": texts.action }, texts.actions[one.action] ?? one.action),
    make("td", { "data-label": c.alarm }, `${one.code || ""} ${one.alarm.replaceAll("_", " ")}`.trim()),
    make("td", { "data-label": texts.person }, one.who),
    make("td", { "data-label": c.says, class: "says" }, text, ...more.map((line) => make("div", { class: "note" }, line))),
  ];
  return make("tr", {}, ...cells);
}

function figures(found) {
  const rows = found.figures.map((one) => [texts.figure_names[one.name], digits(one.value), digits(one.limit), one.kept ? "" : texts.beyond]);
  const parts = [table([texts.figure, texts.value, texts.limit, ""], rows)];
  if (found.frequent.length) {
    parts.push(make("h3", {}, texts.frequent), table([texts.columns.alarm, texts.columns.valve, texts.count, texts.share], found.frequent.map((one) => [`${one.code} ${one.alarm.replaceAll("_", " ")}`, one.valve, String(one.count), `${digits(one.share)} %`])));
  }
  return parts;
}

async function load() {
  const turn = ++asked;
  const query = new URLSearchParams({ search: words.value.trim(), range: range.value });
  const midnight = (id, days) => (byId(id).value ? String(Math.round(new Date(`${byId(id).value}T00:00`).setDate(new Date(`${byId(id).value}T00:00`).getDate() + days) / 1000)) : "");
  for (const [name, seconds] of [["since", midnight("begin", 0)], ["until", midnight("end", 1)]]) if (seconds) query.set(name, seconds);
  range.disabled = Boolean(byId("begin").value || byId("end").value);
  byId("csv").href = "/history.csv?" + query;
  try {
    const answer = await fetch("/history.json?" + query, { cache: "no-store" });
    if (!answer.ok || turn !== asked) return;
    const found = await answer.json();
    const c = texts.columns;
    const names = [texts.time, c.valve, texts.action, c.alarm, texts.person, c.says];
    const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
    setText(byId("shown"), fill(texts.shown, { n: found.entries.length, m: found.count }));
    byId("entries").replaceChildren(make("table", { class: "wide" }, head, make("tbody", {}, ...found.entries.map(entry))));
    byId("figures").replaceChildren(...figures(found));
  } catch {
    setText(byId("shown"), texts.no_answer);
  }
}

export function start() {
  byId("search").addEventListener("submit", (event) => event.preventDefault());
  let timer = null;
  words.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(load, 250);
  });
  for (const one of [range, byId("begin"), byId("end")]) one.addEventListener("change", load);
  byId("print").addEventListener("click", () => window.print());
  let alarms = {};
  listen("/stream/machine", {
    machine: (data) => {
      alarms = { ...(data.whole ? {} : alarms), ...data.alarms };
      showBanner(Object.entries(alarms).flatMap(([valve, list]) => list.map((alarm) => [valve, alarm])));
    },
  }, () => showBanner([]));
  load();
}
