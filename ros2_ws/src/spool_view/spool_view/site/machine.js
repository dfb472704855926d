// The machine: a sentence for the whole, a tile for each valve, worst first, and the alarms of all.

import { reasonOf, showAlarms, showBanner, stateText, titleOf } from "/static/alarms.js";
import { meter, sparkline } from "/static/drawing.js";
import { ABNORMAL, announce, mark, ORDER, setLight } from "/static/light.js";
import { listen } from "/static/stream.js";
import { ago, digits, fill, language, make, nameOf, setText, texts } from "/static/text.js";

const AGAIN = 60000;
/** Valves above which tiles are small, so that a hundred fit a screen. */
const MANY = 24;
/** Valves up to which tiles fill the screen, to be read from three metres. */
const FEW = 4;
/** Tiles of the worst valves that are shown above the others then. */
const WORST = 10;
const rows = new Map();
const shown = new Map();
let alarms = {};
let sparks = {};
let lost = false;
const place = document.getElementById("valves");
const filter = document.getElementById("filter");

export function marginText(margin) {
  if (margin === null) return texts.margin_none;
  return fill(margin < 0 ? texts.margin_below : texts.margin_above, { n: digits(Math.abs(margin)) });
}

/** The tile of a valve; the worst have a second one above the others, which stay in their places. */
function tileOf(row, where) {
  const key = `${where} ${row.name}`;
  let found = shown.get(key);
  if (!found) {
    const [machine, own] = [row.name.split("/").slice(0, -1).join("/"), row.name.split("/").at(-1)];
    found = { light: make("span"), meters: make("span", { class: "meters" }), course: make("span", { class: "course_place" }), news: make("span", { class: "news" }), margin: make("span", { class: "margin_text" }) };
    // A long name is cut in its middle: its end tells valves of one machine apart.
    const name = make("span", { class: "name" }, machine ? make("span", { class: "machine_name" }, machine + "/\u200e") : null, make("b", {}, make("span", { class: "begin" }, own.slice(0, -10)), make("span", { class: "end" }, own.slice(-10))));
    found.tile = make("a", { class: "tile", href: `/valve/${row.name}`, "data-valve": row.name }, make("span", { class: "head" }, name, found.light), found.news, found.meters, found.course, found.margin);
    shown.set(key, found);
  }
  found.tile.dataset.abnormal = String(ABNORMAL.includes(row.condition));
  found.tile.dataset.condition = row.condition;
  setLight(found.light, row.condition, row.letter);
  found.tile.title = row.name;
  setText(found.margin, row.margin === null ? "" : `${texts.columns.margin}: ${marginText(row.margin)}`);
  setText(found.news, news(row));
  const courses = sparks[row.name] ?? [];
  const warns = reasonOf(row, alarms[row.name] ?? [])?.parameter ?? "";
  if (found.courses !== courses || found.warns !== warns) {
    Object.assign(found, { courses, warns });
    found.meters.replaceChildren(...courses.map((one) => meter(one, texts.meters[one.name] ?? nameOf(one.name))));
    const one = courses.find((course) => course.name === warns) ?? (warns === "spring_stiffness" ? courses[0] : courses.at(-1));
    found.course.replaceChildren(...(one ? [sparkline(one, `${nameOf(one.name)}: ${texts.last_hour}`)] : []));
  }
  return found.tile;
}

/** Valves that need somebody, the one that needs it most first; the server ranks them. */
function needy(wanted) {
  const bad = wanted.filter((row) => ABNORMAL.includes(row.condition));
  return bad.sort((a, b) => a.rank[0] - b.rank[0] || a.rank[1] - b.rank[1] || (b.since ?? 0) - (a.since ?? 0) || a.name.localeCompare(b.name, undefined, { numeric: true }));
}

/** What a tile says below the name of a valve. */
function news(row) {
  const reason = reasonOf(row, alarms[row.name] ?? []);
  if (row.condition === "put_aside") return reason ? `${stateText(reason)}, ${reason.by}` : "";
  if (row.condition === "no_word") return row.since ? ago(row.since) : "";
  return reason ? `${titleOf(reason)}, ${ago(row.since)}` : "";
}

/** How many others need somebody, by their states: "4 others: 1 alarm, 3 warnings". */
function others(bad) {
  const numbers = new Map();
  for (const row of bad) numbers.set(row.condition, (numbers.get(row.condition) ?? 0) + 1);
  const parts = [...numbers].map(([one, n]) => `${n} × ${texts.conditions[one]}`);
  return bad.length ? fill(texts.others, { n: bad.length, states: parts.join(", ") }) : "";
}

