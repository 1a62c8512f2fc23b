/* What the theme leaves out for those who use a keyboard or listen: a name for the search, and tables that scroll. */
window.addEventListener("load", () => {
  document.querySelector(".md-search[role=dialog]")?.setAttribute("aria-label", "Search");
  for (const [index, frame] of document.querySelectorAll(".md-typeset__scrollwrap").entries()) {
    frame.tabIndex = 0;
    frame.setAttribute("role", "region");
    frame.setAttribute("aria-label", `Table ${index + 1}`);
  }
});
