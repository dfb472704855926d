// The stream of events: what is not heard for a while is not believed.

import { setText, setTime, texts } from "/static/text.js";

const SILENT = 5000;

/** Listen to `path`; `lost` is called once nothing has come for 5 s, until something comes again. */
export function listen(path, handlers, lost) {
  const link = document.getElementById("link");
  let heard = performance.now();
  let source = null;
  let believed = false;
  const open = () => {
    source?.close();
    source = new EventSource(path);
    for (const [name, handle] of Object.entries({ beat: (data) => setTime(data.now), ...handlers })) {
      source.addEventListener(name, (event) => {
        heard = performance.now();
        if (!believed) {
          believed = true;
          setText(link, texts.connected);
          link.classList.remove("lost");
        }
        handle(JSON.parse(event.data));
      });
    }
  };
  const lose = () => {
    if (believed || link.textContent === texts.connecting) {
      setText(link, texts.lost);
      link.classList.add("lost");
      lost();
    }
    believed = false;
  };
  open();
  setInterval(() => {
    if (performance.now() - heard < SILENT) return;
    lose();
    if (source.readyState === EventSource.CLOSED) open();
  }, 1000);
  window.addEventListener("pagehide", () => source.close());
  window.addEventListener("pageshow", (event) => event.persisted && open());
}
