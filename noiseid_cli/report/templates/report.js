"use strict";
// Tables sort by a click on a heading and are copied for a spreadsheet; the page reads the same without.
(() => {
  const value = (row, column) => row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
  const kept = [];

  function order(table, column, direction) {
    const body = table.tBodies[0];
    const rows = kept.find((entry) => entry.table === table).rows.slice();
    if (direction) {
      rows.sort((a, b) => {
        const [x, y] = [value(a, column), value(b, column)];
        if (x === "" || y === "") return (x === "") - (y === "");
        const both = Number(x) - Number(y);
        return direction * (Number.isNaN(both) ? x.localeCompare(y, "en", { numeric: true }) : both);
      });
    }
    body.classList.toggle("sorted", direction !== 0);
    body.append(...rows);
  }

  function sortable(table) {
    kept.push({ table, rows: [...table.tBodies[0].rows] });
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.title = "Sort by this column";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const next = { ascending: "descending", descending: "none" }[head.getAttribute("aria-sort")] ?? "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        if (next !== "none") head.setAttribute("aria-sort", next);
        order(table, column, { ascending: 1, descending: -1, none: 0 }[next]);
      });
    });
  }

  function fallback(text) {
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }

  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      return fallback(text);
    }
  }

  function copyable(place, before, what, text) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "copy";
    button.textContent = "Copy";
    button.setAttribute("aria-label", `Copy ${what}`);
    button.addEventListener("click", async () => {
      button.textContent = (await copy(text())) ? "Copied" : "Not copied";
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
    place.insertBefore(button, before);
  }

  const tabbed = (table) => [...table.rows]
    .map((row) => [...row.cells].map((cell, j) => (row.parentNode === table.tHead ? cell.textContent.trim() : value(row, j))).join("\t"))
    .join("\n");

  for (const figure of document.querySelectorAll("figure.table")) {
    const table = figure.querySelector("table");
    if (table.tBodies[0].rows.length > 1) sortable(table);
    copyable(figure, figure.querySelector(".scroll"), figure.querySelector("figcaption strong").textContent, () => tabbed(table));
  }
  for (const code of document.querySelectorAll("pre")) {
    const box = document.createElement("div");
    box.className = "code";
    code.replaceWith(box);
    box.append(code);
    copyable(box, code, "these lines", () => code.textContent);
  }
})();
