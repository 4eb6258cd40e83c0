// The page: two stages, a player, sliders, a loop, and the same inputs elsewhere.

const find = (id) => document.getElementById(id);
const [play, speed, clock, told, watch, text, copied] = ["play", "speed", "clock", "told", "watch", "text", "copied"].map(find);
const SPEEDS = [0.05, 0.1, 0.2, 0.5, 1, 2, 4], READ = 150; // times real time; ms between readings of what is kept
const HOME = { azimuth: 0.75, elevation: 0.5 };
const camera = { ...HOME }, loopCamera = { azimuth: 0.7, elevation: 0.55 };
const world = new World(fromLink(location.hash.slice(1)) ?? inputsOf(PRESETS[0]));
let playing = false, pending = 0, last = 0, due = 0, read = 0, link = "", wasPlaying = false, isSeen = true;

function element(tag, attributes = {}, ...children) {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...children);
  return made;
}

// ---- stages

function makeStage(k) {
  const canvas = element("canvas", { tabIndex: 0 }), dial = element("canvas", { className: "dial" });
  canvas.setAttribute("role", "application");
  dial.setAttribute("role", "img");
  const name = element("h2"), rule = element("span"), turn = element("p", { className: "turn" }), table = element("dl");
  const section = element("section", { className: "stage" },
    element("div", { className: "head" }, name, rule),
    element("div", { className: "show" }, element("div", { className: "globe" }, canvas),
      element("div", { className: "side" }, element("div", { className: "face" }, dial), turn,
        element("p", { className: "caption" }, "twist ψ, seen along d₃"))),
    table);
  const scene = new Scene(canvas, world.runs[k]);
  const lines = [0, 1, 2].map(() => [element("dt"), element("dd")]);
  table.append(...lines.flat());
  grippable(canvas, scene, hands);
  return { section, scene, canvas, dial, name, rule, turn, lines };
}

// What hands do to the bodies.
const hands = {
  grab(run) {
    wasPlaying = playing;
    setPlaying(false);
    grip.run = run;
  },
  // Both bodies stop, in the pose of the one that is pulled.
  pulled() {
    if (Math.hypot(...grip.pull) >= SHORTEST && (world.steps > 0 || size(world.inputs.velocity) > 0)) {
      const k = world.runs.indexOf(grip.run);
      begin({ ...world.inputs, attitude: grip.run.state.p, velocity: STILL, pulse: STILL });
      grip.run = world.runs[k];
      press(null);
      watch.textContent = "Both are at rest in the same attitude. Let go to kick them.";
    }
    render();
  },
  letGo(kick) {
    const velocity = kick && kick(world);
    if (!velocity) {
      setPlaying(wasPlaying);
      return render();
    }
    begin({ ...world.inputs, velocity });
    watch.textContent = `The same kick for both: the standard body starts at ${signed(size(velocity), 1)} rad/s. Watch the wedges.`;
    told.textContent = `Kicked. The standard body starts at ${signed(size(velocity), 1)} radians per second.`;
    setPlaying(true);
  },
  turn(azimuth, elevation) {
    camera.azimuth += azimuth;
    camera.elevation = Math.min(1.55, Math.max(-1.55, camera.elevation + elevation));
    if (!playing) render();
  },
};

function begin(inputs) {
  world.begin(inputs);
  stages.forEach((stage, k) => { stage.scene.motion = world.runs[k]; });
  due = 0;
  showInputs();
}

// Canvases first, words after: a canvas asks for its size, and words that have changed would be laid out for that.
function render() {
  const twists = stages.map(({ scene, dial }) => {
    const { twist } = scene.draw(Infinity, camera, ink);
    drawGrip(scene, world);
    drawDial(dial, { ...scene.motion, twist }, ink);
    return twist;
  });
  stages.forEach(({ turn }, k) => { turn.textContent = degrees(twists[k]); });
  clock.textContent = `${signed(world.time, 2)} s`;
  if (playing && performance.now() - read < READ) return;
  read = performance.now();
  for (const { scene, lines } of stages) {
    changes(scene.motion, world.inputs).forEach(([name, change], i) => {
      const [dt, dd] = lines[i], busy = scene.motion.pulsed && world.time < 1;
      dt.textContent = name;
      dd.textContent = busy ? "the push is acting" : `${isKept(change) ? "✓ " : ""}${verdict(change)}`;
      dd.className = isKept(change) && !busy ? "kept" : "";
    });
  }
}

// ---- player

function setPlaying(on) {
  playing = on;
  play.classList.toggle("playing", on);
  play.setAttribute("aria-label", on ? "Pause" : "Play");
  for (const run of world.runs) run.share = 1;
  last = performance.now();
  cancelAnimationFrame(pending);
  if (on) pending = requestAnimationFrame(frame);
  else told.textContent = inWords(world);
}

function frame(now) {
  pending = requestAnimationFrame(frame);
  const passed = Math.max(0, Math.min(0.1, (now - last) / 1000));
  last = now;
  if (!isSeen) return;
  due += passed * Number(speed.value);
  const steps = Math.floor(due / STEP);
  world.advance(steps);
  due -= steps * STEP;
  for (const run of world.runs) run.share = due / STEP;
  render();
}

function again() {
  begin(world.inputs);
  setPlaying(true);
}

function stepOn() {
  setPlaying(false);
  world.advance(20);
  told.textContent = inWords(world);
  render();
}

// ---- presets and inputs

function press(chosen) {
  for (const button of find("presets").children) button.setAttribute("aria-pressed", button.textContent === chosen);
}

function choose(preset, starts) {
  Object.assign(camera, HOME);
  speed.value = preset.speed;
  watch.textContent = preset.watch;
  press(preset.name);
  begin(inputsOf(preset));
  setPlaying(starts);
  if (!starts) render();
}

