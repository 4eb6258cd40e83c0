// Sliders of the inputs. Whatever they give is a possible body: second moments are positive, and slants are parts of what
// two of them allow, small enough for any pair.

// Each slider reads a number from the inputs, and gives the inputs with another one.
const correlation = (i, j, k) => ({ inertia }) => inertia[k] / Math.sqrt(inertia[i] * inertia[j]);
function withMoment(inputs, i, value) {
  const inertia = [...inputs.inertia], grown = Math.sqrt(value / inertia[i]);
  inertia[i] = value;
  for (const k of { 0: [4, 5], 1: [3, 5], 2: [3, 4] }[i]) inertia[k] *= grown; // the slants stay, and so does definiteness
  return { ...inputs, inertia };
}
function withSlant(inputs, i, j, k, value) {
  const inertia = [...inputs.inertia];
  inertia[k] = value * Math.sqrt(inertia[i] * inertia[j]);
  return { ...inputs, inertia };
}
const SLIDERS = [
  ...["d₁", "d₂", "d₃"].map((name, i) => ({ name: `second moment along ${name}`, low: LEAST, high: MOST, step: 0.05, unit: " kg m²",
    read: (inputs) => inputs.inertia[i], put: (inputs, x) => withMoment(inputs, i, x) })),
  { name: "tilt between d₁ and d₂", low: -SLANT, high: SLANT, step: 0.05, unit: "", read: correlation(0, 1, 5),
    put: (inputs, x) => withSlant(inputs, 0, 1, 5, x) },
  { name: "tilt between d₂ and d₃", low: -SLANT, high: SLANT, step: 0.05, unit: "", read: correlation(1, 2, 3),
    put: (inputs, x) => withSlant(inputs, 1, 2, 3, x) },
  { name: "gravity", low: 0, high: 20, step: 0.01, unit: " m/s²", read: ({ gravity }) => gravity[0],
    put: (inputs, x) => ({ ...inputs, gravity: [x] }) },
];

function makeSlider(slider) {
  const input = element("input", { type: "range", min: slider.low, max: slider.high, step: slider.step });
  slider.input = input;
  slider.output = element("output");
  input.addEventListener("input", () => {
    press(null);
    begin(slider.put(world.inputs, Number(input.value)));
    render();
  });
  return element("label", {}, element("span", {}, slider.name), input, slider.output);
}
