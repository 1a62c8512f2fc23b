/* The page of a query of retrievers or of pipelines: what was retrieved and answered, and what other methods found. The arrow
   keys and buttons go through the queries of a method, worst first; m and n through the methods. */
"use strict";

(() => {
  const { element, number, state, load, hash, shortName, worstFirst, KINDS, STATUS } = relocbench;
  const $ = (id) => document.getElementById(id);
  const kind = $("shown").dataset.sets, ofEveryMethod = ["task", "query", "group", "positives"];
  const opened = new Map();
  let now = null; // what is shown: the task, the query, the method and its list
  let turn = 0;

  function tell(...what) {
    $("note").hidden = !what.length;
    $("note").replaceChildren(...what);
    if (what.length) $("shown").hidden = true;
  }

  async function open(setId, name) {
    const key = `${setId}/${name}`;
    if (!opened.has(key)) {
      const set = await load(`${kind}/${setId}`), task = Object.hasOwn(set.tasks, name) ? set.tasks[name] : null;
      if (!task) throw new Error(`the set has no task '${name}'`);
      const [answers, details] = await Promise.all([load(task.answers), task.details ? load(task.details) : null]);
      const labels = Object.keys(answers.methods), kept = details?.rows || Array.from(answers.units.query, (_, row) => row);
      opened.set(key, {
        set, name, task, answers, details, labels, rows: Object.fromEntries(labels.map((label) => [label, relocbench.rows(set, name, answers, label)])),
        pairs: await pairsOf(task, name), places: new Map(kept.map((row, at) => [row, at])), pictured: new Set(Object.keys(details?.queries ?? {}).map(Number)),
      });
    }
    return opened.get(key);
  }

  /** The pairs of the task that have a page of their own, among the results of trackers. */
  async function pairsOf(task, name) {
    if (!task.trackers) return null;
    try {
      const set = await load(`sets/${task.trackers}`), { methods, units: { reference, query } } = await load(set.tasks[name].answers);
      return { methods: Object.keys(methods), keys: new Set(Array.from(reference, (time, i) => `${time}-${query[i]}`)) };
    } catch { return null; }
  }

  async function render() {
    const own = ++turn, { set: setId, task, query, ...wanted } = state.all();
    const none = (...why) => tell(...why, element("a", { href: "index.html" }, "all results"), ".");
    if (!setId || !task || !query) return none("This page shows one query. Choose one in the list that opens with a click on a number of a set: ");
    let of = null;
    try { of = await open(setId, task); } catch (error) { return own === turn ? none(`The task cannot be shown: ${error.message}. See `) : null; }
    if (own !== turn) return null;
    const row = of.answers.units.query.findIndex((each) => String(each) === query), method = of.set.page.method;
    if (row < 0) return none(`The task '${of.name}' has no query ${query}. See `);
    tell();
    $("shown").hidden = false;
    $("pictured").disabled = !of.pictured.size;
    if (!of.pictured.size) $("pictured").checked = false;
    const label = of.labels.includes(wanted[method]) ? wanted[method] : of.labels.find((each) => of.set.methods[each].competes) || of.labels[0];
    const list = worstFirst(of.rows[label], of.set.worst).filter((each) => !$("pictured").checked || of.pictured.has(each.row));
    now = { ...of, row: of.rows[label][row], label, list, at: list.findIndex((each) => each.row === row), place: of.places.get(row) };
    document.title = `${shortName(query)} – relocbench`;
    $("title").textContent = `${of.task.gallery || of.name} ← ${of.task.query || of.name}`;
    const fact = (name, ...value) => element("div", {}, element("dt", {}, name), element("dd", {}, ...value));
    $("facts").replaceChildren(
      fact("set", element("a", { href: `${kind === "retrieval" ? "retrieval" : "relocalization"}-${setId}.html${hash({ table: of.name })}` }, of.set.title)), fact("task", of.name), fact("query", query),
      ...(now.row.group ? [fact("place", now.row.group)] : []), ...("positives" in now.row ? [fact("right images", String(now.row.positives)), fact("gallery", String(of.answers.gallery))] : []));
    $("method").replaceChildren(...of.labels.map((each) => element("option", { value: each, selected: each === label }, each)));
    $("previous").disabled = now.at === 0 || !list.length;
    $("next").disabled = now.at === list.length - 1 || !list.length;
    $("place").textContent = now.at < 0 ? `not among the ${list.length} queries with images` : `${now.at + 1} of ${list.length} queries, worst first`;
    picture($("query-picture"), of.details?.queries[row], "Query image");
    for (const draw of kind === "retrieval" ? [drawTop, drawRight] : [drawVerdict, drawPictures, drawAsked]) draw(now);
    drawNumbers(now);
    return null;
  }

  /** A picture, or a field that says why there is none. */
  async function picture(node, name, alt) {
    let known = null;
    if (name) try { known = await load(`thumbnails/${now.set.id}/${name}`); } catch { known = null; }
    node.replaceChildren(known
      ? element("img", { class: "picture", src: known.src, width: known.width, height: known.height, alt })
      : element("div", { class: "no-picture", role: "img", "aria-label": `${alt}: no image in this copy` }, "no image in this copy"));
  }

  /* Retrievers: the first images, and those that are right */
  /** A card of an image: [place, metres, right?]; the order and the words say what the colour says. */
  function card({ details }, [image, metres, right], words) {
    const frame = element("div", { class: "card-picture" }), told = [], name = details.images[image];
    if (right !== undefined && right !== null) told.push(element("span", { class: right ? "yes" : "no" }, right ? "✓ right" : "✗ wrong"));
    if (metres !== null && metres !== undefined) told.push(`${told.length ? " · " : ""}${number(metres, "m")} m away`);
    picture(frame, details.pictures[image], `${words}: ${name}`);
    return element("li", { class: `card${right === 1 ? " is-right" : right === 0 ? " is-wrong" : ""}` }, frame,
      element("div", { class: "words" }, element("div", {}, element("strong", {}, words), " ", ...told), element("div", { class: "name" }, element("span", { title: name }, shortName(name)))));
  }

  const firstImages = ({ details, place }, label) => (place === undefined ? [] : details.methods[label].top[place]);

  function drawTop({ answers, row: { first, positives }, label, place }) {
    const top = firstImages(now, label);
    $("top-title").textContent = `First images of ${label}`;
    $("verdict").textContent = !positives ? "No image of the gallery is right." : Number.isFinite(first) ? `The first right image has rank ${first} of ${answers.gallery}.` : "No right image was retrieved.";
    $("top").replaceChildren(...top.map((told, i) => card(now, told, `${i + 1}.`)));
    if (!top.length) $("top").replaceChildren(element("li", { class: "muted small" }, place === undefined ? "The lists of this query are not in this copy." : "Nothing was retrieved."));
  }

  function drawRight({ details, row: { positives }, place }) {
    const right = details.right && place !== undefined ? details.right[place] : null, near = right?.some(([, metres]) => metres !== null);
    $("right-about").textContent = right === null ? "Which images are right is not known without the dataset." : !positives ? "There are none in the gallery." : right.length < positives ? `${near ? "The nearest" : "The first"} ${right.length} of ${positives}.` : `All ${positives}.`;
    $("right").replaceChildren(...(right ?? []).map((told, i) => card(now, told, `${i + 1}.`)));
  }

  /** Which of the first images of a method are right, as signs. */
  function flags(label) {
    const right = firstImages(now, label).map(([, , is]) => ({ 1: ["yes", "✓", "right"], 0: ["no", "✗", "wrong"] })[is] ?? ["", "?", "not known"]);
    return element("span", { class: "flags", role: "img", "aria-label": right.map(([, , words]) => words).join(", ") || "nothing" }, ...right.map(([name, sign]) => element("span", { class: name }, sign)));
  }

  /* Pipelines: the keyframe that was kept, and all that were retrieved */
  const ranked = (rank) => (Number.isFinite(rank) ? String(rank) : "none");
  const keyframes = ({ details, label, place }) => (place === undefined ? null : details?.pipelines[label]?.[place] ?? null);

  function drawVerdict({ set, answers, row: { row, outcome, asked, right_rank, hit_rank }, label }) {
    const message = answers.methods[label].messages[row];
    $("verdict").textContent = {
      right: `Right: within ${set.correct[0]} m and ${set.correct[1]}°.`,
      choice: `Lost to the choice: the answer against keyframe ${ranked(right_rank)} was right, and another one was more confident.`,
      unreachable: "Cannot be judged: the true pose against the keyframe that was kept is not known.",
      retrieval: asked ? `Lost to retrieval: ${asked === 1 ? "the keyframe is not" : `none of the ${asked} keyframes is`} in the basin.` : "Lost to retrieval: no keyframe was retrieved.",
      tracking: `Lost to tracking: keyframe ${ranked(hit_rank)} is in the basin, and no answer is right.`,
    }[outcome] + (message ? ` It said: ${message}` : "");
    $("verdict").className = `verdict ${outcome === "right" ? "yes" : "no"}`;
  }

  function drawPictures({ details, pictured, row: { row, keyframe, rank, outcome }, place }) {
    const list = keyframes(now), answered = keyframe >= 0n, kept = answered ? String(keyframe) : list?.[0]?.[0] ?? null;
    const own = list?.find(([time]) => time === kept), nearest = details && place !== undefined ? details.nearest[place] : null;
    const pictureOf = (time) => (pictured.has(row) && time ? details.keyframes[time] : null);
    const words = (time, metres, degrees) => [element("div", {}, metres === null ? "distance not known" : metres === undefined ? "" : `${number(metres, "m")} m and ${number(degrees, "deg")}° from the query`), element("div", { class: "name" }, time)];
    picture($("kept-picture"), pictureOf(kept), "Keyframe");
    picture($("nearest-picture"), pictureOf(nearest?.[0]), "Nearest keyframe");
    $("kept-title").textContent = answered ? `Keyframe that was kept, rank ${ranked(rank)}` : kept ? "First keyframe, without an answer" : "Keyframe";
    $("kept").className = `card ${outcome === "right" ? "is-right" : "is-wrong"}`;
    $("kept-words").replaceChildren(...(kept ? words(kept, own?.[1], own?.[2]) : ["Nothing was retrieved."]));
    $("nearest-words").replaceChildren(...(nearest ? words(...nearest) : ["It is not known without the dataset."]));
  }

  /** The link to the page of a pair; null where it has none. */
  function pairLink({ task, name, pairs, row: { query } }, keyframe, tracker) {
    const pair = `${keyframe}-${query}`;
    return pairs?.keys.has(pair) ? `pair.html${hash({ set: task.trackers, pairset: name, pair, ...(pairs.methods.includes(tracker) ? { method: tracker } : {}) })}` : null;
  }

  function drawAsked({ set, row: { keyframe: kept }, label }) {
    const list = keyframes(now), [metres, degrees] = set.correct, [, tracker] = set.methods[label].parts;
    $("asked-about").textContent = list === null ? "Which keyframes were retrieved, and where they are, is shown where the dataset is available with rankings and answers beside the pipeline." : "Distance and angle are those of the true pose. A keyframe whose pair is among the results of trackers is linked to it.";
    const cell = (...inner) => element("td", {}, ...inner), text = (...inner) => element("td", { class: "text" }, ...inner);
    $("asked").replaceChildren(...(list ?? []).map(([keyframe, distance, angle, near, status, confidence, t, r], i) => {
      const link = pairLink(now, keyframe, tracker), is = Number(t) <= metres && Number(r) <= degrees, chosen = String(kept) === keyframe;
      return element("tr", { class: chosen ? "chosen" : null },
        cell(String(i + 1)), text(link ? element("a", { href: link }, keyframe) : keyframe), cell(number(distance, "m")), cell(number(angle, "deg")),
        text(distance === null ? "not known" : near ? "yes" : "no"), text(STATUS[status] ?? status), cell(number(confidence, "")), cell(number(t, "m")), cell(number(r, "deg")),
        text(element("span", { class: is ? "yes" : "no" }, is ? "✓ right" : "✗ wrong"), chosen ? ", kept" : ""));
    }));
    if (!list?.length) $("asked").replaceChildren(element("tr", {}, element("td", { class: "text muted", colspan: 10 }, list === null ? "not known" : "none")));
  }

  /** The answers of all methods to this query, the best first. */
  function drawNumbers({ set, answers, labels, rows, row: { row }, label }) {
    const own = labels.map((each) => ({ label: each, ...rows[each][row] })), key = set.worst;
    const best = [...own].sort((a, b) => (a[key] === b[key] ? 0 : a[key] < b[key] ? -1 : 1));
    const columns = set.list.filter(({ key, optional }) => !ofEveryMethod.includes(key) && (!optional || own.some((each) => each[key] >= 0)));
    const words = ({ kind: of }) => (["text", "status", "outcome"].includes(of) ? "text" : null);
    const head = (title, name = "text") => element("th", { class: name, scope: "col" }, title);
    $("heads").replaceChildren(head(set.page.method), ...columns.map((column) => head(column.title, words(column))), ...(kind === "retrieval" ? [head("first five")] : []), head("message"));
    $("numbers").replaceChildren(...best.map((each) => element("tr", { class: each.label === label ? "chosen" : null },
      element("td", { class: "text" }, element("button", { type: "button", class: "cell", onclick: () => choose(each.label) }, each.label)),
      ...columns.map((column) => { const td = element("td", { class: words(column) }); td.innerHTML = KINDS[column.kind](each[column.key], "display"); return td; }),
      ...(kind === "retrieval" ? [element("td", { class: "text" }, flags(each.label))] : []), element("td", { class: "text message" }, answers.methods[each.label].messages[row] || ""))));
  }

  function choose(label) {
    state.set({ [now.set.page.method]: label });
    render();
  }

  function go(step) {
    const to = now?.list[now.at < 0 ? 0 : now.at + step];
    if (!to) return;
    state.set({ query: String(to.query) });
    render();
  }

  const next = (step) => now && choose(now.labels.at((now.labels.indexOf(now.label) + step) % now.labels.length));
  $("previous").addEventListener("click", () => go(-1));
  $("next").addEventListener("click", () => go(1));
  $("method").addEventListener("change", () => choose($("method").value));
  $("pictured").addEventListener("change", () => { state.set({ pictured: $("pictured").checked ? "1" : null }); render(); });
  $("pictured").checked = state.get("pictured") === "1";
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input[type=text], input[type=search], textarea")) return;
    if (event.target.closest(".scroll") && event.key.startsWith("Arrow")) return; // a table that is scrolled by keys
    const step = { ArrowLeft: () => go(-1), ArrowRight: () => go(1), m: () => next(1), n: () => next(-1) }[event.key];
    if (!step) return;
    event.preventDefault();
    step();
  });
  addEventListener("hashchange", render);
  render();
})();
