// Twist, reaction, momenta and energy over time; over them their values now, and the line of time.

const LEFT = 58, RIGHT = 14, BOTTOM = 38; // pixels around the curves

function makeCurves(run) {
  const panels = run.panels.map((panel) => ({
    ...panel,
    curves: panel.curves.map((curve) => ({ ...curve, time: unpack(curve.time), values: unpack(curve.values) })),
  }));
  const plot = element("canvas", { className: "chart" }), line = element("div", { className: "line" });
  const axis = element("div", { className: "axis" }), wrapper = element("div", { className: "plots" }, plot, axis, line);
  plot.setAttribute("role", "img");
  plot.setAttribute("aria-label", `Curves over time of the ${run.name}: ${panels.map((panel) => panel.title).join(", ")}.`);
  for (const panel of panels) {
    panel.head = element("div", { className: "rowhead" },
      element("h3", {}, panel.title, element("span", {}, ` (${panel.unit})`)));
    panel.curves.forEach((curve, k) => {
      curve.output = element("b");
      panel.head.append(element("span", { className: "value" }, swatch(colourOf(panel, k)), symbol(curve), curve.output));
    });
    panel.largest = panel.curves.flatMap(({ values }) => [...values]).reduce((m, y) => Math.max(m, Math.abs(y)), 0);
    wrapper.append(panel.head);
  }
  const about = element("dl", { className: run.thinned ? "thinned" : "" });
  for (const [word, text] of Object.entries(run.about)) about.append(element("dt", {}, word), element("dd", {}, text));
  scrubbable(wrapper);
  const below = element("section", { className: "curves" }, element("h2", {}, run.name), wrapper, about);
  return { below, panels, wrapper, plot, axis, line };
}

function colourOf(panel, k) {
  const own = { Twist: "twist", "Rotor momentum": "rotor" }[panel.title];
  return panel.curves.length === 1 && own ? own : panel.curves.length === 1 ? "frame" : ["d1", "d2", "d3"][k];
}

// Ranges are shared by the runs and hold zero: what stands still looks still, however small its last digits.
function rangeOf(title) {
  let low = 0, high = 0;
  for (const run of runs) {
    for (const panel of run.panels.filter((each) => each.title === title)) {
      for (const { values } of panel.curves) for (const y of values) [low, high] = [Math.min(low, y), Math.max(high, y)];
    }
  }
  if (title === "Twist") [low, high] = [Math.min(low, -30), Math.max(high, 30)];
  if (low === high) return [-1, 1];
  const room = 0.08 * (high - low);
  return [low < 0 ? low - room : 0, high > 0 ? high + room : 0];
}

function plotCurves(run) {
  const width = run.wrapper.clientWidth, narrow = width < 540, [row, head] = narrow ? [150, 48] : [128, 28];
  const height = row * run.panels.length, pen = run.plot.getContext("2d");
  run.wrapper.classList.toggle("narrow", narrow);
  run.wrapper.style.height = run.plot.style.height = `${height + BOTTOM}px`;
  run.panels.forEach((panel, i) => { panel.head.style.top = `${i * row + 4}px`; });
  run.line.style.height = `${height}px`;
  run.line.style.background =
    `repeating-linear-gradient(transparent 0 ${head}px, var(--ink) ${head}px ${row - 8}px, transparent ${row - 8}px ${row}px)`;
  cleared(run.plot, pen);
  const ticks = ticksOf(start, end, width < 400 ? 4 : 6);
  run.panels.forEach((panel, i) => {
    const box = { left: LEFT, right: width - RIGHT, top: i * row + head, bottom: (i + 1) * row - 8 };
    const curves = panel.curves.map((curve, k) => ({
      times: curve.time, values: curve.values, colour: ink[colourOf(panel, k)], dash: DASHES[k],
    }));
    drawChart(pen, box, [start, end], rangeOf(panel.title), ticks, curves, run.events, ink);
  });
  run.axis.style.top = `${height - 4}px`;
  run.axis.replaceChildren(element("span", { className: "unit" }, `time (s)${run.events.length ? "; dotted: events" : ""}`),
    ...ticks.map(({ value, text }) => {
      const tick = element("span", { className: "xtick" }, text);
      tick.style.left = `${LEFT + ((value - start) / (end - start)) * (width - LEFT - RIGHT)}px`;
      return tick;
    }));
}

function scrubbable(wrapper) {
  const seek = (event) => {
    const box = wrapper.getBoundingClientRect();
    setTime(start + ((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)) * (end - start));
  };
  wrapper.addEventListener("pointerdown", (event) => {
    wrapper.setPointerCapture(event.pointerId);
    seek(event);
  });
  wrapper.addEventListener("pointermove", (event) => wrapper.hasPointerCapture(event.pointerId) && seek(event));
}

function inWords(value, largest) {
  const size = Math.floor(Math.log10(largest || 1)), digits = Math.min(6, Math.max(0, 3 - size));
  const odd = value !== 0 && Math.abs(value) < 0.5 * 10 ** -digits;
  const text = odd ? value.toExponential(1) : Math.abs(size) > 5 ? value.toExponential(3) : value.toFixed(digits);
  return text.replace(/-/g, "−");
}
