"use strict";
// Sorts the table by the column whose head is clicked; cells without a value stay below, ties keep their order.
function sortBy(head) {
  const table = head.closest("table"), body = table.tBodies[0];
  const column = [...head.parentNode.children].indexOf(head);
  const down = head.getAttribute("aria-sort") === "ascending";
  const keyOf = (row) => row.cells[column].dataset.by;
  const rows = [...body.rows].map((row) => ({ row, key: keyOf(row) }));
  const numeric = rows.every(({ row, key }) => key === undefined || row.cells[column].classList.contains("number"));
  rows.sort((a, b) => {
    if (a.key === undefined || b.key === undefined) return (a.key === undefined) - (b.key === undefined);
    const order = numeric ? Number(a.key) - Number(b.key) : a.key.localeCompare(b.key, "en", { numeric: true });
    return down ? -order : order;
  });
  for (const other of head.parentNode.children) other.setAttribute("aria-sort", "none");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  body.append(...rows.map(({ row }) => row));
}

for (const head of document.querySelectorAll("#runs th")) {
  head.firstElementChild.addEventListener("click", () => sortBy(head));
}
document.body.dataset.ready = "true";
