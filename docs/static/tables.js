// Sorts a table when the head of a column is clicked: numbers from the highest, words from A; another click turns it.
document.querySelectorAll("table.sortable").forEach((table) => {
  const body = table.tBodies[0];
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const value = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
      const isNumber = (text) => text !== "" && !Number.isNaN(Number(text));
      const down = head.getAttribute("aria-sort") ? head.getAttribute("aria-sort") === "ascending" : isNumber(value(body.rows[0]));
      const order = (a, b) => {
        const [x, y] = [value(a), value(b)];
        if (x === "" || y === "") return (x === "") - (y === ""); // what is missing comes last
        const found = isNumber(x) && isNumber(y) ? Number(x) - Number(y) : x.localeCompare(y, "en", { numeric: true });
        return down ? -found : found;
      };
      const rows = [...body.rows].sort(order);
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      body.append(...rows);
    });
  });
});

// Marks what is wider than its window, so that site.css can say it.
const sizes = new ResizeObserver((entries) => {
  for (const { target } of entries) target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth + 1);
});
document.querySelectorAll(".wide, .table-wrapper, .formula").forEach((element) => sizes.observe(element));

// Shows the cell that the address names, also where its table is wider than the window.
const showTarget = () => document.querySelector("td:target")?.scrollIntoView({ block: "center", inline: "center" });
window.addEventListener("load", showTarget);
window.addEventListener("hashchange", showTarget);
