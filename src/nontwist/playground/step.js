// One step of the rotation-based energy-momentum scheme, as src/nontwist/integrators/lie_midpoint.py derives it, in the
// momentum P of the body. The unknown is half its change, P' = P + 2z; with Q = P + z the momentum of the step, Ω = KQ
// its velocity, Q̃ = JΩ and a = hΩ/2,
//
//     z = (h/2) [Q̃ × Ω + M + (I - s a aᵀ) c × (u - a × u)],    s = 1/(1 + |a|²),
//
// M the moment along the body, c the centre of mass times the mass, u gravity seen from the body at the start of the
// step. A free body has K = J⁻¹, so Q̃ = Q. A body that may not turn about its third director has Ω₃ = 0: K inverts the
// first two rows and columns of J, and the third line, which gives the reaction moment, is left out. Ω·(Q̃ × Ω) = 0
// keeps the energy ½ P·KP + V, Q·(Q × Ω) = 0 the momentum in space. Sums are compensated, the quaternion is kept at
// unit length, so neither drifts by round-off.

const EPS = 2 ** -52;
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const times = (A, x) => [dot(A[0], x), dot(A[1], x), dot(A[2], x)];
const along = ([d1, d2, d3], x) => [dot(d1, x), dot(d2, x), dot(d3, x)]; // components of x in a triad

// The body of the convected inertia J, held against turning about its third director or not.
function makeBody(J, held, centre, gravity) {
  const [[a, d, e], [, b, f], [, , c]] = J, det2 = a * b - d * d;
  const adjugate = [[b * c - f * f, e * f - c * d, d * f - b * e], [e * f - c * d, a * c - e * e, d * e - a * f],
    [d * f - b * e, d * e - a * f, det2]];
  const det = dot(J[0], adjugate[0]);
  const K = held ? [[b / det2, -d / det2, 0], [-d / det2, a / det2, 0], [0, 0, 0]]
    : adjugate.map((row) => row.map((x) => x / det));
  return { J, K, held, centre, gravity };
}

function startOf(body, quaternion, W) {
  const P = times(body.J, W);
  if (body.held) P[2] = 0;
  return { p: [...quaternion], c: [0, 0, 0, 0], P, carry: [0, 0, 0], z: [0, 0, 0], twist: 0 };
}

// The state a step of h later under the moment M along the body.
function stepped(body, state, h, M) {
  const { p, c, P, carry } = state, z = half(body, state, h, M), a = scaled(h / 2, times(body.K, add(P, z)));
  const sums = [0, 1, 2].map((i) => compensated(P[i], 2 * z[i] + carry[i]));
  const turned = advanced(p, c, a);
  // The frame without twist makes the smallest turn that moves the axis as the body does; (1, a) turns by 2 atan a₃ more.
  return { ...turned, P: sums.map((sum) => sum[0]), carry: sums.map((sum) => sum[1]), z, twist: state.twist + 2 * Math.atan(a[2]) };
}

// Half the change of the momentum, by Newton's method without the small derivative of the weight.
function half({ J, K, held, centre, gravity }, { p, P, z: guess }, h, M) {
  const f = h / 2, u = along(triadOf(p), gravity), heavy = size(u) > 0;
  let z = guess, before = Infinity;
  for (let count = 0; count < 40; count++) {
    const Q = add(P, z), W = times(K, Q), full = (Q, W) => (held ? [Q[0], Q[1], dot(J[2], W)] : Q), Qt = full(Q, W);
    let g = add(cross(Qt, W), M);
    if (heavy) {
      const b = scaled(f, W), k = cross(centre, blend(1, u, -1, cross(b, u)));
      g = add(g, blend(1, k, -dot(b, k) / (1 + dot(b, b)), b));
    }
    const columns = [0, 1, 2].map((j) => {
      const e = [0, 0, 0], w = K[j]; // K is symmetric
      e[j] = 1;
      const column = blend(-f, add(cross(full(e, w), W), cross(Qt, w)), 1, e);
      return held ? [column[0], column[1], e[2]] : column;
    });
    const rest = blend(f, g, -1, z), d = solved(columns, held ? [rest[0], rest[1], 0] : rest), now = size(d);
    z = add(z, d);
    if (now <= EPS * size(Q) || now >= before / 2) break;
    before = now;
  }
  return z;
}

// The x of x₀ columns₀ + x₁ columns₁ + x₂ columns₂ = r.
function solved([a, b, c], r) {
  const bc = cross(b, c), det = dot(a, bc);
  return [dot(r, bc) / det, dot(a, cross(r, c)) / det, dot(a, cross(b, r)) / det];
}

// The quaternion p (a, 1)/|(a, 1)|, scalar last, and what it was rounded by.
function advanced(p, c, a) {
  const v = [p[0], p[1], p[2]], w = p[3], f = 1 / Math.sqrt(1 + dot(a, a));
  const less = f - 1 + (1 - (w * w + dot(v, v))) / 2, d = blend(f * w, a, f, cross(v, a));
  const sums = [...d, -f * dot(v, a)].map((x, i) => compensated(p[i], less * p[i] + (x + c[i])));
  return { p: sums.map((sum) => sum[0]), c: sums.map((sum) => sum[1]) };
}

function compensated(x, d) {
  const sum = x + d;
  return [sum, d - (sum - x)];
}

// What a motion keeps: energy, momentum in space, momentum in the body.
function kept({ J, K, centre, gravity }, { p, P }) {
  const W = times(K, P), momentum = times(J, W), triad = triadOf(p);
  return { energy: dot(P, W) / 2 - dot(outOf(triad, centre), gravity), space: outOf(triad, momentum), body: momentum, W };
}

// The height of a triangular pulse of the height 1 from 0 to 1 s.
const triangle = (t) => (t > 0 && t < 1 ? 1 - Math.abs(2 * t - 1) : 0);
