// The picture of a motion on the sphere, drawn from back to front; the box lets the ring behind it through.

const RING = [0.7, 0.86], WHEEL = [0.3, 0.4], MOMENTUM = 0.66, POINTER = 0.98, SECTORS = 72;
const TAIL = 0.7, MEMORY = 60; // rad of the path that are emphasised, and that are drawn at all, back and ahead

class Scene extends Globe {
  constructor(canvas, motion) {
    super(canvas);
    this.motion = motion;
  }

  draw(time, camera, ink) {
    this.begin(camera, ink);
    const state = this.motion.at(time), { triad, twist } = state;
    const [t1, t2, t3] = triad, [c, s] = [Math.cos(twist), Math.sin(twist)];
    const f1 = blend(c, t1, -s, t2), f2 = blend(s, t1, c, t2); // the triad turned back by ψ
    const path = this.walked(time, t3);
    const arrow = (d, length, name) => ({
      d, length, name, from: this.leaves(triad.map((t) => dot(t, d))), near: dot(d, this.view[2]) >= 0,
    });
    const wheels = (this.motion.wheels?.(time) ?? []).map(({ axis, size }) => {
      const d = blend(axis[0], t1, 1, blend(axis[1], t2, axis[2], t3)), side = size < 0 ? -1 : 1;
      return { d, arrow: Math.abs(size) > 0.02 ? { ...arrow(scaled(side, d), MOMENTUM * Math.abs(size), "rotor"), from: 0 } : null };
    });
    const momenta = wheels.flatMap((wheel) => wheel.arrow ?? []);
    const frame = [arrow(f1, RING[1], "frame"), arrow(f2, RING[1], "frame")];
    const body = [arrow(t1, POINTER, "d1"), arrow(t2, POINTER, "d2"), arrow(t3, 1, "d3")];
    this.taken = this.places([...body, ...momenta].map(({ d, length }) => this.project(scaled(length, d))));
    const names = [...this.motion.labels, ...momenta.map(() => "h")];
    const labels = (near) => [...body, ...momenta].forEach(({ near: own }, i) => {
      if (own === near) this.write(names[i], this.taken[i], ink.ink);
    });
    this.taken.push(...body.map(({ d, length }) => this.project(scaled(length, d))));
    const sweep = (near) => this.motion.showsArea && fillArea(this, path.points, path.here, t3, near);
    this.glass();
    sweep(false);
    this.surface(path, t3, false);
    const { weight } = this.motion;
    const centre = weight && this.project(outOf(triad, weight.centre_of_mass));
    if (weight) this.vertical(weight.down);
    for (const near of [false, true]) {
      if (near) this.box(triad);
      if (near && weight) this.hangs(centre);
      this.ring(f1, f2, twist, near);
      for (const { d } of wheels) this.wheel(d, near);
      for (const each of [...frame, ...body, ...momenta]) if (each.near === near) this.arrow(each);
      if (near && weight) this.centreOfMass(centre);
      if (near) {
        sweep(true);
        this.surface(path, t3, true);
      }
      labels(near);
    }
    return state;
  }

  // Indices into the path: where drawing begins, the emphasised tail, here, and where it ends.
  walked(time, tip) {
    const { points, times, way } = this.motion.path, last = points.length - 1;
    const here = time >= times[last] ? last : locate(times, time)[0];
    const memory = this.motion.memory ?? MEMORY;
    const [first, tail, ahead] = [-memory, -TAIL, memory].map((by) => locate(way, way[here] + by)[0]);
    return { points, first, tail, here, ahead: Math.min(last, ahead + 1), tip };
  }

