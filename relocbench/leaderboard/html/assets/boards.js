/* Parts of the pages of retrievers and of pipelines: lists, curves, and bars. */
"use strict";

relocbench.boards = (() => {
  const { element, escape, number, state, look, chart } = relocbench;
  const $ = (id) => document.getElementById(id);

  const option = (value, text, chosen) => element("option", { value, selected: value === chosen }, text);

  /** How DataTables shows text and numbers; what there is none of sorts behind everything else. */
  const text = (value, type) => (type === "display" ? escape(value ?? "") : value ?? "");
  const numeric = (unit) => (value, type) => (type === "display" ? escape(number(value, unit)) : Number.isFinite(Number(value ?? NaN)) ? Number(value) : Number(value) === Infinity ? 1e300 : -1);
  const answerColumn = { title: "answer", data: "status", className: "text", render: (value, type) => text(relocbench.STATUS[value] ?? value, type) };
  const rank = (value, type) => (type === "display" ? (value ?? "") : Number.parseInt(value, 10) || 1e9);

  /** A table that is drawn anew, with other rows. */
  function redraw(id, options, key) {
    if (DataTable.isDataTable(`#${id}`)) new DataTable.Api(`#${id}`).destroy();
    $(id).replaceChildren();
    return relocbench.table($(id), options, key);
  }

  /** A value of a row as a button that opens its queries, with its interval below. */
  const cell = (metric, index, what) => (row, type) => {
    const known = row.values[index];
    if (type !== "display") return known === null || known === undefined ? -1 : Number(known) === Infinity ? 1e300 : Number(known);
    if (known === null || known === undefined) return row.missing.length ? '<span class="missing">missing</span>' : "";
    const shown = number(known, metric.unit), bounds = row.intervals[metric.name];
    const below = bounds ? `<span class="bounds">[${number(bounds[0], metric.unit)}, ${number(bounds[1], metric.unit)}]</span>` : "";
    if (row.chance) return shown;
    return `<button type="button" class="cell" aria-label="${what} of ${escape(row.method)}, ${escape(metric.name)} ${shown}">${shown}</button>${below}`;
  };

  /** The name of a method with the words behind it, linked to its page. */
  function named(label, marks) {
    const page = relocbench.payload("site").pages[label], name = escape(label);
    return (page ? `<a href="${escape(page)}">${name}</a>` : name) + marks.map((mark) => ` <span class="tag">${escape(mark)}</span>`).join("");
  }

  /** Sentences below a table, those that are not empty. */
  function notes(id, ...sentences) {
    const said = sentences.filter(Boolean);
    $(id).hidden = !said.length;
    $(id).textContent = said.map((sentence) => `${sentence}.`).join(" ");
  }

  /** A list over the page: rows, worst first, in pages of fifty. */
  function openList(title, data, columns) {
    $("list-title").textContent = title;
    redraw("list", {
      data, columns, paging: true, pageLength: 50, lengthChange: false, deferRender: true, info: true,
      layout: { topStart: "search", topEnd: null, bottomStart: "info", bottomEnd: "paging" },
    });
    if (!$("list-dialog").open) $("list-dialog").showModal();
  }

  const line = (label, more) => {
    const l = look(label);
    return { name: escape(label), meta: label, type: "scatter", line: { color: l.colour, dash: l.dash, width: 2 }, marker: { color: l.colour, symbol: l.marker, size: 6, maxdisplayed: 8 }, ...more };
  };

  /** A grey curve that belongs to no method. */
  const aside = (name, x, y, hover) => ({ name, x, y, mode: "lines", type: "scatter", line: { color: relocbench.css("--muted"), dash: "2px,3px", width: 1.5 }, hovertemplate: hover });

  /** The curve of the share of values that are at most x, in percent; infinite values count and are never reached. */
  function cumulative(values) {
    const sorted = Float64Array.from(values).sort();
    const finite = sorted.findLastIndex((v) => Number.isFinite(v)) + 1;
    const step = Math.max(1, Math.floor(finite / 800)), x = [0], y = [0];
    for (let i = 0; i < finite; i += step) { x.push(sorted[i]); y.push((100 * (i + 1)) / sorted.length); }
    const last = finite ? sorted[finite - 1] : 0, reached = (100 * finite) / (sorted.length || 1);
    x.push(last, Math.max(last, 1e9)); y.push(reached, reached);
    return { x, y, most: finite ? sorted[Math.floor(0.8 * finite)] : null };
  }

  const middle = (values) => (values.length ? [...values].sort((a, b) => a - b)[values.length >> 1] : 0);

  /** The curve of a method as Plotly takes it; `hover` says what x is. */
  const curve = (label, { x, y }, unit) => line(label, {
    x, y, line: { color: look(label).colour, dash: look(label).dash, width: 2, shape: "hv" }, mode: "lines+markers",
    hovertemplate: `${escape(label)}<br>%{y:.1f} % at most %{x:.3f}${unit}<extra></extra>`,
  });

  const upright = (x) => ({ type: "line", x0: x, x1: x, yref: "paper", y0: 0, y1: 1, line: { color: relocbench.css("--line-strong"), dash: "dot", width: 1 } });

  /** Bars side by side for each method, as [{name, colour, pattern, values: {label: value}}], the first label on top. */
  function stacked(id, labels, parts, layout, template, click) {
    const down = [...labels].reverse(), height = 110 + 30 * labels.length;
    $(id).style.minHeight = `${height}px`;
    chart(id, parts.map((part) => ({
      type: "bar", orientation: "h", name: part.name, y: down.map(escape), x: down.map((label) => part.values[label] ?? null), meta: down,
      marker: { color: part.colour, pattern: { shape: part.pattern || "", fillmode: "overlay", fgcolor: relocbench.css("--page"), size: 6 } },
      texttemplate: template, textposition: "inside", insidetextanchor: "middle", textangle: 0, textfont: { color: part.ink || "#ffffff" },
      hovertemplate: `%{y}<br>${part.name}: ${template}<extra></extra>`,
    })), {
      barmode: "stack", height, showlegend: true, legend: { orientation: "h", traceorder: "normal", x: 0, y: 1.02, yanchor: "bottom", font: { size: 12 } },
      margin: { l: 8, r: 12, t: 12, b: 44 }, uniformtext: { minsize: 10, mode: "hide" }, ...layout, yaxis: { type: "category", ticklabelstandoff: 6, ...layout.yaxis },
    }, click && ((event) => click(event.points[0].data.meta[event.points[0].pointIndex])));
  }

  /** Common to the page of a set: its choice of tables, and the dialog. */
  function chooseTable(set, changed) {
    const titles = set.tables.map((table) => table.title);
    const first = titles.find((title) => title.startsWith("mean")) || titles[0];
    const wanted = titles.includes(state.get("table")) ? state.get("table") : first;
    $("choose-table").replaceChildren(...titles.map((title) => option(title, title, wanted)));
    $("choose-table").addEventListener("change", () => { state.set({ table: $("choose-table").value }); changed(); });
    $("close").addEventListener("click", () => $("list-dialog").close());
    addEventListener("hashchange", () => location.reload());
    return () => set.tables.find((table) => table.title === $("choose-table").value);
  }

  /** The end of an image's path: its file and folder, which tell images of a list apart. */
  const shortName = (key) => key.split("/").slice(-2).join("/");

  return { shortName, $, option, text, numeric, rank, redraw, cell, named, notes, openList, answerColumn, line, aside, cumulative, middle, curve, upright, stacked, chooseTable };
})();
