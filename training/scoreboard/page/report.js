"use strict";
// The page is whole without this script, which sorts and filters what stands in it.
(() => {
  const get = (id) => document.getElementById(id);
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const make = (name, ...content) => { const e = document.createElement(name); e.append(...content); return e; };
  const matrix = get("matrix"), numbers = get("numbers");
  const copies = (element) => [...element.childNodes].map((node) => node.cloneNode(true));
  const metrics = new Map([...numbers.tHead.rows[0].cells].filter((head) => head.dataset.metric)
    .map((head) => [head.dataset.metric, { column: head.cellIndex, better: head.dataset.better, help: head.title, label: head.textContent }]));
  let metric = matrix.dataset.metric;

  // Sorting. Cells without a number stay last, whichever way.
  const better = (head) => head.dataset.better || (head.dataset.task ? metrics.get(metric).better : "");
  const key = (row, column) => {
    const cell = row.cells[column], number = cell.dataset.v;
    return number !== undefined ? Number(number) : cell.tagName === "TH" ? cell.textContent : null;
  };
  function compare(a, b, sign) {
    if (a === null || b === null) return (a === null) - (b === null);
    return sign * (typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true }));
  }
  function sort(table, head) {
    const column = head.cellIndex, sign = head.getAttribute("aria-sort") === "ascending" ? 1 : -1;
    const rows = [...table.tBodies[0].rows].map((row) => [key(row, column), row]);
    rows.sort((a, b) => compare(a[0], b[0], sign));
    table.tBodies[0].append(...rows.map((pair) => pair[1]));
  }
  function turn(table, head) {
    const heads = all("th[data-sort]", table), now = head.getAttribute("aria-sort");
    const first = ["", "lower"].includes(better(head)) ? "ascending" : "descending";
    const other = { ascending: "descending", descending: "ascending" };
    for (const each of heads) each.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", other[now] || first);
    sort(table, head);
  }
  for (const table of [matrix, numbers])
    for (const head of all("th[data-sort]", table)) {
      const button = make("button", head.querySelector("span"));
      button.type = "button";
      button.addEventListener("click", () => turn(table, head));
      head.append(button);
      head.setAttribute("aria-sort", "none");
    }
  const resort = () => all("th[aria-sort$=scending]", matrix).forEach((head) => sort(matrix, head));

  // One metric in the place of another, out of the table of every number.
  const rowOf = (cell) => get(cell.querySelector("a.n").getAttribute("href").slice(1));
  function show(name) {
    const { column, label } = metrics.get(metric = name);
    for (const cell of all("td.flown", matrix)) {
      const source = rowOf(cell).cells[column], tint = source.style.getPropertyValue("--t");
      cell.querySelector("a.n").replaceChildren(...copies(source));
      if (source.dataset.v === undefined) delete cell.dataset.v; else cell.dataset.v = source.dataset.v;
      if (tint) cell.style.setProperty("--t", tint); else cell.removeAttribute("style");
    }
    matrix.caption.textContent = `${label} of every agent on every task`;
    resort();
  }

  // Filters.
  const chosen = { family: get("family"), text: get("filter"), privileged: get("privileged") };
  function filter() {
    const wanted = chosen.text.value.trim().toLowerCase(), family = chosen.family.value;
    for (const element of all("[data-family]", matrix)) element.hidden = Boolean(family) && element.dataset.family !== family;
    const rows = [...matrix.tBodies[0].rows], tasks = all("th[data-task]", matrix);
    for (const row of rows) {
      const named = row.cells[0].textContent.toLowerCase().includes(wanted) || row.dataset.agent.toLowerCase().includes(wanted);
      row.hidden = !named || (row.dataset.privileged === "yes" && !chosen.privileged.checked);
    }
    const seen = (list) => `${list.filter((element) => !element.hidden).length} of ${list.length}`;
    get("count").textContent = `${seen(rows)} agents, ${seen(tasks)} tasks`;
  }
  get("metric").addEventListener("change", (event) => show(event.target.value));
  for (const control of Object.values(chosen)) control.addEventListener("input", filter);
  get("controls").addEventListener("submit", (event) => event.preventDefault());
  get("controls").hidden = false;

  // All metrics of a pair.
  const dialog = get("detail");
  function open(title, about, replay, values) {
    get("detail-title").textContent = title;
    get("detail-about").textContent = about;
    get("detail-replay").replaceChildren(...replay);
    get("detail-values").replaceChildren(...values);
    dialog.showModal();
  }
  function line(head, source) {
    const small = source.querySelector("small"), term = make("dt", head.label);
    term.title = head.help;
    return make("div", term, make("dd", source.firstChild.textContent.trim()), make("dd", small ? small.textContent : ""));
  }
  function detail(cell) {
    const row = rowOf(cell), agent = cell.closest("tr").cells[0], link = row.cells[2].querySelector("a");
    const shown = link ? [make("a", "Watch a replay"), ` ${row.cells[2].dataset.why || ""}`] : [];
    if (link) shown[0].href = link.getAttribute("href");
    const about = [`${row.cells[3].textContent} episodes of ${row.dataset.task}.`, agent.title, row.dataset.note && `† ${row.dataset.note}`].filter(Boolean).join(" ");
    open(row.dataset.label, about, shown, [...metrics.values()].map((head) => line(head, row.cells[head.column])));
  }
  matrix.addEventListener("click", (event) => {
    const link = event.target.closest("a.n"), word = event.target.closest("button.word");
    if (link && !event.ctrlKey && !event.metaKey && !event.shiftKey) { event.preventDefault(); detail(link.parentElement); }
    if (word) {
      const head = all("th[data-task]", matrix).find((each) => each.cellIndex === word.parentElement.cellIndex);
      open(`${word.closest("tr").cells[0].firstChild.textContent}, ${head.title}`, `${word.textContent}: ${word.title || "no reason was given"}`, [], []);
    }
  });
  for (const abbr of all("td.failed abbr, td.unsupported abbr", matrix)) {
    const button = make("button", abbr.textContent);
    Object.assign(button, { type: "button", className: "word", title: abbr.title });
    abbr.replaceWith(button);
  }
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });

  // Agents that are brought out of the plots.
  const pressed = new Set(), drawn = all("svg [data-agent], .board [data-agent]");
  function light(passing) {
    const lit = new Set(passing === undefined ? pressed : [...pressed, passing]);
    for (const element of drawn) {
      const on = lit.has(element.dataset.agent);
      element.classList.toggle("dim", lit.size > 0 && !on);
      element.classList.toggle("lit", on);
      if (on && element.tagName === "g" && element.nextElementSibling?.tagName === "g") element.parentElement.append(element);
    }
  }
  for (const entry of all(".legend [data-key]")) {
    const button = make("button", ...entry.childNodes), name = entry.dataset.key;
    button.type = "button";
    button.setAttribute("aria-pressed", "false");
    button.addEventListener("click", () => {
      if (!pressed.delete(name)) pressed.add(name);
      button.setAttribute("aria-pressed", String(pressed.has(name)));
      light();
    });
    button.addEventListener("mouseenter", () => light(name));
    button.addEventListener("mouseleave", () => light());
    entry.replaceWith(button);
  }
  for (const element of all(".scripted")) element.hidden = false;

  const theme = get("theme");
  theme.hidden = false;
  theme.addEventListener("click", () => {
    const root = document.documentElement, dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const now = root.style.colorScheme || (dark ? "dark" : "light");
    root.style.colorScheme = now === "dark" ? "light" : "dark";
  });
  filter();
  document.body.dataset.ready = "yes";
})();
