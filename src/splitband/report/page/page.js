"use strict";
(() => {
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const status = document.getElementById("status");
  const say = (text) => { status.textContent = text; };
  const css = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  // Tables: a click, or a key on the heading's button, sorts; what has no number comes last.
  function sorted(heading) {
    const table = heading.closest("table"), headings = all("thead th", table);
    const column = headings.indexOf(heading);
    const down = heading.getAttribute("aria-sort") === "ascending";
    headings.forEach((other) => other.setAttribute("aria-sort", "none"));
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    const value = (row) => {
      const cell = row.cells[column], number = parseFloat(cell.dataset.value);
      return heading.classList.contains("number") ? number : cell.textContent.trim();
    };
    const order = (a, b) => {
      const [x, y] = [value(a), value(b)];
      if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
      const sign = typeof x === "number" ? x - y : x.localeCompare(y, undefined, { numeric: true });
      return down ? -sign : sign;
    };
    table.tBodies[0].append(...[...table.tBodies[0].rows].sort(order));
    say(`Sorted by ${heading.textContent.trim()}, ${down ? "descending" : "ascending"}`);
  }
  all("table.sortable thead th").forEach((heading) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => sorted(heading));
  });

  // Rows that are seen only when asked for, where there is a script to ask.
  all(".more").forEach((more) => {
    const rows = all("tr.minor", more.previousElementSibling), button = more.querySelector("button");
    const label = button.textContent;
    const show = (shown) => {
      rows.forEach((row) => { row.hidden = !shown; });
      button.textContent = shown ? "Show fewer" : label;
      button.setAttribute("aria-expanded", String(shown));
    };
    button.addEventListener("click", () => show(button.getAttribute("aria-expanded") !== "true"));
    more.hidden = false;
    show(false);
    addEventListener("beforeprint", () => show(true));
  });

  all(".copy").forEach((button) => button.addEventListener("click", async () => {
    const code = button.parentElement.querySelector("code");
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(code);
      button.textContent = "Selected";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  }));

  const data = document.getElementById("embedded");
  if (!data) { document.documentElement.dataset.drawn = "0"; return; }

  let figures = [];  // of Bokeh, each with the element that it is drawn in

  // Colours: each curve carries the name of a colour that the style has, light and dark.
  function paint() {
    const ink = css("ink"), soft = css("soft"), rule = css("rule"), grid = css("grid");
    for (const { figure } of figures) {
      figure.setv({
        background_fill_color: css("page"), border_fill_color: css("page"),
        outline_line_color: rule,
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

  const switches = all("input[name=method]");

  // Methods: a switch turns a method on and off in all plots.
  function show(method, shown) {
    for (const { figure } of figures)
      for (const renderer of figure.renderers)
        if (renderer.tags.includes("method") && renderer.name === method)
          renderer.visible = shown;
    for (const entry of all(".key [data-method]"))
      if (entry.dataset.method === method) entry.hidden = !shown;
    hide();
  }
  function hide() {
    for (const each of all("figure[data-methods]")) {
      const methods = JSON.parse(each.dataset.methods);
      each.hidden = !switches.some((s) => s.checked && methods.includes(s.value));
    }
  }
  switches.forEach((input) => input.addEventListener("change", () => {
    show(input.value, input.checked);
    say(`${input.value} ${input.checked ? "shown" : "hidden"}`);
  }));

  // Zoom: by buttons for the record, by keys on any plot; ranges that plots share move as one.
  function zoom(range, factor, shift, logarithmic) {
    const to = logarithmic ? Math.log : (x) => x, from = logarithmic ? Math.exp : (x) => x;
    const [least, most] = [range.reset_start, range.reset_end].map(to);
    const [start, end] = [range.start, range.end].map(to);
    const half = Math.min(factor * (end - start), most - least) / 2;
    let middle = (start + end) / 2 + shift * (end - start);
    middle = Math.min(Math.max(middle, least + half), most - half);
    view(range, from(middle - half), from(middle + half));
  }
  function view(range, start, end) {
    range.setv({ start, end });
    say(`From ${start.toPrecision(5)} to ${end.toPrecision(5)}`);
  }
  const keys = {
    "+": [0.5, 0], "=": [0.5, 0], "-": [2, 0], ArrowLeft: [1, -0.25], ArrowRight: [1, 0.25],
  };
  function pressed(event, figure) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const range = figure.x_range;
    if (event.key === "0") view(range, range.reset_start, range.reset_end);
    else if (event.key in keys) zoom(range, ...keys[event.key], figure.x_scale.type === "LogScale");
    else return;
    event.preventDefault();
  }
  function buttons(document_) {
    const range = document_.get_model_by_name("time");
    all(".views button").forEach((button) => button.addEventListener("click", () => {
      const { start, end, zoom: factor, move } = button.dataset;
      if (start !== undefined) view(range, Number(start), Number(end));
      else zoom(range, Number(factor ?? 1), Number(move ?? 0), false);
    }));
  }

  // A printer gets pictures, which fit its paper, in the colours of a light page.
  function pictures() {
    document.documentElement.dataset.printing = "";
    all("details").forEach((each) => { each.open = true; });
    paint();
    for (const { view: drawn, element } of figures) {
      if (!element.offsetParent) continue;
      drawn.paint?.();
      const picture = new Image();
      picture.alt = "";
      picture.src = drawn.export("png").canvas.toDataURL();
      element.append(picture);
    }
  }
  function plots() {
    delete document.documentElement.dataset.printing;
    all(".plot img").forEach((each) => each.remove());
    paint();
  }

  async function draw() {
    const { documents, items } = JSON.parse(data.textContent);
    data.textContent = "";
    await Bokeh.embed.embed_items(documents, items);
    const [drawn] = Bokeh.documents;
    figures = drawn.roots().map((figure) => ({
      figure, view: Bokeh.index.get_one(figure),
      element: document.getElementById(items[0].roots[figure.id]),
    }));
    paint();
    switches.filter((s) => s.checked !== s.defaultChecked).forEach((s) => show(s.value, s.checked));
    hide();
    figures.forEach(({ figure, element }) =>
      element.addEventListener("keydown", (event) => pressed(event, figure)));
    buttons(drawn);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
    addEventListener("beforeprint", pictures);
    addEventListener("afterprint", plots);
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    document.documentElement.dataset.drawn = String(Math.round(performance.now()));
  }
  draw();
})();