/** One sentence for the whole: how many, what, where, what to do. */
function sentence() {
  if (lost) return [["what", texts.lost_sentence]];
  if (!rows.size) return [["what", texts.no_valves]];
  const bad = needy([...rows.values()]);
  if (!bad.length) return [["what", fill(texts.all_good, { total: rows.size })]];
  const row = bad[0];
  const reason = reasonOf(row, alarms[row.name] ?? []);
  const capital = (text) => text && text[0].toUpperCase() + text.slice(1);
  const words = { valve: row.name, state: texts.conditions[row.condition], since: row.since ? ago(row.since) : "" };
  if (reason) {
    const own = reason.texts[language] ?? {};
    const urgency = capital(own.urgency || words.state);
    return [["what", `${fill(texts.sentence_alarm, { ...words, title: titleOf(reason), urgency })}, `], ["since", words.since], ["do", capital(own.advice ?? "")], ["others", others(bad.slice(1))]];
  }
  return [["what", fill(row.condition === "no_word" ? texts.sentence_no_data : texts.sentence_state, words)], ["others", others(bad.slice(1))]];
}

function show() {
  const parts = sentence().filter(([, text]) => text);
  const said = document.getElementById("sentence");
  if (said.textContent !== parts.map(([, text]) => text).join("")) said.replaceChildren(...parts.map(([name, text]) => make("span", { class: name }, text)));
  const worst = lost ? "no_word" : needy([...rows.values()])[0]?.condition ?? "good";
  said.dataset.condition = worst;
  document.title = document.title.replace(/^[^\p{L}]*\d* ?/u, worst === "good" ? "" : `${mark(worst)} ${needy([...rows.values()]).length} `);
  const entries = Object.entries(alarms).flatMap(([valve, list]) => list.map((alarm) => [valve, alarm]));
  showBanner(entries);
  showAlarms(document.getElementById("alarms"), entries, { withValve: true });
  if (place) tiles();
}

function tiles() {
  const wish = filter.value.trim().toLowerCase();
  const wanted = [...rows.values()].filter((row) => row.name.toLowerCase().includes(wish));
  const rank = (row) => (rows.size <= MANY && ABNORMAL.includes(row.condition) ? ORDER.indexOf(row.condition) : ORDER.length);
  wanted.sort((a, b) => rank(a) - rank(b) || a.name.localeCompare(b.name, undefined, { numeric: true }));
  const bad = needy(wanted);
  place.classList.toggle("many", rows.size > MANY);
  place.classList.toggle("few", rows.size <= FEW);
  put(place, wanted.map((row) => tileOf(row, "place")));
  put(document.getElementById("worst"), rows.size > MANY ? bad.slice(0, WORST).map((row) => tileOf(row, "worst")) : []);
  const numbers = {};
  for (const row of rows.values()) numbers[row.condition] = (numbers[row.condition] ?? 0) + 1;
  setText(document.getElementById("counts"), ORDER.filter((one) => numbers[one]).map((one) => `${numbers[one]} × ${texts.conditions[one]}`).join(", "));
}

/** Show `made` in `holder`; a tile that has the focus keeps it. */
function put(holder, made) {
  if (made.length === holder.childElementCount && made.every((tile, i) => tile === holder.children[i])) return;
  const focused = holder.contains(document.activeElement) ? document.activeElement : null;
  holder.replaceChildren(...made);
  focused?.focus({ preventScroll: true });
}

async function loadSparks() {
  try {
    const answer = await fetch("/sparks", { cache: "no-store" });
    if (answer.ok) {
      const found = (await answer.json()).valves;
      for (const [name, courses] of Object.entries(found)) if (JSON.stringify(courses) === JSON.stringify(sparks[name])) found[name] = sparks[name];
      sparks = found;
      show();
    }
  } catch {
    // said by the stream's own state
  }
}

export function start() {
  filter?.addEventListener("input", show);
  listen("/stream/machine", {
    machine: (data) => {
      lost = false;
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
    lost = true;
    for (const row of rows.values()) Object.assign(row, { condition: "no_word", reason: null, since: null, margin: null, shakes: null, natural: null, summary: null, letter: "" });
    show();
  });
  if (place) {
    loadSparks();
    setInterval(loadSparks, AGAIN);
  }
}
