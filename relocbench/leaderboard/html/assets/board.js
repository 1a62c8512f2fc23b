/* The page of a set of any task: its tables, its legend, the map of conditions, and lists of pairs or queries. Other scripts
   add charts of their own to relocbench.parts: functions of what is chosen, called after each change. */
"use strict";

(async () => {
  const { element, option, escape, number, state, load, heat, legend, hiddenLabels, unitLink, worstFirst, bestFirst, KINDS } = relocbench;
  const $ = (id) => document.getElementById(id);
  const site = relocbench.payload("site");
  const set = await load($("set").dataset.set);
  const labels = Object.keys(set.methods), titles = [...new Set(set.tables.map((table) => table.title))];
  const extra = set.charts ? load(set.charts) : {};
  let shown = {};

  function current() {
    const own = set.tables.filter((table) => table.title === $("choose-table").value);
    return own.find((table) => table.group === $("choose-group")?.value) || own[0];
  }

  /** The answers to the tasks of a table which some method has. */
  async function answersOf(names) {
    return Promise.all(names.map(async (name) => ({ name, ...await load(set.tasks[name].answers) })));
  }
  const answered = (table) => answersOf(table.tasks.filter((name) => table.rows.some((row) => !row.missing.includes(name))));

  /** The pairs or queries of a table as a method answered them. */
  const rowsOf = (tasks, table, label) => tasks.flatMap((of) => relocbench.rows(set, of.name, of, label).filter((row) => table.group === "all" || row.group === table.group));

  /** Which pairs of some tasks have pictures: task -> {rows, keyframes and queries as parts of keys}. */
  async function picturesOf(names) {
    const found = await Promise.all(names.map((name) => (set.tasks[name].pictures ? load(set.tasks[name].pictures).catch(() => null) : null)));
    return new Map(names.flatMap((name, i) => (found[i] ? [[name, {
      rows: new Set(found[i].pictured.map((place) => (found[i].rows ? found[i].rows[place] : place))), images: found[i].images,
    }]] : [])));
  }

  /** List pairs or queries of a method. A limit {field, value, words} splits them into those within it, which come first, and others. */
  function openList(label, rows, where, { limit = null, thresholds = set.correct } = {}) {
    const within = limit ? rows.filter((row) => row[limit.field] <= limit.value) : rows;
    const parts = limit && within.length < rows.length
      ? [[`at most ${limit.words}`, within], ["above", rows.filter((row) => !(row[limit.field] <= limit.value))], ["all", rows]] : [];
    $("list-part").replaceChildren(...parts.map(([words, some], i) => element("button", {
      type: "button", "aria-pressed": String(i === 0),
      onclick: (event) => {
        for (const button of $("list-part").children) button.setAttribute("aria-pressed", String(button === event.currentTarget));
        fillList(label, some, thresholds);
      },
    }, `${words}: ${some.length}`)));
    const right = thresholds && rows.filter((row) => isFound(row, thresholds)).length;
    $("list-title").textContent = `${label}, ${where}: ${thresholds ? `${right} of ` : ""}${rows.length} ${thresholds ? "found" : set.units}`;
    $("list-about").textContent = `${thresholds ? `Found within ${thresholds[0]} m and ${thresholds[1]}°; worst` : "Worst"} first. A ${set.unit} opens with a click on its name or picture.`;
    fillList(label, within, thresholds);
    if (!$("list-dialog").open) $("list-dialog").showModal();
  }

  const isFound = (row, [metres, degrees]) => row.translation_error_m <= metres && row.rotation_error_deg <= degrees;

  async function fillList(label, rows, thresholds) {
    const names = [...new Set(rows.map((row) => row.task))], pictures = await picturesOf(names);
    const seen = [...pictures.values()].some((known) => known.rows.size);
    const link = (row, inner, title = "") => `<a href="${escape(unitLink(set, row, label, thresholds))}" title="${escape(title)}">${inner}</a>`;
    const image = (row, side) => {
      const known = pictures.get(row.task);
      return known?.rows.has(row.row) ? `<img class="thumb" alt="" data-image="${escape(`images/${set.id}/${known.images[side]}/${row[side]}`)}">` : "";
    };
    const named = (row) => (set.unit === "pair" ? `${names.length > 1 ? `${set.tasks[row.task].title}, ` : ""}pair ${row.row + 1}` : String(row.query));
    const name = (value, type, row) => (type === "display" ? link(row, escape(relocbench.shortName(named(row))), named(row)) : type === "filter" || set.unit !== "pair" ? named(row) : row.row);
    const known = ({ key, optional }) => !optional || rows.some((row) => row[key] || row[key] === 0);
    redraw("list", {
      first: seen ? 6 : 5,
      data: worstFirst(rows, set.worst).map((row) => (thresholds ? { ...row, found: isFound(row, thresholds) } : row)),
      columns: set.list.filter(known).flatMap(({ key, title, kind, higher }) => [{
        title, data: kind === "link" ? null : key, className: ["text", "link", "status", "outcome", "found"].includes(kind) ? "text" : "", ...(higher === undefined ? {} : bestFirst(higher)), render: kind === "link" ? (row, type) => name(null, type, row) : KINDS[kind],
      }, ...(kind === "link" && seen ? [{
        title: "keyframe and query", data: null, className: "text pictures", orderable: false, render: (row, type) => (type === "display" ? link(row, image(row, "reference") + image(row, "query")) : ""),
      }] : [])]),
      paging: true, pageLength: 50, lengthChange: false, deferRender: true, info: true,
      layout: { topStart: "search", topEnd: null, bottomStart: "info", bottomEnd: "paging" },
      drawCallback: () => relocbench.thumbs($("list")),
    });
  }

  /** A table that is drawn anew, with other rows. */
  function redraw(id, options, key) {
    if (DataTable.isDataTable(`#${id}`)) new DataTable.Api(`#${id}`).destroy();
    $(id).replaceChildren();
    relocbench.table($(id), options, key);
  }

  /** What a method is called, its parts linked to their pages, with the words behind it. */
  function methodName(label) {
    const { parts = [label], top = null, marks = [] } = set.methods[label] ?? {};
    const linked = parts.map((part) => (site.pages[part] ? `<a href="${escape(site.pages[part])}">${escape(part)}</a>` : escape(part)));
    return `${linked.join(" + ")}${top ? `, top ${top}` : ""}${marks.map((mark) => ` <span class="tag">${escape(mark)}</span>`).join("")}`;
  }

  /** How a number is shown: as a button that opens its pairs or queries, with its interval below. */
  const cell = (table, key, { unit, higher }) => (row, type) => {
    const value = row.values[key] ?? null;
    if (type !== "display") return value === null ? (higher ? -1 : 1e301) : Number(value) === Infinity ? 1e300 : Number(value);
    if (value === null) return row.missing.length ? '<span class="missing">missing</span>' : "";
    const text = number(value, unit), bounds = row.intervals[key];
    if (row.chance) return text;
    const below = bounds ? `<span class="bounds">[${number(bounds[0], unit)}, ${number(bounds[1], unit)}]</span>` : "";
    return `<button type="button" class="cell" aria-label="${set.units} of ${escape(row.method)}, ${escape(key)} ${text}">${text}${table.finer?.includes(key) ? "†" : ""}</button>${below}`;
  };

  function columnOf(table, key) {
    if (key === "method") return { title: set.page.method, data: key, className: "text", render: (label, type) => (type === "display" ? methodName(label) : label) };
    if (key === "rank") return { title: key, data: null, className: "rank", ...bestFirst(false), render: ({ texts }, type) => (type === "display" ? escape(texts.rank) : Number.parseInt(texts.rank, 10) || 1e9) };
    const column = set.columns[key];
    if (!column.unit) return { title: escape(column.heading), data: null, className: column.words ? "text" : "", render: ({ texts }, type) => KINDS.text(texts[key], type) };
    return { title: relocbench.breakable(column.heading), data: null, ...bestFirst(column.higher), render: cell(table, key, column) };
  }

  function drawTables() {
    const table = current();
    for (const [id, keys] of Object.entries(table.views ?? set.views)) {
      redraw(id, {
        ...(id === "methods" ? {} : { first: keys.length }), data: table.rows, columns: keys.map((key) => columnOf(table, key)),
        createdRow: (tr, row) => {
          if (row.chance || set.methods[row.method].baseline) tr.classList.add("baseline");
          tr.addEventListener("click", async (event) => {
            if (event.target.closest("button.cell")) openList(row.method, rowsOf(await answered(table), table, row.method), table.title);
          });
        },
      }, id);
    }
    const notes = table.notes.filter((note) => note && `${note}.` !== $("ranks")?.textContent); // it stands below the matrix already
    $("about").textContent = table.about;
    $("level").hidden = !notes.length;
    $("level").textContent = notes.map((note) => `${note}.`).join(" ");
  }

  async function drawCharts() {
    const table = current(), tasks = await answered(table);
    if (table !== current()) return;
    const incomplete = new Set(table.rows.filter((row) => row.missing.length).map((row) => row.method));
    const own = labels.filter((label) => !hidden.has(label) && !incomplete.has(label));
    shown = Object.fromEntries(own.map((label) => [label, rowsOf(tasks, table, label)]));
    drawHeat();
    const open = (label, limit = null) => openList(label, shown[label] ?? rowsOf(tasks, table, label), table.title, { limit });
    const page = { set, site, labels, table, tasks, own, shown, hidden, openList, open, pairLink: (row, label) => unitLink(set, row, label), extra: await extra };
    if (table === current()) for (const part of relocbench.parts) part(page);
  }

  function drawHeat() {
    const inTable = current().tasks, whole = (name) => set.tasks[name].part_of;
    const names = Object.keys(set.tasks).filter((name) => inTable.includes(name) || inTable.includes(whole(name)));
    const drawn = names.filter((name) => set.tasks[name].has_conditions && !names.some((part) => whole(part) === name));
    const a = $("heat-a").value, b = $("heat-b").value, tableOf = (name) => set.tables.find((t) => t.tasks.length === 1 && t.tasks[0] === name && !t.total && t.group === "all");
    const cells = drawn.map((name) => {
      const { gallery, query } = set.tasks[name], same = drawn.filter((other) => set.tasks[other].gallery === gallery && set.tasks[other].query === query);
      return {
        row: gallery, column: query, value: (label) => tableOf(name)?.rows.find((row) => row.method === label)?.values[set.ranking] ?? null,
        open: async () => openList(a, rowsOf(await answersOf(same), { group: "all" }, a), `${gallery} → ${query}`),
      };
    });
    $("heat-section").hidden = new Set(cells.map((each) => `${each.row}\n${each.column}`)).size < set.least_cells;
    if (!$("heat-section").hidden) heat("heat", cells, a, b, set.heat);
  }

  /** The pairs of a cell of the matrix. */
  async function openCell(label, { pair_sets, title, metres, degrees, tier }) {
    const rows = rowsOf(await answersOf(pair_sets), { group: "all" }, label).filter((row) => !tier || row.tier === tier);
    openList(label, rows, title, { thresholds: [metres, degrees] });
  }

  function groups() {
    const own = set.tables.filter((table) => table.title === $("choose-table").value).map((table) => table.group);
    $("choose-group")?.replaceChildren(...own.map((group) => option(group, group, state.get("group", "all"))));
  }

  const redrawAll = () => { drawTables(); drawCharts(); };
  const first = titles.find((title) => /^(total|mean)/.test(title)) || titles[0];
  $("choose-table").replaceChildren(...titles.map((title) => option(title, title, titles.includes(state.get("table")) ? state.get("table") : first)));
  groups();
  const hidden = hiddenLabels(labels, current(), (label) => set.methods[label].baseline);
  const competing = (label) => set.methods[label].competes;
  const chosen = labels.includes(state.get("method")) ? state.get("method") : (set.unit === "pair" ? labels : current().rows.map((row) => row.method).filter((label) => label in set.methods)).find(competing) || labels[0];
  $("heat-a").replaceChildren(...labels.map((label) => option(label, label, chosen)));
  $("heat-b").replaceChildren(option("", "none", ""), ...labels.map((label) => option(label, label, state.get("less"))));
  for (const [id, key] of [["heat-a", "method"], ["heat-b", "less"]]) $(id).addEventListener("change", () => { state.set({ [key]: $(id).value }); drawHeat(); });
  $("choose-table").addEventListener("change", () => { state.set({ table: $("choose-table").value, group: null }); groups(); redrawAll(); });
  $("choose-group")?.addEventListener("change", () => { state.set({ group: $("choose-group").value }); redrawAll(); });
  if ($("choose-error")) {
    $("choose-error").value = ["translation", "rotation"].includes(state.get("error")) ? state.get("error") : "both";
    $("choose-error").addEventListener("change", () => { state.set({ error: $("choose-error").value }); drawCharts(); });
  }
  addEventListener("hashchange", () => location.reload());
  $("close").addEventListener("click", () => $("list-dialog").close());
  $("list-dialog").addEventListener("close", () => state.set({ column: null, [set.units]: null }));
  document.querySelector(".matrix")?.addEventListener("click", (event) => {
    const link = event.target.closest("td a");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    const asked = new URLSearchParams(new URL(link.href).hash.slice(1));
    state.set({ method: asked.get("method"), column: asked.get("column") });
    openCell(asked.get("method"), set.matrix[asked.get("column")]);
  });
  const drawLegend = () => legend(labels, hidden, drawCharts);
  document.addEventListener("relocbench-theme", () => { drawLegend(); drawCharts(); });
  drawTables();
  drawLegend();
  await new Promise((resolve) => setTimeout(resolve, 50)); // the table can be used before the answers are decoded
  await drawCharts();
  if (set.matrix?.[state.get("column")]) openCell(chosen, set.matrix[state.get("column")]);
  else if (state.get(set.units)) openList(chosen, shown[chosen] ?? rowsOf(await answered(current()), current(), chosen), current().title);
})();
