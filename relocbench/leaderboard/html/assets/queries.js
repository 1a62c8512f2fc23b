/* What the pages of single queries share: going through a method's list, keys, and pictures. */
"use strict";

relocbench.queries = (() => {
  const { element, state, load } = relocbench;
  const $ = (id) => document.getElementById(id);

  function tell(...what) {
    $("note").hidden = !what.length;
    $("note").replaceChildren(...what);
    if (what.length) $("shown").hidden = true;
  }

  const allResults = () => element("a", { href: "index.html" }, "all results");
  const fact = (name, ...value) => element("div", {}, element("dt", {}, name), element("dd", {}, ...value));

  /**
   * The task and the row of the query that the address asks for; null where there is none, and the page says why.
   * open: (set, task) => its payloads; rowOf: (of, query) => row or -1; latest: () => whether nothing else was asked for since
   */
  async function findQuery(open, rowOf, latest, whole) {
    const { set, task, query } = state.all();
    const none = (...why) => { tell(...why, allResults(), "."); return null; };
    if (!set || !task || !query) return none(`This page shows one query. Choose one in the list that opens with a click on a number of a ${whole}: `);
    let of = null;
    try { of = await open(set, task); } catch (error) { return latest() ? none(`The task cannot be shown: ${error.message}. See `) : null; }
    if (!latest()) return null;
    const row = rowOf(of, query);
    if (row < 0) return none(`The task '${of.name}' has no query ${query}. See `);
    tell();
    $("shown").hidden = false;
    $("pictured").disabled = !of.pictured.size;
    if (!of.pictured.size) $("pictured").checked = false;
    return { of, row };
  }

  /** A picture, or a field that says why there is none. */
  async function picture(node, setId, name, alt) {
    let known = null;
    if (name) try { known = await load(`thumbnails/${setId}/${name}`); } catch { known = null; }
    node.replaceChildren(known
      ? element("img", { class: "picture", src: known.src, width: known.width, height: known.height, alt })
      : element("div", { class: "no-picture", role: "img", "aria-label": `${alt}: no image in this copy` }, "no image in this copy"));
  }

  /**
   * A list that is walked through: the arrow keys and buttons choose the query, m and n the method.
   * page: {key: what the method is called in the address, labels, label, list, at, name: (row) => text, render}
   */
  function walk(now) {
    const go = (step) => {
      const page = now();
      if (!page || !page.list.length) return;
      const to = page.at < 0 ? 0 : page.at + step;
      if (to < 0 || to >= page.list.length) return;
      state.set({ query: page.name(page.list[to]) });
      page.render();
    };
    const choose = (label) => { const page = now(); state.set({ [page.key]: label }); page.render(); };
    const next = (step) => {
      const page = now();
      if (page) choose(page.labels.at((page.labels.indexOf(page.label) + step) % page.labels.length));
    };
    $("previous").addEventListener("click", () => go(-1));
    $("next").addEventListener("click", () => go(1));
    $("method").addEventListener("change", () => choose($("method").value));
    $("pictured").addEventListener("change", () => { state.set({ pictured: $("pictured").checked ? "1" : null }); now()?.render(); });
    $("pictured").checked = state.get("pictured") === "1";
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input[type=text], input[type=search], textarea")) return;
      if (event.target.closest(".scroll") && event.key.startsWith("Arrow")) return; // a table that is scrolled by keys
      const step = { ArrowLeft: () => go(-1), ArrowRight: () => go(1), m: () => next(1), n: () => next(-1) }[event.key];
      if (!step) return;
      event.preventDefault();
      step();
    });
    addEventListener("hashchange", () => now()?.render ? now().render() : location.reload());
  }

  /** Where a query stands in the list of a method, and the choice of methods. */
  function place(page, words) {
    $("method").replaceChildren(...page.labels.map((l) => element("option", { value: l, selected: l === page.label }, l)));
    $("previous").disabled = page.at === 0 || !page.list.length;
    $("next").disabled = page.at === page.list.length - 1 || !page.list.length;
    $("place").textContent = page.at < 0 ? `not among the ${page.list.length} queries with images` : `${page.at + 1} of ${page.list.length} ${words}, worst first`;
  }

  /** The end of an image's path, with all of it where the pointer rests. */
  const named = (key) => element("span", { title: key }, key.split("/").slice(-2).join("/"));

  return { named, $, findQuery, fact, picture, walk, place };
})();
