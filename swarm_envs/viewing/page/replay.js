"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const get = (id) => document.getElementById(id);
  const { time, drones, types, arena } = data;
  const N = drones.length, T = time.length, last = T - 1, end = Math.max(time[last], 1e-6);
  const HIDDEN = 0.5; // forces below this, g, are not drawn
  const MARGIN = { l: 46, r: 12, t: 8, b: 26 };
  const state = { frame: 0, time: 0, playing: false, speed: 1, trail: 2, forces: true };
  const view = makeScene(get("swarm"), () => draw());
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // Arrays are flat: frame, then drone, then component; integers in units of `data.unit`.
  const at = (name, f, i) => {
    const array = data[name], k = (Math.min(f, array.length / (3 * N) - 1) * N + i) * 3, u = data.unit[name];
    return [array[k] * u, array[k + 1] * u, array[k + 2] * u];
  };
  const turned = (f, i) => {
    const k = (f * N + i) * 4, q = data.quaternion.slice(k, k + 4), size = Math.hypot(...q) || 1;
    return q.map((c) => c / size);
  };
  const length = (v) => Math.hypot(v[0], v[1], v[2]);
  const all = (count, make) => Array.from({ length: count }, (_, k) => make(k));

  function firstCamera() { // far enough to see the flight and its goals
    const [width, height] = view.size, { center, radius } = data.view;
    view.camera.middle = center;
    view.camera.distance = 2.1 * radius * Math.max(1, Math.min(1.6, 0.8 * height / width));
  }
  function box([a, b, c], [d, e, f]) { // the arena's edges above its floor
    const rim = (z) => [[a, b, z], [d, b, z], [d, e, z], [a, e, z]], [low, high] = [rim(c), rim(f)];
    view.path(high, css("--line"), 1, { close: true });
    low.forEach((p, k) => view.path([p, high[k]], css("--line")));
  }
  function drawDrone(f, n) {
    const p = at("position", f, n), g = at("force", f, n), { arm, rotor_radius: rotor } = types[drones[n].type];
    view.drone(p, turned(f, n), arm, rotor, drones[n].color);
    if (state.forces && length(g) >= HIDDEN) view.arrow(p, g.map((v) => v * data.meter_per_gram));
  }
  function drawTrail(f, n) {
    let first = f;
    while (first > 0 && time[f] - time[first - 1] <= state.trail) first--;
    if (state.trail > 0 && first < f) view.path(all(f - first + 1, (k) => at("position", first + k, n)), drones[n].color + "a0", 1.8);
  }
  function draw() {
    const f = state.frame;
    Object.assign(view.colors, { ground: css("--floor"), line: css("--line"), quiet: css("--quiet"), arm: css("--ink"), wall: css("--wall"), roof: css("--roof") });
    view.clear();
    view.ground(arena[0], arena[1]);
    box(arena[0], arena[1]);
    drones.forEach(({ type, color }, n) => {
      view.shadow(at("position", f, n), arena[0][2], types[type].arm + types[type].rotor_radius);
      view.goal(at("goal", f, n), color);
      if (data.moving) {
        view.path(all(T, (k) => at("reference", k, n)), color + "a0", 1, { dash: [2, 4] });
        view.ring(at("reference", f, n), color, 0.04);
      }
      drawTrail(f, n);
    });
    const depth = (p) => view.project(p)[2];
    const items = [
      ...data.solids.map((rings) => [depth(rings[1][0]), () => view.solid(rings)]),
      ...drones.map((_, n) => [depth(at("position", f, n)), () => drawDrone(f, n)]),
    ];
    items.sort((a, b) => b[0] - a[0]).forEach(([, paint]) => paint());
    for (const event of data.events) if (!event.near && event.frame <= f) view.cross(event.at);
  }
  get("swarm").addEventListener("pointermove", (event) => { // names the drone under the pointer
    const box = get("swarm").getBoundingClientRect();
    const near = drones.map((d, n) => {
      const p = at("position", state.frame, n), [x, y] = view.project(p);
      return [Math.hypot(event.clientX - box.left - x, event.clientY - box.top - y), `${d.name}: ${p.map((v) => v.toFixed(2)).join(", ")} m`];
    }).sort((a, b) => a[0] - b[0])[0];
    get("swarm").title = near[0] < 20 ? near[1] : "";
  });

  // The plots: lines [color, values, dashed] over time.
  const series = {
    height: (f, n) => at("position", f, n)[2],
    force: (f, n) => length(at("force", f, n)),
    error: (f, n) => 100 * Math.hypot(...at("position", f, n).map((v, k) => v - at("reference", f, n)[k])),
  };
  function lines(id) {
    if (id === "separation") return data.separation.length ? [[css("--accent"), data.separation], [css("--bad"), data.touching, true]] : [];
    return drones.map((d, n) => [d.color, time.map((_, f) => series[id](f, n))]);
  }
  function ticks(most, count) { // round numbers from 0 to the largest
    const rough = most / count, power = 10 ** Math.floor(Math.log10(rough)), step = [1, 2, 5, 10].find((s) => s * power >= rough) * power;
    return all(Math.floor(most / step + 1e-9) + 1, (k) => +(k * step).toPrecision(6));
  }
  const plots = {};
  function chart(id) {
    const canvas = get(id).querySelector("canvas"), pen = canvas.getContext("2d"), ratio = devicePixelRatio || 1;
    const [w, h] = [get(id).clientWidth, get(id).clientHeight], drawn = (plots[id] ??= lines(id));
    [canvas.width, canvas.height] = [w * ratio, h * ratio];
    pen.scale(ratio, ratio); pen.font = `11px ${getComputedStyle(document.body).fontFamily}`;
    let most = 1e-9;
    for (const [, values] of drawn) for (const value of values) most = Math.max(most, value);
    const x = (t) => MARGIN.l + (w - MARGIN.l - MARGIN.r) * t / end, y = (v) => h - MARGIN.b - (h - MARGIN.t - MARGIN.b) * v / (1.05 * most);
    const line = (points, color, width, dash = []) => {
      pen.beginPath(); points.forEach(([a, b], k) => k ? pen.lineTo(a, b) : pen.moveTo(a, b));
      pen.strokeStyle = color; pen.lineWidth = width; pen.setLineDash(dash); pen.stroke();
    };
    pen.fillStyle = css("--quiet"); pen.textBaseline = "middle"; pen.textAlign = "right";
    for (const v of ticks(1.05 * most, 4)) { line([[x(0), y(v)], [x(end), y(v)]], css("--line"), 1); pen.fillText(v, MARGIN.l - 6, y(v)); }
    pen.textAlign = "center";
    for (const t of ticks(end, 6)) pen.fillText(`${t} s`, x(t), h - MARGIN.b + 14);
    for (const e of data.events) line([[x(time[e.frame]), MARGIN.t], [x(time[e.frame]), h - MARGIN.b]], css(e.near ? "--near" : "--bad"), 1, [2, 3]);
    for (const [color, values, dashed] of drawn) line(values.map((v, f) => [x(time[f]), y(v)]), color, N > 6 ? 1.2 : 1.8, dashed ? [5, 4] : []);
  }
  const CHARTS = ["height", "error", "force", "separation"];
  function layout() { view.aim(); draw(); CHARTS.forEach(chart); place(); }

  function place() {
    for (const id of CHARTS) {
      const width = get(id).clientWidth - MARGIN.l - MARGIN.r, now = (plots[id] ?? []).map(([, values]) => values[state.frame]);
      get(id).querySelector(".cursor").style.left = `${MARGIN.l + width * time[state.frame] / end}px`;
      const range = id === "separation" ? now.slice(0, 1) : [...new Set([Math.min(...now), Math.max(...now)])];
      get(id).parentElement.querySelector("output").textContent = range.map((v) => v.toPrecision(3)).join(" to ");
    }
    get("scrub").value = state.frame;
    get("clock").textContent = `${time[state.frame].toFixed(2)} / ${end.toFixed(2)} s`;
  }
  function show(frame) {
    const before = state.frame;
    state.frame = Math.max(0, Math.min(last, frame));
    place();
    if (state.frame !== before) draw();
  }
  const frameAt = (t) => { // the last frame that is not later
    let low = 0, high = last;
    while (low < high) { const mid = (low + high + 1) >> 1; if (time[mid] <= t + 1e-9) low = mid; else high = mid - 1; }
    return low;
  };
  function seek(t) { state.time = Math.max(0, Math.min(end, t)); show(frameAt(state.time)); }

  let before = 0;
  function tick(now) {
    if (!state.playing) return;
    seek(state.time + state.speed * Math.min(now - before, 250) / 1000);
    before = now;
    if (state.time >= end) play(false); else requestAnimationFrame(tick);
  }
  function play(on) {
    if (on && state.time >= end) seek(0);
    state.playing = on;
    get("play").textContent = on ? "\u275A\u275A" : "\u25B6\uFE0E";
    get("play").setAttribute("aria-label", on ? "Pause" : "Play");
    if (on) { before = performance.now(); requestAnimationFrame(tick); }
  }
  function listen() {
    get("scrub").max = last;
    get("play").onclick = () => play(!state.playing);
    get("scrub").oninput = (e) => { play(false); seek(time[+e.target.value]); };
    get("speed").onchange = (e) => { state.speed = +e.target.value; };
    get("trails").onchange = (e) => { state.trail = +e.target.value; draw(); };
    get("forces").onchange = (e) => { state.forces = e.target.checked; draw(); };
    get("theme").onclick = () => {
      const root = document.documentElement;
      root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
      delete plots.separation;
      layout();
    };
    for (const event of data.events) {
      const mark = document.createElement("i"), button = document.createElement("button");
      mark.style.left = `${100 * event.frame / Math.max(last, 1)}%`;
      button.textContent = event.text;
      mark.className = button.className = event.near ? "near" : "";
      button.onclick = () => { play(false); seek(time[event.frame]); };
      get("marks").appendChild(mark);
      get("events").appendChild(button);
    }
    for (const id of CHARTS) {
      const move = (e) => {
        const left = get(id).getBoundingClientRect().left + MARGIN.l, width = get(id).clientWidth - MARGIN.l - MARGIN.r;
        play(false);
        seek(end * (e.clientX - left) / width);
      };
      get(id).addEventListener("pointerdown", (e) => { get(id).setPointerCapture(e.pointerId); move(e); });
      get(id).addEventListener("pointermove", (e) => { if (e.buttons) move(e); });
    }
    document.addEventListener("keydown", (e) => {
      if (["INPUT", "SELECT", "BUTTON"].includes(e.target.tagName) && e.key === " ") return;
      if (e.target.tagName === "SELECT" || e.target.id === "scrub") return;
      const step = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
      if (e.key === " ") { e.preventDefault(); play(!state.playing); }
      else if (step) { e.preventDefault(); play(false); seek(time[Math.max(0, Math.min(last, state.frame + step))]); }
    });
    window.addEventListener("resize", layout);
  }

  if (matchMedia("(prefers-color-scheme: dark)").matches) document.documentElement.dataset.theme = "dark";
  firstCamera();
  layout();
  listen();
  window.replay = { at, view };
  document.body.dataset.ready = "yes";
})();
