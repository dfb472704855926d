// The list of alarms after ISA-18.2: sorted, filtered, grouped by common cause, with acts on many at a time.

import { askFor } from "/static/acts.js";
import { ago, clock, fill, language, make, now, operable, setText, soon, texts } from "/static/text.js";

export const WAITING = ["unacknowledged", "returned_unacknowledged", "latched_unacknowledged"];
const HIDDEN = ["shelved", "suppressed", "out_of_service"];
const SHOWN = 200;
/** A common cause: alarms of one number at so many valves, each within so many seconds of the one before. */
const TOGETHER = 3;
const WITHIN = 60;
const opened = new Set();
const selected = new Set();
const wishes = { sort: "priority", words: "", letter: "", state: "" };

const waits = (alarm) => WAITING.includes(alarm.state);
const ACTIVE = ["unacknowledged", "acknowledged"];
/** What stands comes before what is over, that before what is put aside; then the worst first. */
const priority = ([, alarm]) => (HIDDEN.includes(alarm.state) ? 200 : ACTIVE.includes(alarm.state) ? 0 : 100) - (alarm.severity === "alarm" ? 40 : 0) - 4 * (alarm.urgency ?? 0) - (waits(alarm) ? 1 : 0);
const SORTS = {
  priority: (a, b) => priority(a) - priority(b) || b[1].raised - a[1].raised,
  time: (a, b) => b[1].raised - a[1].raised,
  valve: (a, b) => a[0].localeCompare(b[0], undefined, { numeric: true }),
};

/** The alarm that the state of a valve speaks of, as the server says; undefined where there is none. */
export function reasonOf(row, list) {
  return row.reason === null ? undefined : list.find((alarm) => alarm.name === row.reason);
}

/** Alarms of one cause at many valves within a minute, and those put aside by one act, become one entry each. */
export function grouped(entries) {
  const groups = [];
  const byCode = new Map();
  const byAct = new Map();
  for (const entry of entries) {
    const served = entry[1].state === "out_of_service" ? `${entry[0]} ${entry[1].by} ${entry[1].hidden}` : null;
    if (served) byAct.set(served, [...(byAct.get(served) ?? []), entry]);
    else if (!entry[1].common || HIDDEN.includes(entry[1].state)) groups.push([entry]);
    else byCode.set(entry[1].code, [...(byCode.get(entry[1].code) ?? []), entry]);
  }
  groups.push(...byAct.values());
  for (const list of byCode.values()) {
    list.sort((a, b) => a[1].raised - b[1].raised);
    const runs = [];
    for (const entry of list) {
      if (runs.length && entry[1].raised - runs.at(-1).at(-1)[1].raised <= WITHIN) runs.at(-1).push(entry);
      else runs.push([entry]);
    }
    for (const run of runs) {
      if (new Set(run.map(([valve]) => valve)).size >= TOGETHER) groups.push(run);
      else groups.push(...run.map((entry) => [entry]));
    }
  }
  return groups;
}

/** One line in the header of each page while something waits for an operator. */
export function showBanner(entries) {
  chime(entries);
  const banner = document.getElementById("banner");
  const waiting = grouped(entries).filter((group) => group.some(([, alarm]) => waits(alarm))).length;
  banner.hidden = !waiting;
  setText(banner, waiting ? fill(texts.waiting, { n: waiting }) : "");
}

const SOUND = "spool_sound";
const switched = document.getElementById("sound");
let heard = null;

/** A short tone when an alarm comes that nobody has acknowledged, where somebody turned the sound on. */
function chime(entries) {
  const before = heard;
  heard = new Set(entries.filter(([, alarm]) => waits(alarm)).map(([valve, alarm]) => `${valve} ${alarm.name} ${alarm.occurrence}`));
  if (before === null || localStorage.getItem(SOUND) !== "on" || [...heard].every((key) => before.has(key))) return;
  const context = new AudioContext();
  const tone = new OscillatorNode(context, { frequency: 880 });
  tone.connect(new GainNode(context, { gain: 0.2 })).connect(context.destination);
  tone.onended = () => context.close();
  tone.start();
  tone.stop(context.currentTime + 0.4);
  switched.dataset.played = String(Number(switched.dataset.played ?? 0) + 1);
}

