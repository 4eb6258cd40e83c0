// The picture of a motion: the unit sphere in orthographic projection, drawn from back to front.

// Rows: right, up, towards the reader.
function viewFrom({ azimuth, elevation }) {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
}

const GRATICULE = [];
for (let m = 0; m < 6; m++) GRATICULE.push(circle([Math.cos(m * TAU / 12), Math.sin(m * TAU / 12), 0], [0, 0, 1], 1, 0));
for (const z of [-0.5, 0, 0.5]) GRATICULE.push(circle([1, 0, 0], [0, 1, 0], Math.sqrt(1 - z * z), z));

function circle(a, b, radius, z) {
  return Array.from({ length: 91 }, (_, k) => {
    const x = blend(radius * Math.cos(k * TAU / 90), a, radius * Math.sin(k * TAU / 90), b);
    return [x[0], x[1], x[2] + z];
  });
}

const RING = [0.7, 0.86], POINTER = 0.98, SECTORS = 72;
const TAIL = 0.7, MEMORY = 60; // rad of the path that are emphasised, and that are drawn at all, back and ahead

class Scene {
  constructor(canvas, motion) {
    Object.assign(this, { canvas, motion, pen: canvas.getContext("2d") });
  }

  draw(time, camera, ink) {
    const { canvas, pen } = this, ratio = Math.min(3, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== across || canvas.height !== down) Object.assign(canvas, { width: across, height: down });
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.lineCap = pen.lineJoin = "round";
    this.radius = Math.min(width, height) * 0.39;
    this.centre = [width / 2, height / 2];
    this.view = viewFrom(camera);
    this.ink = ink;
    this.thick = Math.min(1.25, Math.max(0.6, this.radius / 170));

    const state = this.motion.at(time), { triad, twist } = state;
    const [t1, t2, t3] = triad, [c, s] = [Math.cos(twist), Math.sin(twist)];
    const f1 = blend(c, t1, -s, t2), f2 = blend(s, t1, c, t2); // the triad turned back by ψ
    const path = this.walked(time, t3);

    this.glass();
    this.surface(path, t3, false);
    const arrow = (d, length, name) => ({
      d, length, name, from: this.leaves(triad.map((t) => dot(t, d))), near: dot(d, this.view[2]) >= 0,
    });
    const frame = [arrow(f1, RING[1], "frame"), arrow(f2, RING[1], "frame")];
    const body = [arrow(t1, POINTER, "d1"), arrow(t2, POINTER, "d2"), arrow(t3, 1, "d3")];
    const labels = (near) => body.forEach(({ d, length, name, near: own }, i) => {
      if (own === near) this.label(this.motion.labels[i], d, length + 0.1, ink[name]);
    });
    for (const near of [false, true]) {
      if (near) this.box(triad);
      this.ring(f1, f2, twist, near);
      for (const each of [...frame, ...body]) if (each.near === near) this.arrow(each);
      if (near) this.surface(path, t3, true);
      labels(near);
    }
    return state;
  }

  project(x) {
    const [right, up] = this.view;
    return [this.centre[0] + this.radius * dot(right, x), this.centre[1] - this.radius * dot(up, x)];
  }

  // Indices into the path: where drawing begins, the emphasised tail, here, and where it ends.
  walked(time, tip) {
    const { points, times, way } = this.motion.path, last = points.length - 1;
    const here = time >= times[last] ? last : locate(times, time)[0];
    const [first, tail, ahead] = [-MEMORY, -TAIL, MEMORY].map((by) => locate(way, way[here] + by)[0]);
    return { points, first, tail, here, ahead: Math.min(last, ahead + 1), tip };
  }

  glass() {
    const { pen, radius, ink, centre: [x, y] } = this;
    const fill = pen.createRadialGradient(x - 0.35 * radius, y - 0.4 * radius, 0.1 * radius, x, y, radius);
    fill.addColorStop(0, ink.glass);
    fill.addColorStop(1, ink.glassEdge);
    pen.beginPath();
    pen.arc(x, y, radius, 0, TAU);
    pen.fillStyle = fill;
    pen.fill();
    this.stroke(ink.grid, 1);
  }

  stroke(colour, width, alpha = 1) {
    Object.assign(this.pen, { strokeStyle: colour, lineWidth: width, globalAlpha: alpha });
    this.pen.stroke();
    this.pen.globalAlpha = 1;
  }

  fill(colour, alpha = 1) {
    Object.assign(this.pen, { fillStyle: colour, globalAlpha: alpha });
    this.pen.fill();
    this.pen.globalAlpha = 1;
  }

  // A curve on the sphere, the near or the far half of it.
  curve(points, first, last, near) {
    const { pen, view } = this;
    pen.beginPath();
    for (let k = first, drawn = false; k <= last; k++) {
      const here = (dot(view[2], points[k]) >= 0) === near;
      if (here) pen[drawn ? "lineTo" : "moveTo"](...this.project(points[k]));
      drawn = here;
    }
  }

  surface(path, tip, near) {
    const { ink, pen, thick } = this, alpha = near ? 1 : 0.35;
    for (const line of GRATICULE) {
      this.curve(line, 0, line.length - 1, near);
      this.stroke(ink.grid, 0.7, near ? 0.55 : 0.3);
    }
    this.axes(near);
    this.curve(path.points, path.here, path.ahead, near);
    this.stroke(ink.d3, 1 * thick, 0.25 * alpha);
    this.curve(path.points, path.first, path.here, near);
    this.stroke(ink.d3, 1.8 * thick, 0.75 * alpha);
    const tail = [...path.points.slice(path.tail, path.here + 1), path.tip];
    this.curve(tail, 0, tail.length - 1, near);
    this.stroke(ink.d3, 4 * thick, alpha);
    if ((dot(tip, this.view[2]) >= 0) !== near) return;
    pen.beginPath();
    pen.arc(...this.project(tip), 5.5 * thick, 0, TAU);
    this.fill(ink.d3, alpha);
    this.stroke(ink.card, 1.5 * thick, alpha);
  }

