// The explorer: learning curves of one task, of the algorithms that are ticked, with or without parameter sharing.
(() => {
  const { tasks, algorithms, cells, specification } = window.explorerData;
  const place = document.getElementById("explorer");
  const state = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  state.task = tasks.some(({ name }) => name === state.task) ? state.task : "lbf-8x8-2p-2f-c"; // the first on which all nine were run
  state.sharing = ["shared", "independent"].includes(state.sharing) ? state.sharing : "shared";
  const ticked = new Set(state.algorithms ? state.algorithms.split(",") : algorithms.map(({ name }) => name));

  const element = (tag, attributes = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), attributes);
    made.append(...children);
    return made;
  };

  const families = [...new Set(tasks.map(({ family }) => family))];
  const task = element(
    "select",
    { id: "task" },
    ...families.map((family) =>
      element(
        "optgroup",
        { label: family },
        ...tasks.filter((each) => each.family === family).map(({ name }) => element("option", { value: name }, name)),
      ),
    ),
  );
  task.value = state.task;
  const radio = (value, label) => {
    const input = element("input", { type: "radio", name: "sharing", value, checked: state.sharing === value });
    input.addEventListener("change", () => {
      state.sharing = value;
      remember();
      show();
    });
    return element("label", {}, input, label);
  };
  const box = ({ name }) => {
    const input = element("input", { type: "checkbox", value: name, checked: ticked.has(name) });
    input.addEventListener("change", () => {
      input.checked ? ticked.add(name) : ticked.delete(name);
      remember();
      show();
    });
    return element("label", {}, input, name.toUpperCase());
  };
  task.addEventListener("change", () => {
    state.task = task.value;
    remember();
    show();
  });
  const drawing = element("div", { className: "drawing" });
  const note = element("p", { className: "note" });
  place.replaceChildren(
    element(
      "form",
      { className: "controls" },
      element("label", {}, "task ", task),
      element("fieldset", {}, element("legend", {}, "parameter sharing"), radio("shared", "with"), radio("independent", "without")),
      element("fieldset", {}, element("legend", {}, "algorithms"), ...algorithms.map(box)),
    ),
    drawing,
    note,
  );

  const remember = () => {
    history.replaceState(null, "", `#task=${state.task}&sharing=${state.sharing}` + (ticked.size < algorithms.length ? `&algorithms=${[...ticked]}` : ""));
  };

  const show = async () => {
    const there = cells.filter((cell) => cell.task === state.task && cell.sharing === state.sharing);
    const chosen = there.filter((cell) => ticked.has(cell.algorithm));
    const curves = chosen.flatMap(({ algorithm, seeds, t, m, i }) =>
      t.map((step, k) => ({ a: algorithm.toUpperCase(), t: step, m: m[k], n: seeds, ...(i[k] !== null && { l: m[k] - i[k], h: m[k] + i[k] }) })),
    );
    const paper = chosen.filter((cell) => cell.paper !== null).map((cell) => ({ a: cell.algorithm.toUpperCase(), p: cell.paper }));
    const own = JSON.parse(JSON.stringify(specification));
    if (!curves.some(({ l }) => l !== undefined)) own.layer.shift(); // one seed each: no bands
    const shown = algorithms.filter(({ name }) => chosen.some((cell) => cell.algorithm === name));
    for (const { encoding } of own.layer) {
      encoding.color.scale = { domain: shown.map(({ name }) => name.toUpperCase()), range: shown.map(({ colour }) => colour) };
      if (place.clientWidth < 600) Object.assign(encoding.color.legend, { orient: "bottom", columns: 3 });
    }
    drawing.hidden = chosen.length === 0;
    if (chosen.length) await window.charts.draw(drawing, JSON.stringify(own), { curves, paper });
    const missing = algorithms.filter(({ name }) => !there.some((cell) => cell.algorithm === name)).map(({ name }) => name.toUpperCase());
    note.textContent =
      (chosen.length ? "Lines: means over seeds; bands: 2 s / √n; dashed: the paper's maximum returns. A click on the legend shows one algorithm alone, with shift one more." : "Nothing to show.") +
      (missing.length ? ` Not measured yet on this task ${state.sharing === "shared" ? "with" : "without"} sharing: ${missing.join(", ")}.` : "");
    place.dataset.shown = chosen.map(({ algorithm }) => algorithm).join(" ");
  };
  window.charts.whenThemeChanges(show);
  show();
})();
