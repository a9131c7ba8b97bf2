// Zoom of the figures: drag over a range, double-click for the whole; keys + and - and arrows, 0 for the whole.
(function () {
  "use strict";
  const SUPERSCRIPT = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const plots = new WeakMap();

  function add(name, attributes, parent) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return parent.appendChild(made);
  }
  const at = (node, name) => Number(node.getAttribute(name));
  // A direction of an axes: range in points, values at its ends, and the window as shares of the range.
  const direction = (start, size, from, to, log) => ({ start, size, from, to, log, low: 0, high: 1, marks: [], made: [] });
  const value = (d, share) => (d.log ? d.from * (d.to / d.from) ** share : d.from + (d.to - d.from) * share);
  const moved = (d, place) => d.start + ((place - d.start) / d.size - d.low) / (d.high - d.low) * d.size;
  const holds = (d, place) => place >= d.start && place <= d.start + d.size;
  const share = (d, place) => d.low + (place - d.start) / d.size * (d.high - d.low);

  function panel(group, [x, y, width, height, x0, x1, y0, y1, xlog, ylog]) {
    const p = { x: direction(x, width, x0, x1, xlog), y: direction(y, height, y1, y0, ylog), shapes: [], signs: [], texts: [] };
    for (const axis of group.querySelectorAll(":scope > .axis")) {
      const ticks = [...axis.children].filter((tick) => tick.querySelector("use"));
      const below = ticks.length > 0 && ticks.every((tick) => Math.abs(at(tick.querySelector("use"), "y") - y - height) < 1);
      const d = below ? p.x : p.y, texts = ticks.map((tick) => tick.querySelector("text")).filter(Boolean);
      // An axis of names instead of numbers keeps its range.
      d.fixed = !d.log && texts.some((text) => !/^[−\d.]+$/.test(text.textContent));
      Object.assign(d, { axis, marks: ticks, label: texts[0], tick: ticks.find((tick) => tick.querySelector("text")) });
    }
    for (const node of group.querySelectorAll("[clip-path]")) {
      if (node.closest(".axis, .legend")) continue;
      const signs = node.querySelectorAll("use");
      if (signs.length) { signs.forEach((sign) => p.signs.push([sign, at(sign, "x"), at(sign, "y")])); continue; }
      const clip = document.createElementNS(node.namespaceURI, "g");
      clip.setAttribute("clip-path", node.getAttribute("clip-path"));
      node.removeAttribute("clip-path");
      node.replaceWith(clip);
      clip.append(node);
      node.style.vectorEffect = "non-scaling-stroke";
      p.shapes.push([node, node.getAttribute("transform") || ""]);
    }
    for (const text of group.querySelectorAll(":scope > g > text")) {
      const px = at(text, "x"), py = at(text, "y");
      // Titles stand above the edges, labels of instants above their place.
      if (px > x + 1 && px < x + width - 1 && py > y - 16 && py < y + height) p.texts.push([text, px, py]);
    }
    return p;
  }
  function panels(svg) {
    if (!plots.has(svg)) {
      const groups = svg.querySelectorAll("g.axes"), rows = JSON.parse(svg.dataset.axes);
      plots.set(svg, groups.length === rows.length ? rows.map((row, k) => panel(groups[k], row)) : []);
    }
    return plots.get(svg);
  }
  function ticks(d) {
    const ends = [value(d, d.low), value(d, d.high)], low = Math.min(...ends), high = Math.max(...ends), found = [];
    if (d.log && high > 30 * low) {
      const every = Math.ceil(Math.log10(high / low) / 6);
      for (let k = Math.ceil(Math.log10(low)); k <= Math.log10(high); k += every)
        found.push([10 ** k, "10" + [...String(k)].map((c) => SUPERSCRIPT[c] || "⁻").join("")]);
      return found;
    }
    const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
    const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let k = Math.ceil(low / step); k * step <= high; k++)
      found.push([k * step, places > 8 ? (k * step).toPrecision(4) : (k * step).toFixed(places).replace("-", "−")]);
    return found;
  }
  function label(d, horizontal, whole) {
    d.made.forEach((node) => node.remove());
    d.made = [];
    d.marks.forEach((mark) => (mark.style.display = whole ? "" : "none"));
    if (whole || !d.label) return;
    const mark = d.tick.querySelector("use"), name = horizontal ? "x" : "y", gap = at(d.label, name) - at(mark, name);
    for (const [number, text] of ticks(d)) {
      const part = d.log ? Math.log(number / d.from) / Math.log(d.to / d.from) : (number - d.from) / (d.to - d.from);
      const place = moved(d, d.start + part * d.size), node = d.label.cloneNode(true), sign = mark.cloneNode(true);
      node.textContent = text;
      node.removeAttribute("transform");
      node.setAttribute(name, place + gap);
      sign.setAttribute(name, place);
      d.made.push(d.axis.appendChild(sign), d.axis.appendChild(node));
    }
  }
  function draw(p) {
    const { x, y } = p, sx = 1 / (x.high - x.low), sy = 1 / (y.high - y.low);
    const matrix = `matrix(${sx} 0 0 ${sy} ${moved(x, 0)} ${moved(y, 0)})`;
    for (const [node, own] of p.shapes) node.setAttribute("transform", `${matrix} ${own}`);
    for (const [sign, px, py] of p.signs) { sign.setAttribute("x", moved(x, px)); sign.setAttribute("y", moved(y, py)); }
    for (const [text, px, py] of p.texts) {
      const dx = moved(x, px) - px, dy = py < y.start ? 0 : moved(y, py) - py;
      text.parentNode.setAttribute("transform", `translate(${dx} ${dy})`);
      text.style.display = holds(x, px + dx) && (py < y.start || holds(y, py + dy)) ? "" : "none";
    }
    label(x, true, sx === 1);
    label(y, false, sy === 1);
  }
  // Window of one direction, in this axes and, for the horizontal, in all others above and below with the same range.
  function see(svg, p, name, low, high) {
    const d = p[name];
    if (d.fixed || high - low < 1e-4) return;
    for (const other of panels(svg)) {
      const o = other[name];
      if (other !== p && (name === "y" || o.fixed || ["start", "size", "from", "to"].some((k) => o[k] !== d[k]))) continue;
      const width = Math.min(high - low, 1), from = Math.min(Math.max(low, 0), 1 - width);
      [o.low, o.high] = [from, from + width];
      draw(other);
    }
  }
  function whole(svg) {
    for (const p of panels(svg)) { p.x.low = p.y.low = 0; p.x.high = p.y.high = 1; draw(p); }
  }
  const place = (svg, event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());

  document.addEventListener("pointerdown", function (event) {
    const svg = event.target.closest && event.target.closest("svg[data-axes]");
    if (!svg || event.button !== 0 || event.pointerType === "touch") return;
    const from = place(svg, event), p = panels(svg).find((one) => holds(one.x, from.x) && holds(one.y, from.y));
    if (!p) return;
    event.preventDefault();
    svg.closest("[tabindex]").focus({ preventScroll: true });
    const box = add("rect", { class: "zoom" }, svg), span = {};
    function move(now) {
      const to = place(svg, now), tall = Math.abs(to.y - from.y) > 12;
      for (const name of ["x", "y"]) {
        const d = p[name], ends = [from[name], to[name]].sort((a, b) => a - b);
        span[name] = ends.map((v) => Math.min(Math.max(v, d.start), d.start + d.size));
        if (name === "y" && !tall) span.y = [d.start, d.start + d.size];
      }
      for (const [name, size] of [["x", "width"], ["y", "height"]]) {
        box.setAttribute(name, span[name][0]);
        box.setAttribute(size, span[name][1] - span[name][0]);
      }
    }
    function end() {
      box.remove();
      ["pointermove", "pointerup", "pointercancel"].forEach((name) => window.removeEventListener(name, name === "pointermove" ? move : end));
      if (!span.x || span.x[1] - span.x[0] < 4) return;
      const windows = ["x", "y"].map((name) => [name, ...span[name].map((v) => share(p[name], v))]);
      for (const [name, low, high] of windows) see(svg, p, name, low, high);
    }
    window.addEventListener("pointermove", move);
    window.addEventListener("pointerup", end);
    window.addEventListener("pointercancel", end);
  });
  document.addEventListener("dblclick", function (event) {
    const svg = event.target.closest && event.target.closest("svg[data-axes]");
    if (svg) whole(svg);
  });
  document.addEventListener("keydown", function (event) {
    const svg = event.target.querySelector && event.target.matches(".drawing") && event.target.querySelector("svg[data-axes]");
    if (!svg || event.ctrlKey || event.altKey || event.metaKey || !panels(svg).length) return;
    const p = panels(svg)[0], { low, high } = p.x, middle = (low + high) / 2, half = (high - low) / 2;
    const wanted = { "+": [middle - half / 2, middle + half / 2], "-": [middle - 2 * half, middle + 2 * half],
      ArrowLeft: [low - half / 2, high - half / 2], ArrowRight: [low + half / 2, high + half / 2] }[event.key];
    if (event.key === "0") whole(svg);
    else if (wanted && (half < 0.5 || event.key === "+")) see(svg, p, "x", ...wanted);
    else return;
    event.preventDefault();
  });
  document.documentElement.classList.add("zoomable");
})();
