"use strict";
// Draws the charts, opens the section of a valve that a link leads to, and prints those in which a change was found.
(function () {
  const numbers = JSON.parse(document.getElementById("numbers").textContent);
  const DAY = 86400;
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const percent = (ratio) => 100 * (ratio - 1);
  const signed = (value) => (Math.abs(value) < 1e-9 ? "0 %" : (value > 0 ? "+" : "") + Number(value.toPrecision(3)) + " %");
  const plots = new Map();

  /** Return what strokes lines between places (day, value), or fills the area within them. */
  function pen(plot) {
    const x = (day) => plot.valToPos(day * DAY, "x", true);
    const { top, height } = plot.bbox;
    const y = (value) => Math.min(top + height, Math.max(top, plot.valToPos(value, "y", true)));
    const context = plot.ctx;
    const path = (places) => {
      context.beginPath();
      places.forEach(([day, value], at) => context[at ? "lineTo" : "moveTo"](Math.round(x(day)) + 0.5, Math.round(y(value)) + 0.5));
    };
    return {
      x, top, bottom: top + height, context,
      line(places, name, width = 1, dash = []) {
        path(places);
        context.strokeStyle = colour(name);
        context.lineWidth = width * devicePixelRatio;
        context.setLineDash(dash.map((one) => one * devicePixelRatio));
        context.stroke();
      },
      area(places, name) {
        path(places);
        context.fillStyle = colour(name);
        context.fill();
      },
    };
  }

  /** Draw below the course: the band of healthy weeks, baseline, limits. */
  function below(plot, data, low, high, large) {
    const draw = pen(plot);
    draw.context.save();
    for (const [first, last, value, half] of data.levels) {
      if (half !== null) {
        const [under, over] = [percent(value - half), percent(value + half)];
        draw.area([[first, under], [last, under], [last, over], [first, over]], "--healthy");
      }
      draw.line([[first, percent(value)], [last, percent(value)]], "--text");
      if (data.limit === null || !large) continue;
      for (const limit of [percent(value * (1 - data.limit)), percent(value * (1 + data.limit))]) {
        if (low < limit && limit < high) draw.line([[first, limit], [last, limit]], "--fit", 1, [6, 4]);
      }
    }
    draw.context.restore();
  }

  /** Draw above the course: services, begin and size of the change, values beyond the scale. */
  function above(plot, data, low, high, large) {
    const draw = pen(plot);
    const { context, top, bottom } = draw;
    const letter = (day, text, name) => {
      context.fillStyle = colour(name);
      context.font = `700 ${11 * devicePixelRatio}px system-ui, sans-serif`;
      context.textAlign = "center";
      context.fillText(text, draw.x(day), top - 4 * devicePixelRatio);
    };
    context.save();
    for (const [day, text] of data.services) {
      draw.line([[day, low], [day, high]], "--service", 1.5, [2, 2]);
      if (large) letter(day, text, "--service");
    }
    if (data.since !== null) {
      draw.line([[data.since, low], [data.since, high]], "--fit", 1.2);
      if (large) letter(data.since, "▼", "--fit");
    }
    if (large && data.fit) {
      const { latest, begin, end } = data.fit;
      draw.line([[data.since, percent(begin)], [latest, percent(end)]], "--fit", 2, [7, 3]);
      draw.line([[latest, percent(data.fit.low)], [latest, percent(data.fit.high)]], "--fit", 4);
    }
    const size = 4 * devicePixelRatio;
    data.value.forEach((value, at) => {
      if (!large || value === null || (low <= value && value <= high)) return;
      const [tip, way] = value > high ? [top, 1] : [bottom, -1];
      const x = draw.x(data.day[at]);
      context.fillStyle = colour("--course");
      context.beginPath();
      context.moveTo(x, tip);
      context.lineTo(x - size, tip + 2 * way * size);
      context.lineTo(x + size, tip + 2 * way * size);
      context.fill();
    });
    context.restore();
  }

  function draw(place) {
    if (plots.has(place)) return;
    const data = numbers.charts[place.dataset.key];
    const [low, high] = numbers.scales[place.dataset.scale];
    const large = place.classList.contains("large");
    const course = data.levels !== undefined;
    const edge = { stroke: () => colour("--soft"), font: "11px system-ui, sans-serif", ticks: { show: false }, space: 28,
      border: { show: true, stroke: () => colour("--soft"), width: 1 }, grid: { stroke: () => colour("--line"), width: 0.6 } };
    const bare = large ? {} : { size: 0, values: () => [] };
    const dates = [[28 * DAY, "{YYYY}-{MM}"], [DAY, "{YYYY}-{MM}-{DD}"]];  // by the time between two marks
    const values = (_, marks) => marks.map((mark) => (course ? signed(mark) : `${mark} °C`));
    const units = (_, marks) => marks.map((mark) => String(Number((data.baseline * (1 + mark / 100)).toPrecision(3))));
    const bound = { stroke: "transparent", points: { show: false } };
    // What lies beyond the scale is drawn at its edge.
    const kept = (row) => row.map((value) => (value === null ? null : Math.min(high, Math.max(low, value))));
    const rows = (course ? [data.value, data.low, data.high] : [data.value]).map(kept);
    plots.set(place, new uPlot({
      width: place.clientWidth, height: place.clientHeight, legend: { show: false }, cursor: { show: false },
      padding: large ? [18, course ? 0 : 24, 0, 0] : [2, 0, 2, 0],
      tzDate: (seconds) => uPlot.tzDate(new Date(1000 * seconds), "Etc/UTC"),
      scales: { x: { range: numbers.time.map((day) => day * DAY) }, y: { range: [low, high] } },
      axes: [{ ...edge, values: dates, size: 26, space: large ? 84 : 40, ...bare }, { ...edge, values, size: 52, ...bare },
        ...(large && course ? [{ ...edge, scale: "y", side: 1, values: units, size: 52, grid: { show: false } }] : [])],
      series: [{}, { stroke: () => colour("--course"), width: large ? 0.8 : 1.3, points: { show: large, size: 4, fill: () => colour("--course") } },
        ...(course ? [bound, bound] : [])],
      bands: large && course ? [{ series: [3, 2], fill: () => colour("--course") + "38" }] : [],
      hooks: course ? { drawAxes: [(plot) => below(plot, data, low, high, large)], draw: [(plot) => above(plot, data, low, high, large)] } : {},
    }, [data.day.map((day) => day * DAY), ...rows], place));
    sizes.observe(place);
  }

  const sizes = new ResizeObserver((changes) => {
    for (const { target } of changes) {
      if (target.clientWidth) plots.get(target).setSize({ width: target.clientWidth, height: target.clientHeight });
    }
  });
  const seen = new IntersectionObserver((changes) => {
    for (const change of changes) if (change.isIntersecting) draw(change.target);
  }, { rootMargin: "400px" });
  const places = [...document.querySelectorAll(".chart")];
  places.forEach((place) => seen.observe(place));
  const redraw = () => plots.forEach((plot) => plot.redraw());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

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
    document.documentElement.classList.add("printed");
    places.filter((place) => place.clientWidth).forEach(draw);
    redraw();
  });
  addEventListener("afterprint", () => {
    for (const one of opened) one.open = false;
    document.documentElement.classList.remove("printed");
    redraw();
  });
  show();
})();
