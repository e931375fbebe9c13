// Draws the charts of a page when they come into view, and again when the reader chooses light or dark.
(() => {
  const folder = document.currentScript.src.replace(/charts\.js.*$/, "");
  // Colours that are too dark on a dark page, and those that stand for them there.
  const onDark = { "#332288": "#9a8cf0", "#882255": "#e0659f", "#117733": "#45b36b", "#AA4499": "#d07fc4", "#999933": "#b8b850", "#666666": "#aaaaaa" };
  let vega = null;

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

  const load = () => {
    vega ??= new Promise((resolve) => {
      const script = document.createElement("script");
      script.src = folder + "vega.js";
      script.onload = resolve;
      document.head.append(script);
    });
    return vega;
  };

  // Draws a specification, given as text, into an element; returns Vega's view of it.
  const draw = async (element, text, data = {}) => {
    await load();
    const specification = JSON.parse(coloured(text));
    specification.config = config();
    specification.autosize = { type: "fit-x", contains: "padding" };
    if (Object.keys(data).length) specification.datasets = data;
    const { view } = await vegaEmbed(element, specification, { actions: false, renderer: "svg", tooltip: { theme: isDark() ? "dark" : "light" } });
    return view;
  };

  const drawFigure = (figure) => draw(figure.querySelector(".drawing"), figure.querySelector("script").textContent);

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

  window.charts = { draw, whenThemeChanges };

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
