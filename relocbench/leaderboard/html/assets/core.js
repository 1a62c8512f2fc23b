/* What all pages share: payloads, numbers, the state in the address, and light or dark. */
"use strict";

(() => {
  const payloads = new Map();
  const waiting = new Map();

  /** Called by each file in data/: registers its payload. */
  window.relocbench_data = (key, payload) => {
    payloads.set(key, decoded(payload));
    waiting.get(key)?.resolve(payloads.get(key));
  };

  /** A script beside the page; resolves when it ran. */
  const scripts = new Map();
  function script(source) {
    if (!scripts.has(source)) {
      scripts.set(source, new Promise((resolve, reject) => {
        const element = document.createElement("script");
        element.src = source;
        element.onload = () => resolve();
        element.onerror = () => reject(new Error(`${source} is missing from this copy of the site`));
        document.head.append(element);
      }));
    }
    return scripts.get(source);
  }

  /** The payload of a key, from data/KEY.js, which is loaded when it is first asked for. */
  function load(key) {
    if (payloads.has(key)) return Promise.resolve(payloads.get(key));
    if (!waiting.has(key)) {
      const wait = {};
      wait.promise = new Promise((resolve, reject) => { wait.resolve = resolve; wait.reject = reject; });
      waiting.set(key, wait);
      script(`data/${key.split("/").map(encodeURIComponent).join("/")}.js`).catch(wait.reject);
    }
    return waiting.get(key).promise;
  }

  function bytes(text) {
    const binary = atob(text);
    const out = new Uint8Array(binary.length);
    for (let i = 0; i < binary.length; i++) out[i] = binary.charCodeAt(i);
    return out;
  }

  /** Types of arrays, little-endian as is every machine with a browser; timestamps in nanoseconds do not fit a number. */
  const ARRAYS = { ":f4": Float32Array, ":i8": BigInt64Array, ":u1": Uint8Array };

  /** A payload with its arrays, which stand in it as {type: base64}. */
  function decoded(value) {
    if (value === null || typeof value !== "object" || (Array.isArray(value) && typeof value[0] === "number")) return value;
    const keys = Object.keys(value), Numbers = keys.length === 1 && ARRAYS[keys[0]];
    if (Numbers) return new Numbers(bytes(value[keys[0]]).buffer);
    for (const key of keys) value[key] = decoded(value[key]);
    return value;
  }

  const ENTITIES = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };
  /** Text as HTML that shows it. */
  const escape = (text) => String(text).replace(/[&<>"']/g, (c) => ENTITIES[c]);

  /** A heading as HTML that can break behind its signs where a window is narrow. */
  const breakable = (text) => escape(text).replace(/@(?=\()|,(?=\d)/g, "$&<wbr>");

  /** An element: element("a", {href: "..."}, "text", child). Texts are shown as they are. */
  function element(name, attributes = {}, ...children) {
    const out = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (value === null || value === undefined || value === false) continue;
      if (key.startsWith("on")) out.addEventListener(key.slice(2), value);
      else out.setAttribute(key, value === true ? "" : String(value));
    }
    out.append(...children.flat().filter((child) => child !== null && child !== undefined));
    return out;
  }

  /** An option of a choice. */
  const option = (value, text, chosen) => element("option", { value, selected: value === chosen }, text);

  /** An element of a drawing. */
  function svg(name, attributes, text = "") {
    const out = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) out.setAttribute(key, value);
    out.textContent = text;
    return out;
  }

  /** A small drawing from its markup. */
  function sign(width, height, markup) {
    const out = element("span");
    out.innerHTML = `<svg class="key" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" aria-hidden="true">${markup}</svg>`;
    return out.firstChild;
  }

  /** The mean of numbers; null where one is missing, or there is none. */
  const mean = (values) => (values.length && !values.includes(null) ? values.reduce((sum, value) => sum + value, 0) / values.length : null);

  /** Ties go to the even digit, as on the pages that relocbench itself fills. */
  function rounded(value, digits) {
    const scaled = Math.abs(value) * 10 ** digits;
    const tie = scaled % 1 === 0.5 && scaled < 2 ** 40;
    const even = 2 * Math.round(scaled / 2);
    return tie ? (Math.sign(value) * even / 10 ** digits).toFixed(digits) : value.toFixed(digits);
  }

  /** A value in its unit without the unit's name; shares in percent, "inf" for no answer, empty for no value. */
  function number(value, unit) {
    if (value === null || value === undefined) return "";
    const plain = Number(value);
    if (Number.isNaN(plain)) return "";
    if (!Number.isFinite(plain)) return "inf";
    return unit === "share" ? rounded(100 * plain, 1) : rounded(plain, 3);
  }

  /** The state in the address, key=value&key=value behind the #. */
  const state = {
    all() {
      const out = {};
      for (const part of location.hash.slice(1).split("&")) {
        const at = part.indexOf("=");
        if (at <= 0) continue;
        try { out[part.slice(0, at)] = decodeURIComponent(part.slice(at + 1)); } catch { /* not percent-encoded */ }
      }
      return out;
    },
    get(key, fallback = "") { return this.all()[key] ?? fallback; },
    /** Change some keys; null removes one. The page's history gets no entry, as filters are no places. */
    set(changes) {
      const next = { ...this.all(), ...changes };
      const text = Object.entries(next)
        .filter(([, value]) => value !== null && value !== undefined && value !== "")
        .map(([key, value]) => `${key}=${encodeURIComponent(value)}`)
        .join("&");
      history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
    },
  };

  /** Light or dark: as chosen, otherwise as the system has it. */
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const KEY = "relocbench-theme";
  function chosen() {
    try { return localStorage.getItem(KEY) || "system"; } catch { return "system"; }
  }
  function apply() {
    const isDark = window.relocbench?.printing ? false : chosen() === "dark" || (chosen() === "system" && dark.matches);
    document.documentElement.dataset.theme = isDark ? "dark" : "light";
    document.documentElement.classList.toggle("dark", isDark);
    document.dispatchEvent(new CustomEvent("relocbench-theme"));
  }
  apply();
  dark.addEventListener("change", apply);

  /** Paper is light, and narrower than a window: charts are drawn for it, which must end before these events do. */
  function print(printing) {
    window.relocbench.printing = printing;
    document.documentElement.classList.toggle("printing", printing);
    apply();
  }
  window.addEventListener("beforeprint", () => print(true));
  window.addEventListener("afterprint", () => print(false));
  document.addEventListener("DOMContentLoaded", () => {
    const button = document.getElementById("theme");
    if (!button) return;
    const label = () => { button.textContent = `Theme: ${chosen()}`; };
    label();
    button.addEventListener("click", () => {
      const order = ["system", "light", "dark"];
      const next = order[(order.indexOf(chosen()) + 1) % order.length];
      try { localStorage.setItem(KEY, next); } catch { /* a browser that keeps nothing */ }
      apply();
      label();
    });
  });

  /** Small pictures, by the key of their payload in data-image, are loaded when they come into sight. */
  const inSight = new IntersectionObserver((entries) => {
    for (const { target } of entries.filter((entry) => entry.isIntersecting)) {
      inSight.unobserve(target);
      load(target.dataset.image).then((picture) => { target.src = picture.src; }, () => target.remove());
    }
  }, { rootMargin: "200px" });
  const thumbs = (root) => root.querySelectorAll("img[data-image]:not([src])").forEach((image) => inSight.observe(image));

  /** A table that is cut at the right fades out there, until it is scrolled to its end. */
  const cut = (node) => node.classList.toggle("cut", node.scrollWidth - node.clientWidth - node.scrollLeft > 2);
  const widths = new ResizeObserver((entries) => entries.forEach(({ target }) => cut(target.closest(".scroll"))));
  document.addEventListener("scroll", ({ target }) => { if (target.classList?.contains("scroll")) cut(target); }, { capture: true, passive: true });
  document.addEventListener("DOMContentLoaded", () => {
    thumbs(document);
    for (const node of document.querySelectorAll(".scroll")) {
      widths.observe(node);
      for (const child of node.querySelectorAll("table")) widths.observe(child);
    }
  });

  /** The one scale of colours of all maps: from bad, orange, to good, blue; colours.py has it too. */
  const QUALITY = [[0, "#b3561b"], [0.5, "#f4f4f4"], [1, "#2b5fb8"]];

  /** What became of a pair or a query, by its status in the results. */
  const STATUS = { ok: "answered", failed: "declined", error: "crashed" };

  /** An error, or that there is no answer which could have one. */
  const errorText = (value, unit) => (value === Infinity ? "no pose" : number(value, unit));

  /** Whether a pair is found, as a sign that no method's marker has and the word. */
  const verdict = (right) => `<span class="${right ? "found" : "missed"}">${right ? "✓" : "✗"} ${right ? "found" : "missed"}</span>`;

  window.relocbench = {
    QUALITY, STATUS, thumbs, verdict, errorText,
    load, script, bytes, escape, breakable, element, option, svg, sign, mean, number, state,
    printing: false,
    get isDark() { return document.documentElement.dataset.theme === "dark"; },
    /** A payload that is loaded already. */
    payload: (key) => payloads.get(key),
    css: (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim(),
  };
})();
