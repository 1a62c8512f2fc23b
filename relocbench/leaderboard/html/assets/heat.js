/* Maps of conditions against conditions. */
"use strict";

/**
 * A map of conditions against conditions, for one method or the difference of two.
 * cells: [{row, column, value: (label) => share or null, open}]
 */
relocbench.heat = (id, cells, a, b, titles) => {
  const { escape, chart } = relocbench, node = document.getElementById(id);
  const names = (key) => [...new Set(cells.map((one) => one[key]))]; // in the order of all other tables
  const rows = names("row"), columns = names("column");
  const at = (row, column) => cells.filter((one) => one.row === row && one.column === column);
  const valueOf = (one) => { const own = one.value(a), other = b ? one.value(b) : 0; return own === null || other === null ? null : 100 * (own - other); };
  const z = rows.map((row) => columns.map((column) => relocbench.mean(at(row, column).map(valueOf))));
  const height = (innerWidth > 640 ? 130 : 260) + 60 * rows.length;
  node.style.minHeight = `${height}px`;
  chart(id, [{
    type: "heatmap", z, x: columns.map(escape), y: rows.map(escape), xgap: 2, ygap: 2,
    colorscale: relocbench.QUALITY, showscale: innerWidth > 640, zmin: b ? -100 : 0, zmax: 100,
    texttemplate: "%{z:.1f}", hovertemplate: "%{y} → %{x}: %{z:.1f} %<extra></extra>",
  }], { height, xaxis: { title: { text: titles[0] }, type: "category" }, yaxis: { title: { text: titles[1] }, type: "category" } },
  (event) => { const [y, x] = event.points[0].pointIndex || event.points[0].pointNumber; at(rows[y], columns[x])[0]?.open(); });
};
