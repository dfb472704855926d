// Charts of a valve's page: spectrum with the resonance band, waterfall, trend with limits and alarm marks.

import { clock, digits, fill, LOCALE, nameOf, setText, texts, unitText, valve } from "/static/text.js";

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const SPAN = 120;
const HEIGHT = 170;
let spectrum = null;
let trend = null;
const fall = [];

function size(place, height) {
  return { width: Math.max(260, Math.floor(place.clientWidth)), height };
}

/** Times on an axis: 24 h, with the day where ticks are days apart. */
function hours(_, ticks, __, ___, step) {
  const style = step >= 86400 ? { day: "2-digit", month: "2-digit" } : { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
  return ticks.map((tick) => new Date(1000 * tick).toLocaleString(LOCALE, style));
}

function axis(label, values, decades = false) {
  const filter = decades ? (_, splits) => splits.map((one) => (one !== null && Math.log10(one) % 1 ? null : one)) : undefined;
  return { label, stroke: colour("--text"), grid: { stroke: colour("--line"), width: 1, ...(filter ? { filter } : {}) }, ticks: { stroke: colour("--line"), ...(filter ? { filter } : {}) }, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", ...(values ? { values } : {}) };
}

function follow(chart, place, height) {
  new ResizeObserver(() => chart().setSize(size(place, height))).observe(place);
}

/** Fill the waterfall with what was recorded, or what the page's server saw, before this page was opened. */
export function fillWaterfall(data, natural) {
  fall.splice(0, fall.length, ...data.spool.slice(-SPAN));
  setText(document.getElementById("waterfall_text"), data.until === null ? "" : fill(texts.waterfall_until, { time: clock(data.until) }));
  drawWaterfall(data.step, natural);
}

/** Show the spectrum (peak acceleration by line) with the natural frequency (Hz, or null); within `band` per cent of it the monitor warns. */
export function showSpectrum(data, natural, band) {
  const place = document.getElementById("spectrum");
  const frequency = data.body.map((_, i) => +(i * data.step).toFixed(3));
  let peak = 1;
  for (let i = 2; i < data.body.length; i++) if (data.body[i] > data.body[peak]) peak = i;
  const words = { body: digits(data.body[peak].toPrecision(3)), frequency: digits(frequency[peak].toFixed(1)), natural: natural === null ? texts.not_known : digits(natural.toFixed(1)) };
  const said = fill(texts.spectrum_text, words);
  setText(document.getElementById("spectrum_text"), said);
  const positive = (list) => list.map((value) => Math.max(value, 1e-4));
  const values = [frequency, positive(data.body), positive(data.spool)];
  if (!spectrum) {
    const mark = (chart) => {
      if (chart.natural === null || chart.natural === undefined) return;
      const x = chart.valToPos(chart.natural, "x", true);
      const { top, height } = chart.bbox;
      chart.ctx.save();
      if (chart.warns) {
        const [low, high] = [-1, 1].map((side) => chart.valToPos(chart.natural * (1 + (side * chart.warns) / 100), "x", true));
        chart.ctx.fillStyle = colour("--within");
        chart.ctx.globalAlpha = 0.5;
        chart.ctx.fillRect(low, top, high - low, height);
        chart.ctx.globalAlpha = 1;
      }
      chart.ctx.strokeStyle = colour("--text");
      chart.ctx.setLineDash([6, 4]);
      chart.ctx.beginPath();
      chart.ctx.moveTo(x, top);
      chart.ctx.lineTo(x, top + height);
      chart.ctx.stroke();
      chart.ctx.restore();
    };
    spectrum = new uPlot({
      ...size(place, HEIGHT), scales: { x: { time: false }, y: { distr: 3 } }, hooks: { drawClear: [mark] },
      axes: [axis("Hz"), axis("m/s²", (_, ticks) => ticks.map((tick) => (tick === null || Math.log10(tick) % 1 ? "" : digits(tick))), true)],
      series: [{ label: "Hz" }, { label: texts.body, stroke: colour("--body"), width: 1.5 }, { label: texts.spool, stroke: colour("--spool"), width: 1.5, dash: [5, 2] }],
    }, values, place);
    place.setAttribute("role", "img");
    follow(() => spectrum, place, HEIGHT);
  }
  spectrum.natural = natural;
  spectrum.warns = band;
  spectrum.setData(values);
  place.setAttribute("aria-label", said);
  fall.push(data.spool);
  if (fall.length > SPAN) fall.shift();
  if (fall.every((lines) => lines.length)) setText(document.getElementById("waterfall_text"), "");
  drawWaterfall(data.step, natural);
}

function drawWaterfall(step, natural) {
  const canvas = document.getElementById("waterfall");
  const count = Math.round(200 / step);
  if (canvas.width !== count) canvas.width = count;
  const context = canvas.getContext("2d");
  const picture = context.createImageData(count, SPAN);
  fall.forEach((lines, row) => {
    const y = SPAN - fall.length + row;
    for (let i = 0; i < count; i++) {
      // Three decades up to 10 m/s^2, black over blue and yellow to white: brightness alone tells it.
      const level = lines.length === 0 ? 1 : Math.min(1, Math.max(0, (Math.log10((lines[i] ?? 0) + 1e-9) + 2) / 3));
      const place = 4 * (y * count + i);
      picture.data[place] = 255 * Math.min(1, Math.max(0, 2 * level - 0.6));
      picture.data[place + 1] = 255 * Math.min(1, Math.max(0, 1.6 * level - 0.25));
      picture.data[place + 2] = 255 * Math.min(1, level < 0.5 ? 1.3 * level : Math.max(0.4, 1.4 * level - 0.4));
      picture.data[place + 3] = 255;
    }
  });
  context.putImageData(picture, 0, 0);
  if (natural !== null) {
    context.fillStyle = "#ffffff";
    for (let y = 0; y < SPAN; y += 6) context.fillRect(Math.round(natural / step), y, 1, 3);
  }
}

/** The parameter that the alarm is about, from before it began; `limits` has baseline and limits of a parameter. */
let asked = { parameter: "", raised: 0, marks: [], limits: () => null };
let chosen = false;
/** Loads so far: an answer that comes after that of a later load is out of date. */
let loads = 0;

/** What the trend promises: days near the limit in the last week, and when it is reached. */
function outlook(data) {
  const words = [];
  if (data.near_days) words.push(fill(texts.near_days, { n: data.near_days }));
  if (data.reaches) {
    const unit = data.reaches[0] < 2 * 86400 ? [3600, texts.in_hours] : [86400, texts.in_days];
    const [early, late] = data.reaches.map((seconds) => (seconds === null ? null : Math.round(seconds / unit[0])));
    words.push(fill(late === null ? texts.reaches_after : texts.reaches, { early, late, unit: unit[1] }));
  }
  return words;
}

async function loadTrend() {
  const own = ++loads;
  const parameter = document.getElementById("trend_parameter");
  const range = document.getElementById("trend_range").value;
  const place = document.getElementById("trend");
  const text = document.getElementById("trend_text");
  let data = null;
  try {
    const wish = parameter.value || asked.parameter;
    const from = Number(new URLSearchParams(location.hash.slice(1)).get("at")) || asked.raised;
    const since = !chosen && from ? Math.floor(from - Math.max(600, 0.25 * (Date.now() / 1000 - from))) : 0;
    const answer = await fetch("/trend?" + new URLSearchParams({ valve, range, parameter: wish, ...(since ? { since } : {}) }), { cache: "no-store" });
    data = answer.ok ? await answer.json() : null;
  } catch {
    data = null;
  }
  if (own !== loads) return;
  if (data?.parameters.length && parameter.options.length !== data.parameters.length) {
    parameter.replaceChildren(...data.parameters.map((name) => new Option(nameOf(name), name, false, name === data.parameter)));
  }
  if (data?.parameters.length && !chosen) parameter.value = data.parameter;
  if (!data?.start.length) {
    setText(text, texts.no_trend);
    trend?.destroy();
    trend = null;
    return;
  }
  const round = (value) => digits(Number(value).toPrecision(4));
  const words = { parameter: nameOf(data.parameter), low: round(Math.min(...data.minimum)), high: round(Math.max(...data.maximum)), last: round(data.mean.at(-1)), unit: unitText(data.unit).trim(), span: texts.spans[data.seconds] };
  const said = fill(texts.trend_text, words);
  setText(text, [said, ...outlook(data)].join(" "));
  const bounds = asked.limits(data.parameter);
  const known = (value) => value !== null && value !== undefined;
  const shownY = (_, low, high) => {
    const all = [low, high, bounds?.low, bounds?.high, bounds?.baseline?.value].filter(known);
    const [from, to] = [Math.min(...all), Math.max(...all)];
    const pad = 0.08 * (to - from) || 0.05 * Math.abs(to) || 1;
    return [from - pad, to + pad];
  };
  const behind = (chart) => {
    const { ctx, bbox } = chart;
    ctx.save();
    if (known(bounds?.low) && known(bounds?.high)) {
      const [top, bottom] = [bounds.high, bounds.low].map((value) => chart.valToPos(value, "y", true));
      ctx.fillStyle = colour("--within");
      ctx.fillRect(bbox.left, top, bbox.width, bottom - top);
    }
    ctx.strokeStyle = colour("--text");
    const line = (x1, y1, x2, y2, dash) => {
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(x1, y1);
      ctx.lineTo(x2, y2);
      ctx.stroke();
    };
    if (known(bounds?.baseline?.value)) {
      const y = chart.valToPos(bounds.baseline.value, "y", true);
      line(bbox.left, y, bbox.left + bbox.width, y, []);
    }
    for (const seconds of asked.marks) {
      const x = chart.valToPos(seconds, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.strokeStyle = colour("--alarm");
      line(x, bbox.top, x, bbox.top + bbox.height, [5, 3]);
    }
    ctx.restore();
  };
  const options = {
    ...size(place, HEIGHT), hooks: { drawClear: [behind] },
    legend: { show: false },
    axes: [axis(null, hours), axis(unitText(data.unit).trim() || "1", (_, ticks) => ticks.map((tick) => digits(+tick.toPrecision(6))))],
    tzDate: (seconds) => uPlot.tzDate(new Date(1000 * seconds), Intl.DateTimeFormat().resolvedOptions().timeZone),
    series: [
      { label: texts.time, value: (_, seconds) => (seconds === null ? "" : clock(seconds)) },
      { label: texts.lowest, stroke: colour("--soft"), width: 1 }, { label: texts.mean, stroke: colour("--body"), width: 2, points: { show: data.start.length < 50 } }, { label: texts.highest, stroke: colour("--soft"), width: 1 },
    ],
    scales: { y: { range: shownY }, x: { range: data.from ? [data.from, data.until] : (_, low, high) => [low - data.seconds, high + data.seconds] } },
    bands: [{ series: [3, 1], fill: colour("--line") }],
  };
  trend?.destroy();
  trend = new uPlot(options, [data.start, data.minimum, data.mean, data.maximum], place);
  place.setAttribute("role", "img");
  place.setAttribute("aria-label", said);
}

/** Show the trend of what the headline alarm is about, until the reader chooses another one. */
export function aimTrend(parameter, raised, marks, limits) {
  const before = JSON.stringify([asked.parameter, asked.raised, asked.marks, asked.known]);
  asked = { parameter, raised, marks, limits, known: (limits(parameter)?.low ?? null) !== null };
  if (JSON.stringify([parameter, raised, marks, asked.known]) === before) return;
  if (!chosen) document.getElementById("trend_parameter").replaceChildren();
  loadTrend();
}

export function startTrend() {
  const place = document.getElementById("trend");
  for (const id of ["trend_parameter", "trend_range"]) {
    document.getElementById(id).addEventListener("change", () => {
      chosen = true;
      loadTrend();
    });
  }
  loadTrend();
  setInterval(loadTrend, 60000);
  new ResizeObserver(() => trend?.setSize(size(place, HEIGHT))).observe(place);
}
