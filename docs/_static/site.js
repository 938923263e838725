// What scrolls sideways can be reached by the keyboard, and the two bars at the sides have names.
function makeReachable() {
  for (const element of document.querySelectorAll("pre, div.table-wrapper")) {
    if (element.scrollWidth > element.clientWidth) element.tabIndex = 0;
    else element.removeAttribute("tabindex");
  }
}

window.addEventListener("load", () => {
  document.querySelector("aside.sidebar-drawer")?.setAttribute("aria-label", "All pages");
  document.querySelector("aside.toc-drawer")?.setAttribute("aria-label", "On this page");
  makeReachable();
});
window.addEventListener("resize", makeReachable);
