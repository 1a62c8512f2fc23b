/* The recall of retrievers by the number of images, and the distance of the first keyframe. */
"use strict";

(() => {
  const { escape, chart, line, aside, curves, cumulative, mean, upright } = relocbench;
  const $ = (id) => document.getElementById(id);
  const MARKS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000, 100000];

  /** Numbers of images up to a size: all of a small gallery, else some four hundred, evenly by factors. */
  function depths(most) {
    const all = new Set([1, most]);
    for (let i = 0; i <= 400; i++) all.add(Math.round(most ** (i / 400)));
    return [...all].filter((k) => k >= 1 && k <= most).sort((a, b) => a - b);
  }

  /** The share of all queries whose first right image is among the first k, for ascending k. */
  function reached(first, ks) {
    const sorted = Float64Array.from(first).sort();
    let count = 0;
    return ks.map((k) => { while (count < sorted.length && sorted[count] <= k) count++; return count / sorted.length; });
  }

  function interpolated([at, values], k) {
    const right = at.findIndex((depth) => depth >= k);
    if (right < 0) return values.at(-1);
    if (right === 0) return values[0];
    const share = Math.log(k / at[right - 1]) / Math.log(at[right] / at[right - 1]);
    return values[right - 1] + share * (values[right] - values[right - 1]);
  }

  function drawRecall({ tasks, own, open }) {
    const largest = Math.max(1, ...tasks.map((of) => of.gallery)), ks = depths(largest);
    const traces = own.map((label) => {
      const limits = tasks.map((of) => of.methods[label].depth).filter((depth) => depth !== null);
      const x = depths(Math.max(1, limits.length ? Math.min(...limits) : largest)), shares = tasks.map((of) => reached(of.methods[label].first, x));
      return line(label, { x, y: x.map((_, i) => 100 * mean(shares.map((of) => of[i]))), mode: "lines+markers", hovertemplate: `${escape(label)}<br>%{y:.1f} % among the first %{x}<extra></extra>` });
    });
    traces.push(aside("chance", ks, ks.map((k) => 100 * mean(tasks.map((of) => interpolated(of.chance, k)))), "chance<br>%{y:.1f} % among the first %{x}<extra></extra>"));
    const marks = MARKS.filter((k) => k <= largest);
    chart("recall", traces, {
      xaxis: { title: { text: "number of images K" }, type: "log", tickvals: marks, ticktext: marks.map(String), range: [-0.02, Math.log10(largest) + 0.02] },
      yaxis: { title: { text: "share of all queries, %" }, range: [0, 101] },
    }, open);
  }

  function drawDistances(page, open) {
    const { set, tasks } = page, known = tasks.every((of) => of.nearest_m);
    $("distance-section").hidden = !known;
    if (!known) return;
    const { traces, middle } = curves(page, "distance_m", " m"), nearest = cumulative(tasks.flatMap((of) => [...of.nearest_m]));
    const most = 1.5 * Math.max(1, middle), limit = set.radius_m && set.radius_m < 3 * most ? Math.max(1.1 * set.radius_m, most) : most;
    chart("distance", [...traces, aside("nearest keyframe", nearest.x, nearest.y, "nearest keyframe<br>%{y:.1f} % at most %{x:.2f} m<extra></extra>", "hv")], {
      xaxis: { title: { text: "distance of the first keyframe, m" }, range: [0, limit] }, yaxis: { title: { text: "share of all queries, %" }, range: [0, 101] },
      shapes: set.radius_m ? [upright(set.radius_m)] : [],
    }, open);
  }

  relocbench.parts.push((page) => {
    const open = (event) => { const label = event.points[0].data.meta; if (label) page.open(label); };
    drawRecall({ ...page, open });
    drawDistances(page, open);
  });
})();
