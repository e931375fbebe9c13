// The explorer: learning curves of one task, of the algorithms that are ticked, with or without parameter sharing.
(() => {
  const { families, algorithms } = window.explorerData;
  const place = document.getElementById("explorer");
  const state = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  state.task = state.task in families ? state.task : "lbf-8x8-2p-2f-c"; // the first on which all nine were run
  state.sharing = ["shared", "independent"].includes(state.sharing) ? state.sharing : "shared";
  state.axis = ["steps", "share"].includes(state.axis) ? state.axis : "share";
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
  const radio = (name, value, label) => {
    const input = element("input", { type: "radio", name, value, checked: state[name] === value });
    input.addEventListener("change", () => {
      state[name] = value;
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
      element("fieldset", {}, element("legend", {}, "parameter sharing"), radio("sharing", "shared", "with"), radio("sharing", "independent", "without")),
      element("fieldset", {}, element("legend", {}, "horizontal axis"), radio("axis", "share", "share of the training"), radio("axis", "steps", "timesteps")),
      element("fieldset", {}, element("legend", {}, "algorithms"), ...algorithms.map(box)),
    ),
    drawing,
    note,
  );

  const remember = () => {
    history.replaceState(null, "", `#task=${state.task}&sharing=${state.sharing}&axis=${state.axis}` + (ticked.size < algorithms.length ? `&algorithms=${[...ticked]}` : ""));
  };

  // Off-policy trainings are ten times shorter: the share of its training puts an algorithm's curve beside the others.
  const inShares = ({ t, ...curve }) => ({ ...curve, t: t.map((step) => (100 * step) / t.at(-1)) });
  const nameShares = ({ encoding }) => {
    if (encoding.x) Object.assign(encoding.x, { title: "% of the algorithm's own training", axis: { grid: false } });
    encoding.tooltip?.filter(({ field }) => field === "t").forEach((line) => Object.assign(line, { title: "% of the training", format: ".0f" }));
  };

  const show = async () => {
    const { task, sharing, axis } = state;
    await window.charts.load(`explorer/${task}.js`);
    if (task !== state.task || sharing !== state.sharing || axis !== state.axis) return; // something else was chosen meanwhile
    const there = window.explorerTasks[task][sharing];
    const measured = there ? Object.keys(there.colours) : [];
    const shown = measured.filter((name) => ticked.has(name.toLowerCase()));
    const chosen = (list) => list.filter(({ a }) => shown.includes(a));
    drawing.hidden = shown.length === 0;
    if (shown.length) {
      const colours = Object.fromEntries(shown.map((name) => [name, there.colours[name]]));
      const curves = axis === "share" ? chosen(there.curves).map(inShares) : chosen(there.curves);
      const chart = { kind: "explorer", colours, curves, paper: chosen(there.paper) };
      await window.charts.draw(drawing, chart, ({ layer }) => {
        if (axis === "share") layer.forEach(nameShares);
        const below = { orient: "bottom", columns: 3 };
        if (place.clientWidth < 600) layer.forEach(({ encoding }) => Object.assign(encoding.color.legend, below));
      });
    }
    const missing = algorithms.map((name) => name.toUpperCase()).filter((name) => !measured.includes(name));
    note.textContent =
      (shown.length ? "Lines: means over seeds; bands: 2 s / √n; dashed: the paper's maximum returns. A click on the legend shows one algorithm alone, with shift one more." : "Nothing to show for this choice.") +
      (missing.length ? ` Not measured yet on this task ${sharing === "shared" ? "with" : "without"} sharing: ${missing.join(", ")}.` : "");
    place.dataset.shown = shown.join(" ").toLowerCase();
  };
  window.charts.whenThemeChanges(show);
  show();
})();
