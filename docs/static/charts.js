// Draws the charts of a page when they come into view, and again when the reader chooses light or dark.
(() => {
  const folder = document.currentScript.src.replace(/charts\.js.*$/, "");
  // Colours that are too dark on a dark page, and those that stand for them there.
  const onDark = { "#332288": "#9a8cf0", "#882255": "#e0659f", "#117733": "#45b36b", "#AA4499": "#d07fc4", "#999933": "#b8b850", "#666666": "#aaaaaa", "#0077bb": "#4fb3ee", "#cc3311": "#ff8a75" };

  const isDark = () => {
    const theme = document.body.dataset.theme;
    return theme === "dark" || (theme !== "light" && matchMedia("(prefers-color-scheme: dark)").matches);
  };

  const config = () => {
    const ink = isDark() ? "#cfd0d0" : "#444";
    const grid = isDark() ? "#3a3d42" : "#e4e2dc";
    const font = getComputedStyle(document.body).fontFamily;
    return {
      background: "transparent",
      font,
      view: { stroke: null },
      axis: { labelColor: ink, titleColor: ink, gridColor: grid, domainColor: grid, tickColor: grid, titleFontWeight: "normal", labelFontSize: 11, titleFontSize: 11 },
      legend: { labelColor: ink, titleColor: ink, labelFontSize: 12 },
    };
  };

  const coloured = (text) =>
    isDark() ? text.replace(/#[0-9A-Fa-f]{6}/g, (colour) => onDark[colour] ?? colour) : text;

  const loaded = {};
  // Runs a script of this folder, once.
  const load = (name) =>
    (loaded[name] ??= new Promise((resolve) => {
      const script = document.createElement("script");
      script.src = folder + name;
      script.onload = resolve;
      document.head.append(script);
    }));

  // Where a symmetric logarithmic axis is labelled: at 0 and at about four powers of ten on each side that has values.
  const powersOfTen = (values, constant) => {
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const first = Math.ceil(Math.log10(constant));
    const last = Math.floor(Math.log10(Math.max(-low, high)));
    const labels = [0];
    for (let power = last; power >= first; power -= Math.ceil((last - first + 1) / 4)) labels.push(10 ** power, -(10 ** power));
    return labels.filter((label) => label === 0 || (low <= label && label <= high)); // the axis always has 0
  };

  // The whole specification of a chart, from its kind and its data.
  const filled = (chart) => {
    const specification = structuredClone(window.chartKinds[chart.kind]);
    if (chart.kind === "scalar") {
      const points = Object.entries(chart.runs).flatMap(([r, { t, v }]) => t.map((step, k) => ({ r, t: step, v: v[k] })));
      if (chart.constant) {
        specification.encoding.y.scale = { type: "symlog", constant: chart.constant };
        specification.encoding.y.axis.values = powersOfTen(points.map(({ v }) => v), chart.constant);
      }
      return { ...specification, datasets: { scalar: points } };
    }
    const [lowest, highest] = [chart.bounds[0] ?? -Infinity, chart.bounds[1] ?? Infinity];
    const band = (mean, half) => ({ l: Math.max(mean - half, lowest), h: Math.min(mean + half, highest) });
    const curves = chart.curves.flatMap(({ a, n, t, m, i }) =>
      t.map((step, k) => ({ a, n, t: step, m: m[k], ...(i && band(m[k], i[k])) })),
    );
    if (chart.paper.length === 0) specification.layer.splice(2, 1); // the paper's rules
    if (!chart.curves.some(({ i }) => i)) {
      specification.layer.shift(); // one seed each: there are no intervals
      for (const { encoding } of specification.layer) {
        encoding.tooltip = encoding.tooltip?.filter(({ field }) => field !== "l" && field !== "h");
      }
    }
    for (const { encoding } of specification.layer) {
      encoding.color.scale = { domain: Object.keys(chart.colours), range: Object.values(chart.colours) };
    }
    hideFarStart(specification, chart);
    return { ...specification, datasets: { curves, paper: chart.paper } };
  };

  // Where the evaluations before training lie far below all others, the axis begins above them: else all lines are flat.
  const hideFarStart = (specification, { curves, paper }) => {
    const later = [...curves.flatMap(({ m }) => m.slice(1)), ...paper.map(({ p }) => p)];
    const [low, high] = [Math.min(...later), Math.max(...later)];
    if (Math.min(...curves.map(({ m }) => m[0])) > low - 2 * (high - low)) return;
    for (const layer of specification.layer) {
      layer.mark = { ...(layer.mark.type ? layer.mark : { type: layer.mark }), clip: true };
      layer.encoding.y.scale = { ...layer.encoding.y.scale, domainMin: low - 0.1 * (high - low) };
    }
  };

  // Draws a chart into an element. adapt: changes its specification before.
  const draw = async (element, chart, adapt = () => {}) => {
    await Promise.all([load("chart-kinds.js"), load("vega.js")]);
    const specification = JSON.parse(coloured(JSON.stringify(filled(chart))));
    specification.config = config();
    specification.autosize = { type: "fit-x", contains: "padding" };
    adapt(specification);
    await vegaEmbed(element, specification, { actions: false, renderer: "svg", tooltip: { theme: isDark() ? "dark" : "light" } });
  };

  const drawFigure = (figure) => draw(figure.querySelector(".drawing"), JSON.parse(figure.querySelector("script").textContent));

  const whenThemeChanges = (again) => {
    let dark = isDark();
    const look = () => {
      if (isDark() !== dark) {
        dark = isDark();
        again();
      }
    };
    new MutationObserver(look).observe(document.body, { attributes: true, attributeFilter: ["data-theme"] });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", look);
  };

  window.charts = { draw, load, whenThemeChanges };

  const seen = new Set();
  const observer = new IntersectionObserver(
    (entries) => {
      for (const { isIntersecting, target } of entries) {
        if (isIntersecting && !seen.has(target)) {
          seen.add(target);
          drawFigure(target);
        }
      }
    },
    { rootMargin: "300px" },
  );
  document.querySelectorAll("figure.chart").forEach((figure) => observer.observe(figure));
  whenThemeChanges(() => seen.forEach(drawFigure));
})();
