"use strict";
(() => {
  const get = (id) => document.getElementById(id);
  const scene = JSON.parse(get("scene").textContent), [low, high] = scene.arena;
  const token = new URLSearchParams(location.search).get("token");
  const FORCE_M_PER_N = 4.0, LEAST_N = 0.005, TRAIL = 60;
  const WIDTH = Object.values(scene.row).reduce((sum, count) => sum + count, 0);
  let frame = null, teams = [], trails = [], paused = false, columns = 1;
  const view = makeScene(get("swarm"), draw);

  const place = (p, e) => {
    const gap = 1.15, wide = (high[0] - low[0]) * gap, deep = (high[1] - low[1]) * gap;
    return [p[0] + wide * (e % columns), p[1] - deep * Math.floor(e / columns), p[2]];
  };
  function drone(e, i) {
    const p = place(frame.position[e][i], e), [radius, color] = teams[e][i], force = frame.force[e][i];
    view.drone(p, frame.quaternion[e][i], 0.62 * radius, 0.38 * radius, color);
    if (frame.hit[e][i][0]) view.ring(p, "#c62828", 1.3 * radius, 2.5);
    if (get("forces").checked && Math.hypot(...force) > LEAST_N) view.arrow(p, force.map((f) => FORCE_M_PER_N * f));
  }
  function draw() {
    view.clear();
    if (!frame) return;
    const items = [];
    frame.position.forEach((team, e) => {
      view.ground(place([low[0], low[1], 0], e), place([high[0], high[1], 0], e));
      for (const rings of scene.solids) view.solid(rings.map((ring) => ring.map((p) => place(p, e))));
      team.forEach((p, i) => {
        const [radius, color] = teams[e][i], trail = trails[e] && trails[e][i];
        view.shadow(place(p, e), 0, radius);
        if (get("goals").checked) view.goal(place(frame.goal[e][i], e), color);
        if (trail && trail.length > 1) view.path(trail.map((t) => place(t, e)), color + "70", 1.2);
        items.push([view.project(place(p, e))[2], e, i]);
      });
    });
    items.sort((a, b) => b[0] - a[0]).forEach(([, e, i]) => drone(e, i));
  }
  function decode({ time, drones }) { // rows of float32, environment by environment
    const numbers = new Float32Array(Uint8Array.from(atob(drones), (c) => c.charCodeAt(0)).buffer), found = { time };
    let from = 0;
    for (const [name, count] of Object.entries(scene.row)) {
      let row = from - WIDTH;
      found[name] = teams.map((team) => team.map(() => { row += WIDTH; return Array.from(numbers.subarray(row, row + count)); }));
      from += count;
    }
    return found;
  }
  function take(next) {
    const begun = !frame || next.position.length !== frame.position.length || next.position[0].length !== frame.position[0].length;
    if (begun) {
      const count = next.position.length;
      columns = Math.ceil(Math.sqrt(count));
      const rows = Math.ceil(count / columns), a = place(low, 0), b = place(high, count - 1);
      view.camera.middle = [(Math.min(a[0], b[0], low[0]) + place(high, columns - 1)[0]) / 2, (high[1] + place(low, (rows - 1) * columns)[1]) / 2, (low[2] + high[2]) / 4];
      view.camera.distance = 1.4 * Math.max(high[0] - low[0], high[1] - low[1]) * Math.max(columns, rows);
      trails = [];
    }
    next.position.forEach((team, e) => {
      if (begun || next.time[e] < frame.time[e]) trails[e] = team.map(() => []);
      team.forEach((p, i) => { trails[e][i].push(p); if (trails[e][i].length > TRAIL) trails[e][i].shift(); });
    });
    frame = next;
    get("time").textContent = frame.time.length > 1 ? `${frame.time.length} environments` : `${frame.time[0].toFixed(2)} s`;
    get("status").textContent = scene.task;
    requestAnimationFrame(draw);
  }

  const tell = (asked) => fetch(`control?token=${token}`, { method: "POST", body: JSON.stringify(asked) }).catch(() => {});
  function pause(now) {
    paused = now; tell({ paused });
    get("pause").textContent = paused ? "resume" : "pause"; get("step").disabled = !paused;
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
  const events = new EventSource(`events?token=${token}`);
  events.onmessage = (event) => {
    const next = JSON.parse(event.data);
    if (next.closed) { events.close(); get("status").textContent = `${scene.task}: the environment was closed`; }
    else if (next.teams) teams = next.teams;
    else take(decode(next));
  };
  events.onerror = () => { get("status").textContent = "the program has ended"; events.close(); };
  window.live = { get frame() { return frame; }, camera: view.camera };
})();
