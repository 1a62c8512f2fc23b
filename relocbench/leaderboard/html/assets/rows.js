/* The answers of a method to the pairs or queries of a task as rows, whichever task it is, and the links to their pages. */
"use strict";

(() => {
  const isColumn = (value) => Array.isArray(value) || ArrayBuffer.isView(value);

  /** What gives row i of the columns of a task and of a method; what stands in `words` is said by its place there. */
  relocbench.reader = (set, task, answers, label) => {
    const method = answers.methods[label];
    const words = { status: relocbench.payload("site").statuses, ...set.words, ...answers.words }, columns = Object.entries({ ...answers.units, ...method }).filter(([, values]) => isColumn(values));
    return (row) => {
      const out = { task, row };
      for (const [key, values] of columns) out[key] = words[key] ? words[key][values[row]] : values[row];
      if (set.correct) out.both = Math.max(out.translation_error_m / set.correct[0], out.rotation_error_deg / set.correct[1]);
      return out;
    };
  };

  /** All rows; none of a method that has no answers. */
  relocbench.rows = (set, task, answers, label) => {
    if (!answers.methods[label]) return [];
    const read = relocbench.reader(set, task, answers, label);
    return Array.from(answers.units.query, (_, row) => read(row));
  };

  /** What a pair or query is called in addresses. */
  relocbench.unitName = ({ reference, query }) => (reference === undefined ? String(query) : `${reference}-${query}`);

  /** Rows by what says how bad an answer is, the worst first; equal ones in their order. */
  relocbench.worstFirst = (rows, key) => [...rows].sort((a, b) => (a[key] === b[key] ? 0 : b[key] > a[key] ? 1 : -1));

  /** The part of an address behind the #, as links.py says it. */
  relocbench.hash = (state) => "#" + Object.entries(state).map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&");

  /** The link to the page of a pair or query, with the thresholds of the list it stands in where they are not the usual ones. */
  relocbench.unitLink = (set, row, label, thresholds = set.correct) => {
    const { file, task, unit, method } = set.page, within = thresholds && String(thresholds) !== String(set.correct) ? { within: thresholds.join(",") } : {};
    return file + relocbench.hash({ set: set.id, [task]: row.task, [unit]: relocbench.unitName(row), [method]: label, ...within });
  };

  /** The end of an image's path: its file and folder, which tell images of a list apart. */
  relocbench.shortName = (key) => String(key).split("/").slice(-2).join("/");

  const { escape, number, errorText, verdict, STATUS } = relocbench;
  const numeric = (text) => (value, type) => (type === "display" ? escape(text(value)) : Number.isFinite(Number(value ?? NaN)) ? Number(value) : Number(value) === Infinity ? 1e300 : -1);

  /** How DataTables shows and sorts the kinds of columns; what there is none of sorts behind everything else. */
  relocbench.KINDS = {
    text: (value, type) => (type === "display" ? escape(value ?? "") : value ?? ""),
    status: (value) => escape(STATUS[value] ?? value),
    outcome: (value, type) => (type === "display" ? `<span class="${value === "right" ? "yes" : "no"}">${escape(value === "right" ? "right" : `lost to ${value}`)}</span>` : value),
    found: (value, type) => (type === "display" ? verdict(value) : type === "filter" ? (value ? "found" : "missed") : Number(value)),
    rank: (value, type) => (Number.isFinite(value) ? value : type === "display" ? "none" : 1e9),
    error_m: numeric((value) => errorText(value, "m")),
    error_deg: numeric((value) => errorText(value, "deg")),
    ...Object.fromEntries(["m", "deg", "s", "number"].map((unit) => [unit, numeric((value) => number(value, unit))])),
  };
})();
