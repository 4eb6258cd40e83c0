// What the page says: sentences about the motion, and the same inputs as Python and as run files. JavaScript writes the
// shortest digits that give a number back, 17 at most, so nothing is rounded on the way.

const list = (x) => `[${x.join(", ")}]`;
const rows = (A, indent) => `[\n${A.map((row) => `${indent}    ${list(row)},\n`).join("")}${indent}]`;
const signed = (x, digits) => (Math.abs(x) < 0.5 * 10 ** -digits ? 0 : x).toFixed(digits).replace("-", "−");
const degrees = (x) => `${signed((x * 360) / TAU, 1)}°`;

// Whether the third director is a principal axis, along which the constraint is the paper's.
const isPrincipal = ({ inertia }) => inertia[3] === 0 && inertia[4] === 0;

function namesOf(inputs) {
  const heavy = inputs.gravity[0] > 0, thing = heavy ? "top" : "body";
  return [heavy ? "Heavy top" : "Standard body", `${isPrincipal(inputs) ? "Non-twisting" : "Suslov"} ${thing}`];
}

const kindsOf = (inputs) => [inputs.gravity[0] > 0 ? "heavy_top" : "standard", isPrincipal(inputs) ? "nontwisting" : "suslov"];

// What is kept, and what is not: pairs of a name and the change relative to what there was or is.
function changes(run, inputs) {
  const now = kept(run.body, run.state), { reference } = run, heavy = inputs.gravity[0] > 0;
  const scale = Math.abs(reference.energy) + (heavy ? MASS * HEIGHT * inputs.gravity[0] : 0);
  const much = Math.max(size(reference.space), size(now.space));
  const part = (x, y) => (much > 0 ? size(blend(1, x, -1, y)) / much : 0);
  const across = ([x, y]) => [x, y, 0], upright = ([, , z]) => [0, 0, z];
  const rest = ["energy", scale > 0 ? Math.abs(now.energy - reference.energy) / scale : 0];
  const space = heavy ? ["momentum about the vertical", part(upright(now.space), upright(reference.space))]
    : ["spatial momentum", part(now.space, reference.space)];
  return [rest, space, ["material momentum across d₃", part(across(now.body), across(reference.body))]];
}

const isKept = (change) => change < 1e-10;
const inPercent = (x) => (x < 0.001 ? "less than 0.1 %" : `${(100 * x).toFixed(x < 0.1 ? 1 : 0)} %`);
const power = (x) => (x === 0 ? "exactly" : `to 10${[...`${Math.ceil(Math.log10(x))}`].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("")}`);
const verdict = (change) => (isKept(change) ? `conserved ${power(change)}` : `changes, now by ${inPercent(change)}`);

function inWords(world) {
  const bodies = world.runs.map((run, k) => {
    const { twist, p } = run.state, d3 = triadOf(p)[2].map((x) => signed(x, 2)).join(", ");
    const [energy] = changes(run, world.inputs);
    return `${namesOf(world.inputs)[k]}: twist ${degrees(twist)}, axis at ${d3}, energy ${verdict(energy[1])}.`;
  });
  return `After ${signed(world.time, 2)} seconds. ${bodies.join(" ")}`;
}

// ---- the same inputs elsewhere; the span is what the page has shown, or five seconds

const shownSteps = (world) => world.steps || 1000;
const isPushed = ({ pulse }) => size(pulse) > 0;

function asPython(world) {
  const { inputs, runs } = world, names = ["simulate", "standard", isPrincipal(inputs) ? "nontwisting" : "suslov"];
  const J = rows(inertiaOf(inputs.inertia), ""), heavy = inputs.gravity[0] > 0;
  const bodies = ["standard(inertia)", isPrincipal(inputs) ? "nontwisting(inertia)" : "suslov(inertia, axis=[0, 0, 1])"];
  if (heavy) names.push("with_gravity");
  if (isPushed(inputs)) names.push("pulse");
  const body = (k) => (heavy ? `with_gravity(${bodies[k]}, **weight)` : bodies[k]);
  return [
    '"""Two bodies with the same inertia, start and kick; the second may not turn about its third director."""',
    "",
    `from nontwist import ${names.sort().join(", ")}`,
    "",
    `inertia = ${J}  # kg m², about the fixed point`,
    ...(heavy ? [`weight = {"mass": ${MASS}, "centre_of_mass": [0, 0, ${HEIGHT}], "gravity": [0, 0, ${-inputs.gravity[0]}]}  # kg, m, m/s²`] : []),
    "how = {",
    `    "t_end": ${shownSteps(world) * STEP},  # s`,
    `    "step": ${STEP},`,
    `    "rotation": ${list(inputs.attitude)},  # quaternion, scalar last`,
    '    "scalar_first": False,',
    '    "integrator": "lie-midpoint",',
    ...(isPushed(inputs) ? [`    "load": pulse(${list(inputs.pulse)}, start=0, end=1),  # N m along the moving directors`] : []),
    "}",
    ...["free", "held"].flatMap((name, k) => [
      `${name} = simulate(`,
      `    ${body(k)},`,
      `    material_angular_velocity=${list(runs[k].velocity)},  # rad/s`,
      "    **how,",
      ")",
    ]),
    "",
  ].join("\n");
}

function asRunFile(world, k) {
  const { inputs, runs } = world, heavy = inputs.gravity[0] > 0, kind = kindsOf(inputs)[k], real = (x) => (Number.isInteger(x) ? `${x}.0` : `${x}`);
  const reals = (x) => list(x.map(real));
  return [
    `title = "${namesOf(inputs)[k]}, from the playground"`,
    "",
    "[body]",
    `kind = "${kind}"`,
    `inertia = ${rows(inertiaOf(inputs.inertia).map((row) => row.map(real)), "")}     # kg m², about the fixed point`,
    ...(kind === "suslov" ? ["axis = [0.0, 0.0, 1.0]"] : []),
    ...(heavy ? [`mass = ${real(MASS)}`, `centre_of_mass = ${reals([0, 0, HEIGHT])}`, `gravity = ${reals([0, 0, -inputs.gravity[0]])}`] : []),
    "",
    "[start]",
    `rotation = { quaternion = ${reals(inputs.attitude)}, order = "xyzw" }`,
    `angular_velocity = { body = ${reals(runs[k].velocity)} }     # rad/s`,
    ...(isPushed(inputs) ? ["", "[[load]]", 'kind = "pulse"', 'frame = "body"', 'shape = "triangle"',
      `amplitude = ${reals(inputs.pulse)}     # N m`, "start = 0.0", "end = 1.0"] : []),
    "",
    "[time]",
    `t_end = ${real(shownSteps(world) * STEP)}`,
    `step = ${STEP}`,
    "",
    "[integrator]",
    'name = "lie-midpoint"',
    "",
  ].join("\n");
}
