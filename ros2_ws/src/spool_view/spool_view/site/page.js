// Entry: starts the page that was opened.

import "/static/acts.js";
import { explainLights } from "/static/light.js";
import { view } from "/static/text.js";

const lights = document.getElementById("lights");
if (lights) explainLights(lights);
const page = await import(`/static/${view === "alarms" ? "machine" : view}.js`);
page.start();
