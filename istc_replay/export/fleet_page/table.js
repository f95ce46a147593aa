"use strict";
// Tables of any length: only the rows in sight are in the page. All text is set as text.
for (const root of document.querySelectorAll("[data-rows]")) {
  const {columns, rows} = JSON.parse(document.getElementById(root.dataset.rows).textContent);
  const HEIGHT = 30, BEYOND = 12;
  const pane = root.querySelector(".pane"), body = root.querySelector("tbody");
  const count = root.querySelector("output"), text = root.querySelector("input");
  const choices = [...root.querySelectorAll("select")], heads = [...root.querySelectorAll("thead th")];
  const plain = cell => Array.isArray(cell) ? cell[0] : cell;
  const words = rows.map(row => row.map(plain).filter(c => typeof c === "string").join("\n").toLowerCase());
  let shown = rows.map((_, i) => i), order = {column: -1, down: false}, first = -1;

  const spacer = height => {
    const row = document.createElement("tr"), cell = document.createElement("td");
    row.setAttribute("aria-hidden", "true");
    row.className = "spacer";
    cell.colSpan = columns.length;
    cell.style.height = height + "px";
    row.append(cell);
    return row;
  };
  const written = (value, column) => {
    if (value === null) return "–";
    if (typeof value !== "number") return value;
    const fine = value !== 0 && Math.abs(value) < 0.5 * 10 ** -column.digits;
    return (fine || Math.abs(value) >= 1e7 ? value.toExponential(1) : value.toFixed(column.digits)).replace("-", "−");
  };
  const line = index => {
    const row = document.createElement("tr");
    rows[index].forEach((value, i) => {
      const column = columns[i], cell = document.createElement(i ? "td" : "th");
      if (!i) cell.scope = "row";
      let target = cell;
      if (Array.isArray(value) && value[1]) {
        target = document.createElement("a");
        target.href = value[1];
        cell.append(target);
      }
      const said = written(plain(value), column);
      target.textContent = said;
      if (column.digits !== null) cell.className = "n";
      else { cell.title = said; cell.dir = "auto"; }
      const tone = column.tones && column.tones[plain(value)];
      if (tone) cell.className = tone;
      row.append(cell);
    });
    return row;
  };
  const draw = force => {
    const start = Math.max(0, Math.floor(pane.scrollTop / HEIGHT) - BEYOND);
    if (!force && start === first) return;
    first = start;
    const end = Math.min(shown.length, start + Math.ceil(pane.clientHeight / HEIGHT) + 2 * BEYOND);
    body.replaceChildren(spacer(start * HEIGHT), ...shown.slice(start, end).map(line),
      spacer((shown.length - end) * HEIGHT));
  };
  const compare = (a, b) => {
    const x = plain(rows[a][order.column]), y = plain(rows[b][order.column]);
    if (x === null || y === null) return (x === null) - (y === null) || a - b;
    const ranks = columns[order.column].ranks;
    const by = ranks ? ranks.indexOf(x) - ranks.indexOf(y)
      : typeof x === "number" ? x - y : x < y ? -1 : x > y ? 1 : 0;
    return (order.down ? -by : by) || a - b;
  };
  const update = () => {
    const wanted = text.value.trim().toLowerCase();
    const chosen = choices.filter(c => c.value !== "").map(c => [Number(c.dataset.column), c.value]);
    shown = [];
    for (let i = 0; i < rows.length; i++) {
      if (words[i].includes(wanted) && chosen.every(([c, v]) => String(plain(rows[i][c]) ?? "–") === v)) shown.push(i);
    }
    if (order.column >= 0) shown.sort(compare);
    count.textContent = shown.length + " of " + rows.length;
    heads.forEach((head, i) => head.setAttribute("aria-sort",
      i !== order.column ? "none" : order.down ? "descending" : "ascending"));
    pane.scrollTop = 0;
    draw(true);
  };
  heads.forEach((head, i) => head.querySelector("button").addEventListener("click", () => {
    const again = order.column === i;
    order = {column: i, down: again ? !order.down : columns[i].digits !== null || Boolean(columns[i].ranks)};
    update();
  }));
  text.addEventListener("input", update);
  for (const choice of choices) choice.addEventListener("change", update);
  pane.addEventListener("scroll", () => draw(false), {passive: true});
  window.addEventListener("resize", () => draw(true));
  root.hidden = false;
  update();
}
