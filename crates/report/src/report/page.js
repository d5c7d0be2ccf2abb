// Moves the mechanism, and adds keys. The page is complete without it.
"use strict";
document.querySelectorAll(".mechanism").forEach(figure => {
  const frames = figure.dataset.frames.split(",").map(Number), [begin, end] = figure.dataset.times.split(" ").map(Number);
  const bodies = [...figure.querySelectorAll(".body")], springs = [...figure.querySelectorAll(".spring")];
  const size = 3 * bodies.length, count = frames.length / size, text = figure.querySelector("span"), still = text.textContent;
  const kept = [...bodies, ...springs].map(part => part.getAttribute("transform"));
  const ends = springs.map(spring => spring.dataset.ends.split(" ").map(Number));
  if (count < 2 || !(end > begin)) return;
  function show(share) {
    const place = share * (count - 1), first = Math.min(Math.floor(place), count - 2), part = place - first;
    const pose = k => frames[first * size + k] * (1 - part) + frames[(first + 1) * size + k] * part;
    bodies.forEach((body, b) => body.setAttribute("transform", `translate(${pose(3 * b)} ${pose(3 * b + 1)}) rotate(${pose(3 * b + 2)})`));
    const at = (body, x, y) => {
      if (body < 0) return [x, y];
      const turn = pose(3 * body + 2) * Math.PI / 180, c = Math.cos(turn), s = Math.sin(turn);
      return [pose(3 * body) + c * x - s * y, pose(3 * body + 1) + s * x + c * y];
    };
    springs.forEach((spring, k) => {
      const e = ends[k], [x, y] = at(e[0], e[1], e[2]), [u, v] = at(e[3], e[4], e[5]);
      const width = 6 / Math.max(Math.hypot(u - x, v - y), 1e-3);
      spring.setAttribute("transform", `matrix(${u - x} ${v - y} ${(y - v) * width} ${(u - x) * width} ${x} ${y})`);
    });
    text.textContent = `t = ${(begin + share * (end - begin)).toFixed(2)} s`;
  }
  // a run takes two to twelve seconds on the screen
  const length = 1000 * Math.min(Math.max(end - begin, 2), 12);
  let since = 0, shown = 0, moves = false;
  const button = document.createElement("button");
  function step(now) {
    if (!moves) return;
    // the time of a frame may be that of its beginning, before the start
    shown = (Math.max(now - since, 0) / length) % 1;
    show(shown);
    requestAnimationFrame(step);
  }
  function play(on) {
    moves = on;
    button.textContent = on ? "Stop at the worst instant" : "Play";
    if (on) {
      since = performance.now() - shown * length;
      requestAnimationFrame(step);
    } else {
      [...bodies, ...springs].forEach((part, k) => part.setAttribute("transform", kept[k]));
      text.textContent = still;
    }
  }
  button.type = "button";
  button.onclick = () => play(!moves);
  figure.querySelector("p").append(" ", button);
  play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  addEventListener("beforeprint", () => play(false));
});
// n and p: the next and the previous section, t: the top
addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const tops = [...document.querySelectorAll("section")].map(section => section.getBoundingClientRect().top);
  const by = { n: tops.find(top => top > 2), p: tops.findLast(top => top < -2), t: -scrollY }[event.key];
  if (by !== undefined) scrollBy({ top: by });
});
