// The explorer: learning curves of one task, of the algorithms that are ticked, with or without parameter sharing.
// Its whole state stands behind the # of the page's address.
(() => {
  const { families, algorithms, names, sharings } = window.explorerData;
  const place = document.getElementById("explorer");
  const state = {};

  const read = () => {
    const said = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    state.task = said.task in families ? said.task : "lbf-8x8-2p-2f-c"; // the first on which all nine were run
    state.sharing = ["shared", "independent"].includes(said.sharing) ? said.sharing : "shared";
    state.axis = ["steps", "share"].includes(said.axis) ? said.axis : "share";
    state.ticked = new Set(said.algorithms === undefined ? algorithms : said.algorithms.split(",").filter(Boolean));
  };

  const element = (tag, attributes = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), attributes);
    made.append(...children);
    return made;
  };

  // Notes a choice in the address, and shows it.
  const choose = (change) => {
    change();
    const { task, sharing, axis, ticked } = state;
    const some = ticked.size < algorithms.length ? `&algorithms=${[...ticked]}` : "";
    history.replaceState(null, "", `#task=${task}&sharing=${sharing}&axis=${axis}${some}`);
    show();
  };

  const task = element(
    "select",
    { id: "task" },
    ...[...new Set(Object.values(families))].map((family) =>
      element(
        "optgroup",
        { label: family },
        ...Object.keys(families).filter((name) => families[name] === family).map((name) => element("option", { value: name }, names[name])),
      ),
    ),
  );
  task.addEventListener("change", () => choose(() => { state.task = task.value; }));
  const radio = (name, value, label) => {
    const input = element("input", { type: "radio", name, value });
    input.addEventListener("change", () => choose(() => { state[name] = value; }));
    return element("label", {}, input, label);
  };
  const box = (name) => {
    const input = element("input", { type: "checkbox", value: name });
    input.addEventListener("change", () => choose(() => { input.checked ? state.ticked.add(name) : state.ticked.delete(name); }));
    return element("label", {}, input, name.toUpperCase());
  };
  const drawing = element("div", { className: "drawing" });
  const note = element("p", { className: "note" });
  const controls = element(
    "form",
    { className: "controls" },
    element("label", {}, "task ", task),
    element("fieldset", {}, element("legend", {}, "parameter sharing"), radio("sharing", "shared", "with"), radio("sharing", "independent", "without")),
    element("fieldset", {}, element("legend", {}, "horizontal axis"), radio("axis", "share", "share of the training"), radio("axis", "steps", "timesteps")),
    element("fieldset", {}, element("legend", {}, "algorithms"), ...algorithms.map(box)),
  );
  place.replaceChildren(controls, drawing, note);

  // The controls say what the state is; of both kinds of sharing those can be chosen that were run on the task.
  const showControls = () => {
    const there = sharings[state.task];
    if (!there.includes(state.sharing)) state.sharing = there[0];
    task.value = state.task;
    controls.querySelectorAll("input").forEach((input) => {
      input.checked = input.type === "radio" ? state[input.name] === input.value : state.ticked.has(input.value);
      if (input.name === "sharing") {
        input.disabled = !there.includes(input.value);
        input.parentElement.title = input.disabled ? "not measured on this task" : "";
      }
    });
  };

  // The share of its training puts a shorter training's curve beside longer ones.
  const inShares = ({ t, ...curve }) => ({ ...curve, t: t.map((step) => (100 * step) / t.at(-1)) });
  const nameShares = ({ encoding }) => {
    if (encoding.x) Object.assign(encoding.x, { title: "% of the algorithm's own training", axis: { grid: false } });
    encoding.tooltip?.filter(({ field }) => field === "t").forEach((line) => Object.assign(line, { title: "% of the training", format: ".0f" }));
  };

  // Such as "20M steps: IA2C, MAPPO; 2M steps: IQL".
  const lengths = (curves) => {
    const found = {};
    for (const { a, b } of curves) (found[b] ??= []).push(a);
    const longest = Object.keys(found).sort((x, y) => y - x);
    return longest.map((steps) => `${+(steps / 1e6).toPrecision(2)}M steps: ${found[steps].join(", ")}`).join("; ");
  };

  const BANDS =
    "Lines: means over seeds; dashed: the paper's maximum returns. Bands: 2 s / √n, as in the paper, cut off where no return can be. " +
    "They cover the true mean with a probability of 70 % with two seeds, 82 % with three and 88 % with five. ";

  const show = async () => {
    showControls();
    const asked = location.hash;
    const { task, sharing, axis, ticked } = state;
    await window.charts.load(`explorer/${task}.js`);
    if (task !== state.task || sharing !== state.sharing || axis !== state.axis || asked !== location.hash) return; // something else was chosen meanwhile
    const there = window.explorerTasks[task][sharing];
    const algorithm = (label) => label.split(" ")[0].toLowerCase();
    const measured = Object.keys(there.colours);
    const shown = measured.filter((label) => ticked.has(algorithm(label)));
    const chosen = (list) => list.filter(({ a }) => shown.includes(a));
    drawing.hidden = shown.length === 0;
    if (shown.length) {
      const colours = Object.fromEntries(shown.map((label) => [label, there.colours[label]]));
      const curves = axis === "share" ? chosen(there.curves).map(inShares) : chosen(there.curves);
      const chart = { ...there, kind: "explorer", colours, curves, paper: chosen(there.paper) };
      await window.charts.draw(drawing, chart, ({ layer }) => {
        if (axis === "share") layer.forEach(nameShares);
        const below = { orient: "bottom", columns: 3 };
        if (place.clientWidth < 600) layer.forEach(({ encoding }) => Object.assign(encoding.color.legend, below));
      });
    }
    const missing = algorithms.filter((name) => !measured.map(algorithm).includes(name)).map((name) => name.toUpperCase());
    const other = shown.some((label) => label.endsWith("†")) ? " †: another budget than the paper's, which is not comparable." : "";
    note.textContent =
      (shown.length ? `${BANDS}Lengths of the trainings: ${lengths(chosen(there.curves))}.${other}` : "Nothing to show for this choice.") +
      (missing.length ? ` Not measured yet on this task ${sharing === "shared" ? "with" : "without"} sharing: ${missing.join(", ")}.` : "");
    place.dataset.shown = shown.map(algorithm).join(" ");
  };

  window.addEventListener("hashchange", () => {
    read();
    show();
  });
  window.charts.whenThemeChanges(show);
  read();
  show();
})();
