/* The page of a dataset's pipelines: tables, where queries are lost, errors, seconds of both stages, and lists of queries. */
"use strict";

(async () => {
  const { escape, number, state, load, chart, heat, legend, hiddenLabels } = relocbench;
  const { $, option, text, numeric, rank, redraw, cell, named, notes, openList, answerColumn, cumulative, middle, curve, upright, stacked, chooseTable } = relocbench.boards;
  const site = relocbench.payload("site");
  const set = await load(`pipelines/${$("set").dataset.set}`);
  const labels = Object.keys(set.pipelines);
  const [metres, degrees] = set.right;
  const indexOf = Object.fromEntries(set.metrics.map((metric, index) => [metric.name, index]));
  const decoded = new Map();
  const current = chooseTable(set, () => { drawTables(); drawCharts(); });
  const hidden = hiddenLabels(labels, current(), (label) => set.pipelines[label].baseline);

  async function answersOf(name) {
    if (!decoded.has(name)) {
      const raw = await load(set.tasks[name].located), pipelines = {};
      for (const [label, c] of Object.entries(raw.pipelines)) {
        pipelines[label] = {
          t: c.translation_error_m, r: c.rotation_error_deg, confidence: c.confidence, seconds: c.seconds,
          retrieval: c.retrieval_seconds, status: c.status, outcome: c.outcome, rank: c.rank,
          hit: c.hit_rank, right: c.right_rank,
        };
      }
      decoded.set(name, { name, queries: raw.queries, pipelines });
    }
    return decoded.get(name);
  }
  const tasksOf = (names) => Promise.all(names.map(answersOf));

  /** As links.py says it. */
  const locatedLink = (row, label) => "located.html#" + Object.entries({ set: set.id, task: row.task, query: row.query, pipeline: label })
    .map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&");

  function queriesOf(tasks, label) {
    const out = [];
    for (const of of tasks) {
      const c = of.pipelines[label];
      if (!c) continue;
      for (let i = 0; i < of.queries.length; i++) {
        out.push({
          task: of.name, query: String(of.queries[i]), t: c.t[i], r: c.r[i], both: Math.max(c.t[i] / metres, c.r[i] / degrees),
          outcome: set.outcomes[c.outcome[i]], rank: Number(c.rank[i]), hit: Number(c.hit[i]), confidence: c.confidence[i], seconds: c.seconds[i],
          retrieval: c.retrieval ? c.retrieval[i] : NaN, status: site.statuses[c.status[i]],
        });
      }
    }
    return out;
  }

  const ranked = (value, type) => (type === "display" ? (value > 0 ? value : "none") : value > 0 ? value : 1e9);
  const lost = (outcome) => (outcome === "right" ? "right" : `lost to ${outcome}`);

  async function openQueries(label, names, where) {
    const rows = queriesOf(await tasksOf(names), label).sort((a, b) => (a.both === b.both ? 0 : b.both > a.both ? 1 : -1));
    openList(`${label}: ${where}, worst first`, rows, [
      { title: "task", data: "task", className: "text", render: text },
      { title: "query, ns", data: "query", render: (value, type, row) => (type === "display" ? `<a href="${escape(locatedLink(row, label))}">${escape(value)}</a>` : value) },
      { title: "outcome", data: "outcome", className: "text", render: (value) => escape(lost(value)) },
      { title: "translation error, m", data: "t", render: numeric("m") },
      { title: "rotation error, °", data: "r", render: numeric("deg") },
      { title: "rank kept", data: "rank", render: ranked },
      { title: "first in basin", data: "hit", render: ranked },
      { title: "confidence", data: "confidence", render: numeric("") },
      { title: "seconds", data: "seconds", render: numeric("s") },
      answerColumn,
    ]);
  }

  /** A pipeline by its two methods, which have pages, and how many keyframes are tried. */
  function pipelineName(label) {
    const { retriever, tracker, top, marks } = set.pipelines[label];
    return `${named(retriever, [])} + ${named(tracker, [])}, top ${top}${marks.map((mark) => ` <span class="tag">${escape(mark)}</span>`).join("")}`;
  }

  function drawTables() {
    const table = current(), opened = (event, row) => { if (event.target.closest("button.cell")) openQueries(row.method, table.tasks, table.title); };
    const head = [
      { title: "pipeline", data: "method", className: "text", render: (label, type) => (type === "display" ? pipelineName(label) : label) },
    ];
    const columns = (names) => names.map((name) => ({ title: relocbench.breakable(set.metrics[indexOf[name]].heading), data: null, ...relocbench.bestFirst(set.metrics[indexOf[name]].unit === "share" && !name.startsWith("failed_")), render: cell(set.metrics[indexOf[name]], indexOf[name], "Queries") }));
    const createdRow = (tr, row) => {
      if (set.pipelines[row.method].baseline) tr.classList.add("baseline");
      tr.addEventListener("click", (event) => opened(event, row));
    };
    redraw("methods", {
      data: table.rows, createdRow,
      columns: [...head, { title: "rank", data: "rank", className: "rank", ...relocbench.bestFirst(false), render: rank }, ...columns(set.shown), { title: "declined / crashed", data: (row) => (row.failed === null ? "" : `${row.failed} / ${row.broke}`) }],
    }, "methods");
    const stages = set.stages.filter((name) => !name.startsWith("failed_") || table.rows.some((row) => row.values[indexOf[name]]));
    redraw("stages", { data: table.rows, createdRow, first: head.length + 1 + stages.length, columns: [...head, { title: "basin_m / basin_deg", data: "basin", className: "text", render: text }, ...columns(stages)] }, "stages");
    notes("level", table.ranks);
    const missing = table.rows.filter((row) => row.missing.length).map((row) => `${row.method} on ${row.missing.join(", ")}`);
    const finest = table.tasks.map((name) => set.tasks[name].finest_m).filter((value) => value !== null && value > metres);
    $("about").textContent = `${table.tasks.length > 1 ? `Mean over ${table.tasks.length} tasks, each of which counts the same. ` : ""}${table.queries} queries.` + (missing.length ? ` Missing: ${missing.join("; ")}.` : "") + (finest.length ? ` The truth is too coarse for thresholds below ${number(Math.max(...finest), "m")} m.` : "");
  }

  /** The words and looks of each share: blue for what retrieval did, orange for tracking, with patterns for those who see no colours. */
  const PARTS = {
    right_and_hit: ["right", "--stage-right", ""], right_without_hit: ["right, from outside the basin", "--stage-right", "/"], failed_choice: ["lost to the choice", "--stage-choice", "x"],
    failed_unreachable: ["cannot be judged", "--stage-unknown", "."], failed_retrieval: ["lost to retrieval", "--stage-retrieval", ""], failed_tracking: ["lost to tracking", "--stage-tracking", "\\"],
  };
  const colour = (name) => relocbench.css(name);
  const ink = () => colour("--stage-ink");

  function drawLosses(table) {
    const complete = table.rows.filter((row) => !row.missing.length);
    const parts = set.losses.filter((name) => complete.some((row) => row.values[indexOf[name]])).map((name) => ({
      name: PARTS[name]?.[0] ?? name, colour: colour(PARTS[name]?.[1] ?? "--muted"), pattern: PARTS[name]?.[2] ?? "", ink: ink(),
      values: Object.fromEntries(complete.map((row) => [row.method, 100 * row.values[indexOf[name]]])),
    }));
    $("losses-about").textContent = `Right is within ${metres} m and ${degrees}°. Of the others, retrieval loses those with none of the K keyframes in the basin, from where the tracker can be expected to find the pose; tracking those with one in it and no right answer; the choice those with a right answer and a more confident wrong one.`;
    stacked("losses", complete.map((row) => row.method), parts, { xaxis: { title: { text: "share of all queries, %" }, range: [0, 100.5] } }, "%{x:.1f}", (label) => openQueries(label, table.tasks, table.title));
  }

  function drawClock(table, tasks) {
    const own = labels.filter((label) => tasks.every((of) => of.pipelines[label]));
    const mean = (values) => { const known = values.filter((v) => !Number.isNaN(v)); return known.length ? known.reduce((s, v) => s + v, 0) / known.length : null; };
    const retrieval = {}, tracking = {}, together = {};
    for (const label of own) {
      const rows = queriesOf(tasks, label), { retriever, tracker } = set.pipelines[label];
      const split = rows.filter((row) => !Number.isNaN(row.retrieval) && !Number.isNaN(row.seconds));
      if (split.length) {
        retrieval[label] = mean(split.map((row) => row.retrieval));
        tracking[label] = mean(split.map((row) => Math.max(0, row.seconds - row.retrieval)));
      } else if (set.pipelines[label].oracle) tracking[label] = mean(rows.map((row) => row.seconds));
      else together[label] = mean(rows.map((row) => row.seconds));
    }
    const known = own.filter((label) => (retrieval[label] ?? tracking[label] ?? together[label] ?? null) !== null);
    const total = (label) => (retrieval[label] ?? 0) + (tracking[label] ?? 0) + (together[label] ?? 0);
    known.sort((a, b) => total(a) - total(b));
    const parts = [["retrieval", "--stage-retrieval", "", retrieval], ["tracking", "--stage-tracking", "\\", tracking], ["both stages together", "--stage-unknown", ".", together]]
      .filter(([, , , values]) => Object.values(values).some((value) => value !== null)).map(([name, key, pattern, values]) => ({ name, colour: colour(key), pattern, ink: ink(), values }));
    stacked("clock", known, parts, { xaxis: { title: { text: "mean seconds a query" }, rangemode: "tozero" } }, "%{x:.3f} s", (label) => openQueries(label, table.tasks, table.title));
  }

  async function drawCharts() {
    const table = current();
    drawLosses(table);
    const tasks = await tasksOf(table.tasks);
    if (table !== current()) return;
    const own = labels.filter((label) => !hidden.has(label) && tasks.every((of) => of.pipelines[label]));
    const what = $("choose-error").value, field = { both: "both", translation: "t", rotation: "r" }[what], limits = [];
    const curves = own.map((label) => {
      const found = cumulative(queriesOf(tasks, label).map((row) => row[field]));
      if (found.most !== null && !set.pipelines[label].baseline) limits.push(found.most);
      return curve(label, found, { both: "", translation: " m", rotation: "°" }[what]);
    });
    const mark = { both: 1, translation: metres, rotation: degrees }[what];
    const title = { both: `error / threshold (${metres} m, ${degrees}°)`, translation: "translation error, m", rotation: "rotation error, °" }[what];
    chart("curves", curves, {
      xaxis: { title: { text: title }, range: [0, Math.max(2 * mark, Math.min(10 * mark, middle(limits)))] }, yaxis: { title: { text: "share of all queries, %" }, range: [0, 101] }, shapes: [upright(mark)],
    }, (event) => { const label = event.points[0].data.meta; openQueries(label, table.tasks, table.title); });
    drawClock(table, tasks);
    drawHeat();
  }

  function drawHeat() {
    const names = current().tasks.filter((name) => set.tasks[name].has_conditions);
    $("heat-section").hidden = !names.length;
    if (!names.length) return;
    const a = $("heat-a").value, b = $("heat-b").value, same = (x, y) => set.tasks[x].gallery === set.tasks[y].gallery && set.tasks[x].query === set.tasks[y].query;
    heat("heat", names.map((name) => ({
      row: set.tasks[name].gallery, column: set.tasks[name].query,
      value: (label) => set.tables.find((table) => table.tasks.length === 1 && table.tasks[0] === name)?.rows.find((row) => row.method === label)?.values[indexOf[set.ranking]] ?? null,
      open: () => openQueries(a, names.filter((other) => same(name, other)), `${set.tasks[name].gallery} ← ${set.tasks[name].query}`),
    })), a, b, ["query", "map"]);
  }

  const competing = (label) => !set.pipelines[label].baseline && !set.pipelines[label].oracle;
  const chosen = labels.includes(state.get("method")) ? state.get("method") : current().rows.map((row) => row.method).find(competing) || labels[0];
  $("heat-a").replaceChildren(...labels.map((l) => option(l, l, chosen)));
  $("heat-b").replaceChildren(option("", "none", ""), ...labels.map((l) => option(l, l, state.get("less"))));
  $("choose-error").value = ["translation", "rotation"].includes(state.get("error")) ? state.get("error") : "both";
  $("choose-error").addEventListener("change", () => { state.set({ error: $("choose-error").value }); drawCharts(); });
  for (const [id, key] of [["heat-a", "method"], ["heat-b", "less"]]) $(id).addEventListener("change", () => { state.set({ [key]: $(id).value }); drawHeat(); });
  const drawLegend = () => legend(labels, hidden, drawCharts);
  document.addEventListener("relocbench-theme", () => { drawLegend(); drawCharts(); });
  drawTables();
  drawLegend();
  await drawCharts();
  if (state.get("queries")) openQueries(chosen, current().tasks, current().title);
})();