  surface(path, tip, near) {
    const { ink, pen, thick } = this, alpha = near ? 1 : 0.35;
    this.graticule(near);
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

  // Where a ray from the pivot leaves the box, 0 where it misses it; d in components of the triad.
  leaves(d) {
    const { half, edges, centre = [0, 0, 0] } = this.motion;
    let enters = -Infinity, exits = Infinity;
    edges.forEach((edge, i) => {
      const rate = Math.abs(dot(edge, d)) < 1e-9 ? 1e-9 : dot(edge, d), off = dot(edge, centre);
      const [a, b] = [(off - half[i]) / rate, (off + half[i]) / rate];
      [enters, exits] = [Math.max(enters, Math.min(a, b)), Math.min(exits, Math.max(a, b))];
    });
    return exits > Math.max(0, enters) ? exits : 0;
  }

  box(triad) {
    const { pen, ink, view } = this, { half, edges, centre = [0, 0, 0] } = this.motion;
    const space = edges.map((e) => outOf(triad, e)), place = outOf(triad, centre);
    for (let i = 0; i < 3; i++) {
      for (const sign of [-1, 1]) {
        const normal = scaled(sign, space[i]), [right, up, towards] = view.map((v) => dot(v, normal));
        if (towards <= 0) continue;
        const [a, b] = [1, 2].map((j) => scaled(half[(i + j) % 3], space[(i + j) % 3]));
        const middle = blend(1, place, half[i], normal);
        pen.beginPath();
        for (const [p, q] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
          pen.lineTo(...this.project(blend(1, middle, 1, blend(p, a, q, b))));
        }
        pen.closePath();
        this.fill(ink.box, 0.5);
        this.fill("#0b1420", 0.24 * (1 - Math.max(0, -0.35 * right + 0.6 * up + 0.72 * towards)));
        this.stroke(ink.card, 1, 0.7);
      }
    }
  }

  // The vertical, dashed, and in the corner the arrow of gravity.
  vertical(down) {
    const { pen, ink, radius, thick, view: [right, up], centre: [x0, y0] } = this;
    const corner = [x0 - 1.05 * radius, y0 + 0.86 * radius], [a, b] = [dot(right, down), dot(up, down)];
    const at = (s) => [corner[0] + s * radius * a, corner[1] - s * radius * b];
    pen.beginPath();
    pen.moveTo(...this.project(scaled(-1, down)));
    pen.lineTo(...this.project(down));
    pen.setLineDash([6, 4]);
    this.stroke(ink.muted, 1.3 * thick);
    pen.setLineDash([]);
    this.pointer(at(-0.16), at(0.16), ink.ink, 0.7);
    this.write("g", at(0.16 + Math.max(0.11, (13 * thick) / radius) / Math.max(1e-9, Math.hypot(a, b))), ink.ink);
  }

  // The line from the pivot to the centre of mass.
  hangs(place) {
    const { pen, ink, thick } = this, pivot = this.project([0, 0, 0]);
    pen.beginPath();
    pen.moveTo(...pivot);
    pen.lineTo(...place);
    this.stroke(ink.ink, 2 * thick);
  }

  // The centre of mass, a quartered circle, and the pivot, a dot.
  centreOfMass([x, y]) {
    const { pen, ink, thick } = this, radius = 7 * thick;
    const disc = (place, r, colour) => {
      pen.beginPath();
      pen.arc(...place, r, 0, TAU);
      this.fill(colour);
    };
    disc(this.project([0, 0, 0]), 4 * thick, ink.ink);
    disc([x, y], radius, ink.card);
    this.stroke(ink.ink, 1.2);
    pen.beginPath();
    for (const first of [0, TAU / 2]) {
      pen.moveTo(x, y);
      pen.arc(x, y, radius, first, first + TAU / 4);
    }
    this.fill(ink.ink);
  }

  // Places for the labels of arrows from the middle to these tips: beyond the tip, or else the first direction around it
  // in which the label is clear of other arrows and labels, or the one that comes nearest to that.
  places(tips) {
    const { centre, radius, thick } = this, away = Math.max(0.1 * radius, 17 * thick), places = [];
    const far = (x, [a, b]) => {
      const [ux, uy, px, py] = [a - centre[0], b - centre[1], x[0] - centre[0], x[1] - centre[1]];
      const s = Math.min(1, Math.max(0, (ux * px + uy * py) / Math.max(1e-9, ux * ux + uy * uy)));
      return Math.hypot(px - s * ux, py - s * uy);
    };
    tips.forEach((tip, k) => {
      const [x, y] = [tip[0] - centre[0], tip[1] - centre[1]], first = Math.hypot(x, y) > 1e-9 * radius ? Math.atan2(y, x) : -TAU / 4;
      const tries = [0, 40, -40, 80, -80, 120, -120].map((turn) => {
        const angle = first + (turn * TAU) / 360, place = [tip[0] + away * Math.cos(angle), tip[1] + away * Math.sin(angle)];
        const shafts = tips.filter((_, j) => j !== k).map((other) => far(place, other) / (11 * thick));
        const labels = places.map((other) => Math.hypot(place[0] - other[0], place[1] - other[1]) / (21 * thick));
        return { place, clear: Math.min(1, ...shafts, ...labels) };
      });
      places.push(tries.reduce((best, each) => (each.clear > best.clear ? each : best)).place);
    });
    return places;
  }

  // The half of a wheel about an axis through the middle that is near, or far.
  wheel(axis, near) {
    const a = unit(cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0])), b = cross(axis, a);
    const [inner, outer] = WHEEL.map((radius) => circle(a, b, radius, 0));
    this.pen.beginPath();
    for (let k = 0; k < 90; k++) {
      if ((dot(blend(1, outer[k], 1, outer[k + 1]), this.view[2]) >= 0) !== near) continue;
      this.pen.moveTo(...this.project(inner[k]));
      for (const x of [outer[k], outer[k + 1], inner[k + 1]]) this.pen.lineTo(...this.project(x));
    }
    this.fill(this.ink.rotor, near ? 0.75 : 0.45);
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
}