function showSound() {
  const on = localStorage.getItem(SOUND) === "on";
  switched.setAttribute("aria-pressed", String(on));
  setText(switched, on ? texts.sound_on : texts.sound_off);
}
switched.addEventListener("click", () => {
  localStorage.setItem(SOUND, localStorage.getItem(SOUND) === "on" ? "off" : "on");
  showSound();
});
showSound();

const keyOf = (valve, alarm) => `${valve} ${alarm.name}`;

/** Show `entries`, pairs of valve and alarm, in `place`; rows stay where they are unless they changed. */
export function showAlarms(place, entries, { withValve }) {
  const fresh = () => showAlarms(place, entries, { withValve });
  place.again = fresh;
  const words = wishes.words.toLowerCase().split(/\s+/).filter(Boolean);
  const fits = ([valve, alarm]) => {
    const text = `${valve} ${alarm.code} ${alarm.name} ${alarm.texts[language]?.headline ?? ""} ${alarm.by}`.toLowerCase();
    return words.every((word) => text.includes(word)) && (!wishes.letter || alarm.letter === wishes.letter) && (!wishes.state || alarm.state === wishes.state);
  };
  const wanted = withValve ? entries.filter(fits) : entries;
  const groups = grouped(wanted).map((group) => group.sort(SORTS[wishes.sort])).sort((a, b) => SORTS[wishes.sort](a[0], b[0]));
  const there = new Set(entries.map(([valve, alarm]) => keyOf(valve, alarm)));
  for (const key of selected) if (!there.has(key)) selected.delete(key);
  const text = JSON.stringify([groups, wishes, [...selected], [...opened], Math.floor(now() / 60)]);
  if (place.dataset.shown === text) return;
  place.dataset.shown = text;
  if (withValve && !place.querySelector(".alarm_controls")) place.replaceChildren(controls(place), make("p", { class: "note", id: "shown" }), make("div", { class: "alarm_table" }));
  const table = withValve ? place.querySelector(".alarm_table") : place;
  if (withValve) setText(place.querySelector("#shown"), entries.length ? fill(texts.shown, { n: Math.min(SHOWN, wanted.length), m: entries.length }) : "");
  for (const button of place.querySelectorAll(".many button")) button.disabled = !selected.size;
  const count = place.querySelector(".many .count");
  if (count) setText(count, fill(texts.selected, { n: selected.size }));
  if (!wanted.length) {
    table.replaceChildren(make("p", { class: "note" }, texts.no_alarms));
    return;
  }
  const focused = table.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  const c = texts.columns;
  const names = [...(operable && withValve ? [texts.select] : []), c.alarm, ...(withValve ? [c.valve] : []), c.state, c.severity, c.since, c.by, c.says, ...(operable ? [c.acts] : [])];
  const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
  const body = make("tbody");
  let left = SHOWN;
  for (const group of groups) {
    if (left <= 0) break;
    if (group.length > 1) body.append(groupRow(group, withValve, fresh));
    const key = `group ${group[0][1].code} ${group[0][0]}`;
    if (group.length > 1 && !opened.has(key)) continue;
    for (const [valve, alarm] of group.slice(0, left)) body.append(row(valve, alarm, withValve, fresh, group.length > 1));
    left -= group.length;
  }
  table.replaceChildren(make("table", { class: "wide" }, head, body));
  if (focused) table.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
}

