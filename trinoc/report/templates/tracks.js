"use strict";

// A track lights up in every picture, in the table and in space; one line says what is pointed at.
(() => {
  const readout = document.getElementById("readout");
  let pinned = { track: null, words: "" };
  const light = (track, words) => {
    document.querySelectorAll(".lit").forEach((element) => element.classList.remove("lit"));
    document.body.classList.toggle("has-lit", track !== null);
    if (track !== null)
      document.querySelectorAll(`[data-track="${track}"]`).forEach((e) => e.classList.add("lit"));
    readout.textContent = words;
    readout.hidden = !words;
    document.dispatchEvent(new CustomEvent("trinoc-lit", { detail: track }));
  };
  const under = (element) => {
    const found = element && element.closest ? element.closest("[data-track], [data-words]") : null;
    if (!found) return null;
    return { track: found.dataset.track ?? null, words: found.dataset.words ?? "" };
  };
  const show = (what) => light((what ?? pinned).track, (what ?? pinned).words);
  // Moves of the pointer alone: under a page that scrolls, things come to lie by themselves.
  let last = null;
  document.addEventListener("pointermove", (event) => {
    if (event.target === last || event.target.tagName === "CANVAS") return;
    last = event.target;
    show(under(last));
  });
  document.addEventListener("focusin", (event) => show(under(event.target)));
  document.addEventListener("click", (event) => {
    const what = under(event.target);
    if (!what && event.target.closest && event.target.closest("canvas, button, label, a")) return;
    pinned = !what || (what.track === pinned.track && what.words === pinned.words)
      ? { track: null, words: "" } : what;
    show(pinned);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") show((pinned = { track: null, words: "" }));
  });
  // The figure in space points at tracks by itself.
  document.addEventListener("trinoc-point", (event) => show(event.detail));
  document.addEventListener("trinoc-pin", (event) => {
    pinned = event.detail ?? { track: null, words: "" };
    show(pinned);
  });

  // Arrow keys walk through what is drawn on a picture.
  document.querySelectorAll("svg[tabindex]").forEach((svg) => {
    const items = [...svg.querySelectorAll("[data-words]")];
    let at = -1;
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!step || !items.length) return;
      event.preventDefault();
      at = (at + step + items.length) % items.length;
      if (at < 0) at = 0;
      document.querySelectorAll(".at").forEach((element) => element.classList.remove("at"));
      items[at].classList.add("at");
      show(under(items[at]));
    });
    svg.addEventListener("blur", () => items.forEach((item) => item.classList.remove("at")));
  });
})();
