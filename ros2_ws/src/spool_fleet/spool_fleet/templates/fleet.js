"use strict";
// Opens the section of a valve that a link leads to, and prints those in which a change was found.
(function () {
  function show() {
    const found = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const section = found && found.closest("details");
    if (!section) return;
    section.open = true;
    const summary = section.querySelector("summary");
    summary.focus({ preventScroll: true });
    summary.scrollIntoView();
  }
  let opened = [];
  addEventListener("hashchange", show);
  document.addEventListener("click", (event) => {
    // The same link again changes no hash, but the section may have been closed since.
    const link = event.target.closest("a[href^='#valve-']");
    if (link && link.hash === location.hash) show();
  });
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details.notable:not([open])")];
    for (const one of opened) one.open = true;
  });
  addEventListener("afterprint", () => {
    for (const one of opened) one.open = false;
  });
  show();
})();
