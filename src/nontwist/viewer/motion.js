// The motion of one run.

function unpack(text) {
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

class Motion {
  constructor(run) {
    this.time = unpack(run.time);
    this.attitude = unpack(run.attitude);
    this.angles = Object.fromEntries(["twist", "swing", "area"].map((name) => [name, unpack(run[name])]));
    this.path = this.axisPath();
    this.labels = run.labels;
    Object.assign(this, run.box); // half, edges, centre
    this.weight = run.weight;
    this.rotors = run.rotors.map(({ axis, momentum }) => ({ axis, momentum: unpack(momentum) }));
    this.strongest = Math.max(...this.rotors.flatMap(({ momentum }) => [...momentum]).map(Math.abs), 1e-300);
  }

  // Triad, twist ψ, swing-twist angle τ and solid angle Ω at a time from the start: rotations between states by the
  // shortest way; of τ, which jumps from a half turn to its opposite, that of the nearer state.
  at(time) {
    const [k, s] = locate(this.time, time);
    const p = this.attitude.subarray(4 * k, 4 * k + 4), q = this.attitude.subarray(4 * k + 4, 4 * k + 8);
    const { twist, swing, area } = this.angles, mean = (x) => (1 - s) * x[k] + s * x[k + 1];
    const isNear = Math.abs(swing[k + 1] - swing[k]) < Math.PI;
    return { triad: triadOf(between(p, q, s)), twist: mean(twist), area: mean(area), swing: isNear ? mean(swing) : swing[k + (s > 0.5)] };
  }

  // The rotors at a time: their axes in components of the triad, and their momenta, of the largest of all.
  wheels(time) {
    const [k, s] = locate(this.time, time);
    return this.rotors.map(({ axis, momentum: h }) => ({ axis, size: ((1 - s) * h[k] + s * h[k + 1]) / this.strongest }));
  }

  // Points of the axis on the sphere, close enough to look smooth, with the way so far.
  axisPath() {
    const points = [], times = [], way = [0];
    for (let k = 0; k + 1 < this.time.length; k++) {
      const [u, v] = [this.time[k], this.time[k + 1]];
      const turn = Math.acos(Math.min(1, dot(this.at(u).triad[2], this.at(v).triad[2])));
      const pieces = Math.min(16, Math.max(1, Math.ceil(turn / 0.04)));
      for (let i = 0; i < pieces; i++) times.push(u + ((v - u) * i) / pieces);
    }
    times.push(this.time[this.time.length - 1]);
    for (const time of times) points.push(this.at(time).triad[2]);
    for (let i = 1; i < points.length; i++) {
      way.push(way[i - 1] + Math.hypot(...blend(1, points[i], -1, points[i - 1])));
    }
    return { points, times, way };
  }
}
