// The page: a sphere and curves for each run, one player for all. All text of the runs enters as text, never as HTML.

const content = JSON.parse(document.getElementById("content").textContent);
const [play, scrub, clock, speed, theme] = ["play", "scrub", "clock", "speed", "theme"].map((id) => document.getElementById(id));
const start = Math.min(...content.runs.map((run) => run.start)), end = Math.max(...content.runs.map((run) => run.end));
const camera = {}, ink = {};
let time = start, playing = false, pending = 0, last = 0;

function element(tag, attributes = {}, ...children) {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...children);
  return made;
}

function swatch(colour) {
  const made = element("span", { className: "swatch" });
  made.style.background = `var(--${colour})`;
  return made;
}

function symbol({ letter, index }) {
  return element("i", {}, letter, ...(index ? [element("sub", {}, index)] : []));
}

// ---- sphere

function makeStage(run) {
  const canvas = element("canvas", { tabIndex: 0 });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Sphere of the ${run.name}: path of its axis, body, and the ring of its non-twisting ` +
    "frame. Drag, or press the arrow keys, to turn it.");
  const turn = element("span", { className: "turn" }), place = element("p", { className: "place" });
  const stage = element("section", { className: "stage" },
    element("div", { className: "head" }, element("h2", {}, run.name), turn),
    element("div", { className: "globe" }, canvas),
    place);
  turnable(canvas);
  return { stage, turn, place, scene: new Scene(canvas, new Motion(run)) };
}

function turnable(canvas) {
  let x = 0, y = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    [x, y] = [event.clientX, event.clientY];
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    turnBy(-0.008 * (event.clientX - x), 0.008 * (event.clientY - y));
    [x, y] = [event.clientX, event.clientY];
  });
  canvas.addEventListener("dblclick", home);
  canvas.addEventListener("keydown", (event) => {
    const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!turn) return;
    turnBy(...turn);
    event.preventDefault();
    event.stopPropagation();
  });
}

function turnBy(azimuth, elevation) {
  camera.azimuth += azimuth;
  camera.elevation = Math.min(1.55, Math.max(-1.55, camera.elevation + elevation));
  if (!playing) render();
}

// Towards the side of the sphere where the paths are, if they are on one.
function aim() {
  const points = runs.flatMap((run) => run.scene.motion.path.points);
  const mean = scaled(1 / points.length, points.reduce((sum, x) => blend(1, sum, 1, x), [0, 0, 0]));
  const oneSided = Math.hypot(...mean) > 0.3;
  camera.azimuth = oneSided ? Math.atan2(mean[1], mean[0]) + 0.4 : 0.61;
  camera.elevation = oneSided ? Math.max(-1.2, Math.min(1.2, Math.atan2(mean[2], Math.hypot(mean[0], mean[1])) - 0.3)) : 0.42;
}

function home() {
  aim();
  if (!playing) render();
}

// ---- numbers

function turnInWords(twist) {
  const turns = Math.abs(twist) >= TAU ? ` (${(twist / TAU).toFixed(2)} turns)` : "";
  return `ψ = ${((twist * 360) / TAU).toFixed(1)}°${turns}`.replace("-0.0", "0.0").replace(/-/g, "−");
}

const decimals = Math.max(0, 3 - Math.floor(Math.log10(end - start)));

// ---- player

function render() {
  for (const run of runs) {
    const own = Math.min(run.end, Math.max(run.start, time)) - run.start;
    const { triad, twist } = run.scene.draw(own, camera, ink);
    run.turn.textContent = turnInWords(twist);
    run.place.textContent = `${run.labels[2]} = (${triad[2].map((x) => x.toFixed(3)).join(", ")})`.replace(/-/g, "−");
    for (const panel of run.panels) {
      for (const curve of panel.curves) {
        const [k, s] = locate(curve.time, own);
        const value = (1 - s) * curve.values[k] + s * curve.values[k + 1];
        curve.output.textContent = inWords(value, panel.largest);
      }
    }
    const wide = run.wrapper.clientWidth - LEFT - RIGHT;
    run.line.style.transform = `translateX(${LEFT + (wide * (time - start)) / (end - start)}px)`;
  }
  const text = `${time.toFixed(decimals)} s`.replace("-", "−");
  if (Number(scrub.value) !== time) scrub.value = time;
  clock.textContent = text;
  scrub.setAttribute("aria-valuetext", text);
}

function setTime(to) {
  time = Math.min(end, Math.max(start, to));
  if (!playing) render();
}

function setPlaying(on) {
  if (on && time >= end) time = start;
  playing = on;
  play.classList.toggle("playing", on);
  play.setAttribute("aria-label", on ? "Pause" : "Play");
  last = performance.now();
  cancelAnimationFrame(pending);
  if (on) pending = requestAnimationFrame(frame);
}

function frame(now) {
  time = Math.min(end, time + Math.max(0, Math.min(0.25, (now - last) / 1000)) * Number(speed.value));
  last = now;
  render();
  if (time >= end) setPlaying(false); else pending = requestAnimationFrame(frame);
}

// The motion takes 12 s to play, or longer where the body turns fast, up to 60 s. Speeds are round numbers; the slowest
// shows a third of a radian a second.
function fillSpeeds() {
  const span = end - start, turned = Math.max(1, ...content.runs.map((run) => run.turned));
  const wish = span / Math.min(60, Math.max(12, turned / 3)), slowest = Math.min(wish / 10, (0.33 * span) / turned);
  for (let power = Math.floor(Math.log10(slowest)); power <= Math.log10(10 * wish); power++) {
    for (const value of [1, 2, 5].map((x) => Number(`${x}e${power}`))) {
      if (value < slowest || value > 10 * wish) continue;
      const text = value < 1e-3 ? value.toExponential() : `${value}`;
      speed.append(new Option(`${text.replace("-", "−")}×`, value));
      if (value <= 1.001 * wish) speed.selectedIndex = speed.options.length - 1;
    }
  }
}

// ---- light and dark

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  theme.textContent = name === "dark" ? "Light" : "Dark";
  theme.setAttribute("aria-pressed", name === "dark");
  const style = getComputedStyle(document.documentElement);
  for (const colour of ["card", "ink", "muted", "rule", "d1", "d2", "d3", "frame", "twist", "box", "glass", "glass-edge", "grid"]) {
    ink[colour.replace("-e", "E")] = style.getPropertyValue(`--${colour}`).trim();
  }
  runs.forEach(plotCurves);
  render();
}

const toggleTheme = () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");

// ---- keys

function key(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target === speed) return;
  const step = ((end - start) / 100) * (event.shiftKey ? 10 : 1);
  const faster = (by) => {
    speed.selectedIndex = Math.min(speed.options.length - 1, Math.max(0, speed.selectedIndex + by));
  };
  const action = {
    " ": () => setPlaying(!playing), ArrowLeft: () => setTime(time - step), ArrowRight: () => setTime(time + step),
    Home: () => setTime(start), End: () => setTime(end), "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1),
    "−": () => faster(-1), r: home, d: toggleTheme,
  }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action || (event.key === " " && event.target.tagName === "BUTTON")) return;
  if (event.key !== " " || !event.repeat) action();
  event.preventDefault();
}

// ---- beginning

const runs = content.runs.map((run) => ({ ...run, ...makeStage(run), ...makeCurves(run) }));
document.querySelectorAll(".legend .name").forEach((name, i) => {
  name.textContent = [...new Set(runs.map((run) => run.labels[i]))].join(" or ");
});
const main = document.getElementById("runs");
main.className = runs.length === 2 ? "two" : "one";
main.append(...runs.map((run) => run.stage), ...runs.map((run) => run.below));
Object.assign(scrub, { min: start, max: end });
fillSpeeds();
scrub.addEventListener("input", () => setTime(Number(scrub.value)));
play.addEventListener("click", () => setPlaying(!playing));
theme.addEventListener("click", toggleTheme);
window.addEventListener("keydown", key);
const dark = matchMedia("(prefers-color-scheme: dark)");
dark.addEventListener("change", () => setTheme(dark.matches ? "dark" : "light"));
aim();
setTheme(dark.matches ? "dark" : "light");
new ResizeObserver(() => {
  runs.forEach(plotCurves);
  render();
}).observe(main);
