// Viewer: draws the numbers of a picture with uPlot, to zoom by dragging and back by a double click.
(function () {
  "use strict";
  var sync = 0;
  function scale(log) { return log ? { distr: 3, log: 10 } : {}; }
  function axis(label) { return { label: label, labelSize: 18, size: 56, grid: { stroke: "#ddd", width: 1 } }; }
  function short(value) { return value == null ? "" : String(Number(value.toPrecision(4))); }
  function draw(panel, box, key) {
    var data = [panel.x], series = [{ label: panel.across, value: function (u, v) { return short(v); } }], bands = [];
    panel.lines.forEach(function (line) {
      if (line.low) {
        [line.high, line.low].forEach(function (edge) {
          data.push(edge);
          series.push({ label: line.label + " 95 %", stroke: line.colour, width: 0.01, points: { show: false },
            value: function (u, v) { return short(v); } });
        });
        bands.push({ series: [series.length - 2, series.length - 1], fill: line.colour + "33" });
      }
      data.push(line.values);
      series.push({ label: line.label, stroke: line.colour, width: line.width, dash: line.dash,
        points: { show: false }, value: function (u, v) { return short(v); } });
    });
    var marks = panel.marks || [];
    return new uPlot({
      width: box.clientWidth || 800, height: 260, series: series, bands: bands,
      scales: { x: Object.assign({ time: false, range: function (u, low, high) { return [low, high]; } }, scale(panel.log_x)), y: scale(panel.log_y) },
      axes: [axis(panel.across), axis(panel.up)],
      cursor: { sync: { key: key }, drag: { x: true, y: false } },
      hooks: { draw: [function (u) {
        var c = u.ctx; c.save(); c.strokeStyle = "#222"; c.fillStyle = "#222"; c.setLineDash([2, 3]); c.font = "11px sans-serif"; c.textAlign = "left";
        marks.forEach(function (mark) {
          var at = u.valToPos(mark[0], "x", true);
          if (at < u.bbox.left || at > u.bbox.left + u.bbox.width) { return; }
          c.beginPath(); c.moveTo(at, u.bbox.top); c.lineTo(at, u.bbox.top + u.bbox.height); c.stroke();
          c.fillText(mark[1], at + 3, u.bbox.top + 11);
        });
        c.restore();
      }] }
    }, data, box);
  }
  document.querySelectorAll("figure.zoom").forEach(function (figure) {
    var panels = JSON.parse(figure.querySelector("script").textContent);
    var live = figure.querySelector(".live"), button = figure.querySelector("button"), plots = null, key = "k" + (sync += 1);
    button.hidden = false;
    button.addEventListener("click", function () {
      var on = figure.classList.toggle("on");
      button.textContent = on ? "Show the picture" : "Zoom into the numbers";
      if (on && !plots) {
        plots = panels.map(function (panel) {
          var box = document.createElement("div"); live.appendChild(box); return draw(panel, box, key);
        });
      }
    });
    window.addEventListener("resize", function () {
      (plots || []).forEach(function (plot) { plot.setSize({ width: live.clientWidth || 800, height: 260 }); });
    });
  });
})();
