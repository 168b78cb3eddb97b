"use strict";
// What the live viewer and the replay page draw on a canvas; world frame, m, z up.
function makeScene(canvas, redraw) {
  const pen = canvas.getContext("2d");
  const camera = { turn: -1.0, tilt: 0.4, distance: 5, middle: [0, 0, 1] };
  const colors = { ground: "#e9edf1", line: "#d3dae1", quiet: "#5c6670", arm: "#3a4047", wall: "#aab4bf", roof: "#c3ccd5" };
  const FORCE = "#b0149b", BAD = "#c62828", RIM = 14;
  let c1, s1, c2, s2, focal, width, height;

  function aim() {
    const ratio = window.devicePixelRatio || 1;
    [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.lineJoin = pen.lineCap = "round";
    [c1, s1, c2, s2] = [Math.cos(camera.turn), Math.sin(camera.turn), Math.cos(camera.tilt), Math.sin(camera.tilt)];
    focal = 1.2 * Math.min(width, height); // 45 degrees across the shorter side
  }
  function project(p) { // x, y, depth, pixels a meter
    const x = p[0] - camera.middle[0], y = p[1] - camera.middle[1], z = p[2] - camera.middle[2];
    const ahead = -(c1 * x + s1 * y), depth = Math.max(camera.distance + c2 * ahead - s2 * z, 0.05), scale = focal / depth;
    return [width / 2 + scale * (c1 * y - s1 * x), height / 2 - scale * (c2 * z + s2 * ahead), depth, scale];
  }
  function trace(points, close) {
    pen.beginPath();
    points.forEach((p, k) => { const q = project(p); if (k) pen.lineTo(q[0], q[1]); else pen.moveTo(q[0], q[1]); });
    if (close) pen.closePath();
  }
  function path(points, color, size = 1, { close = false, dash = [] } = {}) {
    trace(points, close);
    pen.setLineDash(dash); pen.strokeStyle = color; pen.lineWidth = size; pen.stroke(); pen.setLineDash([]);
  }
  function fill(points, color) { trace(points, true); pen.fillStyle = color; pen.fill(); }
  function rotate(q, v) {
    const [x, y, z, w] = q, tx = 2 * (y * v[2] - z * v[1]), ty = 2 * (z * v[0] - x * v[2]), tz = 2 * (x * v[1] - y * v[0]);
    return [v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx];
  }
  const plus = (p, v) => [p[0] + v[0], p[1] + v[1], p[2] + v[2]];
  const circle = (p, q, radius) => Array.from({ length: RIM }, (_, k) =>
    plus(p, rotate(q, [radius * Math.cos(2 * Math.PI * k / RIM), radius * Math.sin(2 * Math.PI * k / RIM), 0])));

  function ground(low, high) { // a floor with lines each meter
    const corner = (x, y) => [x, y, low[2]];
    fill([corner(low[0], low[1]), corner(high[0], low[1]), corner(high[0], high[1]), corner(low[0], high[1])], colors.ground);
    for (let x = Math.ceil(low[0]); x <= high[0]; x++) path([corner(x, low[1]), corner(x, high[1])], colors.line);
    for (let y = Math.ceil(low[1]); y <= high[1]; y++) path([corner(low[0], y), corner(high[0], y)], colors.line);
  }
  function solid([bottom, top]) { // a prism between two outlines
    const walls = bottom.map((p, k) => [p, bottom[(k + 1) % bottom.length], top[(k + 1) % top.length], top[k]]);
    walls.sort((u, v) => project(v[0])[2] - project(u[0])[2]);
    for (const wall of walls) fill(wall, colors.wall + "c0");
    fill(top, colors.roof);
  }
  function shadow(p, floor, radius) {
    const flat = [p[0], p[1], floor];
    fill(circle(flat, [0, 0, 0, 1], radius), colors.quiet + "40");
    path([p, flat], colors.quiet + "40");
  }
  function drone(p, q, arm, rotor, color) { // an X of four discs; those in front are paler
    for (const [sx, sy] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
      const hub = plus(p, rotate(q, [sx * arm / Math.SQRT2, sy * arm / Math.SQRT2, 0.012]));
      path([p, hub], colors.arm, 1.5);
      fill(circle(hub, q, rotor), color + (sx > 0 ? "b0" : "e8"));
    }
  }
  function arrow(p, v) {
    const tip = plus(p, v), [a, b] = [project(p), project(tip)], long = Math.hypot(b[0] - a[0], b[1] - a[1]), head = Math.min(8, 0.4 * long);
    if (long < 1) return;
    const [x, y] = [(b[0] - a[0]) / long, (b[1] - a[1]) / long];
    path([p, tip], FORCE, 2.5);
    pen.beginPath(); pen.moveTo(b[0], b[1]);
    pen.lineTo(b[0] - head * (x + 0.5 * y), b[1] - head * (y - 0.5 * x)); pen.lineTo(b[0] - head * (x - 0.5 * y), b[1] - head * (y + 0.5 * x));
    pen.fillStyle = FORCE; pen.fill();
  }
  const goal = (p, color, r = 0.05) => path([[r, 0, 0], [0, 0, r], [-r, 0, 0], [0, 0, -r]].map((d) => plus(p, d)), color, 1.5, { close: true });
  const ring = (p, color, radius, size = 1.5) => path(circle(p, [0, 0, 0, 1], radius), color, size, { close: true });
  function cross(p) {
    const [x, y] = project(p), r = 11;
    pen.beginPath(); pen.moveTo(x - r, y - r); pen.lineTo(x + r, y + r); pen.moveTo(x - r, y + r); pen.lineTo(x + r, y - r);
    pen.strokeStyle = BAD; pen.lineWidth = 4; pen.stroke();
  }

  const held = new Map();
  const spread = () => { const [a, b] = [...held.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
  const changed = () => { aim(); redraw(); };
  canvas.onpointerdown = (event) => { held.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture(event.pointerId); };
  canvas.onpointerup = canvas.onpointercancel = (event) => { held.delete(event.pointerId); };
  canvas.onpointermove = (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const wide = held.size === 2 ? spread() : 0;
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (wide) camera.distance *= wide / Math.max(spread(), 1);
    else {
      camera.turn -= 0.006 * (event.clientX - before[0]);
      camera.tilt = Math.min(1.5, Math.max(0.02, camera.tilt + 0.006 * (event.clientY - before[1])));
    }
    changed();
  };
  canvas.onwheel = (event) => { event.preventDefault(); camera.distance *= Math.exp(0.001 * event.deltaY); redraw(); };
  addEventListener("resize", changed);
  aim();
  const clear = () => pen.clearRect(0, 0, width, height);
  return { camera, colors, aim, project, path, ground, solid, shadow, drone, arrow, goal, ring, cross, clear, get size() { return [width, height]; } };
}
