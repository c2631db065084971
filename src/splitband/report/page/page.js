"use strict";
(async () => {
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const css = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const root = document.documentElement, data = document.getElementById("embedded");
  if (!data) { root.dataset.drawn = "0"; return; }

  const { documents, items } = JSON.parse(data.textContent);
  await Bokeh.embed.embed_items(documents, items);
  const figures = Bokeh.documents[0].roots().map((figure) => ({
    figure, view: Bokeh.index.get_one(figure),
    element: document.getElementById(items[0].roots[figure.id]),
  }));

  // Colours: each curve carries the name of a colour that the style has, light and dark.
  function paint() {
    const [ink, soft, rule, grid, page] = ["ink", "soft", "rule", "grid", "page"].map(css);
    for (const { figure } of figures) {
      figure.setv({
        background_fill_color: page, border_fill_color: page, outline_line_color: rule,
      });
      for (const axis of [...figure.below, ...figure.left, ...figure.above]) axis.setv({
        axis_line_color: rule, major_tick_line_color: soft, minor_tick_line_color: rule,
        major_label_text_color: ink, axis_label_text_color: ink,
        axis_label_text_font_style: "normal", axis_label_text_font_size: "12px",
        major_label_text_font_size: "12px",
      });
      for (const part of figure.center) {
        const [role] = part.tags;
        if (part.type === "Grid") part.setv({ grid_line_color: grid });
        else if (part.type === "Span") part.setv({ line_color: css(role) });
        else if (role) part.setv({ fill_color: css(role), line_color: null });
      }
      for (const renderer of figure.renderers) {
        const color = css(renderer.tags[0]);
        const properties = ["line_color", "fill_color"].filter((p) => p in renderer.glyph);
        renderer.glyph.setv(Object.fromEntries(properties.map((p) => [p, { value: color }])));
      }
    }
  }

  all("[data-curve]").forEach((button) => button.addEventListener("click", () => {
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(shown));
    const { figure } = figures.find(({ element }) => button.closest("figure").contains(element));
    for (const renderer of figure.renderers)
      if (renderer.name === button.dataset.curve) renderer.visible = shown;
  }));

  all(".views button").forEach((button) => button.addEventListener("click", () => {
    const { start, end } = button.dataset;
    Bokeh.documents[0].get_model_by_name("time").setv({ start: Number(start), end: Number(end) });
  }));

  // A printer gets pictures, which fit its paper, in the colours of a light page.
  addEventListener("beforeprint", () => {
    root.dataset.printing = "";
    paint();
    for (const { view, element } of figures) {
      view.paint?.();
      const picture = new Image();
      picture.alt = "";
      picture.src = view.export("png").canvas.toDataURL();
      element.append(picture);
    }
  });
  addEventListener("afterprint", () => {
    delete root.dataset.printing;
    all(".plot img").forEach((each) => each.remove());
    paint();
  });

  paint();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  root.dataset.drawn = "1";
})();
