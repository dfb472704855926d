// The lamp of a valve: grey while normal; a shape, a letter (NE 107), a word and a colour where it is not.

import { make, setText, texts } from "/static/text.js";

export const ORDER = ["alarm", "no_word", "stale", "warning", "put_aside", "unknown", "learning", "at_rest", "good"];
/** Conditions that somebody has to look at; the others are normal operation. */
export const ABNORMAL = ["alarm", "no_word", "stale", "warning", "unknown"];
const SHAPES = { alarm: "▲", no_word: "∅", stale: "✕", warning: "◆", put_aside: "○", unknown: "?", learning: "…", at_rest: "–", good: "●" };

export const mark = (condition) => SHAPES[condition] ?? "?";

export function light(condition, letter = "") {
  const known = ORDER.includes(condition) ? condition : "unknown";
  const mark = ABNORMAL.includes(known) && letter ? ` ${letter}` : "";
  const shape = make("span", { class: "shape", "aria-hidden": "true" }, (SHAPES[known] ?? "?") + mark);
  return make("span", { class: `light ${known}`, "data-condition": known, "data-letter": letter }, shape, make("span", { class: "word" }, texts.conditions[known]));
}

export function setLight(place, condition, letter = "") {
  const now = place.firstElementChild?.dataset;
  if (now?.condition !== condition || now?.letter !== (letter ?? "")) place.replaceChildren(light(condition, letter ?? ""));
}

export function explainLights(place) {
  for (const one of ORDER) place.append(make("dt", {}, light(one)), make("dd", {}, texts.meanings[one]));
}

let announced = [];
let timer = null;
/** Say changes of states to screen readers, several at once as a count. */
export function announce(valve, condition) {
  announced.push([valve, condition]);
  timer ??= setTimeout(() => {
    const said = announced.length > 3
      ? texts.changed_many.replace("{n}", announced.length)
      : announced.map(([name, one]) => `${name}: ${texts.conditions[one]}`).join("; ");
    setText(document.getElementById("announcer"), said);
    announced = [];
    timer = null;
  }, 700);
}
