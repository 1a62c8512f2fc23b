/* The page of a pair: the keyframe warped into the query at a pose, all answers from above, and their numbers. */
"use strict";

(() => {
  const { element, number, state, load } = relocbench;
  const $ = (id) => document.getElementById(id);
  const site = relocbench.payload("site");
  const [metres, degrees] = site.correct;
  const KEYFRAME = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
  const POSES = ["truth", "answer", "keyframe"];
  const decoded = new Map();
  let now = null; // what is shown: the pair set, its pair, the pictures
  let turn = 0;

  function tell(...what) {
    $("note").hidden = !what.length;
    $("note").replaceChildren(...what);
  }

  /** A pair set with its arrays; the poses of row i are those of place `places.get(i)`. */
  async function open(setId, name) {
    const key = `${setId}/${name}`;
    if (!decoded.has(key)) {
      const set = await load(`sets/${setId}`), record = set.tasks[name];
      if (!record) throw new Error(`the set has no pair set '${name}'`);
      const [errors, answers] = await Promise.all([load(record.answers), load(record.pictures)]);
      const methods = {};
      for (const [label, m] of Object.entries(errors.methods)) {
        const t = m.translation_error_m, r = m.rotation_error_deg;
        methods[label] = {
          t, r, both: t.map((value, i) => Math.max(value / metres, r[i] / degrees)), confidence: m.confidence,
          seconds: m.seconds, status: m.status, poses: answers.methods[label].poses,
          messages: answers.methods[label].messages, matches: answers.methods[label].matches, baseline: set.methods[label]?.baseline,
        };
      }
      const rows = answers.rows || Array.from({ length: errors.pairs }, (_, i) => i);
      decoded.set(key, {
        setId, name, set, record, methods, pairs: errors.pairs, images: answers.images, alone: answers.alone,
        reference: errors.units.reference, query: errors.units.query, groups: errors.words.group, group: errors.units.group,
        distance: errors.units.distance_m, angle: errors.units.angle_deg, truth: answers.truth,
        places: new Map(rows.map((row, place) => [row, place])), pictured: new Set(answers.pictured.map((place) => rows[place])),
      });
    }
    return decoded.get(key);
  }

  /** Pose `place` of an array of poses; null where there is none. */
  function poseAt(array, place) {
    if (!array || place === undefined) return null;
    const pose = array.subarray(12 * place, 12 * place + 12);
    return Number.isFinite(pose[0]) ? pose : null;
  }
  const truthOf = (of, row) => poseAt(of.truth, of.places.get(row));
  const answerOf = (of, row, label) => poseAt(of.methods[label].poses, of.places.get(row));
  const messageOf = (of, row, label) => of.methods[label].messages[of.places.get(row)] || "";

  /** Greatest errors of a found pair, metres and degrees: those of the list that the page was opened from. */
  function thresholds() {
    const given = state.get("within").split(",").map(Number);
    return given.length === 2 && given.every((value) => value > 0) ? given : site.correct;
  }
  const isFound = (m, row) => m.t[row] <= now.within[0] && m.r[row] <= now.within[1];

  /** The rows of a method's list, worst first. */
  function listOf(of, label) {
    const both = of.methods[label].both;
    const rows = [...Array(of.pairs).keys()].filter((row) => !$("pictured").checked || of.pictured.has(row));
    return rows.sort((a, b) => (both[a] === both[b] ? 0 : both[b] > both[a] ? 1 : -1));
  }

  const nameOf = (of, row) => `${of.reference[row]}-${of.query[row]}`;

  async function render() {
    const own = ++turn, wanted = state.all();
    if (!wanted.set || !wanted.pairset || !wanted.pair) {
      $("pair").hidden = true;
      return tell("This page shows one pair. Choose one in the list that opens with a click on a number of a set: ", element("a", { href: "index.html" }, "all results"), ".");
    }
    let of = null;
    try { of = await open(wanted.set, wanted.pairset); } catch (error) {
      if (own !== turn) return;
      $("pair").hidden = true;
      return tell(`The pair set cannot be shown: ${error.message}. `, element("a", { href: "index.html" }, "All results"));
    }
    if (own !== turn) return;
    const row = [...Array(of.pairs).keys()].find((i) => nameOf(of, i) === wanted.pair);
    if (row === undefined) {
      $("pair").hidden = true;
      return tell(`The pair set '${of.name}' has no pair ${wanted.pair}. `, element("a", { href: "index.html" }, "All results"));
    }
    const labels = Object.keys(of.methods);
    const label = labels.includes(wanted.method) ? wanted.method : labels.find((l) => !of.methods[l].baseline) || labels[0];
    tell();
    $("pair").hidden = false;
    now = { of, row, label, labels, pictures: null, within: thresholds() };
    Object.assign($("of-set"), { href: `set-${of.set.id}.html`, textContent: of.set.title, hidden: false });
    $("title").textContent = `${of.record.title}: pair ${row + 1} of ${of.pairs}`;
    document.title = `${$("title").textContent} – relocbench`;
    const fact = (name, ...value) => element("div", {}, element("dt", {}, name), element("dd", {}, ...value));
    $("facts").replaceChildren(
      fact("set", element("a", { href: `set-${of.set.id}.html` }, of.set.title)), fact("pair set", of.name), fact("conditions", `${of.record.gallery} → ${of.record.query}`), fact("keyframe, ns", String(of.reference[row])),
      fact("query, ns", String(of.query[row])), fact("distance, m", number(of.distance[row], "m")), fact("angle, °", number(of.angle[row], "deg")),
      ...(of.groups.length > 1 ? [fact("group", of.groups[of.group[row]])] : []));
    $("method").replaceChildren(...labels.map((l) => element("option", { value: l, selected: l === label }, l)));
    $("pictured").disabled = !of.pictured.size;
    if (!of.pictured.size) $("pictured").checked = false;
    const m = of.methods[label];
    // An error that would be rounded to the threshold that it exceeds has all its digits.
    const exact = (value, unit, most) => (value > most && Number(number(value, unit)) <= most ? String(value) : number(value, unit));
    const far = site.statuses[m.status[row]] === "ok"
      ? `${relocbench.escape(label)} is ${exact(m.t[row], "m", now.within[0])} m and ${exact(m.r[row], "deg", now.within[1])}° off`
      : `${relocbench.escape(label)} ${relocbench.STATUS[site.statuses[m.status[row]]]}`;
    $("verdict").innerHTML = `${relocbench.verdict(isFound(m, row))}: ${far} (at most ${now.within[0]} m and ${now.within[1]}° to be found)`;
    place();
    drawNumbers();
    drawPlan();
    await drawPictures(own);
  }

  function place() {
    const { of, row, label } = now, list = listOf(of, label), at = list.indexOf(row);
    now.list = list;
    now.at = at;
    $("previous").disabled = at === 0 || !list.length;
    $("next").disabled = at === list.length - 1 || !list.length;
    $("place").textContent = at < 0 ? `not among the ${list.length} pairs with images` : `${at + 1} of ${list.length} pairs, worst first`;
  }

  function go(step) {
    if (!now || !now.list.length) return;
    const to = now.at < 0 ? 0 : now.at + step;
    if (to < 0 || to >= now.list.length) return;
    state.set({ pair: nameOf(now.of, now.list[to]) });
    render();
  }

  /* marker -> points, turn in degrees, inner radius of a star */
  const MARKERS = {
    square: [4, 45], diamond: [4, 0], "triangle-up": [3, 0], "triangle-down": [3, 180], "triangle-left": [3, -90], "triangle-right": [3, 90],
    pentagon: [5, 0], hexagon: [6, 0], star: [5, 0, 0.45], cross: [4, 0, 0.35], x: [4, 45, 0.35], bowtie: [2, 90, 0.4],
  };
  /** The path of a method's marker. */
  function markerPath(marker, x, y, r) {
    const [points, turned, inner] = MARKERS[marker.replace("-open", "")] || [24, 0];
    const corners = inner ? 2 * points : points;
    return Array.from({ length: corners }, (_, i) => {
      const angle = (2 * Math.PI * i) / corners + (turned * Math.PI) / 180, radius = inner && i % 2 ? inner * r : r;
      return `${i ? "L" : "M"}${(x + radius * Math.sin(angle)).toFixed(2)} ${(y - radius * Math.cos(angle)).toFixed(2)}`;
    }).join("") + "Z";
  }
  const SVG = "http://www.w3.org/2000/svg";
  function draw(name, attributes, text = "") {
    const node = document.createElementNS(SVG, name);
    for (const [k, v] of Object.entries(attributes)) node.setAttribute(k, v);
    node.textContent = text;
    return node;
  }
  function marker(label, x, y, r) {
    const look = relocbench.look(label), open = look.marker.endsWith("-open");
    const paint = open ? { fill: "none", stroke: look.colour, "stroke-width": 1.8 } : { fill: look.colour };
    return draw("path", { d: markerPath(look.marker, x, y, r), ...paint });
  }
  function key(label) {
    const svg = draw("svg", { class: "key", width: 14, height: 14, "aria-hidden": "true" });
    svg.append(marker(label, 7, 7, 5.5));
    return svg;
  }

  function verdict(right) {
    const cell = element("td", { class: "text" });
    cell.innerHTML = relocbench.verdict(right);
    return cell;
  }

  function drawNumbers() {
    const { of, row, label, labels } = now;
    $("numbers").replaceChildren(...labels.map((l) => {
      const m = of.methods[l], failed = site.statuses[m.status[row]] !== "ok";
      return element("tr", { class: `${l === label ? "chosen" : ""} ${m.baseline ? "baseline" : ""}` },
        element("td", { class: "text" }, key(l), element("button", { type: "button", class: "cell", "aria-current": l === label ? "true" : null, onclick: () => choose(l) }, l)),
        verdict(isFound(m, row)), element("td", {}, relocbench.errorText(m.t[row], "m")), element("td", {}, relocbench.errorText(m.r[row], "deg")), element("td", {}, number(m.confidence[row], "")),
        element("td", {}, number(m.seconds[row], "s")), element("td", { class: failed ? "text failed" : "text" }, relocbench.STATUS[site.statuses[m.status[row]]]),
        element("td", { class: "text message" }, messageOf(of, row, l)));
    }));
  }

  function choose(label) {
    state.set({ method: label });
    render();
  }

  /* Pictures */
  const pixelsOf = async (payload) => {
    const image = new Image();
    image.src = payload.src;
    await image.decode();
    const canvas = element("canvas", { width: image.naturalWidth, height: image.naturalHeight }), context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    const data = context.getImageData(0, 0, canvas.width, canvas.height);
    if (payload.shown) { // what lies outside the image is not black but nothing
      const columns = new DataView(relocbench.bytes(payload.shown).buffer);
      for (let v = 0; v < data.height; v++) {
        const first = columns.getUint16(4 * v, true), after = columns.getUint16(4 * v + 2, true);
        for (let u = 0; u < data.width; u++) if (u < first || u >= after) data.data[4 * (v * data.width + u) + 3] = 0;
      }
    }
    return data;
  };

  function put(id, data) {
    const canvas = $(id);
    canvas.width = data.width;
    canvas.height = data.height;
    canvas.getContext("2d").putImageData(data, 0, 0);
  }

  async function drawPictures(own) {
    const { of, row } = now, shown = of.pictured.has(row);
    $("pictures").hidden = $("thumbs").hidden = !shown;
    $("matches-section").hidden = true;
    document.querySelector(".pair-grid").classList.toggle("numbers-only", !shown);
    $("none").replaceChildren();
    if (!shown) {
      const why = of.alone ? "The dataset holds poses alone, without images."
        : of.truth ? "No images were written for this pair. Write the pages again with a larger --pairs N: the N worst pairs of each method, and N drawn at random, have images in each pair set."
        : "No images and no true poses: the dataset was not available when these pages were written. Write them again with --dataset FOLDER; --pairs N says how many pairs get images.";
      $("none").append(element("p", { class: "empty" }, why));
      return;
    }
    const [reference, query, depth] = await Promise.all([
      load(`images/${of.setId}/${of.images.reference}/${of.reference[row]}`),
      load(`images/${of.setId}/${of.images.query}/${of.query[row]}`),
      load(`depths/${of.setId}/${of.images.reference}/${of.reference[row]}`),
    ]).catch((error) => { tell(error.message); return []; });
    if (own !== turn || !depth) return;
    const images = await Promise.all([pixelsOf(reference), pixelsOf(query)]);
    if (own !== turn) return;
    const [width, height] = reference.camera;
    now.pictures = { images, from: reference.camera, to: query.camera, inverse: relocbench.warp.dense(depth, width, height) };
    put("reference", images[0]);
    put("query", images[1]);
    put("query-large", images[1]);
    $("reference-file").textContent = reference.file ? `: ${reference.file}` : "";
    $("query-file").textContent = query.file ? `: ${query.file}` : "";
    drawWarp();
    drawMatches(reference, query);
  }

  function drawMatches(reference, query) {
    const { of, row, label } = now, told = of.methods[label].matches[of.places.get(row)];
    $("matches-section").hidden = !told;
    if (!told) return;
    const agree = told.filter((match) => match[4]).length;
    const words = `Some of the matches of ${label} on this pair, as it tells them: ${agree} that agree with its best pose (full lines) and ${told.length - agree} that do not (dashed). Methods tell a sample, so the numbers say nothing.`;
    $("matches-about").textContent = words;
    relocbench.drawMatches($("matches"), reference, query, told, words);
  }

  function drawWarp() {
    if (!now?.pictures) return;
    const { of, row, label, pictures } = now;
    const poses = { truth: truthOf(of, row), answer: answerOf(of, row, label), keyframe: KEYFRAME };
    const first = poses.answer && !isFound(of.methods[label], row) ? "answer" : "truth"; // a wrong answer shows where it is wrong
    const asked = POSES.includes(state.get("at")) ? state.get("at") : first;
    for (const button of document.querySelectorAll("[data-pose]")) {
      button.setAttribute("aria-pressed", String(button.dataset.pose === asked));
      button.disabled = !poses[button.dataset.pose];
    }
    const words = { truth: "the true pose", answer: `the answer of ${label}`, keyframe: "the keyframe’s own pose" }[asked];
    const out = $("agreement");
    delete out.dataset.correlation;
    now.warped = Boolean(poses[asked]);
    if (!poses[asked]) {
      const why = asked === "answer" ? `${label} gave no pose for this pair: ${messageOf(of, row, label) || relocbench.STATUS[site.statuses[of.methods[label].status[row]]]}` : "This pose is not known.";
      put("warp", new ImageData(pictures.to[0], pictures.to[1]));
      const none = relocbench.warp.compare(new ImageData(pictures.to[0], pictures.to[1]), pictures.images[1]);
      put("difference", none.picture);
      out.textContent = why;
      out.classList.add("failed");
      return wipe();
    }
    const warped = relocbench.warp.warp(pictures.images[0], pictures.inverse, pictures.from, pictures.to, poses[asked]);
    const found = relocbench.warp.compare(warped, pictures.images[1]);
    put("warp", relocbench.warp.hatched(warped));
    put("difference", found.picture);
    out.classList.remove("failed");
    out.dataset.correlation = String(found.correlation);
    const correlation = Number.isNaN(found.correlation) ? "no correlation" : `a correlation of ${found.correlation.toFixed(2)}`;
    out.textContent = `At ${words}: ${correlation} of grey values with the query, over ${Math.round(100 * found.share)} % of the picture.`;
    wipe();
  }

  function wipe() {
    const hidden = $("blink").getAttribute("aria-pressed") === "true", share = Number($("wipe").value);
    $("warp").style.visibility = hidden ? "hidden" : "";
    $("edge").hidden = hidden || !now?.warped || share === 0 || share === 100;
    $("warp").style.clipPath = `inset(0 ${100 - share}% 0 0)`;
    $("edge").style.left = `${share}%`;
  }

  function blink() {
    $("blink").setAttribute("aria-pressed", String($("blink").getAttribute("aria-pressed") !== "true"));
    wipe();
  }

  function showPose(name) {
    const button = document.querySelector(`[data-pose="${name}"]`);
    if (button.disabled) return;
    state.set({ at: name });
    drawWarp();
  }

  /* From above: x to the right and z ahead of the keyframe's camera, which stands at the origin. */
  const centre = (pose) => [
    -(pose[0] * pose[3] + pose[4] * pose[7] + pose[8] * pose[11]),
    -(pose[2] * pose[3] + pose[6] * pose[7] + pose[10] * pose[11]),
  ];
  const heading = (pose) => { const [x, z] = [pose[8], pose[10]], n = Math.hypot(x, z) || 1; return [x / n, z / n]; };

  function drawPlan() {
    const { of, row, label, labels } = now, css = relocbench.css;
    const width = 400, height = 480, edge = 34;
    const marks = [{ name: "keyframe", pose: KEYFRAME, colour: css("--text"), shape: "keyframe" }];
    const truth = truthOf(of, row);
    if (truth) marks.push({ name: "truth", pose: truth, colour: css("--good"), shape: "truth" });
    const without = [];
    for (const l of labels) {
      const pose = answerOf(of, row, l);
      if (pose) marks.push({ name: l, pose, colour: relocbench.look(l).colour, shape: "answer", chosen: l === label });
      else if (!of.places.has(row)) continue;
      else without.push(l);
    }
    marks.sort((a, b) => Number(!!a.chosen) - Number(!!b.chosen));
    const near = Math.max(0.5, 3 * (Number.isFinite(of.distance[row]) ? of.distance[row] : 1));
    for (const mark of marks) { mark.at = centre(mark.pose); mark.far = Math.hypot(...mark.at) > near; }
    const inside = marks.filter((mark) => !mark.far).map((mark) => mark.at);
    if (truth) for (const sign of [-1, 1]) inside.push(centre(truth).map((metre) => metre + sign * now.within[0]));
    const range = (axis) => { const values = inside.map((at) => at[axis]); return [Math.min(...values), Math.max(...values)]; };
    const [left, right] = range(0), [back, front] = range(1);
    const scale = Math.min((width - 2 * edge) / Math.max(right - left, 0.2), (height - 2 * edge - 24) / Math.max(front - back, 0.2), 400);
    const x = (metre) => width / 2 + (metre - (left + right) / 2) * scale, y = (metre) => (height - 24) / 2 - (metre - (back + front) / 2) * scale;
    const told = marks.map((mark) => `${mark.name} ${number(mark.at[0], "m")} m right and ${number(mark.at[1], "m")} m ahead`).join("; ");
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Positions relative to the keyframe: ${told}` });
    if (truth) svg.append(draw("circle", { cx: x(centre(truth)[0]), cy: y(centre(truth)[1]), r: now.within[0] * scale, fill: "none", stroke: css("--good"), "stroke-dasharray": "3 4" }));
    for (const mark of marks) {
      let [px, py] = [x(mark.at[0]), y(mark.at[1])], [hx, hz] = heading(mark.pose);
      const group = draw("g", {});
      group.append(draw("title", {}, `${mark.name}: ${number(mark.at[0], "m")} m right, ${number(mark.at[1], "m")} m ahead of the keyframe`));
      if (mark.far) {
        const angle = Math.atan2(mark.at[0], mark.at[1]), [ox, oy] = [width / 2, (height - 24) / 2];
        const reach = Math.min((width / 2 - 16) / Math.max(Math.abs(Math.sin(angle)), 1e-6), ((height - 24) / 2 - 16) / Math.max(Math.abs(Math.cos(angle)), 1e-6));
        [px, py] = [ox + reach * Math.sin(angle), oy - reach * Math.cos(angle)];
        [hx, hz] = [Math.sin(angle), Math.cos(angle)];
        group.append(draw("path", { d: `M${px + 9 * hx} ${py - 9 * hz}L${px - 7 * hx - 6 * hz} ${py + 7 * hz - 6 * hx}L${px - 7 * hx + 6 * hz} ${py + 7 * hz + 6 * hx}Z`, fill: mark.colour }));
      } else {
        group.append(draw("line", { x1: px, y1: py, x2: px + 22 * hx, y2: py - 22 * hz, stroke: mark.colour, "stroke-width": 2 }));
        if (mark.shape === "answer") {
          if (mark.chosen) group.append(draw("circle", { cx: px, cy: py, r: 9, fill: "none", stroke: mark.colour, "stroke-width": 1.5 }));
          group.append(marker(mark.name, px, py, 5.5));
        } else if (mark.shape === "truth") {
          group.append(draw("path", { d: `M${px - 8} ${py}H${px + 8}M${px} ${py - 8}V${py + 8}`, stroke: mark.colour, "stroke-width": 2.5 }));
        } else {
          group.append(draw("rect", { x: px - 6, y: py - 6, width: 12, height: 12, fill: "none", stroke: mark.colour, "stroke-width": 2 }));
        }
      }
      svg.append(group);
    }
    const about = 90 / scale, unit = 10 ** Math.floor(Math.log10(about)), length = unit * (about / unit >= 5 ? 5 : about / unit >= 2 ? 2 : 1);
    const end = 12 + length * scale, foot = height - 8;
    svg.append(draw("path", { d: `M12 ${foot - 5}V${foot}H${end}V${foot - 5}`, fill: "none", stroke: css("--muted"), "stroke-width": 1.5 }));
    svg.append(draw("text", { x: end + 8, y: foot, fill: css("--muted"), "font-size": 12 }, length < 1 ? `${number(100 * length, "").replace(/\.?0+$/, "")} cm` : `${length} m`));
    $("plan").replaceChildren(svg);
    const sign = (path) => { const span = element("span"); span.innerHTML = `<svg class="key" width="14" height="14" viewBox="0 0 14 14" aria-hidden="true">${path}</svg>`; return span.firstChild; };
    const entries = marks.map((mark) => element("li", {}, mark.shape === "answer" ? key(mark.name)
      : sign(mark.shape === "truth" ? `<path d="M0 7H14M7 0V14" stroke="${mark.colour}" stroke-width="2.5"/>` : `<rect x="2" y="2" width="10" height="10" fill="none" stroke="${mark.colour}" stroke-width="2"/>`),
    mark.name + (mark.far ? `: ${number(Math.hypot(...mark.at), "m")} m away, outside` : "")));
    if (truth) entries.push(element("li", {}, sign(`<circle cx="7" cy="7" r="6" fill="none" stroke="${css("--good")}" stroke-dasharray="2 2"/>`), `within ${now.within[0]} m of the truth`));
    if (without.length) entries.push(element("li", { class: "muted" }, `no pose: ${without.join(", ")}`));
    if (!of.places.has(row)) entries.push(element("li", { class: "muted" }, "The poses of this pair were not written: there are too many pairs, and it has no images."));
    $("plan-key").replaceChildren(...entries);
  }

  $("method").addEventListener("change", () => choose($("method").value));
  $("pictured").addEventListener("change", place);
  $("previous").addEventListener("click", () => go(-1));
  $("next").addEventListener("click", () => go(1));
  $("blink").addEventListener("click", blink);
  $("wipe").addEventListener("input", wipe);
  for (const button of document.querySelectorAll("[data-pose]")) button.addEventListener("click", () => showPose(button.dataset.pose));
  document.addEventListener("keydown", (event) => {
    if (!now || event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.target.closest("select, textarea, input:not([type=checkbox])") && (event.key.startsWith("Arrow") || event.target.tagName === "SELECT")) return;
    if (event.target.closest(".scroll") && event.key.startsWith("Arrow")) return;
    const acts = { ArrowLeft: () => go(-1), ArrowRight: () => go(1), b: blink, t: () => showPose("truth"), a: () => showPose("answer"), k: () => showPose("keyframe") };
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  window.addEventListener("hashchange", render);
  document.addEventListener("relocbench-theme", () => { if (now) { drawNumbers(); drawPlan(); } });
  render();
})();