// Everything that follows from the inputs alone: names, sliders, the matrix, the link.
function showInputs() {
  const names = namesOf(world.inputs);
  stages.forEach((stage, k) => {
    stage.name.textContent = names[k];
    stage.rule.textContent = k ? "no spin about d₃" : "free to turn";
    stage.canvas.setAttribute("aria-label", `${names[k]}. Arrow keys pull at the tip of its axis, enter lets go and kicks both ` +
      "bodies, escape cancels the pull; shift with arrow keys turns the view.");
    stage.dial.setAttribute("aria-label", `Twist of the ${names[k].toLowerCase()}, seen along d₃`);
  });
  for (const { input, output, read, unit } of SLIDERS) {
    const value = read(world.inputs), words = `${signed(value, 2)}${unit}`;
    input.value = value;
    output.textContent = words;
    input.setAttribute("aria-valuetext", words);
  }
  find("inertia").replaceChildren(...inertiaOf(world.inputs.inertia).map((row) =>
    element("tr", {}, ...row.map((x) => element("td", {}, signed(x, 3))))));
  copies.forEach((copy) => { copy.button.textContent = copy.label(); });
  link = `#${toLink(world.inputs)}`;
  if (location.hash !== link) location.replace(link);
}

// ---- the same inputs elsewhere

const copies = [
  { label: () => "Copy the link", text: () => location.href.split("#")[0] + link },
  { label: () => "Copy as Python", text: () => asPython(world) },
  ...[0, 1].map((k) => ({ label: () => `Copy as run file: ${namesOf(world.inputs)[k].toLowerCase()}`, text: () => asRunFile(world, k) })),
].map((copy) => ({ ...copy, button: element("button", { type: "button" }) }));

async function copyOut({ text: write }) {
  text.value = write();
  text.hidden = false;
  text.select();
  try {
    await navigator.clipboard.writeText(text.value);
    copied.textContent = "Copied.";
  } catch {
    copied.textContent = document.execCommand("copy") ? "Copied." : "Selected below: copy it with your keyboard.";
  }
  tellHeight();
}

// ---- the loop

const loop = new Loop(), panel = new LoopPanel(find("loop"), loop);

function showLoop(isDone) {
  panel.draw(loopCamera, ink);
  const [area, turned] = [loop.area, loop.turn].map(degrees), gap = Math.abs(loop.area - loop.turn);
  const none = loop.points.length < 2;
  find("area").textContent = none ? "–" : area;
  find("turned").textContent = none ? "–" : turned;
  find("gap").textContent = none ? "–" : gap < 1e-9 ? "none" : `${gap.toExponential(0)} rad`;
  if (isDone) find("drawn").textContent = none ? "No loop." : `The area inside is ${area}; the arrow returned turned by ${turned}.`;
}

// ---- keys

function key(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || ["SELECT", "TEXTAREA"].includes(event.target.tagName)) return;
  const faster = (by) => { speed.selectedIndex = Math.min(SPEEDS.length - 1, Math.max(0, speed.selectedIndex + by)); };
  const action = {
    " ": () => setPlaying(!playing), r: again, ".": stepOn, d: toggleTheme, t: () => { told.textContent = inWords(world); },
    "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1),
  }[event.key.toLowerCase()];
  if (!action || (event.key === " " && event.target.tagName === "BUTTON") || grip.run) return;
  if (event.key !== " " || !event.repeat) action();
  event.preventDefault();
}

// ---- beginning

function tellHeight() {
  if (parent !== window) parent.postMessage({ playground: document.documentElement.offsetHeight }, "*");
}

const stages = [0, 1].map(makeStage);
find("stages").append(...stages.map((stage) => stage.section));
speed.append(...SPEEDS.map((x) => new Option(`${x}×`, x)));
find("sliders").append(...SLIDERS.map(makeSlider));
find("copies").append(...copies.map((copy) => copy.button));
for (const copy of copies) copy.button.addEventListener("click", () => copyOut(copy));
for (const preset of PRESETS) {
  const button = element("button", { type: "button" }, preset.name);
  button.addEventListener("click", () => choose(preset, true));
  find("presets").append(button);
}
play.addEventListener("click", () => setPlaying(!playing));
find("again").addEventListener("click", again);
find("triangle").addEventListener("click", () => { drawTriangle(loop); showLoop(true); });
find("circle").addEventListener("click", () => { drawCircle(loop, panel.view[2], TAU / 6); showLoop(true); });
find("clear").addEventListener("click", () => { loop.clear(); showLoop(true); });
drawable(find("loop"), panel, showLoop);
window.addEventListener("keydown", key);
window.addEventListener("hashchange", () => {
  const given = location.hash === link ? null : fromLink(location.hash.slice(1));
  if (given) follow(given);
});
window.addEventListener("message", ({ data }) => { if (["light", "dark"].includes(data?.theme)) setTheme(data.theme); });
document.documentElement.classList.toggle("framed", parent !== window);

function follow(inputs) {
  press(null);
  watch.textContent = "The start is that of the link. Pull a body to change it.";
  begin(inputs);
  render();
}

const given = fromLink(location.hash.slice(1)), calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
startTheme(() => {
  render();
  showLoop(false);
});
choose(PRESETS[0], false);
if (given) follow(given);
if (calm) stepOn();
else setPlaying(true);
drawTriangle(loop);
showLoop(false);
new ResizeObserver(() => {
  render();
  showLoop(false);
  tellHeight();
}).observe(document.querySelector("main"));
new IntersectionObserver((changes) => { isSeen = changes[changes.length - 1].isIntersecting; }).observe(find("stages"));
