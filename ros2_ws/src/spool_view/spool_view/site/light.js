// The traffic light: a shape, a word and a colour; green only where all is known and good.

import { make, setText, texts } from "/static/text.js";

export const ORDER = ["alarm", "no_word", "stale", "warning", "unknown", "learning", "at_rest", "good"];
const SHAPES = { alarm: "▲", no_word: "∅", stale: "✕", warning: "◆", unknown: "?", learning: "…", at_rest: "–", good: "●" };

export function light(condition) {
  const shape = make("span", { class: "shape", "aria-hidden": "true" }, SHAPES[condition] ?? "?");
  const known = ORDER.includes(condition) ? condition : "unknown";
  return make("span", { class: `light ${known}`, "data-condition": known }, shape, make("span", {}, texts.conditions[known]));
}

export function setLight(place, condition) {
  if (place.firstElementChild?.dataset.condition !== condition) place.replaceChildren(light(condition));
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
