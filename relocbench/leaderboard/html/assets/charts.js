/* Charts by Plotly, in the colours of the page; the script is loaded when the first chart is drawn. */
"use strict";

relocbench.look = (label) => {
  const look = relocbench.payload("site").looks[label] || { light: "#6b7280", dark: "#9aa3b2", dash: "solid", marker: "circle" };
  return { colour: relocbench.isDark ? look.dark : look.light, dash: look.dash, marker: look.marker };
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

relocbench.chart = (id, ...given) => {
  waitingCharts.set(id, given);
  chartsInSight.unobserve(document.getElementById(id));
  chartsInSight.observe(document.getElementById(id));
};

window.addEventListener("beforeprint", () => {
  for (const [id, given] of waitingCharts) relocbench.drawChart(id, ...given);
  waitingCharts.clear();
});

relocbench.drawChart = async (id, traces, layout, onClick = null) => {
  await relocbench.script("assets/plotly.min.js");
  const { css } = relocbench;
  const axis = { gridcolor: css("--line"), zerolinecolor: css("--line"), linecolor: css("--line-strong"), automargin: true };
  const node = document.getElementById(id);
  // Plotly shows a few tags of HTML in texts: names are escaped by those who give them.
  await Plotly.react(node, traces, {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: css("--text"), family: css("--font"), size: 12 },
    margin: { l: 52, r: 12, t: 12, b: 44 },
    showlegend: false,
    hovermode: "closest",
    hoverlabel: { bgcolor: css("--raised"), bordercolor: css("--line-strong"), font: { color: css("--text") } },
    ...layout,
    xaxis: { ...axis, ...layout.xaxis },
    yaxis: { ...axis, ...layout.yaxis },
  }, { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] });
  node.removeAllListeners("plotly_click");
  if (onClick) node.on("plotly_click", onClick);
};
