// Kicks: grab a body, pull, let go. The impulse is that of a pull F at the point r, r × F, the same for both bodies; at
// the tip of d₃ it has no part along d₃. Keys do the same at the tip. A drag beside the body turns the view.

const GAIN = 7, LONGEST = 1.4, SHORTEST = 0.04; // rad/s for a pull of one radius, of a body of the mean inertia; radii
const BODY = 0.6, NEAR = { mouse: 24, pen: 30, touch: 40 }; // radii; pixels from the tip of d₃
const TURNS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

// The grip on a body: the point r in space, and the pull in radii to the right and up.
const grip = { run: null, point: null, pull: [0, 0] };

function pullInSpace(view) {
  const full = Math.hypot(...grip.pull), part = full > LONGEST ? LONGEST / full : 1;
  return blend(part * grip.pull[0], view[0], part * grip.pull[1], view[1]);
}

// The velocity that the pull gives to the free body, along its directors.
function kickOf(world, view) {
  const [free] = world.runs, { J } = free.body, mean = (J[0][0] + J[1][1] + J[2][2]) / 3;
  const impulse = scaled(GAIN * mean, cross(grip.point, pullInSpace(view)));
  const W = times(free.body.K, along(triadOf(grip.run.state.p), impulse)), fast = size(W);
  return fast > FASTEST ? scaled((0.999 * FASTEST) / fast, W) : W;
}

function drawGrip(scene, world) {
  if (!grip.run || Math.hypot(...grip.pull) < SHORTEST) return;
  const force = pullInSpace(scene.view), from = scene.project(grip.point), to = scene.project(blend(1, grip.point, 1, force));
  scene.pointer(from, to, scene.ink.ink, 1.1);
  scene.write(`${signed(size(kickOf(world, scene.view)), 1)} rad/s`, [to[0], to[1] + (to[1] > from[1] ? 18 : -18)], scene.ink.ink);
}

// `page` has grab(run), pulled(), letGo(velocity or null), turn(azimuth, elevation).
function grippable(canvas, scene, page) {
  let last = null, first = null;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const pointAt = (event) => {
    const [x, y] = place(event), tip = triadOf(scene.motion.state.p)[2], [tx, ty] = scene.project(tip);
    if (Math.hypot(x - tx, y - ty) < NEAR[event.pointerType || "mouse"]) return tip;
    const [u, v] = [(x - scene.centre[0]) / scene.radius, (scene.centre[1] - y) / scene.radius], flat = u * u + v * v;
    if (flat > BODY * BODY) return null;
    return blend(1, blend(u, scene.view[0], v, scene.view[1]), Math.sqrt(1 - flat), scene.view[2]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    first = last = place(event);
    grip.point = pointAt(event);
    grip.pull = [0, 0];
    if (grip.point) page.grab(scene.motion);
  });
  canvas.addEventListener("pointermove", (event) => {
    canvas.style.cursor = pointAt(event) || grip.run ? "grab" : "move";
    if (!last || !canvas.hasPointerCapture(event.pointerId)) return;
    const here = place(event);
    if (grip.run) {
      grip.pull = [(here[0] - first[0]) / scene.radius, (first[1] - here[1]) / scene.radius];
      page.pulled();
    } else page.turn(-0.008 * (here[0] - last[0]), 0.008 * (here[1] - last[1]));
    last = here;
  });
  const end = (kicks) => () => {
    if (grip.run) letGo(scene, page, kicks);
    last = null;
  };
  canvas.addEventListener("pointerup", end(true));
  canvas.addEventListener("pointercancel", end(false));
  // A finger on the body pulls it; beside the body it scrolls the page.
  canvas.addEventListener("touchstart", (event) => grip.run && event.preventDefault(), { passive: false });
  canvas.addEventListener("keydown", (event) => gripByKey(event, scene, page));
  canvas.addEventListener("blur", () => grip.run && letGo(scene, page, false));
}

function gripByKey(event, scene, page) {
  const turn = TURNS[event.key];
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (turn && event.shiftKey) page.turn(0.1 * turn[0], 0.1 * turn[1]);
  else if (turn) {
    if (!grip.run) {
      [grip.point, grip.pull] = [triadOf(scene.motion.state.p)[2], [0, 0]];
      page.grab(scene.motion);
    }
    grip.pull = blend(1, [...grip.pull, 0], 0.1, [...turn, 0]).slice(0, 2);
    page.pulled();
  } else if (grip.run && (event.key === "Enter" || event.key === " ")) letGo(scene, page, true);
  else if (grip.run && event.key === "Escape") letGo(scene, page, false);
  else return;
  event.preventDefault();
  event.stopPropagation();
}

function letGo(scene, page, kicks) {
  const isPulled = kicks && Math.hypot(...grip.pull) >= SHORTEST;
  page.letGo(isPulled ? (world) => kickOf(world, scene.view) : null);
  Object.assign(grip, { run: null, point: null, pull: [0, 0] });
}
