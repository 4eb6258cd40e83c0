"use strict";
// Vectors are arrays [x, y, z]; triads have unit vectors as rows; quaternions have their scalar last.

const TAU = 2 * Math.PI;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const blend = (a, x, b, y) => [a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]];
const scaled = (s, x) => [s * x[0], s * x[1], s * x[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const size = (x) => Math.hypot(x[0], x[1], x[2]);
const outOf = (triad, x) => blend(1, blend(x[0], triad[0], x[1], triad[1]), x[2], triad[2]);
const unit = (x) => scaled(1 / size(x), x);

// Index k and weight s with x = (1 - s) times[k] + s times[k + 1].
function locate(times, x) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= x) low = middle; else high = middle;
  }
  return [low, Math.min(1, Math.max(0, (x - times[low]) / (times[high] - times[low] || 1)))];
}

// Rows t1, t2, t3 of the triad whose quaternion maps body to space.
function triadOf([x, y, z, w]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
    [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
    [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
  ];
}

// The quaternion at the part s of the shortest way from p to q.
function between(p, q, s) {
  const cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
  const sign = cosine < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(1, sign * cosine));
  const [a, b] = angle > 1e-4 ? [Math.sin((1 - s) * angle), Math.sin(s * angle)] : [1 - s, s];
  const mean = [0, 1, 2, 3].map((i) => a * p[i] + sign * b * q[i]);
  const length = Math.hypot(...mean);
  return mean.map((x) => x / length);
}
