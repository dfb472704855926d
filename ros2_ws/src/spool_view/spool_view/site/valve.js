// A valve's page: what is wrong and what to do, margin, parameters, spectrum and trend on one screen; details below.

import { actButton } from "/static/acts.js";
import { buttons, reasonOf, showAlarms, showBanner, stateText, titleOf } from "/static/alarms.js";
import { aimTrend, fillWaterfall, showSpectrum, startTrend } from "/static/charts.js";
import { gauge, marginPicture } from "/static/drawing.js";
import { ABNORMAL, announce, mark, setLight } from "/static/light.js";
import { listen } from "/static/stream.js";
import { ago, clock, digits, fill, language, make, nameOf, now, operable, quantity, setText, texts, valve } from "/static/text.js";

const byId = (id) => document.getElementById(id);
let before = null;
let natural = null;
let band = null;
const shown = {};

/** Build a part again only where its data changed. */
function once(id, data, build) {
  const text = JSON.stringify(data);
  if (shown[id] === text) return;
  shown[id] = text;
  byId(id).replaceChildren(...build().filter((one) => one !== null));
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
  return [marginPicture(found.margin, found.band), card(c.margin, margin, "margin"), card(c.shakes, quantity(found.shakes)), card(c.natural, quantity(found.natural)), card(texts.amplification, quantity(found.amplification))];
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
  if (!compared) return make("tr", { "data-parameter": one.name }, ...cells);
  cells.push(
    make("td", { "data-label": c.baseline }, one.baseline ? quantity(one.baseline) : ""),
    make("td", { "data-label": c.limits }, limits(one)),
    make("td", { "data-label": c.change, "data-change": one.name }, change(one)),
    make("td", {}, ...(one.baseline ? [gauge(one, label)] : [])),
  );
  return make("tr", { "data-parameter": one.name }, ...cells);
}

/** The alarm that counts most: what it is, what to do, since when, value then and now, and whether its detector judges. */
function headline(data) {
  const worst = reasonOf(data, data.alarms);
  if (data.condition === "no_word") return [make("p", { class: "what" }, fill(texts.no_data, { since: data.since ? ago(data.since) : "" }))];
  if (!worst) return [];
  if (data.condition === "put_aside") return [make("p", { class: "what" }, make("strong", {}, titleOf(worst)), ` ${stateText(worst)}, ${worst.by}, ${ago(data.since)} `, worst.comment)];
  const own = worst.texts[language] ?? { title: titleOf(worst), advice: "", urgency: "", headline: "" };
  const now = data.estimate?.parameters.find((one) => one.name === worst.parameter);
  const parts = [
    make("p", { class: "what" }, make("span", { class: `letter ${worst.letter}` }, worst.letter || "!"), " ", make("strong", {}, own.title), " ", make("span", { class: "note" }, `${texts.number} ${worst.code}, ${ago(worst.raised)}`)),
    own.advice ? make("p", { class: "do" }, fill(texts.to_do, { advice: own.advice, urgency: own.urgency })) : null,
    make("p", { class: "values" }, fill(texts.when_raised, { text: own.headline }), now ? " " + fill(texts.value_now, { text: quantity(now.compared ?? now) }) : ""),
  ];
  const blind = data.judgements.filter((one) => one.startsWith(worst.kind) && !one.endsWith(": judged"));
  if (blind.length) parts.push(make("p", { class: "blind" }, fill(texts.blind, { text: blind.map((one) => one.replaceAll("_", " ")).join("; ") })));
  if (operable) parts.push(...buttons(valve, worst));
  return parts;
}

function table(rows, compared) {
  const c = texts.columns;
  const names = [texts.parameter, c.estimate, ...(compared ? [c.baseline, c.limits, c.change, c.picture] : [])];
  const head = make("thead", {}, make("tr", {}, ...names.map((name) => make("th", { scope: "col" }, name))));
  return make("table", { class: "wide" }, head, make("tbody", {}, ...rows));
}

function estimates(found) {
  if (!found) return [make("p", { class: "note" }, texts.not_known)];
  const state = make("p", { class: "note" }, `${texts.model}: ${found.model}, ${texts.estimate_states[found.state]}`);
  return [table(found.parameters.map((one) => estimateRow(one, true)), true), state];
}

function others(found) {
  return found ? [table(found.others.map((one) => estimateRow(one, false)), false)] : [make("p", { class: "note" }, texts.not_known)];
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
  setLight(byId("light"), data.condition, data.letter);
  document.title = document.title.replace(/^[^\p{L}\d]* ?/u, ABNORMAL.includes(data.condition) ? `${mark(data.condition)} ` : "");
  setText(byId("summary"), data.summary ?? "");
  natural = data.resonance?.natural.value ?? null;
  band = data.resonance?.band ?? null;
  const minute = Math.floor(now() / 10);
  byId("headline").dataset.condition = data.condition;
  once("headline", [data.condition, data.since, data.alarms, data.estimate, data.judgements, minute], () => headline(data));
  const worst = reasonOf(data, data.alarms);
  const limits = (name) => data.estimate?.parameters.find((one) => one.name === name) ?? null;
  aimTrend(limits(worst?.parameter) ? worst.parameter : "", worst?.raised ?? 0, data.alarms.map((alarm) => alarm.raised).filter(Boolean), limits);
  showBanner(data.alarms.map((alarm) => [valve, alarm]));
  once("resonance", data.resonance, () => resonance(data.resonance));
  showAlarms(byId("alarms"), data.alarms.map((alarm) => [valve, alarm]), { withValve: false });
  once("estimates", data.estimate, () => estimates(data.estimate));
  once("others", data.estimate, () => others(data.estimate));
  once("baseline", data.baseline, () => baseline(data.baseline));
  once("gap", data.gap, () => gap(data.gap));
  once("judgements", data.judgements, () => data.judgements.map((one) => make("li", {}, one)));
}

export function start() {
  if (operable) {
    byId("valve_acts").append(...["maintain", "return_to_service", "freeze_baseline", "learn_baseline", "analyse", "take_snapshot"].map((act) => actButton(act, valve)));
  }
  let last = null;
  listen(`/stream/valve/${valve}`, {
    valve: (data) => {
      last = data;
      show(data);
    },
    waterfall: (data) => fillWaterfall(data, natural),
    spectrum: (data) => showSpectrum(data, natural, band),
  }, () => {
    if (last) show({ ...last, condition: "no_word", reason: null, since: null, summary: null, resonance: null, judgements: [], estimate: last.estimate && { ...last.estimate, state: "stale" } });
    else setLight(byId("light"), "no_word");
    setText(byId("spectrum_text"), texts.no_samples);
  });
  startTrend();
}
