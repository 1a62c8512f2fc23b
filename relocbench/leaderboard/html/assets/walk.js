/* What the pages of a pair and of a query share: the way through the answers of a method, worst first, by buttons, keys and
   the address. */
"use strict";

/** A fact of a list of facts. */
relocbench.fact = (name, ...value) => relocbench.element("div", {}, relocbench.element("dt", {}, name), relocbench.element("dd", {}, ...value));

/**
 * Run such a page: payloads of its sets lie in `folder`, `content` is the element that shows a unit, `taskKey` and `unitKey` are the
 * keys of the address, `taskWord` says what a task is, and `keys` has further keys of the keyboard. `draw` is called with what is shown
 * (the set, the task, its answers and details, the chosen label and row) and a function that says whether it still is.
 */
relocbench.walk = ({ folder, content, taskKey, taskWord, unitKey, draw, keys }) => {
  const { element, state, load, option, unitName, worstFirst } = relocbench;
  const $ = (id) => document.getElementById(id);
  const opened = new Map();
  let now = null, turn = 0;

  function tell(...what) {
    $("note").hidden = !what.length;
    $("note").replaceChildren(...what);
  }

  /** A task of a set; details of row i are at place `places.get(i)`. */
  async function open(setId, name) {
    const key = `${setId}/${name}`;
    if (!opened.has(key)) {
      const set = await load(`${folder}/${setId}`), task = Object.hasOwn(set.tasks, name) ? set.tasks[name] : null;
      if (!task) throw new Error(`the set has no ${taskWord} '${name}'`);
      const beside = task.pictures ?? task.details, [answers, details] = await Promise.all([load(task.answers), beside ? load(beside) : null]);
      const labels = Object.keys(answers.methods), kept = details?.rows || Array.from(answers.units.query, (_, row) => row);
      const readers = Object.fromEntries(labels.map((label) => [label, relocbench.reader(set, name, answers, label)]));
      opened.set(key, {
        set, name, task, answers, details, labels, lists: {}, rowOf: (label, row) => readers[label](row), places: new Map(kept.map((row, place) => [row, place])),
        pictured: new Set(details?.pictured ? details.pictured.map((place) => kept[place]) : Object.keys(details?.queries ?? {}).map(Number)),
      });
    }
    return opened.get(key);
  }

  async function render() {
    const own = ++turn, wanted = state.all(), { set: setId, [taskKey]: name, [unitKey]: unit } = wanted;
    const none = (...why) => { $(content).hidden = true; tell(...why, element("a", { href: "index.html" }, "all results"), "."); };
    if (!setId || !name || !unit) return none(`This page shows one ${unitKey}. Choose one in the list that opens with a click on a number of a set: `);
    let of = null;
    try { of = await open(setId, name); } catch (error) { return own === turn ? none(`The ${taskWord} cannot be shown: ${error.message}. See `) : null; }
    if (own !== turn) return null;
    const method = of.set.page.method, label = of.labels.includes(wanted[method]) ? wanted[method] : of.labels.find((each) => of.set.methods[each]?.competes) || of.labels[0];
    const every = of.lists[label] ??= worstFirst(relocbench.rows(of.set, of.name, of.answers, label), of.set.worst), row = every.find((each) => unitName(each) === unit);
    if (!row) return none(`The ${taskWord} '${of.name}' has no ${unitKey} ${unit}. See `);
    tell();
    $(content).hidden = false;
    $("pictured").disabled = !of.pictured.size;
    if (!of.pictured.size) $("pictured").checked = false;
    const list = every.filter((each) => !$("pictured").checked || of.pictured.has(each.row)), at = list.indexOf(row);
    now = { ...of, row, label, list, at, place: of.places.get(row.row) };
    $("method").replaceChildren(...of.labels.map((each) => option(each, each, label)));
    $("previous").disabled = at === 0 || !list.length;
    $("next").disabled = at === list.length - 1 || !list.length;
    $("place").textContent = at < 0 ? `not among the ${list.length} ${of.set.units} with images` : `${at + 1} of ${list.length} ${of.set.units}, worst first`;
    draw(now, () => own === turn);
    return null;
  }

  function choose(label) {
    state.set({ [now.set.page.method]: label });
    render();
  }

  function go(step) {
    const to = now?.list[now.at < 0 ? 0 : now.at + step];
    if (!to) return;
    state.set({ [unitKey]: unitName(to) });
    render();
  }

  /** Choose the next method, or the one before. */
  const nextMethod = (step) => choose(now.labels.at((now.labels.indexOf(now.label) + step) % now.labels.length));

  $("previous").addEventListener("click", () => go(-1));
  $("next").addEventListener("click", () => go(1));
  $("method").addEventListener("change", () => choose($("method").value));
  $("pictured").addEventListener("change", () => { state.set({ pictured: $("pictured").checked ? "1" : null }); render(); });
  $("pictured").checked = state.get("pictured") === "1";
  document.addEventListener("keydown", (event) => {
    if (!now || event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.target.closest("select, textarea, input:not([type=checkbox])") && (event.key.startsWith("Arrow") || event.target.tagName === "SELECT")) return;
    if (event.target.closest(".scroll") && event.key.startsWith("Arrow")) return; // a table that is scrolled by keys
    const act = { ArrowLeft: () => go(-1), ArrowRight: () => go(1), ...keys }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  window.addEventListener("hashchange", render);
  render();
  return { tell, choose, nextMethod };
};
