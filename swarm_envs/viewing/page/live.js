"use strict";
(() => {
  const get = (id) => document.getElementById(id);
  const scene = JSON.parse(get("scene").textContent), [low, high] = scene.arena;
  const token = new URLSearchParams(location.search).get("token");
  const canvas = get("swarm"), pen = canvas.getContext("2d");
  const FORCE_M_PER_N = 4.0, LEAST_N = 0.005, TRAIL = 60;
  const camera = { turn: -0.9, tilt: 0.45, distance: 0 };
  let frame = null, trails = [], paused = false, columns = 1, origin = [0, 0, 0];

  // World to screen: a camera that looks at the middle of all arenas. Returns x, y, depth, pixels a metre.
  let c1, s1, c2, s2, focal, centre;
  function aim() {
    const ratio = devicePixelRatio || 1;
    canvas.width = innerWidth * ratio; canvas.height = innerHeight * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    [c1, s1] = [Math.cos(camera.turn), Math.sin(camera.turn)];
    [c2, s2] = [Math.cos(camera.tilt), Math.sin(camera.tilt)];
    focal = 0.9 * Math.min(innerWidth, innerHeight * 1.3);
    centre = [innerWidth / 2, innerHeight / 2];
  }
  function project(p) {
    const x = p[0] - origin[0], y = p[1] - origin[1], z = p[2] - origin[2];
    const right = -s1 * x + c1 * y, ahead = -(c1 * x + s1 * y);
    const up = c2 * z + s2 * ahead, depth = Math.max(camera.distance + c2 * ahead - s2 * z, 0.05);
    const scale = focal / depth;
    return [centre[0] + scale * right, centre[1] - scale * up, depth, scale];
  }
  const place = (p, e) => {
    const gap = 1.15, wide = (high[0] - low[0]) * gap, deep = (high[1] - low[1]) * gap;
    return [p[0] + wide * (e % columns), p[1] - deep * Math.floor(e / columns), p[2]];
  };
  function path(points, color, width, close) {
    pen.beginPath();
    points.forEach((p, k) => { const q = project(p); if (k) pen.lineTo(q[0], q[1]); else pen.moveTo(q[0], q[1]); });
    if (close) pen.closePath();
    pen.strokeStyle = color; pen.lineWidth = width; pen.stroke();
  }
  function fill(points, color) {
    pen.beginPath();
    points.forEach((p, k) => { const q = project(p); if (k) pen.lineTo(q[0], q[1]); else pen.moveTo(q[0], q[1]); });
    pen.closePath(); pen.fillStyle = color; pen.fill();
  }
  function ground(e) {
    const corner = (x, y, z) => place([x, y, z], e);
    fill([corner(low[0], low[1], 0), corner(high[0], low[1], 0), corner(high[0], high[1], 0), corner(low[0], high[1], 0)], "#e9edf1");
    for (let x = Math.ceil(low[0]); x <= high[0]; x++) path([corner(x, low[1], 0), corner(x, high[1], 0)], "#d3dae1", 1);
    for (let y = Math.ceil(low[1]); y <= high[1]; y++) path([corner(low[0], y, 0), corner(high[0], y, 0)], "#d3dae1", 1);
    for (const solid of scene.solids) block(solid, e);
  }
  function block(solid, e) {
    const { low: a, high: b } = solid, rim = [];
    const sides = solid.round ? 20 : 4;
    for (let k = 0; k < sides; k++) {
      const angle = 2 * Math.PI * (k + 0.5) / sides, reach = solid.round ? 1 : Math.SQRT2;
      rim.push([(a[0] + b[0]) / 2 + reach * Math.cos(angle) * (b[0] - a[0]) / 2, (a[1] + b[1]) / 2 + reach * Math.sin(angle) * (b[1] - a[1]) / 2]);
    }
    const ring = (z) => rim.map(([x, y]) => place([x, y, z], e));
    const bottom = ring(a[2]), top = ring(b[2]);
    const walls = bottom.map((p, k) => [p, bottom[(k + 1) % sides], top[(k + 1) % sides], top[k]]);
    walls.sort((u, v) => project(v[0])[2] - project(u[0])[2]);
    for (const wall of walls) fill(wall, "#aab4bfcc");
    fill(top, "#c3ccd5");
  }
  function rotate(q, v) {
    const [x, y, z, w] = q, tx = 2 * (y * v[2] - z * v[1]), ty = 2 * (z * v[0] - x * v[2]), tz = 2 * (x * v[1] - y * v[0]);
    return [v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx];
  }
  function circle(middle, q, radius, e) {
    const points = [];
    for (let k = 0; k < 12; k++) {
      const angle = Math.PI * k / 6, turned = rotate(q, [radius * Math.cos(angle), radius * Math.sin(angle), 0]);
      points.push(place([middle[0] + turned[0], middle[1] + turned[1], middle[2] + turned[2]], e));
    }
    return points;
  }
  function drone(e, i) {
    const p = frame.position[e][i], q = frame.quaternion[e][i], radius = frame.radius[e][i], color = frame.color[e][i];
    const arm = 0.62 * radius, hub = place(p, e);
    for (const [sx, sy] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
      const way = rotate(q, [sx * arm / Math.SQRT2, sy * arm / Math.SQRT2, 0.1 * radius]);
      const rotor = [p[0] + way[0], p[1] + way[1], p[2] + way[2]];
      path([hub, place(rotor, e)], "#3a4047", 1.5);
      fill(circle(rotor, q, 0.38 * radius, e), color + (sx > 0 ? "b0" : "e0"));
    }
    if (frame.hit[e][i]) path(circle(p, [0, 0, 0, 1], 1.3 * radius, e), "#d62728", 2.5, true);
    const f = frame.force[e][i];
    if (get("forces").checked && Math.hypot(...f) > LEAST_N)
      path([hub, place([p[0] + FORCE_M_PER_N * f[0], p[1] + FORCE_M_PER_N * f[1], p[2] + FORCE_M_PER_N * f[2]], e)], "#d62728", 2);
  }
  function draw() {
    pen.clearRect(0, 0, innerWidth, innerHeight);
    if (!frame) return;
    const items = [];
    frame.position.forEach((team, e) => {
      ground(e);
      team.forEach((p, i) => {
        const radius = frame.radius[e][i], flat = [p[0], p[1], 0];
        fill(circle(flat, [0, 0, 0, 1], radius, e), "#20242833");
        path([place(p, e), place(flat, e)], "#20242822", 1);
        const goal = frame.goal[e][i], size = 0.05;
        if (get("goals").checked)
          path([[size, 0, 0], [0, 0, size], [-size, 0, 0], [0, 0, -size]].map((d) => place(goal.map((g, k) => g + d[k]), e)), frame.color[e][i], 1.5, true);
        const trail = trails[e] && trails[e][i];
        if (trail && trail.length > 1) path(trail.map((t) => place(t, e)), frame.color[e][i] + "70", 1.2);
        items.push([project(place(p, e))[2], e, i]);
      });
    });
    items.sort((a, b) => b[0] - a[0]).forEach(([, e, i]) => drone(e, i));
  }
  function take(next) {
    const begun = !frame || next.position.length !== frame.position.length || next.position[0].length !== frame.position[0].length;
    if (begun) {
      const count = next.position.length;
      columns = Math.ceil(Math.sqrt(count));
      const rows = Math.ceil(count / columns), a = place(low, 0), b = place(high, count - 1);
      origin = [(Math.min(a[0], b[0], low[0]) + place(high, columns - 1)[0]) / 2, (high[1] + place(low, (rows - 1) * columns)[1]) / 2, (low[2] + high[2]) / 4];
      camera.distance = 1.4 * Math.max(high[0] - low[0], high[1] - low[1]) * Math.max(columns, rows);
      trails = [];
    }
    next.position.forEach((team, e) => {
      if (begun || next.time[e] < frame.time[e]) trails[e] = team.map(() => []);
      team.forEach((p, i) => { trails[e][i].push(p); if (trails[e][i].length > TRAIL) trails[e][i].shift(); });
    });
    frame = next;
    get("time").textContent = frame.time.length > 1 ? `${frame.time.length} environments` : `${frame.time[0].toFixed(2)} s`;
    get("said").textContent = scene.task;
    requestAnimationFrame(draw);
  }

  const tell = (asked) => fetch(`control?token=${token}`, { method: "POST", body: JSON.stringify(asked) }).catch(() => {});
  function pause(now) {
    paused = now; tell({ paused });
    get("pause").textContent = paused ? "go on" : "pause"; get("step").disabled = !paused;
  }
  get("pause").onclick = () => pause(!paused);
  get("step").onclick = () => tell({ step: true });
  for (const speed of scene.speeds) get("speed").add(new Option(`${speed} x`, speed, speed === 1, speed === 1));
  get("speed").onchange = (event) => tell({ speed: Number(event.target.value) });
  get("forces").onchange = get("goals").onchange = draw;
  addEventListener("keydown", (event) => {
    if (event.key === " ") { event.preventDefault(); pause(!paused); }
    if (event.key === "ArrowRight" && paused) tell({ step: true });
  });
  let held = null;
  canvas.onpointerdown = (event) => { held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); };
  canvas.onpointerup = () => { held = null; };
  canvas.onpointermove = (event) => {
    if (!held) return;
    camera.turn -= 0.006 * (event.clientX - held[0]);
    camera.tilt = Math.min(1.5, Math.max(0.02, camera.tilt + 0.006 * (event.clientY - held[1])));
    held = [event.clientX, event.clientY]; aim(); draw();
  };
  canvas.onwheel = (event) => { event.preventDefault(); camera.distance *= Math.exp(0.001 * event.deltaY); draw(); };
  addEventListener("resize", () => { aim(); draw(); });
  aim();
  const events = new EventSource(`events?token=${token}`);
  events.onmessage = (event) => {
    const next = JSON.parse(event.data);
    if (next.closed) { events.close(); get("said").textContent = `${scene.task}: the environment was closed`; }
    else if (next.position) take(next);
  };
  events.onerror = () => { get("said").textContent = "the program has ended"; events.close(); };
  window.live = { get frame() { return frame; }, camera };
})();
