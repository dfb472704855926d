// A valve's page: state, resonance, alarms, estimates, spectrum, trend, gap analysis.

import { actButton } from "/static/acts.js";
import { showAlarms } from "/static/alarms.js";
import { showSpectrum, startTrend } from "/static/charts.js";
import { gauge } from "/static/gauge.js";
import { announce, setLight } from "/static/light.js";
import { listen } from "/static/stream.js";
import { clock, digits, fill, make, nameOf, operable, quantity, setText, texts, valve } from "/static/text.js";

const byId = (id) => document.getElementById(id);
let before = null;
let natural = null;
const shown = {};

/** Build a part again only where its data changed. */
function once(id, data, build) {
  const text = JSON.stringify(data);
  if (shown[id] === text) return;
  shown[id] = text;
  byId(id).replaceChildren(...build());
}

function card(name, text, id) {
  return make("dl", {}, make("dt", {}, name), make("dd", { id: id ?? null }, text));
}

function resonance(found) {
  const c = texts.columns;
  if (!found) return [card(c.margin, texts.not_known, "margin")];
  let margin = texts.margin_none;
  if (found.margin !== null) margin = fill(found.margin < 0 ? texts.margin_below : texts.margin_above, { n: digits(Math.abs(found.margin)) });
  if (found.band !== null) margin += ` (${fill(texts.margin_limit, { n: digits(found.band) })})`;
  return [card(c.margin, margin, "margin"), card(c.shakes, quantity(found.shakes)), card(c.natural, quantity(found.natural)), card(texts.amplification, quantity(found.amplification))];
}

function change(one) {
  if ((one.change ?? null) === null) return "";
  const text = Math.abs(one.change).toFixed(1);
  const sign = Number(text) === 0 ? "" : one.change > 0 ? "+" : "−";
  return `${sign}${digits(text)} %`;
}

function limits(one) {
  if ((one.low ?? null) === null) return "";
  const places = Math.min(8, Math.max(0, 2 - Math.floor(Math.log10(one.high - one.low || 1))));
  const end = (value) => digits(value.toFixed(places).replace(/^-(?=[0.]+$)/, ""));
  return `${end(one.low)} … ${end(one.high)}`;
}

function estimateRow(one, compared) {
  const c = texts.columns;
  const referred = one.compared ? make("div", { class: "note" }, fill(texts.referred, { text: quantity(one.compared) })) : null;
  const name = nameOf(one.name);
  const cells = [make("th", { scope: "row" }, name), make("td", { "data-label": c.estimate }, quantity(one), ...(referred ? [referred] : []))];
  const label = `${name}: ${quantity(one.compared ?? one)}; ${c.baseline} ${quantity(one.baseline)}; ${c.limits} ${limits(one)}`;
  cells.push(
    make("td", { "data-label": c.baseline }, compared && one.baseline ? quantity(one.baseline) : ""),
    make("td", { "data-label": c.limits }, compared ? limits(one) : ""),
    make("td", { "data-label": c.change, "data-change": one.name }, compared ? change(one) : ""),
    make("td", {}, ...(compared && one.baseline ? [gauge(one, label)] : [])),
  );
  return make("tr", { "data-parameter": one.name }, ...cells);
}

function estimates(found) {
  if (!found) return [make("p", { class: "note" }, texts.not_known)];
  const c = texts.columns;
  const names = [texts.parameter, c.estimate, c.baseline, c.limits, c.change, c.picture];
  const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
  const rows = [...found.parameters.map((one) => estimateRow(one, true)), ...found.others.map((one) => estimateRow(one, false))];
  const state = make("p", {}, `${texts.model}: ${found.model}, ${texts.estimate_states[found.state]}`);
  return [state, make("table", { class: "wide" }, head, make("tbody", {}, ...rows))];
}

function baseline(found) {
  if (!found) return [texts.baseline_none];
  const by = found.frozen_by ? fill(texts.confirmed_by, { who: found.frozen_by }) : "";
  return [fill(texts.baseline_is, { version: found.version, stage: found.stage, by })];
}

function gap(found) {
  if (!found) return [make("p", { class: "note" }, texts.no_gap)];
  const verdict = found.done ? found.verdict : texts.gap_failed;
  const when = fill(texts.gap_at, { time: clock(found.stamp), confidence: found.confidence === null ? texts.not_known : digits(found.confidence) });
  const parts = [make("p", {}, make("strong", { lang: "en" }, verdict), ` ${when}`), make("p", { lang: "en" }, found.sentence)];
  if (found.report) parts.push(make("p", {}, make("a", { href: "/gap?" + new URLSearchParams({ valve }), download: "" }, texts.gap_report)));
  return parts;
}

function show(data) {
  if (before !== null && before !== data.condition) announce(valve, data.condition);
  before = data.condition;
  setLight(byId("light"), data.condition);
  setText(byId("summary"), data.summary ?? "");
  natural = data.resonance?.natural.value ?? null;
  once("resonance", data.resonance, () => resonance(data.resonance));
  showAlarms(byId("alarms"), data.alarms.map((alarm) => [valve, alarm]), { withValve: false });
  once("estimates", data.estimate, () => estimates(data.estimate));
  once("baseline", data.baseline, () => baseline(data.baseline));
  once("gap", data.gap, () => gap(data.gap));
  once("judgements", data.judgements, () => data.judgements.map((one) => make("li", {}, one)));
}

export function start() {
  if (operable) {
    byId("baseline_acts").append(actButton("freeze_baseline", valve), actButton("learn_baseline", valve));
    byId("gap_acts").append(actButton("analyse", valve), actButton("take_snapshot", valve));
  }
  let last = null;
  listen(`/stream/valve/${valve}`, {
    valve: (data) => {
      last = data;
      show(data);
    },
    spectrum: (data) => showSpectrum(data, natural),
  }, () => {
    if (last) show({ ...last, condition: "no_word", summary: null, resonance: null, judgements: [], estimate: last.estimate && { ...last.estimate, state: "stale" } });
    else setLight(byId("light"), "no_word");
    setText(byId("spectrum_text"), texts.no_samples);
  });
  startTrend();
}
