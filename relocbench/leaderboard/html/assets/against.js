/* Errors against time, distance, angle and months: points, and the running median of each method. */
"use strict";

(() => {
  const { escape, number, chart, evenly, pairText, openPair, keys, css, line } = relocbench;
  const $ = (id) => document.getElementById(id);
  const MOST_POINTS = 300, MOST_PAIRS = 5000, MOST_SVG = 1500, PLACES = 40, FEW = 6;
  const UNITS_OF_TIME = [["days", 86400], ["h", 3600], ["min", 60]];
  const MONTH_NS = 30.4375 * 86400e9;

  /** Medians of y over windows of an eighth of the pairs, which are ordered by x; over each x where there are few of them. */
  function runningMedian(xs, ys) {
    const median = (values) => { const sorted = [...values].sort((a, b) => a - b); return sorted[(sorted.length - 1) >> 1]; };
    const distinct = [...new Set(xs)];
    if (distinct.length <= FEW && xs.length >= 2 * distinct.length) return distinct.map((x) => [x, median(ys.filter((_, i) => xs[i] === x))]);
    const width = Math.max(5, Math.ceil(xs.length / 8)), places = Math.min(PLACES, xs.length - width + 1);
    const found = Array.from({ length: Math.max(0, places) }, (_, k) => {
      const from = places === 1 ? 0 : Math.round((k * (xs.length - width)) / (places - 1));
      return [xs[from + (width >> 1)], median(ys.slice(from, from + width))];
    });
    return found.filter(([x], k) => !k || x !== found[k - 1][0]); // one value at one x
  }

  /** Draw one chart; `place` gives the x of a pair, NaN where there is none. Points of a few values of x are spread. */
  function draw(page, id, place, axis, words, spread = 0) {
    chart(id, () => {
      const { own, shown, field, mark, unit, title, pairLink } = page;
      const drawn = own.reduce((sum, label) => sum + Math.min(MOST_POINTS, shown[label].length), 0), type = drawn > MOST_SVG ? "scattergl" : "scatter";
      const traces = [], least = page.field === "both" ? 1e-3 : 1e-4;
      for (const label of own) {
        const pairs = evenly(shown[label].filter((pair) => Number.isFinite(place(pair))), MOST_PAIRS);
        if (!pairs.length) continue;
        const order = pairs.map((pair) => [place(pair), pair]).sort((a, b) => a[0] - b[0]);
        const points = evenly(order.filter(([, pair]) => Number.isFinite(pair[field])), MOST_POINTS);
        const aside = (i) => spread * (((i * 0.618034) % 1) - 0.5);
        const look = line(label, {});
        traces.push({
          ...look, x: points.map(([x], i) => x + aside(i)), y: points.map(([, pair]) => Math.max(pair[field], least)), mode: "markers", type,
          marker: { ...look.marker, maxdisplayed: 0, size: 5, opacity: own.length > 6 ? 0.4 : 0.55 }, customdata: points.map(([, pair]) => pairLink(pair, label)),
          text: points.map(([x, pair]) => `${words}: ${number(x, "m")}<br>${pairText(pair)}`), hovertemplate: `${escape(label)}<br>%{text}<extra></extra>`,
        });
        const middle = runningMedian(order.map(([x]) => x), order.map(([, pair]) => pair[field]));
        traces.push({
          ...look, x: middle.map(([x]) => x), y: middle.map(([, y]) => (Number.isFinite(y) ? Math.max(y, least) : null)), mode: spread ? "lines+markers" : "lines", type: "scatter",
          line: { ...look.line, width: 2.5 }, hovertemplate: `${escape(label)}<br>median %{y:.3f}<extra></extra>`,
        });
      }
      return [traces, {
        xaxis: { title: { text: axis } }, yaxis: { title: { text: title }, type: "log", nticks: 6 },
        shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: mark, y1: mark, line: { color: css("--line-strong"), dash: "dot", width: 1.5 } }],
        annotations: [{ xref: "paper", x: 1, xanchor: "right", y: Math.log10(mark), yanchor: "bottom", showarrow: false, text: unit ? `threshold ${mark}${{ m: " m", deg: "°" }[unit]}` : "thresholds", font: { size: 11, color: css("--muted") } }],
      }, (event) => { const [point] = event.points; if (point.customdata) openPair(point.customdata, event.event); }];
    });
  }

  function drawMonths(page) {
    const { own, shown } = page, facts = page.extra.months, sets = page.tasks.map((of) => of.name);
    const by = (how) => sets.filter((name) => facts[name]?.by === how);
    const told = [];
    if (by("dates").length) told.push(`By the dates of both images${by("seasons").length ? `: ${by("dates").join(", ")}` : ""}.`);
    if (by("seasons").length) told.push(`By the seasons of both drives, of which neighbours count as 3 months apart${by("dates").length ? `: ${by("seasons").join(", ")}` : ""}.`);
    if (by("drive").length && by("drive").length === sets.length) told.push("Both images of every pair are of one drive, so that no months lie between them.");
    const unknown = sets.filter((name) => !facts[name]?.by);
    if (unknown.length) told.push(`Not recorded: neither dates nor seasons of ${unknown.length === sets.length ? "these drives" : unknown.join(", ")}.`);
    const place = (pair) => {
      const fact = facts[pair.task];
      if (!fact?.by) return NaN;
      return fact.by === "dates" ? Math.abs(Number(pair.query - pair.reference)) / MONTH_NS : fact.months;
    };
    const largest = Math.max(0, ...own.map((label) => shown[label].reduce((most, pair) => Math.max(most, place(pair) || 0), 0)));
    if (by("dates").length && !by("seasons").length && largest < 0.5) told.push(`The images of a pair lie at most ${Math.max(1, Math.ceil(30.4375 * largest))} d apart.`);
    $("months-about").textContent = told.join(" ");
    const known = largest >= 0.5 || by("seasons").length > 0;
    $("months-panel").hidden = !known;
    if (known) draw(page, "months", place, "months between the images", "months", by("dates").length ? 0 : 0.5);
  }

  relocbench.parts.push((page) => {
    const { own, shown, tasks } = page;
    const unanswered = own.map((label) => [label, shown[label].filter((p) => !Number.isFinite(p.translation_error_m)).length, shown[label].length]).filter(([, n]) => n);
    $("undrawn").textContent = `Lines are running medians over an eighth of a method's pairs, where a pair without an answer counts as an infinite error: they end where most have none. Of a method at most ${MOST_POINTS} points are drawn, and a click on one opens its pair; the dotted line is the threshold.`
      + (unanswered.length ? ` Pairs without an answer have no point: ${unanswered.map(([label, n, all]) => `${label} ${n} of ${all}`).join(", ")}.` : "");
    const starts = new Map(tasks.map(({ name, units: { query } }) => [name, query.reduce((first, time) => (time < first ? time : first), query[0])]));
    const since = (p) => Number(p.query - starts.get(p.task)) / 1e9;
    const span = tasks.reduce((most, of) => of.units.query.reduce((longest, time) => Math.max(longest, Number(time - starts.get(of.name)) / 1e9), most), 0);
    const [unit, seconds] = UNITS_OF_TIME.find(([, each]) => span >= 3 * each) || ["s", 1];
    draw(page, "route", (p) => since(p) / seconds, `time since the first query, ${unit}`, unit);
    draw(page, "distance", (p) => p.distance_m, "distance of the cameras, m", "m");
    draw(page, "angle", (p) => p.angle_deg, "angle between the cameras, °", "°");
    drawMonths(page);
    keys("against-keys", own.filter((label) => shown[label].length));
  });
})();
