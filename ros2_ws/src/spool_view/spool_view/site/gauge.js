// Gauge of an estimate: its interval against the baseline and the limits that the monitor warns at.

const SVG = "http://www.w3.org/2000/svg";

function part(tag, attributes) {
  const found = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  return found;
}

/** A picture of `one` (value, width, baseline, low, high), described by `label`. */
export function gauge(one, label) {
  const compared = one.compared ?? one;
  const value = compared.value;
  const width = compared.width ?? 0;
  const base = one.baseline?.value;
  const picture = part("svg", { class: "gauge", viewBox: "0 0 224 32", role: "img", "aria-label": label });
  if (value === null || base === undefined || base === null || one.low === null) return picture;
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
