// An operator's acts: a dialog for who, why and how long; the token stays in this tab.

import { fill, make, operable, personal, setText, texts } from "/static/text.js";

const TOKEN = "spool_token";
const WHO = "spool_who";
const dialog = document.getElementById("dialog");
const said = document.getElementById("said");
let finish = null;

function field(id, label, attributes = {}) {
  return make("label", { for: id }, label, make("input", { id, autocomplete: "off", ...attributes }));
}

/** Show a dialog; `done` gets its values and returns what is wrong, or nothing. */
function ask(title, fields, done) {
  setText(document.getElementById("dialog_title"), title);
  setText(document.getElementById("dialog_do"), texts.do);
  setText(document.getElementById("dialog_said"), "");
  document.getElementById("dialog_fields").replaceChildren(...fields);
  finish = done;
  dialog.showModal();
  dialog.querySelector("input")?.focus();
}

async function send(path, content) {
  try {
    const answer = await fetch(path, {
      method: "POST", cache: "no-store", redirect: "error",
      headers: { "content-type": "application/json", authorization: `Bearer ${sessionStorage.getItem(TOKEN) ?? ""}` },
      body: JSON.stringify(content),
    });
    const found = await answer.json().catch(() => ({}));
    return [answer.status, found.text ?? "", found.token ?? ""];
  } catch {
    return [0, "", ""];
  }
}

function showMode() {
  const signed = sessionStorage.getItem(TOKEN) !== null;
  setText(document.getElementById("mode"), signed ? fill(texts.signed_in, { who: sessionStorage.getItem(WHO) ?? "" }) : texts.not_signed_in);
  setText(document.getElementById("sign_in"), signed ? texts.sign_out : texts.sign_in);
}

function signIn(then) {
  const fields = [
    field("who", texts.who, { required: "", maxlength: 60 }),
    field("token", personal ? texts.password : texts.token, { required: "", type: "password" }),
  ];
  ask(texts.sign_in, fields, async (values) => {
    sessionStorage.setItem(TOKEN, values.token.trim());
    sessionStorage.setItem(WHO, values.who.trim());
    const [status, text, token] = await send("/operator", personal ? { who: values.who.trim(), token: values.token } : {});
    if (status !== 200) {
      sessionStorage.removeItem(TOKEN);
      return text || texts.no_answer;
    }
    if (personal) sessionStorage.setItem(TOKEN, token);
    showMode();
    if (then) setTimeout(then);
    return "";
  });
}

/** Ask an operator for what an act needs, and do it. */
export function askFor(act, title, target) {
  if (sessionStorage.getItem(TOKEN) === null) {
    signIn(() => askFor(act, title, target));
    return;
  }
  const fields = [];
  if (act === "maintain") fields.push(field("minutes", texts.maintain_minutes, { type: "number", min: 1, max: 527040, step: "any", value: 120, required: "" }));
  if (act === "shelve") fields.push(field("minutes", texts.minutes, { type: "number", min: 0, max: 10080, step: "any", value: 30, required: "" }));
  fields.push(field("comment", texts.comment, { maxlength: 200 }));
  const own = sessionStorage.getItem(WHO) ?? "";
  if (!personal) fields.push(field("who", texts.who, { required: "", maxlength: 60, value: own }));
  ask(title, fields, async (values) => {
    const content = { act, ...target, who: values.who ?? own, comment: values.comment };
    if (values.minutes !== undefined) content.minutes = Number(values.minutes);
    const [status, text] = await send(target.targets ? "/acts" : "/act", content);
    if (status === 401) {
      sessionStorage.removeItem(TOKEN);
      showMode();
    }
    if (status !== 200) return status ? fill(texts.refused, { text }) : texts.no_answer;
    setText(said, fill(texts.done, { text: `${title}${text ? ": " + text : ""}` }));
    return "";
  });
}

/** A button for an act on the valve. */
export function actButton(act, valve) {
  const title = `${texts.acts[act]}: ${valve}`;
  return make("button", { type: "button", "data-act": act, onclick: () => askFor(act, title, { valve }) }, texts.acts[act]);
}

document.getElementById("dialog_form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = document.getElementById("dialog_do");
  const values = Object.fromEntries([...dialog.querySelectorAll("input")].map((one) => [one.id, one.value]));
  button.disabled = true;
  const wrong = await finish(values);
  button.disabled = false;
  if (wrong) setText(document.getElementById("dialog_said"), wrong);
  else dialog.close();
});
document.getElementById("dialog_leave").addEventListener("click", () => dialog.close());
dialog.addEventListener("close", () => dialog.open || document.getElementById("dialog_fields").replaceChildren());

if (operable) {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    history.replaceState(null, "", location.pathname);
    sessionStorage.setItem(TOKEN, given);
  }
  document.getElementById("sign_in").addEventListener("click", () => {
    if (sessionStorage.getItem(TOKEN) === null) return signIn(null);
    sessionStorage.removeItem(TOKEN);
    showMode();
  });
  showMode();
}
