// Pictures of numbers as SVG: gauge of an estimate, margin to resonance, trend of the last hour. Grey while normal.

import { digits, make } from "/static/text.js";

const SVG = "http://www.w3.org/2000/svg";

function part(tag, attributes) {
  const found = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  return found;
}

const known = (value) => value !== null && value !== undefined;

/** A picture of `one` (value, width, baseline, low, high), described by `label`. */
export function gauge(one, label) {
  const compared = one.compared ?? one;
  const value = compared.value;
  const width = compared.width ?? 0;
  const base = one.baseline?.value;
  const picture = part("svg", { class: "gauge", viewBox: "0 0 224 32", role: "img", "aria-label": label });
  if (!known(value) || !known(base) || !known(one.low)) return picture;
  const from = Math.min(one.low, value - width, base);
  const to = Math.max(one.high, value + width, base);
  const margin = 0.08 * (to - from) || 1;
  const x = (v) => (8 + (208 * (v - from + margin)) / (to - from + 2 * margin)).toFixed(1);
  const outside = value < one.low || value > one.high ? " outside" : "";
  picture.append(
    part("rect", { class: "within", x: x(one.low), y: 4, width: Math.max(0, x(one.high) - x(one.low)), height: 24 }),
    part("line", { class: "edge", x1: x(one.low), x2: x(one.low), y1: 4, y2: 28 }),
    part("line", { class: "edge", x1: x(one.high), x2: x(one.high), y1: 4, y2: 28 }),
    part("line", { class: "base", x1: x(base), x2: x(base), y1: 2, y2: 30 }),
    part("line", { class: "range" + outside, x1: x(value - width), x2: x(value + width), y1: 16, y2: 16 }),
    part("circle", { class: "dot" + outside, cx: x(value), cy: 16, r: 4 }),
  );
  return picture;
}

/** Range of the margin to resonance that is drawn, per cent either way. */
const WIDEST = 60;

/** Margin to resonance (per cent; null: none) as a pointer; the band within which the monitor warns is `band` either way. A picture that is given moves: to make them all again twice a second costs memory. */
export function marginPicture(margin, band, picture = null) {
  const x = (v) => 56 + (52 * Math.max(-WIDEST, Math.min(WIDEST, v))) / WIDEST;
  if (!picture) {
    picture = part("svg", { class: "margin", viewBox: "0 0 112 12", preserveAspectRatio: "xMinYMid meet", "aria-hidden": "true" });
    picture.append(part("line", { class: "edge", x1: 4, x2: 108, y1: 9, y2: 9 }), part("rect", { class: "warns", y: 6, height: 6 }), part("line", { class: "base", x1: 56, x2: 56, y1: 5, y2: 12 }), part("path", {}));
  }
  const [, warns, , pointer] = picture.children;
  warns.setAttribute("x", x(-(band ?? 0)));
  warns.setAttribute("width", x(band ?? 0) - x(-(band ?? 0)));
  pointer.setAttribute("class", known(margin) && known(band) && Math.abs(margin) <= band ? "dot outside" : "dot");
  pointer.setAttribute("d", known(margin) ? `M${x(margin) - 4} 0H${x(margin) + 4}L${x(margin)} 8Z` : "");
  return picture;
}

/** Trend of one parameter over the last hour, with baseline and the limits of the monitor behind it. */
export function sparkline(one, label) {
  const picture = part("svg", { class: "spark", viewBox: "0 0 40 18", preserveAspectRatio: "none", role: "img", "aria-label": label });
  const values = one?.mean ?? [];
  if (!values.length) return picture;
  const limits = [one.low, one.high].filter(known);
  const all = [...values, ...limits, ...(known(one.baseline) ? [one.baseline] : [])];
  const low = Math.min(...all);
  const span = Math.max(...all) - low || Math.abs(low) || 1;
  const y = (v) => (16.5 - (15 * (v - low)) / span).toFixed(1);
  const begin = one.until - 3600;
  const x = (t) => (Math.max(0, Math.min(1, (t - begin) / 3600)) * 40).toFixed(1);
  if (limits.length === 2) picture.append(part("rect", { class: "within", x: 0, y: y(one.high), width: 40, height: Math.max(0.5, y(one.low) - y(one.high)) }));
  if (known(one.baseline)) picture.append(part("line", { class: "base", x1: 0, x2: 40, y1: y(one.baseline), y2: y(one.baseline) }));
  const last = values.at(-1);
  const outside = limits.length === 2 && (last < one.low || last > one.high) ? " outside" : "";
  let path = "";
  values.forEach((value, i) => {
    const gap = i === 0 || one.start[i] - one.start[i - 1] > 90;
    path += `${gap ? "M" : "L"}${x(one.start[i])} ${y(value)}`;
  });
  picture.append(part("path", { class: "course" + outside, d: path }));
  return picture;
}

/** Name, place between the limits of the monitor, and change against the healthy valve of the newest value of a course. */
export function meter(one, name) {
  const value = one.mean.at(-1);
  const [low, high] = [one.low, one.high];
  const place = known(value) && known(low) && known(high) && high > low ? Math.max(2, Math.min(98, 30 + (40 * (value - low)) / (high - low))) : null;
  const change = known(value) && one.baseline ? 100 * (value / one.baseline - 1) : null;
  const text = change === null ? "–" : `${change < 0 ? "−" : "+"}${digits(Math.abs(change).toFixed(Math.abs(change) < 9.95 ? 1 : 0))} %`;
  const picture = part("svg", { class: "scale", viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" });
  picture.append(part("rect", { class: "whole", x: 0, y: 2, width: 100, height: 6 }), part("rect", { class: "within", x: 30, y: 2, width: 40, height: 6 }));
  if (place !== null) picture.append(part("rect", { class: "dot", x: place - 1.5, y: 0, width: 3, height: 10 }));
  const outside = place !== null && (value < low || value > high);
  return make("span", { class: outside ? "meter outside" : "meter" }, make("span", { class: "label" }, name), picture, make("span", { class: "change" }, text));
}
