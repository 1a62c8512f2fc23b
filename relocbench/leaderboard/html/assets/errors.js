/* Cumulative errors of trackers and pipelines; of trackers also what confidences are worth, and seconds against recall. */
"use strict";

(() => {
  const { escape, number, chart, css, curves, line, upright } = relocbench;
  const $ = (id) => document.getElementById(id);

  function drawErrors(page) {
    const { set, table, open, field, mark, unit, title } = page, sign = { m: " m", deg: "°" }[unit] ?? "", { traces, middle } = curves(page, field, sign);
    const finest = Math.max(0, ...table.tasks.map((name) => set.tasks[name][{ m: "finest_m", deg: "finest_deg" }[unit]] ?? 0));
    chart("curves", traces, {
      xaxis: { title: { text: title }, range: [0, Math.max(2 * mark, Math.min(10 * mark, middle))] }, yaxis: { title: { text: `share of all ${set.units}, %` }, range: [0, 101] },
      shapes: [{ type: "rect", x0: 0, x1: finest, y0: 0, y1: 1, yref: "paper", fillcolor: css("--line"), opacity: 0.5, layer: "below", line: { width: 0 } }, upright(mark)],
    }, (event) => { const [{ x, data: { meta } }] = event.points; open(meta, { field, value: x, words: `${number(x, unit)}${sign}` }); });
  }

  /** The share of wrong answers among the most confident ones. */
  function drawRisk({ set, own, shown, open }) {
    const [metres, degrees] = set.correct, competing = own.filter((label) => !set.methods[label].baseline && shown[label].some((row) => row.status === "ok"));
    chart("risk", competing.map((label) => {
      // Answers of one confidence are kept or dropped together; without a confidence an answer is the least sure.
      const sure = (row) => (Number.isNaN(row.confidence) ? -Infinity : row.confidence);
      const answered = shown[label].filter((row) => row.status === "ok").sort((a, b) => (sure(a) === sure(b) ? 0 : sure(b) - sure(a)));
      const x = [], y = []; let wrong = 0;
      answered.forEach((row, i) => {
        if (!(row.translation_error_m <= metres && row.rotation_error_deg <= degrees)) wrong++;
        if (i + 1 === answered.length || sure(answered[i + 1]) !== sure(row)) { x.push((100 * (i + 1)) / shown[label].length); y.push((100 * wrong) / (i + 1)); }
      });
      return line(label, { x, y, mode: x.length === 1 ? "markers" : "lines+markers", hovertemplate: `${escape(label)}<br>%{y:.1f} % wrong of %{x:.1f} %<extra></extra>` });
    }), { xaxis: { title: { text: "most confident answers, % of all pairs" }, range: [0, 101] }, yaxis: { title: { text: "wrong, %" }, range: [-1, 101] } }, (event) => open(event.points[0].data.meta));
  }

  function drawCost({ set, table, hidden, open }) {
    const known = table.rows.filter(({ method, values }) => !hidden.has(method) && values.median_seconds > 0 && values[set.ranking] !== null);
    chart("cost", known.map(({ method, values }) => line(method, { x: [values.median_seconds], y: [100 * values[set.ranking]], mode: "markers", hovertemplate: `${escape(method)}<br>%{y:.1f} %, %{x:.3f} s<extra></extra>` })),
      { xaxis: { title: { text: "median seconds a pair" }, type: "log" }, yaxis: { title: { text: `${escape(set.ranking)}, %` } } }, (event) => open(event.points[0].data.meta));
  }

  relocbench.parts.push((page) => {
    const [metres, degrees] = page.set.correct, what = $("choose-error").value;
    Object.assign(page, {
      both: { field: "both", mark: 1, unit: "", title: `error / threshold (${metres} m, ${degrees}°)` },
      translation: { field: "translation_error_m", mark: metres, unit: "m", title: "translation error, m" },
      rotation: { field: "rotation_error_deg", mark: degrees, unit: "deg", title: "rotation error, °" },
    }[what]);
    drawErrors(page);
    if ($("risk")) drawRisk(page);
    if ($("cost")) drawCost(page);
  });
})();
