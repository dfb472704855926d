// Texts, numbers and times in the page's language; elements are made with text only, never with markup.

const data = JSON.parse(document.getElementById("page_data").textContent);
export const { texts, language, valve, view, operable, personal } = data;

export function fill(text, values) {
  return text.replace(/\{(\w+)\}/g, (_, name) => String(values[name] ?? ""));
}

/** Digits with the language's decimal mark. */
export function digits(text) {
  return language !== "en" ? String(text).replace(".", ",") : String(text);
}

export function unitText(unit) {
  return !unit || unit === "1" ? "" : " " + unit.replace(" s", "·s").replace("^2", "²").replace("deg C", "°C");
}

/** A quantity with its interval, e.g. "28.7 ± 0.3 Hz". */
export function quantity(one) {
  if (!one || one.text === null) return texts.not_known;
  const half = one.half === null || one.half === "unknown" ? "" : " ± " + digits(one.half);
  const held = one.validity === "valid" ? "" : ` (${texts[one.validity] ?? one.validity})`;
  return digits(one.text) + half + unitText(one.unit) + held;
}

export function nameOf(name) {
  return texts[name] ?? name.replaceAll("_", " ");
}

/** s by which the clock of the page's server is ahead of this computer's. */
let ahead = 0;
/** Seconds since 1970 by the server's clock. */
export const now = () => Date.now() / 1000 + ahead;

/** Take the server's time; say where this computer's clock differs. */
export function setTime(seconds) {
  if (Math.abs(now() - seconds) > 1) ahead = seconds - Date.now() / 1000;
  const place = document.getElementById("clock");
  const zone = Intl.DateTimeFormat().resolvedOptions().timeZone;
  if (place) setText(place, fill(Math.abs(ahead) > 5 ? texts.clocks_differ : texts.zone, { zone, n: Math.round(Math.abs(ahead)) }));
}

/** Day first and 24 h in every language of the page. */
export const LOCALE = { en: "en-GB", de: "de-DE", pl: "pl-PL" }[language];

export function clock(seconds) {
  return seconds ? new Date(1000 * seconds).toLocaleString(LOCALE, { dateStyle: "short", timeStyle: "medium", hourCycle: "h23" }) : "";
}

/** A time of today without its date. */
export function soon(seconds) {
  const style = Math.abs(seconds - now()) < 43200 ? { hour: "2-digit", minute: "2-digit", hourCycle: "h23" } : { dateStyle: "short", timeStyle: "short", hourCycle: "h23" };
  return new Date(1000 * seconds).toLocaleString(LOCALE, style);
}

/** How long ago, and when: "for 12 min, since 18:35"; with the date where it was not today. */
export function ago(seconds) {
  if (!seconds) return "";
  const passed = Math.max(0, now() - seconds);
  const unit = passed < 60 ? ["s", 1] : passed < 5400 ? ["min", 60] : passed < 172800 ? ["h", 3600] : ["d", 86400];
  const since = new Date(1000 * seconds);
  const today = since.toDateString() === new Date(1000 * now()).toDateString();
  const time = since.toLocaleString(LOCALE, { ...(today ? {} : { day: "2-digit", month: "2-digit" }), hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
  return fill(texts.for_since, { n: unit[0] === "s" ? Math.floor(passed) : Math.round(passed / unit[1]), unit: texts.units[unit[0]], time });
}

/** An element with attributes and children; strings become text. */
export function make(tag, attributes = {}, ...children) {
  const found = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "onclick") found.addEventListener("click", value);
    else if (value !== null && value !== false) found.setAttribute(name, value);
  }
  found.append(...children.filter((one) => one !== null && one !== undefined));
  return found;
}

/** Set text only where it changed: screen readers and selections are left alone. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
