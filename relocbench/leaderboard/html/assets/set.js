/* The page of a set: the table, the charts of what is chosen, and lists of pairs. Other scripts add charts of their own to
   relocbench.parts: functions of what is chosen, called after each change. */
"use strict";

(async () => {
  const { element, escape, number, state, load, look, chart, heat, legend, hiddenLabels } = relocbench;
  const $ = (id) => document.getElementById(id);
  const site = relocbench.payload("site");
  const set = await load(`sets/${$("set").dataset.set}`);
  const [metres, degrees] = site.correct;
  const ranking = set.metrics.findIndex((metric) => metric.name === set.ranking);
  const seconds = set.metrics.length - 1;
  const labels = Object.keys(set.methods);
  const decoded = new Map();
  const extra = load(`charts/${set.id}`);
  let shown = null;

  const option = (value, text, chosen) => element("option", { value, selected: value === chosen }, text);
  const titles = [...new Set(set.tables.map((table) => table.title))];

  function current() {
    const title = $("choose-table").value, group = $("choose-group").value;
    return set.tables.find((t) => t.title === title && t.group === group) || set.tables.find((t) => t.title === title);
  }

  /** The arrays of a pair set, decoded once. */
  async function errorsOf(name) {
    if (!decoded.has(name)) {
      const raw = await load(set.pair_sets[name].key);
      const methods = {};
      for (const [label, m] of Object.entries(raw.methods)) {
        methods[label] = {
          t: m.translation_error_m, r: m.rotation_error_deg,
          confidence: m.confidence, seconds: m.seconds, status: m.status,
        };
      }
      decoded.set(name, {
        name, pairs: raw.pairs, reference: raw.reference, query: raw.query, groups: raw.groups,
        group: raw.group, distance: raw.distance_m, angle: raw.angle_deg, methods,
      });
    }
    return decoded.get(name);
  }

  /** The pairs of a table as a method answered them. */
  function pairsOf(sets, table, label) {
    const out = [];
    for (const of of sets) {
      const m = of.methods[label];
      if (!m) continue;
      for (let i = 0; i < of.pairs; i++) {
        if (table.group !== "all" && of.groups[of.group[i]] !== table.group) continue;
        out.push({
          set: of.name, row: i, reference: of.reference[i], query: of.query[i], t: m.t[i], r: m.r[i],
          both: Math.max(m.t[i] / metres, m.r[i] / degrees), confidence: m.confidence[i], seconds: m.seconds[i],
          status: site.statuses[m.status[i]], distance: of.distance[i], angle: of.angle[i],
        });
      }
    }
    return out;
  }

  /** The link to a pair as links.py says it, with the thresholds of the list it stands in where they are not the usual ones. */
  const pairLink = (pair, label, [m, deg] = [metres, degrees]) => "pair.html#" + Object.entries({
    set: set.id, pairset: pair.set, pair: `${pair.reference}-${pair.query}`, method: label, ...(m === metres && deg === degrees ? {} : { within: `${m},${deg}` }),
  }).map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&");

  /** List pairs of a method. A limit {field, value, words} splits them into those within it, which come first, and others. */
  function openPairs(label, pairs, where, limit = null, thresholds = [metres, degrees]) {
    const within = limit ? pairs.filter((pair) => pair[limit.field] <= limit.value) : pairs;
    const parts = limit && within.length < pairs.length
      ? [[`at most ${limit.words}`, within], ["above", pairs.filter((pair) => !(pair[limit.field] <= limit.value))], ["all", pairs]] : [];
    $("pairs-part").replaceChildren(...parts.map(([words, some], i) => element("button", {
      type: "button", "aria-pressed": String(i === 0),
      onclick: (event) => {
        for (const button of $("pairs-part").children) button.setAttribute("aria-pressed", String(button === event.currentTarget));
        listPairs(label, some, thresholds);
      },
    }, `${words}: ${some.length}`)));
    const right = pairs.filter((pair) => pair.t <= thresholds[0] && pair.r <= thresholds[1]).length;
    $("pairs-title").textContent = `${label}, ${where}: ${right} of ${pairs.length} found`;
    $("pairs-about").textContent = `Found within ${thresholds[0]} m and ${thresholds[1]}°; worst first. A pair opens with a click on its number or picture.`;
    listPairs(label, within, thresholds);
    if (!$("pairs").open) $("pairs").showModal();
  }

  /** Which pairs of some pair sets have pictures: pair set -> {rows, keyframes and queries as parts of keys}. */
  async function picturesOf(names) {
    const found = await Promise.all(names.map((name) => load(set.pair_sets[name].answers).catch(() => null)));
    return new Map(names.flatMap((name, i) => (found[i] ? [[name, {
      rows: new Set(found[i].pictured.map((place) => (found[i].rows ? found[i].rows[place] : place))), images: found[i].images,
    }]] : [])));
  }

  async function listPairs(label, pairs, [m, deg]) {
    const names = [...new Set(pairs.map((pair) => pair.set))], pictures = await picturesOf(names);
    if (DataTable.isDataTable("#pair-list")) new DataTable.Api("#pair-list").destroy();
    $("pair-list").replaceChildren();
    const numeric = (unit) => (value, type) => (type === "display" ? escape(relocbench.errorText(value, unit)) : Number.isNaN(value) ? -1 : value);
    const text = (value, type) => (type === "display" ? escape(value) : value);
    const right = (row) => row.t <= m && row.r <= deg;
    const image = (row, side) => {
      const known = pictures.get(row.set);
      return known?.rows.has(row.row) ? `<img class="thumb" alt="" data-image="${escape(`images/${set.id}/${known.images[side]}/${row[side]}`)}">` : "";
    };
    const link = (row, inner) => `<a href="${escape(pairLink(row, label, [m, deg]))}">${inner}</a>`;
    const named = (row) => (names.length > 1 ? `${set.pair_sets[row.set].title}, pair ${row.row + 1}` : `pair ${row.row + 1}`);
    const seen = [...pictures.values()].some((known) => known.rows.size);
    relocbench.table($("pair-list"), {
      first: seen ? 6 : 5,
      data: [...pairs].sort((a, b) => (a.both === b.both ? 0 : b.both > a.both ? 1 : -1)),
      columns: [
        { title: "pair", data: null, className: "text", render: (row, type) => (type === "display" ? link(row, escape(named(row))) : type === "filter" ? named(row) : row.row) },
        ...(seen ? [{ title: "keyframe and query", data: null, className: "text pictures", orderable: false, render: (row, type) => (type === "display" ? link(row, image(row, "reference") + image(row, "query")) : "") }] : []),
        { title: "found", data: null, className: "text", ...relocbench.bestFirst(true), render: (row, type) => (type === "display" ? relocbench.verdict(right(row)) : type === "filter" ? (right(row) ? "found" : "missed") : Number(right(row))) },
        { title: "translation error, m", data: "t", ...relocbench.bestFirst(false), render: numeric("m") },
        { title: "rotation error, °", data: "r", ...relocbench.bestFirst(false), render: numeric("deg") },
        { title: "confidence", data: "confidence", ...relocbench.bestFirst(true), render: numeric("") },
        { title: "answer", data: "status", className: "text", render: (value, type) => text(relocbench.STATUS[value] ?? value, type) },
        { title: "seconds", data: "seconds", ...relocbench.bestFirst(false), render: numeric("s") },
        { title: "distance, m", data: "distance", render: numeric("m") },
        { title: "angle, °", data: "angle", render: numeric("deg") },
        { title: "pair set", data: "set", className: "text", render: text },
      ],
      paging: true, pageLength: 50, lengthChange: false, deferRender: true, info: true,
      layout: { topStart: "search", topEnd: null, bottomStart: "info", bottomEnd: "paging" },
      drawCallback: () => relocbench.thumbs($("pair-list")),
    });
  }

  /** The pairs of a cell of the matrix. */
  async function openCell(label, place) {
    const column = set.columns[place];
    const sets = await Promise.all(column.pair_sets.map(errorsOf));
    openPairs(label, pairsOf(sets, { group: "all" }, label), column.title, null, [column.metres, column.degrees]);
  }

  function drawTable(table) {
    if (DataTable.isDataTable("#methods")) new DataTable.Api("#methods").destroy();
    $("methods").replaceChildren();
    const name = (label, type) => {
      if (type !== "display") return label;
      const marks = set.methods[label].marks.map((mark) => ` <span class="tag">${escape(mark)}</span>`).join("");
      return `<a href="${escape(site.pages[label])}">${escape(label)}</a>${marks}`;
    };
    const rank = (value, type) => (type === "display" ? value : Number.parseInt(value, 10) || 1e9);
    const value = (metric, index) => (row, type) => {
      const known = row.values[index];
      if (type !== "display") return known === null ? (metric.higher ? -1 : Infinity) : Number(known);
      if (known === null) return row.missing.length ? '<span class="missing">missing</span>' : "";
      const bounds = row.intervals[metric.name];
      const below = bounds ? `<span class="bounds">[${number(bounds[0], metric.unit)}, ${number(bounds[1], metric.unit)}]</span>` : "";
      const finer = table.finer.includes(metric.name) ? "†" : "";
      return `<button type="button" class="cell" aria-label="Pairs of ${escape(row.method)}, ${escape(metric.name)} ${number(known, metric.unit)}">${number(known, metric.unit)}${finer}</button>${below}`;
    };
    relocbench.table($("methods"), {
      data: table.rows,
      columns: [
        { title: "method", data: "method", className: "text", render: name },
        { title: "rank", data: "rank", className: "rank", ...relocbench.bestFirst(false), render: rank },
        ...set.metrics.map((metric, index) => ({ title: relocbench.breakable(metric.heading), data: null, ...relocbench.bestFirst(metric.higher), render: value(metric, index) })),
        { title: "declined / crashed", data: (row) => (row.failed === null ? "" : `${row.failed} / ${row.broke}`) },
      ],
      createdRow: (tr, row) => {
        if (set.methods[row.method].baseline) tr.classList.add("baseline");
        tr.addEventListener("click", async (event) => {
          if (event.target.closest("button.cell")) openPairs(row.method, pairsOf(await dataOf(table), table, row.method), table.title);
        });
      },
    }, "methods");
    const missing = table.rows.flatMap((row) => row.missing.map((name) => `${row.method} on ${name} (${set.methods[row.method].missing[name] ?? "no result"})`));
    $("about").textContent = `${table.pairs} pairs` + (table.rejected ? `; ${table.rejected} more have no accepted truth` : "") + (missing.length ? `. Missing: ${missing.join("; ")}` : "") + ".";
    const ranks = `${table.ranks}.` === $("ranks")?.textContent ? "" : table.ranks; // it stands below the matrix already
    const notes = [ranks, table.level.length ? `No significant gain over the identity baseline: ${table.level.join(", ")}` : ""].filter(Boolean);
    $("level").hidden = !notes.length;
    $("level").textContent = notes.map((note) => `${note}.`).join(" ");
  }

  const dataOf = (table) => Promise.all(
    table.pair_sets.filter((name) => table.rows.some((row) => !row.missing.includes(name))).map(errorsOf));

  const line = (label, more) => {
    const l = look(label);
    return { name: escape(label), meta: label, line: { color: l.colour, dash: l.dash, width: 2 }, marker: { color: l.colour, symbol: l.marker, size: 6, maxdisplayed: 8 }, ...more };
  };

  async function drawCharts() {
    const table = current(), sets = await dataOf(table);
    if (table !== current()) return;
    const incomplete = new Set(table.rows.filter((row) => row.missing.length).map((row) => row.method));
    const own = labels.filter((label) => !hidden.has(label) && !incomplete.has(label));
    shown = Object.fromEntries(own.map((label) => [label, pairsOf(sets, table, label)]));
    const click = (event) => { const label = event.points[0].data.meta; openPairs(label, shown[label], table.title); };
    const what = $("choose-error").value, field = { both: "both", translation: "t", rotation: "r" }[what];
    const mark = { both: 1, translation: metres, rotation: degrees }[what], unit = { both: "", translation: "m", rotation: "deg" }[what];
    const title = { both: `error / threshold (${metres} m, ${degrees}°)`, translation: "translation error, m", rotation: "rotation error, °" }[what];
    const limits = [];
    const curves = own.filter((label) => shown[label].length).map((label) => {
      const values = Float64Array.from(shown[label], (pair) => pair[field]).sort();
      const finite = values.findLastIndex((v) => Number.isFinite(v)) + 1;
      if (finite && !set.methods[label].baseline) limits.push(values[Math.floor(0.8 * finite)]);
      const step = Math.max(1, Math.floor(finite / 800)), x = [0], y = [0];
      for (let i = 0; i < finite; i += step) { x.push(values[i]); y.push((100 * (i + 1)) / values.length); }
      const last = finite ? values[finite - 1] : 0, reached = (100 * finite) / values.length;
      x.push(last, Math.max(last, 1e9)); y.push(reached, reached);
      return line(label, { x, y, line: { color: look(label).colour, dash: look(label).dash, width: 2, shape: "hv" }, mode: "lines+markers", type: "scatter", hovertemplate: `${escape(label)}<br>%{y:.1f} % at most %{x:.3f}<extra></extra>` });
    });
    const finest = Math.max(0, ...table.pair_sets.map((name) => set.pair_sets[name][{ translation: "finest_m", rotation: "finest_deg" }[what]] ?? 0));
    const limit = Math.max(2 * mark, ...(limits.length ? [limits.sort((a, b) => a - b)[limits.length >> 1]] : []));
    chart("curves", curves, {
      xaxis: { title: { text: title }, range: [0, limit] }, yaxis: { title: { text: "share of all pairs, %" }, range: [0, 101] },
      shapes: [
        { type: "rect", x0: 0, x1: finest, y0: 0, y1: 1, yref: "paper", fillcolor: relocbench.css("--line"), opacity: 0.5, layer: "below", line: { width: 0 } },
        { type: "line", x0: mark, x1: mark, y0: 0, y1: 100, line: { color: relocbench.css("--line-strong"), dash: "dot", width: 1 } },
      ],
    }, (event) => {
      const [{ x, data: { meta: label } }] = event.points;
      const words = `${number(x, unit)}${{ both: "", translation: " m", rotation: "°" }[what]}`;
      openPairs(label, shown[label], table.title, { field, value: x, words });
    });
    const risks = own.filter((label) => !set.methods[label].baseline && shown[label].some((p) => p.status === "ok")).map((label) => {
      // Answers of one confidence are kept or dropped together; without a confidence an answer is the least sure.
      const sure = (p) => (Number.isNaN(p.confidence) ? -Infinity : p.confidence);
      const answered = shown[label].filter((p) => p.status === "ok").sort((a, b) => (sure(a) === sure(b) ? 0 : sure(b) - sure(a)));
      const x = [], y = []; let wrong = 0;
      answered.forEach((p, i) => {
        if (!(p.t <= metres && p.r <= degrees)) wrong++;
        if (i + 1 === answered.length || sure(answered[i + 1]) !== sure(p)) { x.push((100 * (i + 1)) / shown[label].length); y.push((100 * wrong) / (i + 1)); }
      });
      return line(label, { x, y, mode: x.length === 1 ? "markers" : "lines+markers", type: "scatter", hovertemplate: `${escape(label)}<br>%{y:.1f} % wrong of %{x:.1f} %<extra></extra>` });
    });
    chart("risk", risks, { xaxis: { title: { text: "most confident answers, % of all pairs" }, range: [0, 101] }, yaxis: { title: { text: "wrong, %" }, range: [-1, 101] } }, click);
    const cost = table.rows.filter((row) => !hidden.has(row.method) && row.values[seconds] > 0 && row.values[ranking] !== null);
    chart("cost", cost.map((row) => line(row.method, { x: [row.values[seconds]], y: [100 * row.values[ranking]], mode: "markers", type: "scatter", hovertemplate: `${escape(row.method)}<br>%{y:.1f} %, %{x:.3f} s<extra></extra>` })),
      { xaxis: { title: { text: "median seconds a pair" }, type: "log" }, yaxis: { title: { text: `${escape(set.ranking)}, %` } } }, click);
    drawHeat();
    const page = { set, site, labels, table, sets, own, shown, field, mark, unit, title, metres, degrees, line, openPairs, pairLink, extra: await extra };
    if (table === current()) for (const part of relocbench.parts) part(page);
  }

  function drawHeat() {
    const inTable = current().pair_sets;
    const tables = set.tables.filter((t) => !t.total && t.group === "all" && inTable.includes(t.pair_sets[0]));
    const cells = tables.map((t) => {
      const { reference, query } = set.pair_sets[t.pair_sets[0]];
      return { row: reference, column: query, value: (label) => t.rows.find((row) => row.method === label)?.values[ranking] ?? null };
    });
    const open = async (reference, query) => {
      const label = $("heat-a").value, chosen = tables.filter((t) => set.pair_sets[t.pair_sets[0]].reference === reference && set.pair_sets[t.pair_sets[0]].query === query);
      const sets = (await Promise.all(chosen.map(dataOf))).flat();
      openPairs(label, pairsOf(sets, { group: "all" }, label), `${reference} → ${query}`);
    };
    $("heat-section").hidden = new Set(cells.map((cell) => `${cell.row}\n${cell.column}`)).size < 2;
    if ($("heat-section").hidden) return;
    heat("heat", cells.map((cell) => ({ ...cell, open: () => open(cell.row, cell.column) })), $("heat-a").value, $("heat-b").value, ["query", "reference"]);
  }

  function groups() {
    const own = set.tables.filter((t) => t.title === $("choose-table").value).map((t) => t.group);
    $("choose-group").replaceChildren(...own.map((g) => option(g, g, state.get("group", "all"))));
  }

  $("choose-table").replaceChildren(...titles.map((t) => option(t, t, state.get("table", titles.find((x) => x.startsWith("total")) || titles[0]))));
  groups();
  const hidden = hiddenLabels(labels, current(), (label) => set.methods[label].baseline);
  const chosen = labels.includes(state.get("method")) ? state.get("method") : labels.find((l) => !set.methods[l].baseline) || labels[0];
  $("heat-a").replaceChildren(...labels.map((l) => option(l, l, chosen)));
  $("heat-b").replaceChildren(option("", "none", ""), ...labels.map((l) => option(l, l, state.get("less"))));
  $("choose-error").value = ["translation", "rotation"].includes(state.get("error")) ? state.get("error") : "both";
  $("choose-table").addEventListener("change", () => { state.set({ table: $("choose-table").value, group: null }); groups(); drawTable(current()); drawCharts(); });
  $("choose-group").addEventListener("change", () => { state.set({ group: $("choose-group").value }); drawTable(current()); drawCharts(); });
  $("choose-error").addEventListener("change", () => { state.set({ error: $("choose-error").value }); drawCharts(); });
  for (const [id, key] of [["heat-a", "method"], ["heat-b", "less"]]) $(id).addEventListener("change", () => { state.set({ [key]: $(id).value }); drawHeat(); });
  addEventListener("hashchange", () => location.reload());
  $("close").addEventListener("click", () => $("pairs").close());
  $("pairs").addEventListener("close", () => state.set({ column: null, pairs: null }));
  document.querySelector(".matrix")?.addEventListener("click", (event) => {
    const link = event.target.closest("td a");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    const asked = new URLSearchParams(new URL(link.href).hash.slice(1));
    state.set({ method: asked.get("method"), column: asked.get("column") });
    openCell(asked.get("method"), asked.get("column"));
  });
  document.addEventListener("relocbench-theme", () => { legend(labels, hidden, drawCharts); drawCharts(); });
  drawTable(current());
  legend(labels, hidden, drawCharts);
  await new Promise((resolve) => setTimeout(resolve, 50)); // the table can be used before the errors are decoded
  await drawCharts();
  if (set.columns[state.get("column")]) openCell(chosen, state.get("column"));
  else if (state.get("pairs") && shown[chosen]) openPairs(chosen, shown[chosen], current().title);
})();
