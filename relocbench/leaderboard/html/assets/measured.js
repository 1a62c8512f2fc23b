/* What was measured besides answers: sweeps of one factor, matching of single pixels, and basins of convergence. */
"use strict";

(() => {
  const { element, option, mean, escape, number, state, chart, keys, css, line } = relocbench;
  const $ = (id) => document.getElementById(id);
  const percent = (shares) => shares.map((share) => (share === null ? null : 100 * share));

  /* Sweeps */
  function drawSweep(page) {
    const { extra: { sweep }, set, table, own } = page;
    const names = sweep ? table.tasks.filter((name) => name in sweep.values) : [];
    const values = [...new Set(names.map((name) => sweep.values[name]))].sort((a, b) => a - b);
    $("sweep-section").hidden = values.length < 3;
    if (values.length < 3) return;
    const tableOf = (name) => set.tables.find((t) => !t.total && t.tasks[0] === name && t.group === table.group);
    const span = values.at(-1) - values[0];
    const traces = [], drawn = [];
    let several = false, bars = false;
    own.forEach((label, place) => {
      const points = values.map((value) => {
        const rows = names.filter((name) => sweep.values[name] === value).map((name) => tableOf(name)?.rows.find((row) => row.method === label));
        several ||= rows.length > 1;
        return { value, share: mean(rows.map((row) => row?.values[set.ranking] ?? null)), bounds: rows.length === 1 ? rows[0]?.intervals[set.ranking] : null };
      });
      if (!points.some((point) => point.share !== null)) return;
      bars ||= points.some((point) => point.bounds);
      drawn.push(label);
      const aside = own.length > 1 ? span * 0.02 * (place / (own.length - 1) - 0.5) : 0; // so that intervals do not cover each other
      const reach = (i) => points.map(({ share, bounds }) => (bounds && share !== null ? 100 * Math.abs(bounds[i] - share) : 0));
      const look = line(label, {});
      traces.push({
        ...look, marker: { ...look.marker, maxdisplayed: 0 }, x: values.map((value) => value + aside), y: percent(points.map((point) => point.share)), mode: "lines+markers", type: "scatter", customdata: values,
        error_y: { type: "data", symmetric: false, array: reach(1), arrayminus: reach(0), thickness: 1, width: 3, color: look.line.color },
        hovertemplate: `${escape(label)}<br>%{y:.1f} % at %{customdata:.3g}<extra></extra>`,
      });
    });
    $("sweep-title").textContent = `One factor: ${sweep.name}`;
    $("sweep-about").textContent = `Only ${sweep.name} differs between the queries; the dotted line is where the keyframes have it. `
      + (several ? "Where several pair sets have one value, a point is their mean, without an interval. " : "")
      + (bars ? "Bars are the intervals of the tables." : "There are no intervals: a pair set is worth too few independent pairs, or several have one value.");
    chart("sweep", traces, {
      xaxis: { title: { text: escape(sweep.axis) } }, yaxis: { title: { text: `${escape(set.ranking)}, %` }, range: [-2, 102] },
      shapes: [{ type: "line", x0: sweep.reference, x1: sweep.reference, yref: "paper", y0: 0, y1: 1, line: { color: css("--line-strong"), dash: "dot", width: 1.5 } }],
    }, (event) => { const { meta } = event.points[0].data, value = event.points[0].customdata; page.openList(meta, page.shown[meta].filter((pair) => sweep.values[pair.task] === value), `${sweep.axis} ${number(value, "m")}`); });
    keys("sweep-keys", drawn);
  }

  /** A curve of shares against the offset of starts, with what the starts themselves get. */
  function curve(id, lines, starts, offsets, of) {
    const unit = escape(of);
    const traces = lines.map(({ label, shares, x }) => line(label, { x: x || offsets, y: percent(shares), mode: "lines+markers", type: "scatter", hovertemplate: `${escape(label)}<br>%{y:.1f} % from %{x} ${unit}<extra></extra>` }));
    traces.unshift({ x: offsets, y: percent(starts), mode: "lines", type: "scatter", fill: "tozeroy", fillcolor: css("--line"), line: { color: css("--line-strong"), width: 1, dash: "dot" }, hovertemplate: "the starts themselves<br>%{y:.1f} % from %{x}<extra></extra>" });
    const scale = offsets[0] > 0 ? { type: "log" } : { rangemode: "tozero" };
    chart(id, traces, {
      xaxis: { title: { text: `distance of the start from the truth, ${unit}` }, tickvals: offsets, ...scale }, yaxis: { title: { text: "found, %" }, range: [0, 101] },
    });
    keys(`${id}-keys`, lines.map(({ label }) => label), "grey: what the starts themselves get");
  }

  /* Matching of single pixels */
  function drawMatching(page) {
    const { extra: { matching }, tasks, own } = page, near = $("matching-near").value;
    const known = tasks.map((of) => matching.pair_sets?.[of.name]).filter(Boolean);
    const labels = own.filter((label) => known.length && known.every((of) => label in of.methods));
    $("matching-section").hidden = !labels.length;
    if (!labels.length) return;
    const average = (of) => matching.offsets.map((_, i) => mean(known.map((each) => of(each)[near][i])));
    $("matching-about").textContent = `Pixels whose true place is known are started beside it, and the method brings them back or does not (evaluate --matching). `
      + (known.length > 1 ? `A point is the mean of ${known.length} pair sets. ` : "") + "All pairs count, whichever group is chosen; no intervals are recorded.";
    curve("matching", labels.map((label) => ({ label, shares: average((of) => of.methods[label]) })), average((of) => of.starts), matching.offsets, "px");
  }

  /* Basins of convergence */
  const CHOICES = [["folder", "Probe"], ["what", "Starts"], ["level", "Level of the pyramid"], ["conditions", "Conditions"], ["criterion", "Found"]];
  const WORDS = { pixels: "single pixels", translation: "poses, moved", rotation: "poses, turned" };
  function drawProbe(page) {
    const all = page.extra.probes, lines = all.flatMap((probe) => probe.lines.map((line) => ({ ...line, folder: probe.folder })));
    const starts = all.flatMap((probe) => probe.starts.map((start) => ({ ...start, folder: probe.folder })));
    $("probe-section").hidden = !lines.length && !starts.length;
    $("probe-curves").hidden = !lines.length;
    drawStarts(starts, all.length > 1);
    if (!lines.length) return;
    let left = lines;
    const controls = [];
    for (const [key, title] of CHOICES) {
      const values = [...new Set(left.map((line) => line[key]))], kept = state.get(`probe-${key}`, values[0]), chosen = values.includes(kept) ? kept : values[0];
      left = left.filter((line) => line[key] === chosen);
      if (values.length < 2) continue;
      const text = (value) => (key === "level" ? (value === "" ? "as the method works" : `level ${value} alone`) : WORDS[value] || value);
      const select = element("select", { id: `probe-${key}` }, ...values.map((value) => option(value, text(value), chosen)));
      select.addEventListener("change", () => { state.set({ [`probe-${key}`]: select.value }); drawProbe(page); $(`probe-${key}`)?.focus(); });
      controls.push(element("label", {}, title, select));
    }
    $("probe-controls").replaceChildren(...controls);
    left = left.filter((line) => page.own.includes(line.method) || !page.labels.includes(line.method));
    if (!left.length) return;
    const [first] = left;
    curve("probe", left.map((line) => ({ label: line.method, shares: line.shares, x: line.offsets })), first.starts, first.offsets, first.unit);
    fill("probe-widths", ["method", "pairs", "found from the truth, %", "half of that is left up to"],
      left.map((line) => [line.method, String(line.pairs), number(line.shares[0], "share"), line.half ?? "not recorded of this criterion"]));
  }

  function drawStarts(starts, several) {
    $("probe-starts-section").hidden = !starts.length;
    const share = (value) => number(value, "share");
    fill("probe-starts", ["method", ...(several ? ["probe"] : []), "conditions", "pairs", "from the keyframe's pose, %", "mirrored, %", "random, %", "keyframe's pose less random, points"],
      starts.map((s) => [s.method, ...(several ? [s.folder] : []), s.conditions, String(s.pairs), share(s.keyframe), share(s.mirrored), share(s.random), s.ahead]));
  }

  /** A table of texts, the first of each row being a name. */
  function fill(id, head, rows) {
    const cells = (name, texts) => texts.map((text, i) => element(name, { scope: name === "th" ? "col" : null, class: i ? null : "text" }, text));
    $(id).replaceChildren(element("table", {}, element("thead", {}, element("tr", {}, ...cells("th", head))), element("tbody", {}, ...rows.map((row) => element("tr", {}, ...cells("td", row))))));
  }

  let last = null;
  $("matching-near").addEventListener("change", () => drawMatching(last));
  relocbench.parts.push((page) => {
    last = page;
    Object.assign(relocbench.furtherLooks, page.extra.looks);
    drawSweep(page);
    drawMatching(page);
    drawProbe(page);
  });
})();
