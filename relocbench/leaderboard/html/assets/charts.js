/* Charts by Plotly, in the colours of the page; the script is loaded when the first chart is drawn. */
"use strict";

/** The looks of methods without results, which a page may add. */
relocbench.furtherLooks = {};

relocbench.look = (label) => {
  const look = relocbench.payload("site").looks[label] || relocbench.furtherLooks[label] || { light: "#6b7280", dark: "#9aa3b2", dash: "solid", marker: "circle" };
  return { colour: relocbench.isDark ? look.dark : look.light, dash: look.dash, marker: look.marker };
};

/** A method's line as it is drawn everywhere, for keys. */
relocbench.lineKey = (label) => {
  const { colour, dash } = relocbench.look(label);
  return `<svg class="key" width="26" height="10" aria-hidden="true"><line x1="0" y1="5" x2="26" y2="5" stroke="${colour}" stroke-width="2.5" stroke-dasharray="${dash === "solid" ? "" : dash.replaceAll("px", "")}"/></svg>`;
};

/** A key of methods below a chart that is far from the page's legend. */
relocbench.keys = (id, labels, ...more) => {
  document.getElementById(id).replaceChildren(...labels.map((label) => {
    const item = relocbench.element("li");
    item.innerHTML = relocbench.lineKey(label);
    item.append(label);
    return item;
  }), ...more.map((text) => relocbench.element("li", { class: "muted" }, text)));
};

/** Charts are drawn when they come near the window: drawing all of a large set at once takes seconds. */
const waitingCharts = new Map();
const chartsInSight = new IntersectionObserver((entries) => {
  for (const { target } of entries.filter((entry) => entry.isIntersecting)) {
    const given = waitingCharts.get(target.id);
    waitingCharts.delete(target.id);
    chartsInSight.unobserve(target);
    if (given) relocbench.drawChart(target.id, ...given);
  }
}, { rootMargin: "150px" });

/** Given are traces, layout and what a click does, or a function that finds the three when the chart is drawn. */
relocbench.chart = (id, ...given) => {
  if (relocbench.printing) {
    waitingCharts.delete(id);
    return void relocbench.drawChart(id, ...given);
  }
  waitingCharts.set(id, given);
  chartsInSight.unobserve(document.getElementById(id));
  chartsInSight.observe(document.getElementById(id));
};

relocbench.drawChart = async (id, ...given) => {
  if (!window.Plotly) await relocbench.script("assets/plotly.min.js"); // a chart that is printed cannot wait
  let [traces, layout, onClick = null] = given;
  if (typeof traces === "function") {
    const found = traces();
    const drawn = found instanceof Promise ? await found : found;
    if (!drawn) return; // it is not wanted any more
    [traces, layout, onClick = null] = drawn;
  }
  const { css } = relocbench;
  const axis = { gridcolor: css("--line"), zerolinecolor: css("--line"), linecolor: css("--line-strong"), automargin: true };
  const node = document.getElementById(id);
  if (node.dataset.printed && !relocbench.printing) Plotly.purge(node); // it would keep the width of paper
  if (relocbench.printing) node.dataset.printed = "yes";
  else delete node.dataset.printed;
  // Plotly shows a few tags of HTML in texts: names are escaped by those who give them.
  const drawing = Plotly.react(node, traces, {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: css("--text"), family: css("--font"), size: 12 },
    margin: { l: 52, r: 12, t: 12, b: 44 },
    showlegend: false,
    hovermode: "closest",
    ...(relocbench.printing ? { width: node.clientWidth } : {}),
    hoverlabel: { bgcolor: css("--raised"), bordercolor: css("--line-strong"), font: { color: css("--text") } },
    ...layout,
    xaxis: { ...axis, ...layout.xaxis },
    yaxis: { ...axis, ...layout.yaxis },
  }, { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] });
  await drawing;
  node.removeAllListeners("plotly_click");
  if (onClick) node.on("plotly_click", onClick);
};
