// The explorer: learning curves of one task, of the algorithms that are ticked, with or without parameter sharing.
(() => {
  const { families, algorithms } = window.explorerData;
  const place = document.getElementById("explorer");
  const state = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  state.task = state.task in families ? state.task : "lbf-8x8-2p-2f-c"; // the first on which all nine were run
  state.sharing = ["shared", "independent"].includes(state.sharing) ? state.sharing : "shared";
  const ticked = new Set(state.algorithms ? state.algorithms.split(",") : algorithms);

  const element = (tag, attributes = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), attributes);
    made.append(...children);
    return made;
  };

  const task = element(
    "select",
    { id: "task" },
    ...[...new Set(Object.values(families))].map((family) =>
      element(
        "optgroup",
        { label: family },
        ...Object.keys(families).filter((name) => families[name] === family).map((name) => element("option", { value: name }, name)),
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
  const box = (name) => {
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
    const { task, sharing } = state;
    await window.charts.load(`explorer/${task}.js`);
    if (task !== state.task || sharing !== state.sharing) return; // something else was chosen meanwhile
    const there = window.explorerTasks[task][sharing];
    const measured = there ? Object.keys(there.colours) : [];
    const shown = measured.filter((name) => ticked.has(name.toLowerCase()));
    const chosen = (list) => list.filter(({ a }) => shown.includes(a));
    drawing.hidden = shown.length === 0;
    if (shown.length) {
      const colours = Object.fromEntries(shown.map((name) => [name, there.colours[name]]));
      const chart = { kind: "explorer", colours, curves: chosen(there.curves), paper: chosen(there.paper) };
      await window.charts.draw(drawing, chart, ({ layer }) => {
        const below = { orient: "bottom", columns: 3 };
        if (place.clientWidth < 600) layer.forEach(({ encoding }) => Object.assign(encoding.color.legend, below));
      });
    }
    const missing = algorithms.map((name) => name.toUpperCase()).filter((name) => !measured.includes(name));
    note.textContent =
      (shown.length ? "Lines: means over seeds; bands: 2 s / √n; dashed: the paper's maximum returns. A click on the legend shows one algorithm alone, with shift one more." : "Nothing to show.") +
      (missing.length ? ` Not measured yet on this task ${sharing === "shared" ? "with" : "without"} sharing: ${missing.join(", ")}.` : "");
    place.dataset.shown = shown.join(" ").toLowerCase();
  };
  window.charts.whenThemeChanges(show);
  show();
})();