function controls(place) {
  const again = () => place.again();
  const select = (name, options) => {
    const box = make("select", { id: `alarms_${name}` }, ...options.map(([value, text]) => make("option", { value }, text)));
    box.value = wishes[name];
    box.addEventListener("change", () => {
      wishes[name] = box.value;
      again();
    });
    return box;
  };
  const words = make("input", { type: "search", id: "alarms_words", autocomplete: "off" });
  words.addEventListener("input", () => {
    wishes.words = words.value;
    again();
  });
  const states = Object.entries(texts.states).filter(([name]) => name !== "normal" && name !== "unknown");
  const parts = [
    make("label", {}, texts.filter_alarms, " ", words),
    make("label", {}, texts.letter, " ", select("letter", [["", texts.any], ...["F", "C", "S", "M"].map((one) => [one, `${one} ${texts.letters[one]}`])])),
    make("label", {}, texts.columns.state, " ", select("state", [["", texts.any], ...states])),
    make("label", {}, texts.sort, " ", select("sort", Object.keys(SORTS).map((one) => [one, texts.sorts[one]]))),
  ];
  const controls = make("div", { class: "alarm_controls" }, make("p", { class: "controls" }, ...parts));
  if (operable) {
    const many = ["acknowledge", "shelve", "maintain"].map((act) => make("button", {
      type: "button", "data-many": act, disabled: "",
      onclick: () => askFor(act, `${texts.acts[act]}: ${fill(texts.selected, { n: selected.size })}`, { targets: targets(place) }),
    }, texts.acts[act]));
    controls.append(make("p", { class: "acts many" }, make("span", { class: "count note" }, ""), ...many));
  }
  return controls;
}

function targets(place) {
  const rows = [...place.entries_by_key ?? []];
  return rows.filter(([key]) => selected.has(key)).map(([, target]) => target);
}

function box(keys, label, fresh) {
  const whole = keys.every((key) => selected.has(key));
  const found = make("input", { type: "checkbox", "aria-label": label, "data-key": `select ${keys[0]} ${keys.length}` });
  found.checked = whole;
  found.addEventListener("change", () => {
    for (const key of keys) found.checked ? selected.add(key) : selected.delete(key);
    fresh();
  });
  return make("td", { class: "select" }, found);
}

function noteTarget(valve, alarm) {
  const place = document.getElementById("alarms");
  place.entries_by_key ??= new Map();
  place.entries_by_key.set(keyOf(valve, alarm), { valve, alarm: alarm.name, occurrence: alarm.occurrence });
}

function groupRow(group, withValve, fresh) {
  const c = texts.columns;
  const first = group[0][1];
  const key = `group ${first.code} ${group[0][0]}`;
  const waiting = group.filter(([, alarm]) => waits(alarm)).length;
  for (const [valve, alarm] of group) noteTarget(valve, alarm);
  const toggle = make("button", {
    type: "button", "data-key": key, "aria-expanded": String(opened.has(key)),
    onclick: () => {
      opened.has(key) ? opened.delete(key) : opened.add(key);
      fresh();
    },
  }, opened.has(key) ? "▾" : "▸", " ", first.state === "out_of_service" ? fill(texts.served, { n: group.length, valve: group[0][0] }) : fill(texts.common_cause, { n: new Set(group.map(([valve]) => valve)).size, title: titleOf(first) }));
  const cells = [
    make("th", { scope: "row", colspan: withValve ? 2 : 1 }, toggle),
    make("td", { "data-label": c.state, class: waiting ? "waits" : null }, waiting ? "! " + fill(texts.waiting, { n: waiting }) : stateText(first)),
    make("td", { "data-label": c.severity }, texts.severities[first.severity] ?? first.severity),
    make("td", { "data-label": c.since }, ago(first.hidden ?? first.raised)),
    make("td", { "data-label": c.by }, ...doneBy(first)),
    make("td", { "data-label": c.says, class: "says" }, first.hidden ? "" : first.texts[language]?.advice ?? ""),
  ];
  if (operable && withValve) cells.unshift(box(group.map(([valve, alarm]) => keyOf(valve, alarm)), texts.select, fresh));
  if (operable) cells.push(make("td"));
  return make("tr", { class: "group", "data-group": first.code }, ...cells);
}

