/* A map of the drive: the queries of the chosen table from above, coloured by the error of one method. */
"use strict";

(() => {
  const { element, option, sign, state, load, escape, chart, pairText, openPair, css } = relocbench;
  const $ = (id) => document.getElementById(id);
  const MOST_SVG = 1500; // points up to which they are drawn sharply, and as marks that print well
  const FAINT = 0.01, STRONG = 10; // errors at the ends of the colours, in thresholds
  let last = null;

  /** Good to bad, as on all maps, with a step at the threshold: what is found is blue, what is missed orange. */
  const AT_THRESHOLD = Math.log10(1 / FAINT) / Math.log10(STRONG / FAINT);
  const [[, BAD], , [, GOOD]] = relocbench.QUALITY, JUST_GOOD = "#b7cbef", JUST_BAD = "#eec6a4";
  const colourscale = () => [[0, GOOD], [AT_THRESHOLD, JUST_GOOD], [AT_THRESHOLD, JUST_BAD], [1, BAD]];

  /** The points of a world: each pair that has a place there. */
  function pointsIn(world, page, label, places) {
    const out = [];
    for (const pair of page.shown[label]) {
      const place = places.get(pair.task);
      const at = place.world === world ? place : place.own?.world === world ? place.own : null;
      if (at && Number.isFinite(at.x[pair.row])) out.push({ pair, x: at.x[pair.row], y: at.y[pair.row] });
    }
    return out;
  }

  /** The drives of the chosen table whose poses are in a world. */
  function drives(page, world) {
    const inWorld = page.extra.worlds[world].routes, pairs = page.tasks.map((of) => page.extra.drives[of.name]);
    const [keyframes, queries] = [0, 1].map((side) => [...new Set(pairs.map((pair) => pair[side]))].filter((name) => name in inWorld));
    return { keyframes, queries: queries.filter((name) => !keyframes.includes(name)), all: [...new Set([...queries, ...keyframes])] };
  }

  function routes(world, page) {
    const own = page.extra.worlds[world].routes, { keyframes, all } = drives(page, world);
    return all.map((name) => ({
      x: own[name].x, y: own[name].y, mode: "lines", type: "scatter", hoverinfo: "skip", meta: name,
      line: { color: css("--line-strong"), width: keyframes.includes(name) ? 2 : 1.25, dash: keyframes.includes(name) ? "solid" : "dot" },
    }));
  }

  const placesOf = ({ set, tasks }) => Promise.all(tasks.map((of) => load(`maps/${set.id}/${set.tasks[of.name].answers.split("/").at(-1)}`)));

  async function drawn(page, label, world) {
    const { extra, field, mark } = page;
    const known = await placesOf(page);
    if (page !== last) return null;
    const places = new Map(page.tasks.map((of, i) => [of.name, known[i]]));
    const points = pointsIn(world, page, label, places), type = points.length > MOST_SVG ? "scattergl" : "scatter";
    keys(page, label, world, page.shown[label].length - points.length);
    const answered = points.filter(({ pair }) => Number.isFinite(pair[field])).sort((a, b) => a.pair[field] - b.pair[field]);
    const without = points.filter(({ pair }) => !Number.isFinite(pair[field]));
    const trace = (some) => ({
      type, mode: "markers", x: some.map((p) => p.x), y: some.map((p) => p.y), customdata: some.map((p) => page.pairLink(p.pair, label)),
      text: some.map((p) => pairText(p.pair)), hovertemplate: `${escape(label)}<br>%{text}<extra></extra>`, meta: label,
    });
    const size = innerWidth < 640 ? 6 : 9;
    const traces = [
      ...routes(world, page),
      {
        ...trace(answered),
        marker: {
          size, color: answered.map(({ pair }) => Math.log10(Math.min(Math.max(pair[field] / mark, FAINT), STRONG))), cmin: Math.log10(FAINT), cmax: Math.log10(STRONG),
          colorscale: colourscale(), line: { color: css("--line-strong"), width: 1 },
          showscale: false,
        },
      },
      { ...trace(without), marker: { symbol: "x-thin", size, line: { color: css("--text"), width: 2 } } },
    ];
    const { axes, origin } = extra.worlds[world];
    const axis = (i) => `${axes[i].replace("-", "−") || ["to the right", "to the top"][i]}, m${origin[i] ? ` from ${origin[i]}` : ""}`;
    return [traces, {
      margin: { l: 56, r: 12, t: 12, b: 44 }, xaxis: { title: { text: axis(0) }, zeroline: false }, yaxis: { title: { text: axis(1) }, scaleanchor: "x", zeroline: false },
    }, (event) => { const [point] = event.points; if (point.customdata) openPair(point.customdata, event.event); }];
  }

  function keys(page, label, world, unplaced = 0) {
    const mark = (markup) => sign(20, 12, markup);
    const line = (dash) => mark(`<line x1="0" y1="6" x2="20" y2="6" stroke="${css("--line-strong")}" stroke-width="2" stroke-dasharray="${dash}"/>`);
    const { keyframes, queries } = drives(page, world);
    const some = (names) => (names.length > 4 ? `${names.length} drives` : names.join(", "));
    const unknown = unplaced ? element("li", { class: "muted" }, `${unplaced} of ${page.shown[label].length} pairs have no place in this world`) : null;
    const missing = page.shown[label].filter((pair) => !Number.isFinite(pair[page.field])).length;
    $("map-keys").replaceChildren(...[
      element("li", {}, mark(`<circle cx="10" cy="6" r="5" fill="${GOOD}" stroke="${css("--line-strong")}"/>`), "where a query stands: blue if it is found, orange if it is missed; the worst are on top"),
      element("li", {}, mark(`<path d="M6 2L14 10M14 2L6 10" stroke="${css("--text")}" stroke-width="2"/>`), `no answer: ${missing} of ${page.shown[label].length}`),
      keyframes.length ? element("li", {}, line(""), `drive of the keyframes: ${some(keyframes)}`) : null,
      queries.length ? element("li", {}, line("2 3"), `of the queries: ${some(queries)}`) : null,
      unknown,
    ].filter(Boolean));
  }

  /** What the colours mean: a bar of them over a factor of 1000, with the threshold in bold. */
  function scale({ mark, unit, title }) {
    const words = (times) => `${Number((times * mark).toPrecision(3))}${{ m: " m", deg: "°" }[unit] || ""}`;
    $("map-scale").replaceChildren(
      element("span", { class: "small muted" }, title),
      element("span", { class: "gradient", style: `background: linear-gradient(to right, ${colourscale().map(([at, colour]) => `${colour} ${100 * at}%`).join(", ")})`, role: "img", "aria-label": `Colours from ${words(FAINT)} to ${words(STRONG)}, on a logarithmic scale` }),
      element("span", { class: "ticks small" }, element("span", {}, `≤ ${words(FAINT)}`), element("span", {}, words(0.1)), element("b", {}, words(1)), element("span", {}, `≥ ${words(STRONG)}`)),
    );
  }

  /** The worlds that hold pairs of the chosen table, with what they are called. */
  const worldsOf = (page) => page.extra.worlds.map((world, i) => [i, world]).filter(([i]) => drives(page, i).all.length);

  function draw() {
    const page = last, methods = page.labels.filter((label) => page.shown[label]?.length);
    const worlds = worldsOf(page);
    $("map-section").hidden = !methods.length || !worlds.length;
    if ($("map-section").hidden) return;
    const asked = state.get("map") || state.get("method");
    const label = methods.includes(asked) ? asked : methods.find((l) => !page.set.methods[l].baseline) || methods[0];
    const world = worlds.some(([i]) => String(i) === state.get("world")) ? Number(state.get("world")) : worlds[0][0];
    $("map-method").replaceChildren(...methods.map((l) => option(l, l, label)));
    $("map-world").replaceChildren(...worlds.map(([i, w]) => option(String(i), `that of ${w.name}`, String(world))));
    $("map-of").hidden = worlds.length < 2;
    scale(page);
    keys(page, label, world);
    chart("map", () => drawn(page, label, world));
    setTimeout(() => placesOf(page), 1000); // so that they are there when the page is printed before the map was in sight
  }

  $("map-method").addEventListener("change", () => { state.set({ map: $("map-method").value }); draw(); });
  $("map-world").addEventListener("change", () => { state.set({ world: $("map-world").value }); draw(); });
  $("map-list").addEventListener("click", () => { const label = $("map-method").value; last.open(label); });

  relocbench.parts.push((page) => {
    last = page;
    if (!page.extra.worlds) {
      $("map-about").textContent = "Results hold no positions: there is a map where the dataset is available. Write the pages again with --dataset FOLDER.";
      return;
    }
    $("map-about").textContent = "From above. Queries stand where the truth puts them beside their keyframe. "
      + (worldsOf(page).length > 1 ? "These drives do not share a world: each world has a map of its own, where the pairs whose keyframes or queries are in it stand. " : "")
      + "A click opens the pair.";
    draw();
  });
})();
