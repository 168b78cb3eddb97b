"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const get = (id) => document.getElementById(id);
  const { time, drones, types, arena } = data;
  const N = drones.length, T = time.length, last = T - 1, end = Math.max(time[last], 1e-6);
  const HIDDEN = 0.5; // forces below this, g, are not drawn
  const scene = get("swarm"), charts = ["height", "error", "force", "separation"];
  const MARGIN = { l: 46, r: 12, t: 8, b: 26 };
  const state = { frame: 0, time: 0, playing: false, speed: 1, trail: 2, forces: true, drawn: -1 };

  // Arrays are flat: frame, then drone, then component; integers in units of `data.unit`.
  const at = (name, f, i) => {
    const array = data[name], k = (Math.min(f, array.length / (3 * N) - 1) * N + i) * 3, u = data.unit[name];
    return [array[k] * u, array[k + 1] * u, array[k + 2] * u];
  };
  const length = (v) => Math.hypot(v[0], v[1], v[2]);
  const turn = (f, i) => { // rotation matrix, by rows, of drone i's attitude
    const k = (f * N + i) * 4, q = data.quaternion.slice(k, k + 4), s = Math.hypot(...q) || 1;
    const [x, y, z, w] = q.map((c) => c / s);
    return [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)];
  };

  // A vehicle's shape: four rotor discs on an X, and a hub. Body frame, m.
  const RIM = 12;
  function shape(type) {
    const points = [], faces = [], parts = [], d = type.arm / Math.SQRT2;
    const add = (part, ...p) => { points.push(p); parts.push(part); return points.length - 1; };
    for (const [sx, sy] of [[1, -1], [-1, -1], [-1, 1], [1, 1]]) {
      const centre = add("rotor", sx * d, sy * d, 0.012);
      for (let k = 0; k < RIM; k++) {
        const a = 2 * Math.PI * k / RIM;
        add("rotor", sx * d + type.rotor_radius * Math.cos(a), sy * d + type.rotor_radius * Math.sin(a), 0.012);
        faces.push([centre, centre + 1 + k, centre + 1 + (k + 1) % RIM, sx > 0 ? "front" : "rotor"]);
      }
      const w = 0.09 * type.arm, a = add("arm", sy * sx * -w, w, 0.004), b = add("arm", sy * sx * w, -w, 0.004);
      const c = add("arm", sx * d, sy * d, 0.004);
      faces.push([a, b, c, "arm"]);
    }
    const r = 0.34 * type.arm, hub = points.length;
    for (const p of [[r, 0, 0], [0, r, 0], [-r, 0, 0], [0, -r, 0], [0, 0, 0.5 * r], [0, 0, -0.6 * r]]) add("hub", ...p);
    for (let k = 0; k < 4; k++)
      for (const tip of [4, 5]) faces.push([hub + k, hub + (k + 1) % 4, hub + tip, "arm"]);
    return { points, faces };
  }
  const shapes = types.map(shape);

  // The mesh holds all drones, then an arrow head a drone; only its points change over time.
  const mesh = { i: [], j: [], k: [], facecolor: [] };
  let offset = 0;
  const mix = (hex, target, share) => "#" + [1, 3, 5].map((p) =>
    Math.round(parseInt(hex.slice(p, p + 2), 16) * (1 - share) + target * share).toString(16).padStart(2, "0")).join("");
  const face = (a, b, c, color) => { mesh.i.push(a); mesh.j.push(b); mesh.k.push(c); mesh.facecolor.push(color); };
  for (const drone of drones) {
    const { points, faces } = shapes[drone.type];
    const colors = { rotor: drone.color, front: mix(drone.color, 255, 0.35), arm: mix(drone.color, 0, 0.6) };
    for (const [a, b, c, part] of faces) face(offset + a, offset + b, offset + c, colors[part]);
    offset += points.length;
  }
  const ARROW = "#b0149b";
  for (let n = 0; n < N; n++, offset += 5)
    for (let k = 0; k < 4; k++) { face(offset + 4, offset + k, offset + (k + 1) % 4, ARROW); }

  function bodies(f) {
    const x = [], y = [], z = [];
    for (let n = 0; n < N; n++) {
      const m = turn(f, n), p = at("position", f, n);
      for (const [a, b, c] of shapes[drones[n].type].points) {
        x.push(p[0] + m[0] * a + m[1] * b + m[2] * c);
        y.push(p[1] + m[3] * a + m[4] * b + m[5] * c);
        z.push(p[2] + m[6] * a + m[7] * b + m[8] * c);
      }
    }
    const shafts = { x: [], y: [], z: [] };
    for (let n = 0; n < N; n++) {
      const p = at("position", f, n), g = at("force", f, n), size = length(g);
      const shown = state.forces && size >= HIDDEN, s = shown ? data.metre_per_gram : 0;
      const tip = p.map((v, k) => v + s * g[k]), u = shown ? g.map((v) => v / size) : [0, 0, 1];
      const head = shown ? Math.min(0.06, 0.4 * s * size) : 0, neck = tip.map((v, k) => v - head * u[k]);
      const h = Math.abs(u[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
      let e = [u[1] * h[2] - u[2] * h[1], u[2] * h[0] - u[0] * h[2], u[0] * h[1] - u[1] * h[0]];
      e = e.map((v) => v / length(e));
      const w = [u[1] * e[2] - u[2] * e[1], u[2] * e[0] - u[0] * e[2], u[0] * e[1] - u[1] * e[0]];
      for (const [a, b] of [[1, 0], [0, 1], [-1, 0], [0, -1]])
        [x, y, z].forEach((axis, k) => axis.push(neck[k] + 0.4 * head * (a * e[k] + b * w[k])));
      [x, y, z].forEach((axis, k) => axis.push(tip[k]));
      const stub = shown ? neck : p;
      ["x", "y", "z"].forEach((axis, k) => shafts[axis].push(p[k], stub[k], null));
    }
    return [{ x, y, z }, shafts];
  }
  function points(name, f) {
    const out = { x: [], y: [], z: [] };
    for (let n = 0; n < N; n++) {
      const p = at(name, f, n);
      out.x.push(p[0]); out.y.push(p[1]); out.z.push(p[2]);
    }
    return out;
  }
  const shadows = (f) => ({ ...points("position", f), z: Array(N).fill(arena[0][2]) }); // what is how high is hard to see without
  // Paths have as many points in every frame, so that their colours need not change.
  function paths(name, first, f, count) {
    const out = { x: [], y: [], z: [] };
    for (let n = 0; n < N; n++) {
      for (let k = 0; k < count; k++) {
        const p = at(name, Math.max(first, f - count + 1 + k), n);
        out.x.push(p[0]); out.y.push(p[1]); out.z.push(p[2]);
      }
      out.x.push(null); out.y.push(null); out.z.push(null);
    }
    return out;
  }
  const trailCount = () => {
    const steps = state.trail <= 0 ? 1 : Math.round(state.trail / (end / Math.max(last, 1)));
    return Math.max(2, Math.min(T, steps + 1));
  };
  const repeat = (count) => drones.flatMap((d) => Array(count + 1).fill(d.color));
  const trails = (f) => state.trail > 0 ? paths("position", 0, f, trailCount()) : paths("position", f, f, 2);
  const collisions = data.events.filter((e) => !e.near);
  const crashes = (f) => {
    const seen = collisions.filter((e) => e.frame <= f);
    return { x: seen.map((e) => e.at[0]), y: seen.map((e) => e.at[1]), z: seen.map((e) => e.at[2]) };
  };

  function box(low, high) {
    const [a, b, c] = low, [d, e, f] = high, gap = null;
    const x = [a, d, d, a, a, gap, a, d, d, a, a, gap, a, a, gap, d, d, gap, d, d, gap, a, a];
    const y = [b, b, e, e, b, gap, b, b, e, e, b, gap, b, b, gap, b, b, gap, e, e, gap, e, e];
    const z = [c, c, c, c, c, gap, f, f, f, f, f, gap, c, f, gap, c, f, gap, c, f, gap, c, f];
    return { x, y, z };
  }
  function solid(rings) { // a prism between two outlines
    const [low, high] = rings, n = low.length, all = [...low, ...high];
    const i = [], j = [], k = [];
    for (let a = 0; a < n; a++) {
      const b = (a + 1) % n;
      i.push(a, b); j.push(b, n + b); k.push(n + a, n + a);
      if (a > 0 && a < n - 1) { i.push(0, n); j.push(a, n + a); k.push(a + 1, n + a + 1); }
    }
    return { type: "mesh3d", x: all.map((p) => p[0]), y: all.map((p) => p[1]), z: all.map((p) => p[2]), i, j, k,
             color: "#8a94a0", opacity: 0.55, flatshading: true, hoverinfo: "skip", showscale: false };
  }

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const MOVING = ["bodies", "shafts", "trails", "handles", "wanted", "goals", "shadows", "crashes"];
  function build() {
    const f = state.frame, [drawn, shafts] = bodies(f), quiet = css("--quiet"), colors = drones.map((d) => d.color);
    const line = (color, width, more) => ({ type: "scatter3d", mode: "lines", line: { color, width, ...more }, hoverinfo: "skip" });
    const moving = {
      bodies: { type: "mesh3d", ...mesh, ...drawn, flatshading: true, hoverinfo: "skip", showscale: false,
                lighting: { ambient: 0.9, diffuse: 0.35, specular: 0.05, roughness: 0.9, fresnel: 0 }, lightposition: { x: 0, y: -2000, z: 8000 } },
      shafts: { ...line(ARROW, 5), ...shafts },
      trails: { ...line(repeat(trailCount()), 3), ...trails(f) },
      handles: { type: "scatter3d", mode: "markers", ...points("position", f), marker: { size: 3, color: colors },
                 text: drones.map((d) => d.name), hovertemplate: "%{text}<br>%{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>" },
      wanted: { type: "scatter3d", mode: "markers", ...points("reference", f), marker: { size: 4, color: colors, symbol: "circle-open" }, hoverinfo: "skip", visible: data.moving },
      goals: { type: "scatter3d", mode: "markers", ...points("goal", f), marker: { size: 6, color: colors, symbol: "diamond-open" },
               text: drones.map((d) => "goal of " + d.name), hovertemplate: "%{text}<extra></extra>" },
      shadows: { type: "scatter3d", mode: "markers", ...shadows(f), marker: { size: 3, color: quiet, opacity: 0.3 }, hoverinfo: "skip" },
      // A letter, since Plotly's own cross is a glyph that many fonts lack.
      crashes: { type: "scatter3d", mode: "text", ...crashes(f), text: collisions.map(() => "\u00D7"), textfont: { size: 40, color: css("--bad") },
                 hovertext: collisions.map((e) => e.text), hoverinfo: "text" },
    };
    const still = [
      { ...line(quiet, 2), ...box(arena[0], arena[1]), opacity: 0.7 },
      ...(data.moving ? [{ ...line(repeat(T), 2.5, { dash: "dot" }), ...paths("reference", 0, last, T), opacity: 0.7 }] : []),
      ...data.solids.map(solid),
    ];
    return [...MOVING.map((name) => moving[name]), ...still];
  }
  // One unit of the scene is as long as the arena's longest side; the camera, which looks 45
  // degrees wide, stands so that it sees the flight.
  function firstCamera() {
    const size = Math.max(...arena[1].map((v, k) => v - arena[0][k])), { center, radius } = data.view;
    const tall = Math.max(1, scene.clientHeight / scene.clientWidth), far = 2.05 * tall * radius / size;
    const middle = center.map((v, k) => (v - (arena[0][k] + arena[1][k]) / 2) / size);
    const [x, y, z] = [0.50, -0.79, 0.36].map((v, k) => middle[k] + far * v);
    return { eye: { x, y, z }, center: { x: middle[0], y: middle[1], z: middle[2] }, up: { x: 0, y: 0, z: 1 } };
  }
  function sceneLayout() {
    const sides = arena[1].map((v, k) => v - arena[0][k]), size = Math.max(...sides);
    const axis = (k, title) => ({ range: [arena[0][k], arena[1][k]], title: { text: title, font: { size: 12 } }, color: css("--quiet"),
      gridcolor: css("--line"), zeroline: false, showspikes: false, tickfont: { size: 10 }, nticks: 6, showbackground: false });
    return { margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: css("--panel"), showlegend: false, uirevision: 1,
      font: { family: getComputedStyle(document.body).fontFamily, color: css("--ink") },
      scene: { xaxis: axis(0, "x (m)"), yaxis: axis(1, "y (m)"), zaxis: axis(2, "z (m)"), dragmode: "orbit", uirevision: 1,
               aspectmode: "manual", aspectratio: { x: sides[0] / size, y: sides[1] / size, z: sides[2] / size },
               camera: scene.layout?.scene?.camera ?? firstCamera() } };
  }

  function series(id, n) {
    return time.map((_, f) => {
      if (id === "height") return at("position", f, n)[2];
      if (id === "force") return length(at("force", f, n));
      const p = at("position", f, n), q = at("reference", f, n);
      return 100 * Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
    });
  }
  function chartTraces(id) {
    const base = { type: "scatter", mode: "lines" };
    if (id === "separation") return data.separation.length === 0 ? [] : [
      { ...base, x: time, y: data.separation, line: { color: css("--accent"), width: 2 }, hovertemplate: "%{y:.3f} m<extra></extra>" },
      { ...base, x: time, y: data.touching, line: { color: css("--bad"), width: 1.5, dash: "dash", shape: "hv" }, hovertemplate: "touch at %{y:.3f} m<extra></extra>" }];
    return drones.map((d, n) => ({ ...base, x: time, y: series(id, n), name: d.name, line: { color: d.color, width: N > 6 ? 1.2 : 1.8 },
      hovertemplate: d.name + ": %{y:.3g}<extra></extra>" }));
  }
  function chartLayout() {
    const axis = { color: css("--quiet"), gridcolor: css("--line"), zeroline: false, fixedrange: true, tickfont: { size: 11 } };
    const marks = data.events.map((e) => ({ type: "line", xref: "x", yref: "paper", x0: time[e.frame], x1: time[e.frame], y0: 0, y1: 1, line: { color: css(e.near ? "--near" : "--bad"), width: 1, dash: "dot" } }));
    return { margin: MARGIN, showlegend: false, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", hovermode: "closest", dragmode: false,
      font: { family: getComputedStyle(document.body).fontFamily }, shapes: marks,
      xaxis: { ...axis, range: [0, end], ticksuffix: " s" }, yaxis: { ...axis, rangemode: "tozero", automargin: false, nticks: 5 } };
  }
  const SETTINGS = { responsive: true, displaylogo: false, displayModeBar: false };
  async function draw() {
    await Plotly.react(scene, build(), sceneLayout(), { ...SETTINGS, scrollZoom: true });
    for (const id of charts) {
      await Plotly.react(get(id), chartTraces(id), chartLayout(), SETTINGS);
      if (!get(id).querySelector(".cursor")) get(id).appendChild(Object.assign(document.createElement("div"), { className: "cursor" }));
    }
    place();
  }

  // The plot area lies at fixed margins, so the cursor needs nothing of Plotly's insides.
  function place() {
    for (const id of charts) {
      const width = get(id).clientWidth - MARGIN.l - MARGIN.r;
      get(id).querySelector(".cursor").style.left = `${MARGIN.l + width * time[state.frame] / end}px`;
    }
    get("scrub").value = state.frame;
    get("clock").textContent = `${time[state.frame].toFixed(2)} / ${end.toFixed(2)} s`;
  }
  function show(frame) {
    state.frame = Math.max(0, Math.min(last, frame));
    place();
    if (state.drawn === state.frame) return;
    state.drawn = state.frame;
    const f = state.frame, [drawn, shafts] = bodies(f);
    const parts = [drawn, shafts, trails(f), points("position", f), points("reference", f), points("goal", f), shadows(f), crashes(f)];
    const pick = (axis) => parts.map((part) => part[axis]);
    Plotly.restyle(scene, { x: pick("x"), y: pick("y"), z: pick("z") }, MOVING.map((_, k) => k));
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
  const redraw = () => { state.drawn = state.frame; draw(); };

  function listen() {
    get("scrub").max = last;
    get("play").onclick = () => play(!state.playing);
    get("scrub").oninput = (e) => { play(false); seek(time[+e.target.value]); };
    get("speed").onchange = (e) => { state.speed = +e.target.value; };
    get("trails").onchange = (e) => { state.trail = +e.target.value; redraw(); };
    get("forces").onchange = (e) => { state.forces = e.target.checked; state.drawn = -1; show(state.frame); };
    get("theme").onclick = () => {
      const root = document.documentElement;
      root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
      redraw();
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
    for (const id of charts) {
      const move = (e) => {
        const left = get(id).getBoundingClientRect().left + MARGIN.l, width = get(id).clientWidth - MARGIN.l - MARGIN.r;
        play(false);
        seek(end * (e.clientX - left) / width);
      };
      get(id).addEventListener("pointerdown", (e) => { get(id).setPointerCapture(e.pointerId); move(e); });
      get(id).addEventListener("pointermove", (e) => { if (e.buttons) move(e); });
    }
    // While the camera turns Plotly tells only here where it is; without this a frame drawn
    // meanwhile would turn it back.
    scene.on("plotly_relayouting", (e) => { if (e["scene.camera"]) scene.layout.scene.camera = e["scene.camera"]; });
    document.addEventListener("keydown", (e) => {
      if (["INPUT", "SELECT", "BUTTON"].includes(e.target.tagName) && e.key === " ") return;
      if (e.target.tagName === "SELECT" || e.target.id === "scrub") return;
      const step = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
      if (e.key === " ") { e.preventDefault(); play(!state.playing); }
      else if (step) { e.preventDefault(); play(false); seek(time[Math.max(0, Math.min(last, state.frame + step))]); }
    });
    window.addEventListener("resize", place);
  }

  if (matchMedia("(prefers-color-scheme: dark)").matches) document.documentElement.dataset.theme = "dark";
  draw().then(() => { listen(); document.body.dataset.ready = "yes"; });
})();
