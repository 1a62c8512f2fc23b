/* The legend of a page: buttons that say which methods its charts draw. */
"use strict";

(() => {
  const { element, state } = relocbench;
  const $ = (id) => document.getElementById(id);

  /** Buttons that take methods out of all charts; what is hidden stands in the address. */
  function legend(labels, hidden, changed) {
    $("hidden").textContent = someHidden(labels, hidden);
    $("legend").replaceChildren(...labels.map((label) => {
      const button = element("button", { type: "button", "aria-pressed": String(!hidden.has(label)) });
      button.innerHTML = relocbench.lineKey(label);
      button.append(label);
      button.addEventListener("click", () => {
        if (!hidden.delete(label)) hidden.add(label);
        $("hidden").textContent = someHidden(labels, hidden);
        state.set({ hide: JSON.stringify([...hidden]) });
        button.setAttribute("aria-pressed", String(!hidden.has(label)));
        changed();
      });
      return element("li", {}, button);
    }));
  }

  const DRAWN = 8;

  /**
   * The labels that are not drawn: those that the address hides, or else what many methods leave no room for.
   * The best are drawn; labels may hold commas, so that they stand in the address as JSON.
   */
  function hiddenLabels(labels, table, isFloor) {
    const text = state.get("hide");
    try { if (text) return new Set([].concat(JSON.parse(text))); } catch { /* no JSON */ }
    if (labels.length <= DRAWN + 2) return new Set();
    const best = new Set(table.rows.filter((row) => !isFloor(row.method)).slice(0, DRAWN).map((row) => row.method));
    return new Set(labels.filter((label) => !best.has(label)));
  }

  const someHidden = (labels, hidden) => (hidden.size && labels.length > DRAWN + 2 ? `${labels.length - hidden.size} of ${labels.length} are drawn: a click on a name adds it or takes it away.` : "");

  Object.assign(relocbench, { legend, hiddenLabels });
})();