function row(valve, alarm, withValve, fresh, inside) {
  const c = texts.columns;
  noteTarget(valve, alarm);
  const cells = [
    make("th", { scope: "row" }, alarm.letter ? make("span", { class: `letter ${alarm.letter}` }, alarm.letter) : null, ` ${alarm.code} ${titleOf(alarm)}`),
    make("td", { "data-label": c.state, class: waits(alarm) ? "waits" : null, "data-state": alarm.state }, (waits(alarm) ? "! " : "") + stateText(alarm)),
    make("td", { "data-label": c.severity }, texts.severities[alarm.severity] ?? alarm.severity),
    make("td", { "data-label": c.since, title: clock(alarm.raised) }, ago(alarm.raised)),
    make("td", { "data-label": c.by }, ...doneBy(alarm)),
    make("td", { "data-label": c.says, class: "says" }, ...said(valve, alarm)),
  ];
  if (withValve) cells.splice(1, 0, make("td", { "data-label": c.valve }, make("a", { href: `/valve/${valve}` }, ...valve.split(/(?<=[/_])/).flatMap((part) => [part, make("wbr")]))));
  if (operable && withValve) cells.unshift(box([keyOf(valve, alarm)], `${texts.select}: ${valve}, ${alarm.name}`, fresh));
  if (operable) cells.push(make("td", { "data-label": c.acts }, ...buttons(valve, alarm)));
  return make("tr", { "data-alarm": alarm.name, class: inside ? "inside" : null }, ...cells);
}

/** What people call the alarm, as the events do. */
export function titleOf(alarm) {
  return alarm.texts[language]?.title ?? alarm.name.replaceAll("_", " ");
}

/** The state, and until when it is put aside. */
export function stateText(alarm) {
  const end = alarm.shelved_until ? ", " + fill(texts.shelved_until, { time: soon(alarm.shelved_until) }) : alarm.state === "shelved" ? ", " + texts.until_over : "";
  return (texts.states[alarm.state] ?? alarm.state) + (HIDDEN.includes(alarm.state) ? end : "");
}

function doneBy(alarm) {
  return alarm.comment ? [alarm.by, make("span", {}, " ", fill(texts.comment_is, { comment: alarm.comment }))] : [alarm.by];
}

/** The headline, and its details behind a switch that stays as the reader left it. */
function said(valve, alarm) {
  const own = alarm.texts[language];
  if (!own) return [];
  const lines = own.details.map(([label, text]) => [make("dt", {}, label), make("dd", {}, text)]).flat();
  const key = `${valve} ${alarm.name} details`;
  const folded = make("details", { open: opened.has(key) ? "" : null }, make("summary", { "data-key": key }, own.headline), make("dl", {}, ...lines));
  folded.addEventListener("toggle", () => (folded.open ? opened.add(key) : opened.delete(key)));
  return [folded];
}

export function buttons(valve, alarm) {
  const acts = [
    ...(waits(alarm) ? ["acknowledge"] : []),
    alarm.state === "shelved" ? "unshelve" : "shelve",
    ...(alarm.state === "out_of_service" ? ["return_to_service"] : []),
    ...(alarm.state === "latched_acknowledged" ? ["reset"] : []),
  ];
  const label = alarm.name.replaceAll("_", " ");
  const made = acts.map((act) => make("button", {
    type: "button", "data-act": act, "data-key": `${valve} ${alarm.name} ${act}`, "aria-label": `${texts.acts[act]}: ${valve}, ${label}`,
    onclick: () => askFor(act, `${texts.acts[act]}: ${valve}, ${label}`, { valve, alarm: alarm.name, occurrence: alarm.occurrence }),
  }, texts.acts[act]));
  return [make("span", { class: "acts" }, ...made)];
}
