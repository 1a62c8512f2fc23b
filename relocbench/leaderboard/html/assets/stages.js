/* What pipelines lose to each of their stages, and the seconds of both stages on one clock. */
"use strict";

(() => {
  const { escape, chart, css, mean } = relocbench;
  const $ = (id) => document.getElementById(id);

  /** The words and looks of each share: blue for what retrieval did, orange for tracking, with patterns for those who see no colours. */
  const PARTS = {
    right_and_hit: ["right", "--stage-right", ""], right_without_hit: ["right, from outside the basin", "--stage-right", "/"], failed_choice: ["lost to the choice", "--stage-choice", "x"],
    failed_unreachable: ["cannot be judged", "--stage-unknown", "."], failed_retrieval: ["lost to retrieval", "--stage-retrieval", ""], failed_tracking: ["lost to tracking", "--stage-tracking", "\\"],
  };

  /** Bars side by side for each method, as [[name, colour, pattern], {label: value}], the first label on top. */
  function stacked(id, labels, parts, axis, template, open) {
    const down = [...labels].reverse(), height = 110 + 30 * labels.length;
    $(id).style.minHeight = `${height}px`;
    chart(id, parts.map(([[name, colour, shape], values]) => ({
      type: "bar", orientation: "h", name, y: down.map(escape), x: down.map((label) => values[label] ?? null), meta: down,
      marker: { color: css(colour), pattern: { shape, fillmode: "overlay", fgcolor: css("--page"), size: 6 } },
      texttemplate: template, textposition: "inside", insidetextanchor: "middle", textangle: 0, textfont: { color: css("--stage-ink") },
      hovertemplate: `%{y}<br>${name}: ${template}<extra></extra>`,
    })), {
      barmode: "stack", height, showlegend: true, legend: { orientation: "h", traceorder: "normal", x: 0, y: 1.02, yanchor: "bottom", font: { size: 12 } },
      margin: { l: 8, r: 12, t: 12, b: 44 }, uniformtext: { minsize: 10, mode: "hide" }, xaxis: axis, yaxis: { type: "category", ticklabelstandoff: 6 },
    }, ({ points: [point] }) => open(point.data.meta[point.pointIndex]));
  }

  function drawLosses({ set, table, open }) {
    const complete = table.rows.filter((row) => !row.missing.length), lost = set.losses.filter((key) => complete.some((row) => row.values[key]));
    const parts = lost.map((key) => [PARTS[key], Object.fromEntries(complete.map((row) => [row.method, 100 * row.values[key]]))]);
    stacked("losses", complete.map((row) => row.method), parts, { title: { text: "share of all queries, %" }, range: [0, 100.5] }, "%{x:.1f}", open);
  }

  function drawClock({ set, own, shown, open }) {
    const retrieval = {}, tracking = {}, together = {};
    for (const label of own) {
      const split = shown[label].filter((row) => row.retrieval_seconds >= 0 && !Number.isNaN(row.seconds)), whole = mean(shown[label].map((row) => row.seconds).filter((seconds) => !Number.isNaN(seconds)));
      if (split.length) {
        retrieval[label] = mean(split.map((row) => row.retrieval_seconds));
        tracking[label] = mean(split.map((row) => Math.max(0, row.seconds - row.retrieval_seconds)));
      } else (set.methods[label].oracle ? tracking : together)[label] = whole;
    }
    const parts = [[["retrieval", "--stage-retrieval", ""], retrieval], [["tracking", "--stage-tracking", "\\"], tracking], [["both stages together", "--stage-unknown", "."], together]];
    const total = (label) => parts.reduce((sum, [, values]) => sum + (values[label] ?? 0), 0), known = own.filter((label) => parts.some(([, values]) => (values[label] ?? null) !== null));
    stacked("clock", known.sort((a, b) => total(a) - total(b)), parts.filter(([, values]) => Object.values(values).some((value) => value !== null)), { title: { text: "mean seconds a query" }, rangemode: "tozero" }, "%{x:.3f} s", open);
  }

  relocbench.parts.push((page) => { drawLosses(page); drawClock(page); });
})();
