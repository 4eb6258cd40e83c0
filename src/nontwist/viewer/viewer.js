// The page: a sphere and curves for each run, one player for all. All text of the runs enters as text, never as HTML.

const content = JSON.parse(document.getElementById("content").textContent);
const [play, scrub, clock, speed] = ["play", "scrub", "clock", "speed"].map((id) => document.getElementById(id));
const start = Math.min(...content.runs.map((run) => run.start)), end = Math.max(...content.runs.map((run) => run.end));
const camera = { ...content.camera };
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

const AREA = 2 * TAU; // rad: the area of longer paths is not shown at first
const WEDGES = [
  { sign: "", letter: "τ", words: "swing–twist angle", colour: "d1" },
  { sign: "−", letter: "ψ", words: "twist", colour: "twist" },
  { sign: "=", letter: "Ω", words: "area of the path", colour: "d3" },
];

function makeStage(run) {
  const canvas = element("canvas", { tabIndex: 0 }), dial = element("canvas", { className: "dial" });
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", `Sphere of the ${run.name}: path of its axis, body, ${run.rotors.length ? "rotor, " : ""}and the ring of its non-twisting ` +
    "frame. Drag, or press the arrow keys, to turn it.");
  dial.setAttribute("role", "img");
  dial.setAttribute("aria-label", `Twist of the ${run.name}, seen along ${run.labels[2]}`);
  const turn = element("span", { className: "turn" }), place = element("p", { className: "place" });
  const wedges = WEDGES.map(({ sign, letter, words, colour }) => {
    const face = element("canvas"), number = element("b"), note = element("small", {}, words);
    face.setAttribute("role", "img");
    face.setAttribute("aria-label", `${words} of the ${run.name}`);
    const part = element("div", { className: "part" }, element("span", { className: "sign" }, sign),
      element("div", { className: "face" }, face), element("span", {}, element("i", {}, letter), number, note));
    return { part, face, number, note, colour };
  });
  const stage = element("section", { className: "stage" },
    element("div", { className: "head" }, element("h2", {}, run.name), turn),
    element("p", { className: "watch" }, run.watch),
    element("div", { className: "show" }, element("div", { className: "globe" }, canvas),
      element("div", { className: "side" }, element("div", { className: "face" }, dial),
        element("p", { className: "caption" }, `twist ψ, seen along ${run.labels[2]}`))),
    element("div", { className: "wedges" }, ...wedges.map((wedge) => wedge.part)),
    place);
  turnable(canvas);
  const motion = new Motion(run), { way } = motion.path;
  motion.showsArea = way[way.length - 1] < AREA;
  return { stage, turn, place, dial, wedges, scene: new Scene(canvas, motion) };
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

function home() {
  Object.assign(camera, content.camera);
  if (!playing) render();
}

function toggleArea() {
  const shows = !runs.some((run) => run.scene.motion.showsArea);
  for (const run of runs) run.scene.motion.showsArea = shows;
  if (!playing) render();
}

// ---- numbers

function inDegrees(angle) {
  return `${((angle * 360) / TAU).toFixed(1)}°`.replace(/^-0\.0°/, "0.0°").replace("-", "−");
}

function turnInWords(twist) {
  const turns = Math.abs(twist) >= TAU ? ` (${(twist / TAU).toFixed(2)} turns)` : "";
  return `ψ = ${inDegrees(twist)}${turns}`.replace("-", "−");
}

const eventsAt = (run, now) => ` · ${run.events.filter((at) => at <= now).length} of ${run.events.length} events so far`;

const decimals = Math.max(0, 3 - Math.floor(Math.log10(end - start)));

function writeNumbers(run, { own, wide, triad, swing, twist, area }) {
  const events = run.events.length ? eventsAt(run, own + run.start) : "", turns = Math.round((area - swing + twist) / TAU);
  [swing, twist, area].forEach((angle, i) => { run.wedges[i].number.textContent = inDegrees(angle); });
  run.wedges[2].note.textContent = WEDGES[2].words + (turns ? `, ${turns > 0 ? "less" : "and"} ${Math.abs(turns)} × 360°` : "");
  run.turn.textContent = turnInWords(twist);
  run.place.textContent = `${run.labels[2]} = (${triad[2].map((x) => x.toFixed(3)).join(", ")})${events}`.replace(/-/g, "−");
  for (const panel of run.panels) {
    for (const curve of panel.curves) {
      const [k, s] = locate(curve.time, own);
      curve.output.textContent = inWords((1 - s) * curve.values[k] + s * curve.values[k + 1], panel.largest);
    }
  }
  run.line.style.transform = `translateX(${LEFT + (wide * (time - start)) / (end - start)}px)`;
}

// ---- player

// Canvases first, words after: a canvas asks for its size, and words that have changed would be laid out for that.
function render() {
  const states = runs.map((run) => {
    const own = Math.min(run.end, Math.max(run.start, time)) - run.start, state = run.scene.draw(own, camera, ink);
    drawDial(run.dial, { ...run.scene.motion, twist: state.twist }, ink);
    [state.swing, state.twist, state.area].forEach((angle, i) => drawWedge(run.wedges[i].face, angle, ink[run.wedges[i].colour], ink));
    return { ...state, own, wide: run.wrapper.clientWidth - LEFT - RIGHT };
  });
  runs.forEach((run, k) => writeNumbers(run, states[k]));
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
    "−": () => faster(-1), r: home, d: toggleTheme, a: toggleArea,
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
document.getElementById("rotor").hidden = !runs.some((run) => run.rotors.length);
document.getElementById("weight").hidden = !runs.some((run) => run.weight);
const main = document.getElementById("runs");
main.className = runs.length === 2 ? "two" : "one";
main.append(...runs.map((run) => run.stage), ...runs.map((run) => run.below));
Object.assign(scrub, { min: start, max: end });
fillSpeeds();
scrub.addEventListener("input", () => setTime(Number(scrub.value)));
play.addEventListener("click", () => setPlaying(!playing));
window.addEventListener("keydown", key);
startTheme(() => {
  runs.forEach(plotCurves);
  render();
});
new ResizeObserver(() => {
  runs.forEach(plotCurves);
  render();
}).observe(main);
