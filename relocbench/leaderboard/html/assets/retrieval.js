/* The page of a retrieval set: the table, the curves, the map of conditions, and lists of queries. */
"use strict";

(async () => {
  const { escape, number, state, load, chart, heat, legend, hiddenLabels } = relocbench;
  const { shortName, $, option, text, numeric, rank, redraw, cell, named, notes, openList, answerColumn, line, aside, cumulative, curve, upright, chooseTable } = relocbench.boards;
  const site = relocbench.payload("site");
  const set = await load(`retrieval/${$("set").dataset.set}`);
  const labels = Object.keys(set.methods);
  const ranking = set.metrics.findIndex((metric) => metric.name === set.ranking);
  const decoded = new Map();
  const current = chooseTable(set, () => { drawTable(); drawCharts(); });
  const hidden = hiddenLabels(labels, current(), (label) => set.methods[label].baseline);

  /** The ranks of a task, decoded once: of each query the rank of its first right image, Infinity for none. */
  async function ranksOf(name) {
    if (!decoded.has(name)) {
      const raw = await load(set.tasks[name].ranks), methods = {};
      for (const [label, m] of Object.entries(raw.methods)) {
        const first = Float64Array.from(m.first, (value) => (value > 0n ? Number(value) : Infinity));
        methods[label] = { first, sorted: first.filter(Number.isFinite).sort(), status: m.status, seconds: m.seconds, distance: m.distance_m, depth: m.depth };
      }
      decoded.set(name, { name, queries: raw.queries, groups: raw.groups, positives: raw.positives, gallery: raw.gallery, chance: raw.chance, nearest: raw.nearest_m, methods });
    }
    return decoded.get(name);
  }
  const tasksOf = (names) => Promise.all(names.map(ranksOf));

  /** As links.py says it. */
  const queryLink = (row, label) => "query.html#" + Object.entries({ set: set.id, task: row.task, query: row.query, method: label })
    .map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&");

  function queriesOf(tasks, label) {
    const out = [];
    for (const of of tasks) {
      const m = of.methods[label];
      if (!m) continue;
      of.queries.forEach((query, i) => out.push({
        task: of.name, query, group: of.groups ? of.groups[i] : "", first: m.first[i], positives: Number(of.positives[i]),
        distance: m.distance ? m.distance[i] : NaN, seconds: m.seconds[i], status: site.statuses[m.status[i]],
      }));
    }
    return out.sort((a, b) => (a.first === b.first ? 0 : b.first > a.first ? 1 : -1));
  }

  async function openQueries(label, names, where) {
    const tasks = await tasksOf(names), rows = queriesOf(tasks, label);
    openList(`${label}: ${where}, worst first`, rows, [
      { title: "task", data: "task", className: "text", render: text },
      { title: "query", data: "query", className: "text", render: (value, type, row) => (type === "display" ? `<a href="${escape(queryLink(row, label))}" title="${escape(value)}">${escape(shortName(value))}</a>` : value) },
      ...(rows.some((row) => row.group) ? [{ title: "place", data: "group", className: "text", render: text }] : []),
      { title: "first right rank", data: "first", render: (value, type) => (type === "display" ? (Number.isFinite(value) ? value : "none") : Number.isFinite(value) ? value : 1e9) },
      { title: "right images", data: "positives" },
      ...(rows.some((row) => !Number.isNaN(row.distance)) ? [{ title: "first keyframe, m", data: "distance", render: numeric("m") }] : []),
      { title: "seconds", data: "seconds", render: numeric("s") },
      answerColumn,
    ]);
  }

  function drawTable() {
    const table = current();
    const chance = { method: "(chance)", chance: true, rank: null, values: table.chance, intervals: {}, seconds: null, failed: null, broke: null, rescored: "", missing: [] };
    redraw("methods", {
      data: [...table.rows, chance],
      columns: [
        { title: "method", data: "method", className: "text", render: (label, type) => (type === "display" ? named(label, set.methods[label]?.marks ?? []) : label) },
        { title: "rank", data: "rank", className: "rank", ...relocbench.bestFirst(false), render: rank },
        ...set.metrics.map((metric, index) => ({ title: relocbench.breakable(metric.heading), data: null, ...relocbench.bestFirst(true), render: cell(metric, index, "Queries") })),
        { title: "median_seconds", data: "seconds", render: numeric("s") },
        { title: "declined / crashed", data: (row) => (row.failed === null ? "" : `${row.failed} / ${row.broke}`) },
        { title: "rescored", data: "rescored", className: "text", render: text },
      ],
      createdRow: (tr, row) => {
        if (row.chance || set.methods[row.method].baseline) tr.classList.add("baseline");
        tr.addEventListener("click", (event) => { if (event.target.closest("button.cell")) openQueries(row.method, table.tasks, table.title); });
      },
    }, "methods");
    const several = table.tasks.length > 1 ? `Mean over ${table.tasks.length} tasks. ` : `${set.tasks[table.tasks[0]].direction}. `;
    const without = table.without_positives ? ` ${table.without_positives} queries have no right image in the gallery, and count as not found.` : "";
    const missing = table.rows.filter((row) => row.missing.length).map((row) => `${row.method} on ${row.missing.join(", ")}`);
    $("about").textContent = `${several}${table.queries} queries, ${table.gallery} images in the galler${table.tasks.length > 1 ? "ies" : "y"}.${without}${missing.length ? ` Missing: ${missing.join("; ")}.` : ""}`;
    notes("level", table.ranks, table.at_chance.length ? `No significant gain over chance: ${table.at_chance.join(", ")}` : "");
  }

  /** How many of ascending values are at most x. */
  function atMost(sorted, x) {
    let low = 0, high = sorted.length;
    while (low < high) { const mid = (low + high) >> 1; if (sorted[mid] <= x) low = mid + 1; else high = mid; }
    return low;
  }

  /** Numbers of images up to a size: all of a small gallery, else some four hundred, evenly by factors. */
  function depths(most) {
    const all = new Set([1, most]);
    for (let i = 0; i <= 400; i++) all.add(Math.round(most ** (i / 400)));
    return [...all].filter((k) => k >= 1 && k <= most).sort((a, b) => a - b);
  }

  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

  function interpolated([at, values], k) {
    const right = at.findIndex((depth) => depth >= k);
    if (right < 0) return values.at(-1);
    if (right === 0) return values[0];
    const share = Math.log(k / at[right - 1]) / Math.log(at[right] / at[right - 1]);
    return values[right - 1] + share * (values[right] - values[right - 1]);
  }

  async function drawCharts() {
    const table = current(), tasks = await tasksOf(table.tasks);
    if (table !== current()) return;
    const own = labels.filter((label) => !hidden.has(label) && tasks.every((of) => of.methods[label]));
    const open = (event) => { const label = event.points[0].data.meta; if (label) openQueries(label, table.tasks, table.title); };
    const largest = Math.max(1, ...tasks.map((of) => of.gallery));
    const curves = own.map((label) => {
      const limits = tasks.map((of) => of.methods[label].depth).filter((depth) => depth !== null);
      const x = depths(Math.max(1, limits.length ? Math.min(...limits) : largest));
      const y = x.map((k) => 100 * mean(tasks.map((of) => atMost(of.methods[label].sorted, k) / of.queries.length)));
      return line(label, { x, y, mode: "lines+markers", hovertemplate: `${escape(label)}<br>%{y:.1f} % among the first %{x}<extra></extra>` });
    });
    const ks = depths(largest);
    curves.push(aside("chance", ks, ks.map((k) => 100 * mean(tasks.map((of) => interpolated(of.chance, k)))), "chance<br>%{y:.1f} % among the first %{x}<extra></extra>"));
    const marks = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000, 100000].filter((k) => k <= largest);
    chart("recall", curves, {
      xaxis: { title: { text: "number of images K" }, type: "log", tickvals: marks, ticktext: marks.map(String), range: [-0.02, Math.log10(largest) + 0.02] },
      yaxis: { title: { text: "share of all queries, %" }, range: [0, 101] },
    }, open);
    drawDistances(table, tasks, own, open);
    drawHeat();
  }

  function drawDistances(table, tasks, own, open) {
    const known = tasks.every((of) => of.nearest);
    $("distance-section").hidden = !known;
    if (!known) return;
    const limits = [], curves = own.map((label) => {
      const found = cumulative(tasks.flatMap((of) => [...of.methods[label].distance].map((v) => (Number.isNaN(v) ? Infinity : v))));
      if (found.most !== null && !set.methods[label].baseline) limits.push(found.most);
      return curve(label, found, " m");
    });
    const nearest = cumulative(tasks.flatMap((of) => [...of.nearest]));
    curves.push({ ...aside("nearest keyframe", nearest.x, nearest.y, "nearest keyframe<br>%{y:.1f} % at most %{x:.2f} m<extra></extra>"), line: { color: relocbench.css("--muted"), dash: "2px,3px", width: 1.5, shape: "hv" } });
    const most = 1.5 * Math.max(1, ...limits), limit = set.radius_m && set.radius_m < 3 * most ? Math.max(1.1 * set.radius_m, most) : most;
    chart("distance", curves, {
      xaxis: { title: { text: "distance of the first keyframe, m" }, range: [0, limit] }, yaxis: { title: { text: "share of all queries, %" }, range: [0, 101] },
      shapes: set.radius_m ? [upright(set.radius_m)] : [],
    }, open);
  }

  function drawHeat() {
    const inTable = current().tasks, whole = (name) => name.slice(0, Math.max(0, name.lastIndexOf("__")));
    const names = Object.keys(set.tasks).filter((name) => inTable.includes(name) || inTable.includes(whole(name)));
    const shown = names.filter((name) => set.tasks[name].has_conditions && !names.some((part) => whole(part) === name));
    $("heat-section").hidden = !shown.length;
    if (!shown.length) return;
    const a = $("heat-a").value, b = $("heat-b").value;
    heat("heat", shown.map((name) => ({
      row: set.tasks[name].gallery, column: set.tasks[name].query,
      value: (label) => set.tables.find((table) => table.tasks.length === 1 && table.tasks[0] === name)?.rows.find((row) => row.method === label)?.values[ranking] ?? null,
      open: () => openQueries(a, shown.filter((other) => set.tasks[other].gallery === set.tasks[name].gallery && set.tasks[other].query === set.tasks[name].query), `${set.tasks[name].gallery} ← ${set.tasks[name].query}`),
    })), a, b, ["query", "gallery"]);
  }

  const chosen = labels.includes(state.get("method")) ? state.get("method") : current().rows.map((row) => row.method).find((l) => !set.methods[l].baseline) || labels[0];
  $("heat-a").replaceChildren(...labels.map((l) => option(l, l, chosen)));
  $("heat-b").replaceChildren(option("", "none", ""), ...labels.map((l) => option(l, l, state.get("less"))));
  for (const [id, key] of [["heat-a", "method"], ["heat-b", "less"]]) $(id).addEventListener("change", () => { state.set({ [key]: $(id).value }); drawHeat(); });
  const drawLegend = () => legend(labels, hidden, drawCharts);
  document.addEventListener("relocbench-theme", () => { drawLegend(); drawCharts(); });
  drawTable();
  drawLegend();
  await drawCharts();
  if (state.get("queries")) openQueries(chosen, current().tasks, current().title);
})();
