// Entry: starts the page that was opened.

import "/static/acts.js";
import { explainLights } from "/static/light.js";
import { valve } from "/static/text.js";

explainLights(document.getElementById("lights"));
const page = await import(valve ? "/static/valve.js" : "/static/machine.js");
page.start();
