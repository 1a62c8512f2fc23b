/* The page of a query of retrievers or of pipelines: what was retrieved and answered, and what other methods found. The arrow
   keys and buttons go through the queries of a method, worst first; m and n through the methods. */
"use strict";

(() => {
  const { element, fact, number, load, hash, shortName, KINDS, STATUS } = relocbench;
  const $ = (id) => document.getElementById(id);
  const kind = $("shown").dataset.sets, ofEveryMethod = ["task", "query", "group", "positives"];
  let now = null; // what is shown: the task, the query, and the pairs of trackers

  /** The pairs of a task that have a page of their own, among the results of trackers. */
  const known = new Map();
  const pairsOf = (task, name) => known.get(task) ?? known.set(task, readPairs(task, name)).get(task);
  async function readPairs(task, name) {
    if (!task.trackers) return null;
    try {
      const set = await load(`sets/${task.trackers}`), { methods, units: { reference, query } } = await load(set.tasks[name].answers);
      return { methods: Object.keys(methods), keys: new Set(Array.from(reference, (time, i) => `${time}-${query[i]}`)) };
    } catch { return null; }
  }

  async function show(of, isCurrent) {
    const { set, name, task, row, answers, details } = of, pairs = await pairsOf(task, name);
    if (!isCurrent()) return;
    now = { ...of, pairs };
    document.title = `${shortName(row.query)} – relocbench`;
    $("title").textContent = `${task.gallery || name} ← ${task.query || name}`;
    $("facts").replaceChildren(
      fact("set", element("a", { href: `${kind === "retrieval" ? "retrieval" : "relocalization"}-${set.id}.html${hash({ table: name })}` }, set.title)), fact("task", name), fact("query", String(row.query)),
      ...(row.group ? [fact("place", row.group)] : []), ...("positives" in row ? [fact("right images", String(row.positives)), fact("gallery", String(answers.gallery))] : []));
    picture($("query-picture"), details?.queries[row.row], "Query image");
    for (const draw of kind === "retrieval" ? [drawTop, drawRight] : [drawVerdict, drawPictures, drawAsked]) draw(now);
    drawNumbers(now);
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
  function drawNumbers({ set, answers, labels, rowOf, row: { row }, label }) {
    const own = labels.map((each) => ({ label: each, ...rowOf(each, row) })), key = set.worst;
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

  const { choose, nextMethod } = relocbench.walk({
    folder: kind, content: "shown", taskKey: "task", taskWord: "task", unitKey: "query", draw: show,
    keys: { m: () => nextMethod(1), n: () => nextMethod(-1) },
  });
})();
