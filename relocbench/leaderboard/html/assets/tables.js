/* Tables that sort and search, by DataTables; what is typed and how it is sorted stands in the address. */
"use strict";

relocbench.table = (node, options = {}, key = "") => {
  const { state } = relocbench;
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
    ...options,
  });
  const mark = () => table.table().container().querySelector(".dt-search")?.classList.toggle("used", Boolean(table.search()));
  mark();
  table.on("search", mark);
  if (key) {
    table.on("order", () => {
      const [first] = table.order();
      if (first) state.set({ [`${key}-sort`]: `${first[0]}:${first[1]}` });
    });
    table.on("search", () => state.set({ [`${key}-find`]: table.search() }));
  }
  return table;
};
