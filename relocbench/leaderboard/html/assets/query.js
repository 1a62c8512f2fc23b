/* The page of a query of retrievers: the first images of a method, which are right, and what others found. */
"use strict";

(() => {
  const { element, number, state, load, STATUS } = relocbench;
  const { $, findQuery, fact, named, picture, walk, place } = relocbench.queries;
  const site = relocbench.payload("site");
  const decoded = new Map();
  let now = null;
  let turn = 0;

  async function open(setId, name) {
    const key = `${setId}/${name}`;
    if (!decoded.has(key)) {
      const set = await load(`retrieval/${setId}`), task = Object.hasOwn(set.tasks, name) ? set.tasks[name] : null;
      if (!task) throw new Error(`the set has no task '${name}'`);
      const [ranks, lists] = await Promise.all([load(task.ranks), load(task.lists)]);
      const rows = lists.rows || Array.from({ length: ranks.queries.length }, (_, i) => i);
      const methods = Object.fromEntries(Object.entries(ranks.methods).map(([label, m]) => [label, {
        first: Float64Array.from(m.first, (value) => (value > 0n ? Number(value) : Infinity)),
        status: m.status, seconds: m.seconds, ...lists.methods[label],
      }]));
      decoded.set(key, {
        setId, name, set, task, lists, methods, queries: ranks.queries, groups: ranks.groups, positives: ranks.positives, gallery: ranks.gallery,
        places: new Map(rows.map((row, at) => [row, at])), pictured: new Set(Object.keys(lists.queries).map(Number)),
      });
    }
    return decoded.get(key);
  }

  function listOf(of, label) {
    const first = of.methods[label].first;
    const rows = [...first.keys()].filter((row) => !$("pictured").checked || of.pictured.has(row));
    return rows.sort((a, b) => (first[a] === first[b] ? 0 : first[b] > first[a] ? 1 : -1));
  }

  async function render() {
    const own = ++turn, found = await findQuery(open, (one, query) => one.queries.indexOf(query), () => own === turn, "set");
    if (!found) return;
    const { of, row } = found, wanted = state.all();
    const labels = Object.keys(of.methods);
    const label = labels.includes(wanted.method) ? wanted.method : labels.find((l) => !of.set.methods[l].baseline) || labels[0];
    const list = listOf(of, label);
    now = { key: "method", of, row, labels, label, list, at: list.indexOf(row), name: (r) => of.queries[r], render };
    document.title = `${of.queries[row]} – relocbench`;
    $("title").textContent = `${of.task.gallery} ← ${of.task.query}`;
    $("facts").replaceChildren(
      fact("set", element("a", { href: `retrieval-${of.setId}.html#table=${encodeURIComponent(of.name)}` }, of.set.title)), fact("task", of.name), fact("query", of.queries[row]),
      ...(of.groups ? [fact("place", of.groups[row])] : []), fact("right images", String(of.positives[row])), fact("gallery", String(of.gallery)));
    place(now, "queries");
    drawTop();
    drawRight();
    drawNumbers();
    await picture($("query-picture"), of.setId, of.lists.queries[row], "Query image");
    $("query-picture").className = "frame";
  }

  /** A card of an image: [place, metres, right?]; the order and the words say what the colour says. */
  function card(of, [image, metres, right], words) {
    const frame = element("div", { class: "card-picture" }), told = [];
    if (right !== undefined && right !== null) told.push(element("span", { class: right ? "yes" : "no" }, right ? "✓ right" : "✗ wrong"));
    if (metres !== null && metres !== undefined) told.push(`${told.length ? " · " : ""}${number(metres, "m")} m away`);
    picture(frame, of.setId, of.lists.pictures[image], `${words}: ${of.lists.images[image]}`);
    return element("li", { class: `card${right === 1 ? " is-right" : right === 0 ? " is-wrong" : ""}` }, frame,
      element("div", { class: "words" }, element("div", {}, element("strong", {}, words), " ", ...told), element("div", { class: "name" }, named(of.lists.images[image]))));
  }

  const rankOf = (value) => (Number.isFinite(value) ? String(value) : "none");

  function drawTop() {
    const { of, row, label } = now, m = of.methods[label], at = of.places.get(row);
    const top = at === undefined ? [] : m.top[at];
    $("top-title").textContent = `First images of ${label}`;
    const first = m.first[row];
    $("verdict").replaceChildren(element("span", { class: "verdict" }, !of.positives[row] ? "No image of the gallery is right." : Number.isFinite(first) ? `The first right image has rank ${first} of ${of.gallery}.` : "No right image was retrieved."));
    $("top").replaceChildren(...top.map((told, i) => card(of, told, `${i + 1}.`)));
    if (!top.length) $("top").replaceChildren(element("li", { class: "muted small" }, at === undefined ? "The lists of this query are not in this copy." : "Nothing was retrieved."));
  }

  function drawRight() {
    const { of, row } = now, at = of.places.get(row), right = of.lists.right && at !== undefined ? of.lists.right[at] : null;
    const all = Number(of.positives[row]), near = right?.some(([, metres]) => metres !== null);
    $("right-about").textContent = right === null ? "Which images are right is not known without the dataset." : !all ? "There are none in the gallery." : right.length < all ? `${near ? "The nearest" : "The first"} ${right.length} of ${all}.` : `All ${all}.`;
    $("right").replaceChildren(...(right ?? []).map((told, i) => card(of, told, `${i + 1}.`)));
  }

  function drawNumbers() {
    const { of, row, labels, label } = now, at = of.places.get(row);
    const order = [...labels].sort((a, b) => of.methods[a].first[row] - of.methods[b].first[row] || 0);
    $("numbers").replaceChildren(...order.map((l) => {
      const m = of.methods[l], flags = (at === undefined ? [] : m.top[at]).map(([, , right]) => element("span", { class: right === 1 ? "yes" : right === 0 ? "no" : "" }, right === 1 ? "✓" : right === 0 ? "✗" : "?"));
      const words = (at === undefined ? [] : m.top[at]).map(([, , right]) => (right === 1 ? "right" : right === 0 ? "wrong" : "not known")).join(", ");
      const choose = element("button", { type: "button", class: "cell", onclick: () => { state.set({ method: l }); render(); } }, l);
      return element("tr", { class: l === label ? "chosen" : null },
        element("td", { class: "text" }, choose), element("td", {}, rankOf(m.first[row])),
        element("td", { class: "text" }, element("span", { class: "flags", role: "img", "aria-label": words || "nothing" }, ...flags)),
        element("td", {}, number(m.seconds[row], "s")), element("td", { class: "text" }, STATUS[site.statuses[m.status[row]]]), element("td", { class: "text message" }, (at === undefined ? "" : m.messages[at]) || ""));
    }));
  }

  walk(() => now);
  render();
})();
