// A video beside its rendering: the same frame twice, with an edge between them that can be moved.
function mphygsWipe(root, film) {
  const [seen, drawn] = root.querySelectorAll("img"), edge = root.querySelector("[data-role=edge]");
  const time = root.querySelector("[data-role=time]"), label = root.querySelector("[data-role=label]");
  const line = root.querySelector(".edge");
  time.max = String(film.frames.length - 1);
  function show() {
    const k = Number(time.value), share = Number(edge.value);
    seen.src = film.seen[k];
    drawn.src = film.drawn[k];
    drawn.style.clipPath = `inset(0 0 0 ${share}%)`;
    line.style.left = `${share}%`;
    label.textContent = `frame ${film.frames[k]}, ${film.fitted[k] ? "fitted" : "unseen"}`;
    root.dataset.frame = String(film.frames[k]);
  }
  edge.addEventListener("input", show);
  time.addEventListener("input", show);
  show();
}
