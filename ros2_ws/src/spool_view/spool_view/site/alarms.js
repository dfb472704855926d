// The list of alarms: states after ISA-18.2, with an operator's acts.

import { askFor } from "/static/acts.js";
import { clock, fill, language, make, operable, texts } from "/static/text.js";

const WAITING = ["unacknowledged", "returned_unacknowledged", "latched_unacknowledged"];
const SHOWN = 200;
const opened = new Set();

/** Show `entries`, pairs of valve and alarm, in `place`; rows stay where they are unless they changed. */
export function showAlarms(place, entries, { withValve }) {
  entries = [...entries].sort((a, b) => WAITING.includes(b[1].state) - WAITING.includes(a[1].state)).slice(0, SHOWN);
  const text = JSON.stringify(entries);
  if (place.dataset.shown === text) return;
  const focused = place.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  place.dataset.shown = text;
  if (!entries.length) {
    place.replaceChildren(make("p", { class: "note" }, texts.no_alarms));
    return;
  }
  const c = texts.columns;
  const names = [...(withValve ? [c.valve] : []), c.alarm, c.state, c.severity, c.since, c.by, c.says, ...(operable ? [c.acts] : [])];
  const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
  const body = make("tbody", {}, ...entries.map(([valve, alarm]) => row(valve, alarm, withValve)));
  place.replaceChildren(make("table", { class: "wide" }, head, body));
  if (focused) place.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
}

function row(valve, alarm, withValve) {
  const c = texts.columns;
  const waits = WAITING.includes(alarm.state);
  let state = texts.states[alarm.state] ?? alarm.state;
  if (alarm.state === "shelved") state += ", " + (alarm.shelved_until ? fill(texts.shelved_until, { time: clock(alarm.shelved_until) }) : texts.until_over);
  const comment = alarm.comment ? make("span", {}, " ", fill(texts.comment_is, { comment: alarm.comment })) : null;
  const cells = [
    make("th", { scope: "row" }, `${alarm.code} ${alarm.name.replaceAll("_", " ")}`),
    make("td", { "data-label": c.state, class: waits ? "waits" : null, "data-state": alarm.state }, (waits ? "! " : "") + state),
    make("td", { "data-label": c.severity }, texts.severities[alarm.severity] ?? alarm.severity),
    make("td", { "data-label": c.since }, clock(alarm.raised)),
    make("td", { "data-label": c.by }, alarm.by, ...(comment ? [comment] : [])),
    make("td", { "data-label": c.says, class: "says" }, ...said(valve, alarm)),
  ];
  if (withValve) cells.unshift(make("td", { "data-label": c.valve }, make("a", { href: `/valve/${valve}` }, valve)));
  if (operable) cells.push(make("td", { "data-label": c.acts }, ...buttons(valve, alarm)));
  return make("tr", { "data-alarm": alarm.name }, ...cells);
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

function buttons(valve, alarm) {
  const latched = alarm.state === "latched_acknowledged";
  const acts = [
    ...(WAITING.includes(alarm.state) ? ["acknowledge"] : []),
    alarm.state === "shelved" ? "unshelve" : "shelve",
    ...(latched ? ["reset"] : []),
  ];
  const label = alarm.name.replaceAll("_", " ");
  const made = acts.map((act) => make("button", {
    type: "button", "data-act": act, "data-key": `${valve} ${alarm.name} ${act}`, "aria-label": `${texts.acts[act]}: ${valve}, ${label}`,
    onclick: () => askFor(act, `${texts.acts[act]}: ${valve}, ${label}`, { valve, alarm: alarm.name, occurrence: alarm.occurrence }),
  }, texts.acts[act]));
  return [make("span", { class: "acts" }, ...made)];
}
