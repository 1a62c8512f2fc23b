/* The page of a pair: the keyframe warped into the query at a pose, all answers from above, and their numbers. */
"use strict";

(() => {
  const { element, fact, number, sign, state, load, svg: draw } = relocbench;
  const $ = (id) => document.getElementById(id);
  const site = relocbench.payload("site");
  const KEYFRAME = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
  const POSES = ["truth", "answer", "keyframe"];
  let now = null; // what is shown: the task, its pair, and where they are known the pictures

  /** Pose `place` of an array of poses; null where there is none. */
  function poseAt(array) {
    if (!array || now.place === undefined) return null;
    const pose = array.subarray(12 * now.place, 12 * now.place + 12);
    return Number.isFinite(pose[0]) ? pose : null;
  }
  const truth = () => poseAt(now.details.truth);
  const answerOf = (label) => poseAt(now.details.methods[label].poses);
  const messageOf = (label) => now.details.methods[label].messages[now.place] || "";

  /** Greatest errors of a found pair, metres and degrees: those of the list that the page was opened from. */
  function thresholds() {
    const given = state.get("within").split(",").map(Number);
    return given.length === 2 && given.every((value) => value > 0) ? given : site.correct;
  }
  const isFound = (row) => row.translation_error_m <= now.within[0] && row.rotation_error_deg <= now.within[1];

  function show(of, isCurrent) {
    const { set, name, task, answers, row, label, rowOf, labels } = of, within = thresholds();
    now = { ...of, pictures: null, within, own: labels.map((each) => ({ label: each, ...rowOf(each, row.row) })) };
    Object.assign($("of-set"), { href: `set-${set.id}.html`, textContent: set.title, hidden: false });
    $("title").textContent = `${task.title}: pair ${row.row + 1} of ${answers.pairs}`;
    document.title = `${$("title").textContent} – relocbench`;
    $("facts").replaceChildren(
      fact("set", element("a", { href: `set-${set.id}.html` }, set.title)), fact("pair set", name), fact("conditions", `${task.gallery} → ${task.query}`), fact("keyframe, ns", String(row.reference)),
      fact("query, ns", String(row.query)), fact("distance, m", number(row.distance_m, "m")), fact("angle, °", number(row.angle_deg, "deg")), ...(answers.words.group.length > 1 ? [fact("group", row.group)] : []));
    // An error that would be rounded to the threshold that it exceeds has all its digits.
    const exact = (value, unit, most) => (value > most && Number(number(value, unit)) <= most ? String(value) : number(value, unit));
    const far = row.status === "ok"
      ? `${relocbench.escape(label)} is ${exact(row.translation_error_m, "m", within[0])} m and ${exact(row.rotation_error_deg, "deg", within[1])}° off`
      : `${relocbench.escape(label)} ${relocbench.STATUS[row.status]}`;
    $("verdict").innerHTML = `${relocbench.verdict(isFound(row))}: ${far} (at most ${within[0]} m and ${within[1]}° to be found)`;
    drawNumbers();
    drawPlan();
    drawPictures(isCurrent);
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
    $("numbers").replaceChildren(...now.own.map((row) => {
      const { label, status } = row, failed = status !== "ok";
      return element("tr", { class: `${label === now.label ? "chosen" : ""} ${now.set.methods[label]?.baseline ? "baseline" : ""}` },
        element("td", { class: "text" }, key(label), element("button", { type: "button", class: "cell", "aria-current": label === now.label ? "true" : null, onclick: () => choose(label) }, label)),
        verdict(isFound(row)), element("td", {}, relocbench.errorText(row.translation_error_m, "m")), element("td", {}, relocbench.errorText(row.rotation_error_deg, "deg")), element("td", {}, number(row.confidence, "")),
        element("td", {}, number(row.seconds, "s")), element("td", { class: failed ? "text failed" : "text" }, relocbench.STATUS[status]),
        element("td", { class: "text message" }, messageOf(label)));
    }));
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

  async function drawPictures(isCurrent) {
    const { set, details, row, pictured } = now, shown = pictured.has(row.row);
    $("pictures").hidden = $("thumbs").hidden = !shown;
    $("matches-section").hidden = true;
    document.querySelector(".pair-grid").classList.toggle("numbers-only", !shown);
    $("none").replaceChildren();
    if (!shown) {
      const why = details.alone ? "The dataset holds poses alone, without images."
        : details.truth ? "No images were written for this pair. Write the pages again with a larger --pairs N: the N worst pairs of each method, and N drawn at random, have images in each pair set."
        : "No images and no true poses: the dataset was not available when these pages were written. Write them again with --dataset FOLDER; --pairs N says how many pairs get images.";
      $("none").append(element("p", { class: "empty" }, why));
      return;
    }
    const [reference, query, depth] = await Promise.all([
      load(`images/${set.id}/${details.images.reference}/${row.reference}`),
      load(`images/${set.id}/${details.images.query}/${row.query}`),
      load(`depths/${set.id}/${details.images.reference}/${row.reference}`),
    ]).catch((error) => { tell(error.message); return []; });
    if (!isCurrent() || !depth) return;
    const images = await Promise.all([pixelsOf(reference), pixelsOf(query)]);
    if (!isCurrent()) return;
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
    const { details, label, place } = now, matches = details.methods[label].matches[place];
    $("matches-section").hidden = !matches;
    if (!matches) return;
    const agree = matches.filter((match) => match[4]).length;
    const words = `Some of the matches of ${label} on this pair, as it tells them: ${agree} that agree with its best pose (full lines) and ${matches.length - agree} that do not (dashed). Methods tell a sample, so the numbers say nothing.`;
    $("matches-about").textContent = words;
    relocbench.drawMatches($("matches"), reference, query, matches, words);
  }

  function drawWarp() {
    if (!now?.pictures) return;
    const { row, label, pictures } = now;
    const poses = { truth: truth(), answer: answerOf(label), keyframe: KEYFRAME };
    const first = poses.answer && !isFound(row) ? "answer" : "truth"; // a wrong answer shows where it is wrong
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
      const why = asked === "answer" ? `${label} gave no pose for this pair: ${messageOf(label) || relocbench.STATUS[row.status]}` : "This pose is not known.";
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
    const { row, label, labels, place } = now, { css } = relocbench, truePose = truth();
    const width = 400, height = 480, edge = 34;
    const marks = [{ name: "keyframe", pose: KEYFRAME, colour: css("--text"), shape: "keyframe" }];
    if (truePose) marks.push({ name: "truth", pose: truePose, colour: css("--good"), shape: "truth" });
    const without = [];
    for (const l of labels) {
      const pose = answerOf(l);
      if (pose) marks.push({ name: l, pose, colour: relocbench.look(l).colour, shape: "answer", chosen: l === label });
      else if (place === undefined) continue;
      else without.push(l);
    }
    marks.sort((a, b) => Number(!!a.chosen) - Number(!!b.chosen));
    const near = Math.max(0.5, 3 * (Number.isFinite(row.distance_m) ? row.distance_m : 1));
    for (const mark of marks) { mark.at = centre(mark.pose); mark.far = Math.hypot(...mark.at) > near; }
    const inside = marks.filter((mark) => !mark.far).map((mark) => mark.at);
    if (truePose) for (const side of [-1, 1]) inside.push(centre(truePose).map((metre) => metre + side * now.within[0]));
    const range = (axis) => { const values = inside.map((at) => at[axis]); return [Math.min(...values), Math.max(...values)]; };
    const [left, right] = range(0), [back, front] = range(1);
    const scale = Math.min((width - 2 * edge) / Math.max(right - left, 0.2), (height - 2 * edge - 24) / Math.max(front - back, 0.2), 400);
    const x = (metre) => width / 2 + (metre - (left + right) / 2) * scale, y = (metre) => (height - 24) / 2 - (metre - (back + front) / 2) * scale;
    const positions = marks.map((mark) => `${mark.name} ${number(mark.at[0], "m")} m right and ${number(mark.at[1], "m")} m ahead`).join("; ");
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Positions relative to the keyframe: ${positions}` });
    if (truePose) svg.append(draw("circle", { cx: x(centre(truePose)[0]), cy: y(centre(truePose)[1]), r: now.within[0] * scale, fill: "none", stroke: css("--good"), "stroke-dasharray": "3 4" }));
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
    const small = (markup) => sign(14, 14, markup);
    const entries = marks.map((mark) => element("li", {}, mark.shape === "answer" ? key(mark.name)
      : small(mark.shape === "truth" ? `<path d="M0 7H14M7 0V14" stroke="${mark.colour}" stroke-width="2.5"/>` : `<rect x="2" y="2" width="10" height="10" fill="none" stroke="${mark.colour}" stroke-width="2"/>`),
    mark.name + (mark.far ? `: ${number(Math.hypot(...mark.at), "m")} m away, outside` : "")));
    if (truePose) entries.push(element("li", {}, small(`<circle cx="7" cy="7" r="6" fill="none" stroke="${css("--good")}" stroke-dasharray="2 2"/>`), `within ${now.within[0]} m of the truth`));
    if (without.length) entries.push(element("li", { class: "muted" }, `no pose: ${without.join(", ")}`));
    if (place === undefined) entries.push(element("li", { class: "muted" }, "The poses of this pair were not written: there are too many pairs, and it has no images."));
    $("plan-key").replaceChildren(...entries);
  }

  const { tell, choose } = relocbench.walk({
    folder: "sets", content: "pair", taskKey: "pairset", taskWord: "pair set", unitKey: "pair", draw: show,
    keys: { b: blink, t: () => showPose("truth"), a: () => showPose("answer"), k: () => showPose("keyframe") },
  });
  $("blink").addEventListener("click", blink);
  $("wipe").addEventListener("input", wipe);
  for (const button of document.querySelectorAll("[data-pose]")) button.addEventListener("click", () => showPose(button.dataset.pose));
  document.addEventListener("relocbench-theme", () => { if (now) { drawNumbers(); drawPlan(); } });
})();
