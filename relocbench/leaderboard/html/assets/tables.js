/* Tables that sort and search, by DataTables; what is typed, sorted and shown stands in the address. */
"use strict";

/** Columns of a table that are shown before the rest is asked for. */
relocbench.FIRST_COLUMNS = 5;

/** DataTables' option of a column of numbers, of which a click shows the best first. */
relocbench.bestFirst = (higher) => ({ orderSequence: higher ? ["desc", "asc"] : ["asc", "desc"] });

relocbench.table = (node, options = {}, key = "") => {
  const { state, element } = relocbench;
  const { first = relocbench.FIRST_COLUMNS, ...given } = options;
  const kept = key ? state.get(`${key}-sort`) : "";
  const [column, direction] = kept.split(":");
  const table = new DataTable(node, {
    autoWidth: false,
    paging: false,
    info: false,
    order: kept && Number.isInteger(Number(column)) ? [[Number(column), direction === "desc" ? "desc" : "asc"]] : [],
    search: { search: key ? state.get(`${key}-find`) : "" },
    language: { search: "Search", emptyTable: "Nothing to show", zeroRecords: "Nothing fits" },
    layout: { topStart: "search", topEnd: null, bottomStart: null, bottomEnd: null },
    ...given,
  });
  const mark = () => table.table().container().querySelector(".dt-search")?.classList.toggle("used", Boolean(table.search()));
  mark();
  table.on("search", mark);
  const count = table.columns().count();
  if (count > first + 1) { // a button in place of a single column is no help
    const rest = Array.from({ length: count - first }, (_, i) => first + i);
    const button = element("button", { type: "button", class: "columns" });
    const show = (all) => {
      table.columns(rest).visible(all);
      button.textContent = all ? "First columns" : `All ${count} columns`;
      button.setAttribute("aria-pressed", String(all));
    };
    button.addEventListener("click", () => {
      const all = button.getAttribute("aria-pressed") !== "true";
      if (key) state.set({ [`${key}-all`]: all ? "1" : null });
      show(all);
    });
    table.table().container().querySelector(".dt-search")?.append(button);
    show(Boolean(key && state.get(`${key}-all`)) || rest.includes(Number(column)));
  }
  if (key) {
    table.on("order", () => {
      const [sorted] = table.order();
      if (sorted) state.set({ [`${key}-sort`]: `${sorted[0]}:${sorted[1]}` });
    });
    table.on("search", () => state.set({ [`${key}-find`]: table.search() }));
  }
  return table;
};
