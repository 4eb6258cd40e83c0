// What the page shows: inputs, and from them the two bodies in motion. The inputs alone stand in the link:
//
//     inertia   second moments of mass E11 E22 E33 E23 E13 E12, kg m², about the fixed point; J = tr(E) I - E
//     attitude  of the start, quaternion, scalar last
//     velocity  W, rad/s, that the kick gives the free body; the other one gets the same impulse, less the reaction
//     gravity   m/s²; a mass of 1 kg stands 0.3 m along the third director
//     pulse     peak of a triangular moment along the body, N m, from 0 to 1 s

const STEP = 0.005, MASS = 1, HEIGHT = 0.3; // s, kg, m
const LEAST = 0.3, MOST = 4, SLANT = 0.6, FASTEST = 40; // kg m², kg m², 1, rad/s
const ORDER = { inertia: 6, attitude: 4, velocity: 3, gravity: 1, pulse: 3 };

const inertiaOf = ([a, b, c, f, e, d]) => [[b + c, -d, -e], [-d, a + c, -f], [-e, -f, a + b]];
const secondMoments = ([a, b, c, f, e, d]) => [[a, d, e], [d, b, f], [e, f, c]];

// Whether a mass distribution has these second moments, its centre of mass at HEIGHT: E - m c cᵀ is positive.
function isPhysical([a, b, c, f, e, d]) {
  const low = c - MASS * HEIGHT ** 2;
  return a > 0 && a * b - d * d > 0 && a * (b * low - f * f) - d * (d * low - f * e) + e * (d * f - b * e) > 0;
}

function isPossible(inputs) {
  return Object.entries(ORDER).every(([name, count]) => inputs[name].length === count && inputs[name].every(Number.isFinite))
    && isPhysical(inputs.inertia) && Math.max(...inputs.inertia) <= 1e3 && Math.min(...inputs.inertia.slice(0, 3)) >= 0.1
    && Math.abs(Math.hypot(...inputs.attitude) - 1) < 1e-9 && size(inputs.velocity) <= FASTEST
    && inputs.gravity[0] >= 0 && inputs.gravity[0] <= 100 && size(inputs.pulse) <= 1e3;
}

class World {
  constructor(inputs) {
    this.begin(inputs);
  }

  begin(inputs) {
    this.inputs = inputs;
    const J = inertiaOf(inputs.inertia), gravity = [0, 0, -inputs.gravity[0]], free = makeBody(J, false, [0, 0, MASS * HEIGHT], gravity);
    const held = makeBody(J, true, free.centre, gravity), momentum = times(J, inputs.velocity);
    this.steps = 0;
    this.runs = [[free, inputs.velocity], [held, times(held.K, momentum)]].map(([body, W]) => new Run(body, inputs, W));
  }

  get time() {
    return this.steps * STEP;
  }

  advance(count) {
    for (; count > 0; count--) {
      const M = scaled(triangle((this.steps + 0.5) * STEP), this.inputs.pulse);
      this.steps += 1;
      for (const run of this.runs) run.step(M, this.time);
    }
  }
}

const POINTS = 2000, APART = 0.012, MEMORY_OF_RUNS = 20; // of the path that are kept; rad between them; rad that are drawn

// A body in motion, with the path of its axis. The page draws it between its last two states.
class Run {
  constructor(body, { inertia, attitude, pulse }, velocity) {
    Object.assign(this, { body, velocity, ...boxOf(inertia), labels: ["d₁", "d₂", "d₃"], pulsed: size(pulse) > 0, share: 1, memory: MEMORY_OF_RUNS });
    this.state = this.before = startOf(body, attitude, velocity);
    const tip = triadOf(this.state.p)[2];
    this.path = { points: [tip], times: [0], way: [0] };
    this.reference = kept(body, this.state);
  }

  step(M, time) {
    this.before = this.state;
    this.state = stepped(this.body, this.state, STEP, M);
    const { points, times: at, way } = this.path, tip = triadOf(this.state.p)[2], last = points[points.length - 1];
    const moved = size(blend(1, tip, -1, last));
    if (moved >= APART) {
      way.push(way[way.length - 1] + moved);
      points.push(tip);
      at.push(time);
    }
    if (points.length > POINTS) for (const list of [points, at, way]) list.splice(0, POINTS / 2);
    if (this.pulsed && time <= 1 + STEP / 2) this.reference = kept(this.body, this.state);
  }

  at() {
    const { before, state, share } = this, twist = (1 - share) * before.twist + share * state.twist;
    return { triad: triadOf(between(before.p, state.p, share)), twist };
  }
}

// The box of this inertia: half sides, and edges as rows, eigenvectors of E (Jacobi's rotations).
function boxOf(inertia) {
  const A = secondMoments(inertia), V = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 8; sweep++) {
    for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) {
      if (A[i][j] === 0) continue;
      const angle = Math.atan2(2 * A[i][j], A[j][j] - A[i][i]) / 2, [c, s] = [Math.cos(angle), Math.sin(angle)];
      const turn = (x) => { [x[i], x[j]] = [c * x[i] - s * x[j], s * x[i] + c * x[j]]; };
      A.forEach(turn);
      [A[i], A[j]] = [blend(c, A[i], -s, A[j]), blend(s, A[i], c, A[j])];
      [V[i], V[j]] = [blend(c, V[i], -s, V[j]), blend(s, V[i], c, V[j])];
    }
  }
  const trace = A[0][0] + A[1][1] + A[2][2];
  return { half: [0, 1, 2].map((i) => Math.max(0.03, 0.55 * Math.sqrt(Math.max(0, A[i][i]) / trace))), edges: V };
}

// ---- the link

const toLink = (inputs) => Object.keys(ORDER).map((name) => `${name}=${inputs[name].join(",")}`).join("&");

function fromLink(text) {
  const given = new URLSearchParams(text);
  const inputs = Object.fromEntries(Object.keys(ORDER).map((name) => [name, (given.get(name) ?? "").split(",").map(toNumber)]));
  return isPossible(inputs) ? inputs : null;
}

const toNumber = (text) => (/^-?\d+(\.\d+)?(e[+-]?\d+)?$/i.test(text) ? Number(text) : NaN);
