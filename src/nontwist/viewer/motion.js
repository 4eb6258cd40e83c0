"use strict";
// The motion of one run. Vectors are arrays [x, y, z]; triads have unit vectors as rows.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const blend = (a, x, b, y) => [a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]];
const scaled = (s, x) => [s * x[0], s * x[1], s * x[2]];
const TAU = 2 * Math.PI;

function unpack(text) {
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

// Index k and weight s with x = (1 - s) times[k] + s times[k + 1].
function locate(times, x) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= x) low = middle; else high = middle;
  }
  return [low, Math.min(1, Math.max(0, (x - times[low]) / (times[high] - times[low] || 1)))];
}

// Rows t1, t2, t3 of the triad whose quaternion (scalar last) maps body to space.
function triadOf([x, y, z, w]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
    [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
    [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
  ];
}

class Motion {
  constructor(run) {
    this.time = unpack(run.time);
    this.attitude = unpack(run.attitude);
    this.twist = unpack(run.twist);
    this.path = this.axisPath();
    this.labels = run.labels;
    this.half = run.box.half;
    this.edges = run.box.edges;
  }

  // Triad and twist at a time from the start: rotations between states by the shortest way.
  at(time) {
    const [k, s] = locate(this.time, time);
    const p = this.attitude.subarray(4 * k, 4 * k + 4), q = this.attitude.subarray(4 * k + 4, 4 * k + 8);
    const cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
    const sign = cosine < 0 ? -1 : 1;
    const angle = Math.acos(Math.min(1, sign * cosine));
    const [a, b] = angle > 1e-4 ? [Math.sin((1 - s) * angle), Math.sin(s * angle)] : [1 - s, s];
    const mean = [0, 1, 2, 3].map((i) => a * p[i] + sign * b * q[i]);
    const size = Math.hypot(...mean);
    return { triad: triadOf(mean.map((x) => x / size)), twist: (1 - s) * this.twist[k] + s * this.twist[k + 1] };
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
