// Momenta, energy and twist over time, drawn by Plotly; over them their values now, and the line of time.

const LEFT = 58, RIGHT = 14, BOTTOM = 34; // pixels around the curves

function makeCurves(run) {
  const panels = run.panels.map((panel) => ({
    ...panel,
    curves: panel.curves.map((curve) => ({ ...curve, time: unpack(curve.time), values: unpack(curve.values) })),
  }));
  const plot = element("div"), line = element("div", { className: "line" });
  const wrapper = element("div", { className: "plots" }, plot, line);
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
  return { below, panels, wrapper, plot, line };
}

function colourOf(panel, k) {
  return panel.title === "Twist" ? "twist" : panel.curves.length === 1 ? "frame" : ["d1", "d2", "d3"][k];
}

// Ranges are shared by the runs and hold zero: what stands still looks still, however small its last digits.
function rangeOf(i) {
  let low = 0, high = 0;
  for (const run of runs) {
    for (const { values } of run.panels[i].curves) for (const y of values) [low, high] = [Math.min(low, y), Math.max(high, y)];
  }
  if (runs[0].panels[i].title === "Twist") [low, high] = [Math.min(low, -0.5), Math.max(high, 0.5)];
  const room = 0.08 * (high - low || 1);
  return [low < 0 ? low - room : 0, high > 0 ? high + room : 0];
}

function plotCurves(run) {
  const width = run.wrapper.clientWidth, narrow = width < 540, [row, head] = narrow ? [150, 48] : [132, 30];
  const count = run.panels.length, height = row * count;
  run.wrapper.classList.toggle("narrow", narrow);
  run.panels.forEach((panel, i) => { panel.head.style.top = `${i * row + 4}px`; });
  run.line.style.height = `${height}px`;
  run.line.style.background =
    `repeating-linear-gradient(transparent 0 ${head}px, var(--ink) ${head}px ${row - 8}px, transparent ${row - 8}px ${row}px)`;
  const axis = { zeroline: true, zerolinecolor: ink.grid, gridcolor: ink.rule, linecolor: ink.grid, fixedrange: true,
    tickfont: { color: ink.muted, size: 11 } };
  const layout = {
    width, height: height + BOTTOM, margin: { l: LEFT, r: RIGHT, t: 0, b: BOTTOM }, showlegend: false, dragmode: false,
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink.muted, size: 11 },
    xaxis: { ...axis, range: [start, end], anchor: `y${count}`, ticks: "outside", tickcolor: ink.grid, zeroline: false,
      title: { text: "time (s)", standoff: 4 } },
  };
  const traces = [];
  run.panels.forEach((panel, i) => {
    layout[i ? `yaxis${i + 1}` : "yaxis"] = { ...axis, range: rangeOf(i), nticks: 4, anchor: "x",
      domain: [1 - ((i + 1) * row - 8) / height, 1 - (i * row + head) / height] };
    panel.curves.forEach((curve, k) => traces.push({
      x: Array.from(curve.time, (t) => t + run.start), y: curve.values, type: "scatter", mode: "lines", yaxis: `y${i ? i + 1 : ""}`,
      line: { color: ink[colourOf(panel, k)], width: 1.8, dash: ["solid", "dash", "dot"][k], simplify: false },
    }));
  });
  return Plotly.react(run.plot, traces, layout, { staticPlot: true });
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

// Round-off of what is zero is shown as zero: its digits tell nothing.
function inWords(value, largest) {
  const x = Math.abs(value) < 1e-12 * largest ? 0 : value;
  const size = Math.floor(Math.log10(largest || 1)), digits = Math.min(6, Math.max(0, 3 - size));
  const odd = x !== 0 && Math.abs(x) < 0.5 * 10 ** -digits;
  const text = odd ? x.toExponential(1) : Math.abs(size) > 5 ? x.toExponential(3) : x.toFixed(digits);
  return text.replace(/-/g, "−");
}