  axes(near) {
    ["x", "y", "z"].forEach((name, i) => {
      const e = [0, 0, 0];
      e[i] = 1;
      if ((dot(e, this.view[2]) >= 0) !== near) return;
      this.pen.beginPath();
      this.pen.moveTo(...this.project(e));
      this.pen.lineTo(...this.project(scaled(1.18, e)));
      this.stroke(this.ink.muted, 1.2, near ? 1 : 0.5);
      this.label(name, e, 1.24, this.ink.muted);
    });
  }

  // Where a ray from the middle leaves the box; d in components of the triad.
  leaves(d) {
    const { half, edges } = this.motion;
    return Math.min(...edges.map((edge, i) => half[i] / Math.max(1e-9, Math.abs(dot(edge, d)))));
  }

  box(triad) {
    const { pen, ink, view } = this, { half, edges } = this.motion;
    const space = edges.map((e) => [0, 1, 2].map((x) => e[0] * triad[0][x] + e[1] * triad[1][x] + e[2] * triad[2][x]));
    for (let i = 0; i < 3; i++) {
      for (const sign of [-1, 1]) {
        const normal = scaled(sign, space[i]), [right, up, towards] = view.map((v) => dot(v, normal));
        if (towards <= 0) continue;
        const [a, b] = [1, 2].map((j) => scaled(half[(i + j) % 3], space[(i + j) % 3]));
        const middle = scaled(half[i], normal);
        pen.beginPath();
        for (const [p, q] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
          pen.lineTo(...this.project(blend(1, middle, 1, blend(p, a, q, b))));
        }
        pen.closePath();
        this.fill(ink.box);
        this.fill("#0b1420", 0.36 * (1 - Math.max(0, -0.35 * right + 0.6 * up + 0.72 * towards)));
        this.stroke(ink.card, 1, 0.7);
      }
    }
  }

  // The ring is fixed in the non-twisting frame; the wedge is the twist, from the frame's first director to the body's.
  ring(f1, f2, twist, near) {
    const { pen, ink, view } = this, [inner, outer] = RING;
    const along = (angle) => blend(Math.cos(angle), f1, Math.sin(angle), f2);
    const half = (from, to) => {
      const pieces = [], count = Math.max(1, Math.ceil((Math.abs(to - from) / TAU) * SECTORS));
      for (let k = 0; k < count; k++) {
        const [a, b] = [0, 1].map((i) => from + ((to - from) * (k + i)) / count);
        if ((dot(along((a + b) / 2), view[2]) >= 0) === near) pieces.push([a, b]);
      }
      return pieces;
    };
    const sectors = (pieces) => {
      pen.beginPath();
      for (const [a, b] of pieces) {
        pen.moveTo(...this.project(scaled(inner, along(a))));
        for (const [radius, angle] of [[outer, a], [outer, b], [inner, b]]) {
          pen.lineTo(...this.project(scaled(radius, along(angle))));
        }
      }
    };
    sectors(half(0, TAU));
    this.fill(ink.frame, 0.16);
    sectors(half(0, twist % TAU));
    this.fill(ink.twist, 0.85);
    pen.beginPath();
    for (const [a, b] of half(0, TAU)) {
      for (const radius of RING) {
        pen.moveTo(...this.project(scaled(radius, along(a))));
        pen.lineTo(...this.project(scaled(radius, along(b))));
      }
    }
    this.stroke(ink.frame, 1.2, 0.9);
    for (let k = 0; k < 24; k++) {
      const e = along((k * TAU) / 24);
      if ((dot(e, view[2]) >= 0) !== near) continue;
      pen.beginPath();
      pen.moveTo(...this.project(scaled(k % 6 ? (k % 2 ? 0.82 : 0.79) : inner, e)));
      pen.lineTo(...this.project(scaled(outer, e)));
      this.stroke(ink.frame, 1.2, 0.9);
    }
  }

  arrow({ d, length, name, from }) {
    const { pen, ink, thick } = this;
    const [x0, y0] = this.project(scaled(Math.min(from, length), d)), [x1, y1] = this.project(scaled(length, d));
    const size = Math.hypot(x1 - x0, y1 - y0), bold = name === "frame" ? 0.55 : 1;
    const head = Math.min(15 * bold * thick, 0.9 * size), wide = 6 * bold * thick;
    if (size < 0.5) return;
    const [ux, uy] = [(x1 - x0) / size, (y1 - y0) / size], [bx, by] = [x1 - head * ux, y1 - head * uy];
    for (const [colour, extra] of [[ink.card, 2.2], [ink[name], 0]]) {
      pen.beginPath();
      pen.moveTo(x0, y0);
      pen.lineTo(bx, by);
      this.stroke(colour, 4.4 * bold * thick + extra);
      pen.beginPath();
      pen.moveTo(x1, y1);
      pen.lineTo(bx - wide * uy, by + wide * ux);
      pen.lineTo(bx + wide * uy, by - wide * ux);
      pen.closePath();
      this.fill(colour);
      if (extra) this.stroke(colour, extra);
    }
  }

  label(text, direction, distance, colour) {
    const { pen, ink } = this, [x, y] = this.project(scaled(distance, direction));
    pen.font = `600 ${Math.round(Math.max(11, 16 * this.thick))}px system-ui, "Liberation Sans", Arial, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    Object.assign(pen, { strokeStyle: ink.card, lineWidth: 3, fillStyle: colour });
    pen.strokeText(text, x, y);
    pen.fillText(text, x, y);
  }
}
