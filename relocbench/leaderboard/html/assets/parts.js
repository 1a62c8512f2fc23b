/* What the charts of a board share that stand in scripts of their own. Each puts a function into relocbench.parts, which the
   page calls with what is chosen after each change. */
"use strict";

relocbench.parts = [];

/** At most `most` of some items, evenly taken from their order. */
relocbench.evenly = (items, most) => {
  const count = Math.min(items.length, most);
  return Array.from({ length: count }, (_, i) => items[Math.floor((i * items.length) / count)]);
};

/** What stands beside a point that is a pair. */
relocbench.pairText = (pair) => {
  const { escape, number } = relocbench;
  const error = pair.status === "ok" ? `${number(pair.translation_error_m, "m")} m, ${number(pair.rotation_error_deg, "deg")}°` : relocbench.STATUS[pair.status];
  return `${error}<br>${escape(pair.task)}<br>${number(pair.distance_m, "m")} m and ${number(pair.angle_deg, "deg")}° from the keyframe`;
};

/** A click on a point opens its pair; with a key for new tabs, in one. */
relocbench.openPair = (address, event) => {
  if (event?.ctrlKey || event?.metaKey) window.open(address);
  else location.href = address;
};

/** The line of a method as Plotly takes it. */
relocbench.line = (label, more) => {
  const { colour, dash, marker } = relocbench.look(label);
  return { name: relocbench.escape(label), meta: label, type: "scatter", line: { color: colour, dash, width: 2 }, marker: { color: colour, symbol: marker, size: 6, maxdisplayed: 8 }, ...more };
};

/** A grey curve that belongs to no method. */
relocbench.aside = (name, x, y, hover, shape = "linear") => ({ name, x, y, mode: "lines", type: "scatter", line: { color: relocbench.css("--muted"), dash: "2px,3px", width: 1.5, shape }, hovertemplate: hover });

/** The curve of the share of values that are at most x, in percent; infinite values count and are never reached. */
relocbench.cumulative = (values) => {
  const sorted = Float64Array.from(values).sort();
  const finite = sorted.findLastIndex((v) => Number.isFinite(v)) + 1;
  const step = Math.max(1, Math.floor(finite / 800)), x = [0], y = [0];
  for (let i = 0; i < finite; i += step) { x.push(sorted[i]); y.push((100 * (i + 1)) / sorted.length); }
  const last = finite ? sorted[finite - 1] : 0, reached = (100 * finite) / (sorted.length || 1);
  x.push(last, Math.max(last, 1e9)); y.push(reached, reached);
  return { x, y, most: finite ? sorted[Math.floor(0.8 * finite)] : null };
};

/** The cumulative curves of methods, and the middle of what four fifths of each stay below, without trivial baselines. */
relocbench.curves = ({ set, own, shown }, field, unit) => {
  const limits = [], traces = own.filter((label) => shown[label].length).map((label) => {
    const { x, y, most } = relocbench.cumulative(shown[label].map((row) => row[field]));
    if (most !== null && !set.methods[label].baseline) limits.push(most);
    const plain = relocbench.line(label);
    return { ...plain, x, y, line: { ...plain.line, shape: "hv" }, mode: "lines+markers", hovertemplate: `${plain.name}<br>%{y:.1f} % at most %{x:.3f}${unit}<extra></extra>` };
  });
  return { traces, middle: limits.sort((a, b) => a - b)[limits.length >> 1] ?? 0 };
};

relocbench.upright = (x) => ({ type: "line", x0: x, x1: x, yref: "paper", y0: 0, y1: 1, line: { color: relocbench.css("--line-strong"), dash: "dot", width: 1 } });
