/* The page of a query of pipelines: the keyframes that were retrieved, the tracker's answers, and what the query was lost to. */
"use strict";

(() => {
  const { element, number, state, load, STATUS } = relocbench;
  const { $, findQuery, fact, picture, walk, place } = relocbench.queries;
  const site = relocbench.payload("site");
  const decoded = new Map();
  let now = null;
  let turn = 0;

  async function open(setId, name) {
    const key = `${setId}/${name}`;
    if (!decoded.has(key)) {
      const set = await load(`pipelines/${setId}`), task = Object.hasOwn(set.tasks, name) ? set.tasks[name] : null;
      if (!task) throw new Error(`the set has no task '${name}'`);
      const [answers, candidates] = await Promise.all([load(task.located), set.rescored ? load(task.candidates) : null]);
      const queries = answers.queries, [metres, degrees] = set.right;
      const rows = candidates?.rows || Array.from({ length: queries.length }, (_, i) => i);
      const pipelines = Object.fromEntries(Object.entries(answers.pipelines).map(([label, c]) => {
        const t = c.translation_error_m, r = c.rotation_error_deg;
        return [label, {
          t, r, both: t.map((value, i) => Math.max(value / metres, r[i] / degrees)), confidence: c.confidence, seconds: c.seconds, status: c.status,
          outcome: c.outcome, keyframe: c.keyframe, rank: c.rank, hit: c.hit_rank, right: c.right_rank, asked: c.asked,
          messages: c.messages, told: candidates?.pipelines[label] ?? null,
        }];
      }));
      decoded.set(key, {
        setId, name, set, task, pipelines, candidates, queries, pairs: await pairsOf(task, name),
        places: new Map(rows.map((row, at) => [row, at])), pictured: new Set(Object.keys(candidates?.pictures ?? {}).map(Number)),
      });
    }
    return decoded.get(key);
  }

  /** The pairs of the task that have a page of their own, among the results of trackers. */
  async function pairsOf(task, name) {
    if (!task.trackers) return null;
    try {
      const set = await load(`sets/${task.trackers}`), errors = await load(set.pair_sets[name].key);
      const reference = errors.reference, query = errors.query;
      return { methods: Object.keys(errors.methods), keys: new Set(Array.from(reference, (time, i) => `${time}-${query[i]}`)) };
    } catch { return null; }
  }

  /** As links.py says it; null where the pair has no page. */
  function pairLink(of, keyframe, query, tracker) {
    const pair = `${keyframe}-${query}`;
    if (!of.pairs?.keys.has(pair)) return null;
    const wanted = { set: of.task.trackers, pairset: of.name, pair, ...(of.pairs.methods.includes(tracker) ? { method: tracker } : {}) };
    return "pair.html#" + Object.entries(wanted).map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&");
  }

  function listOf(of, label) {
    const both = of.pipelines[label].both;
    const rows = [...both.keys()].filter((row) => !$("pictured").checked || of.pictured.has(row));
    return rows.sort((a, b) => (both[a] === both[b] ? 0 : both[b] > both[a] ? 1 : -1));
  }

  async function render() {
    const own = ++turn, found = await findQuery(open, (one, query) => one.queries.findIndex((time) => String(time) === query), () => own === turn, "dataset");
    if (!found) return;
    const { of, row } = found, wanted = state.all();
    const labels = Object.keys(of.pipelines), competing = (l) => !of.set.pipelines[l].baseline && !of.set.pipelines[l].oracle;
    const label = labels.includes(wanted.pipeline) ? wanted.pipeline : labels.find(competing) || labels[0];
    const list = listOf(of, label);
    now = { key: "pipeline", of, row, labels, label, list, at: list.indexOf(row), name: (r) => String(of.queries[r]), render };
    document.title = `${of.name} ${of.queries[row]} – relocbench`;
    $("title").textContent = `${of.task.gallery || of.name} ← ${of.task.query || of.name}`;
    $("facts").replaceChildren(
      fact("dataset", element("a", { href: `relocalization-${of.setId}.html#table=${encodeURIComponent(of.name)}` }, of.set.title)), fact("task", of.name), fact("query, ns", String(of.queries[row])));
    place(now, "queries");
    drawVerdict();
    drawPictures();
    drawAsked();
    drawNumbers();
  }

  const ranked = (value) => (value > 0n ? String(value) : "none");
  const told = () => { const { of, row, label } = now, at = of.places.get(row); return at === undefined ? null : of.pipelines[label].told?.[at] ?? null; };

  function drawVerdict() {
    const { of, row, label } = now, c = of.pipelines[label], asked = Number(c.asked[row]), outcome = of.set.outcomes[c.outcome[row]];
    const [metres, degrees] = of.set.right, of_them = asked === 1 ? "the keyframe" : `the ${asked} keyframes`;
    $("verdict").textContent = {
      right: `Right: within ${metres} m and ${degrees}°.`,
      choice: `Lost to the choice: the answer against keyframe ${ranked(c.right[row])} was right, and another one was more confident.`,
      unreachable: "Cannot be judged: the true pose against the keyframe that was kept is not known.",
      retrieval: asked ? `Lost to retrieval: ${asked === 1 ? "the keyframe is not" : `none of ${of_them} is`} in the basin.` : "Lost to retrieval: no keyframe was retrieved.",
      tracking: `Lost to tracking: keyframe ${ranked(c.hit[row])} is in the basin, and no answer is right.`,
    }[outcome] + (c.messages[row] ? ` It said: ${c.messages[row]}` : "");
    $("verdict").className = `verdict ${outcome === "right" ? "yes" : "no"}`;
  }

  const away = (metres, degrees) => (metres === null ? "distance not known" : `${number(metres, "m")} m and ${number(degrees, "deg")}° from the query`);

  function drawPictures() {
    const { of, row, label } = now, c = of.pipelines[label], at = of.places.get(row), shown = of.candidates, list = told();
    const pictureOf = (keyframe) => (keyframe === null ? null : shown?.keyframes[keyframe] ?? null);
    const kept = c.keyframe[row] >= 0n ? String(c.keyframe[row]) : list?.[0]?.[0] ?? null;
    const own = list?.find(([keyframe]) => keyframe === kept), nearest = shown && at !== undefined ? shown.nearest[at] : null;
    picture($("query-picture"), of.setId, of.pictured.has(row) ? shown.pictures[row] : null, "Query image");
    picture($("kept-picture"), of.setId, of.pictured.has(row) ? pictureOf(kept) : null, "Keyframe");
    picture($("nearest-picture"), of.setId, of.pictured.has(row) && nearest ? pictureOf(nearest[0]) : null, "Nearest keyframe");
    $("kept-title").textContent = c.keyframe[row] >= 0n ? `Keyframe that was kept, rank ${ranked(c.rank[row])}` : kept ? "First keyframe, without an answer" : "Keyframe";
    $("kept").className = `card ${of.set.outcomes[c.outcome[row]] === "right" ? "is-right" : "is-wrong"}`;
    $("kept-words").replaceChildren(...(kept ? [element("div", {}, own ? away(own[1], own[2]) : ""), element("div", { class: "name" }, kept)] : ["Nothing was retrieved."]));
    $("nearest-words").replaceChildren(...(nearest ? [element("div", {}, away(nearest[1], nearest[2])), element("div", { class: "name" }, nearest[0])] : ["It is not known without the dataset."]));
  }

  function drawAsked() {
    const { of, row, label } = now, c = of.pipelines[label], list = told(), [metres, degrees] = of.set.right, { tracker } = of.set.pipelines[label];
    $("asked-about").textContent = list === null ? "Which keyframes were retrieved, and where they are, is shown where the dataset is available with rankings and answers beside the pipeline." : "Distance and angle are those of the true pose. A keyframe whose pair is among the results of trackers is linked to it.";
    const rows = list ?? [];
    $("asked").replaceChildren(...rows.map(([keyframe, distance, angle, near, status, confidence, t, r], i) => {
      const link = pairLink(of, keyframe, of.queries[row], tracker), is = Number(t) <= metres && Number(r) <= degrees, kept = String(c.keyframe[row]) === keyframe;
      return element("tr", { class: kept ? "chosen" : null },
        element("td", {}, String(i + 1)), element("td", { class: "text" }, link ? element("a", { href: link }, keyframe) : keyframe),
        element("td", {}, number(distance, "m")), element("td", {}, number(angle, "deg")), element("td", { class: "text" }, distance === null ? "not known" : near ? "yes" : "no"),
        element("td", { class: "text" }, STATUS[status] ?? status), element("td", {}, number(confidence, "")), element("td", {}, number(t, "m")), element("td", {}, number(r, "deg")),
        element("td", { class: "text" }, element("span", { class: is ? "yes" : "no" }, is ? "✓ right" : "✗ wrong"), kept ? ", kept" : ""));
    }));
    if (!rows.length) $("asked").replaceChildren(element("tr", {}, element("td", { class: "text muted", colspan: 10 }, list === null ? "not known" : "none")));
  }

  function drawNumbers() {
    const { of, row, labels, label } = now, order = [...labels].sort((a, b) => of.pipelines[a].both[row] - of.pipelines[b].both[row] || 0);
    $("numbers").replaceChildren(...order.map((l) => {
      const c = of.pipelines[l], outcome = of.set.outcomes[c.outcome[row]];
      return element("tr", { class: l === label ? "chosen" : null },
        element("td", { class: "text" }, element("button", { type: "button", class: "cell", onclick: () => { state.set({ pipeline: l }); render(); } }, l)),
        element("td", { class: "text" }, element("span", { class: outcome === "right" ? "yes" : "no" }, outcome === "right" ? "right" : `lost to ${outcome}`)),
        element("td", {}, number(c.t[row], "m")), element("td", {}, number(c.r[row], "deg")), element("td", {}, ranked(c.rank[row])), element("td", {}, ranked(c.hit[row])), element("td", {}, ranked(c.right[row])),
        element("td", {}, number(c.seconds[row], "s")), element("td", { class: "text message" }, c.messages[row] || ""));
    }));
  }

  walk(() => now);
  render();
})();
