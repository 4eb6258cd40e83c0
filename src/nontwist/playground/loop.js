// The second panel: a loop drawn on the sphere. An arrow is carried along it, tangent and without turning about the
// normal, and home along the shortest arc. It comes back turned by the area inside; both are worked out here, one from
// the arrow, one from spherical triangles, and neither from the other.

const SPACING = 0.02, SHAFT = 0.3, GHOSTS = 0.3; // rad: between points; radii: the arrow; rad: between its traces
const OCTANT = [[0, 0, 1], [1, 0, 0], [0, 1, 0]];

// The arrow v at a, carried to b along the arc between them: the smallest turn that takes a to b.
function carried(v, a, b) {
  const n = cross(a, b), c = dot(a, b);
  return blend(1, blend(c, v, 1, cross(n, v)), dot(n, v) / (1 + c), n);
}

// The area of a triangle of arcs, positive where a, b, c go round anticlockwise (Van Oosterom and Strackee).
const triangleArea = (a, b, c) => 2 * Math.atan2(dot(a, cross(b, c)), 1 + dot(a, b) + dot(b, c) + dot(c, a));

function arc(a, b) {
  const angle = Math.atan2(size(cross(a, b)), dot(a, b)), count = Math.max(1, Math.ceil(angle / SPACING));
  return Array.from({ length: count }, (_, k) => unit(blend(1 - (k + 1) / count, a, (k + 1) / count, b)));
}

class Loop {
  constructor() {
    this.clear();
  }

  clear() {
    Object.assign(this, { points: [], arrows: [], area: 0, turn: 0, isClosed: false });
  }

  // Draw on to a place of the sphere.
  to(x) {
    const { points, arrows } = this;
    if (!points.length) {
      const east = cross([0, 0, 1], x);
      points.push(x);
      arrows.push(unit(size(east) > 1e-3 ? east : cross([0, 1, 0], x)));
      return;
    }
    for (const point of arc(points[points.length - 1], x)) {
      const last = points[points.length - 1];
      this.area += triangleArea(points[0], last, point);
      arrows.push(carried(arrows[arrows.length - 1], last, point));
      points.push(point);
    }
    this.follow();
  }

  // The turn of the arrow once it is home; whole turns are counted as the loop grows.
  follow() {
    const { points, arrows } = this, home = carried(arrows[arrows.length - 1], points[points.length - 1], points[0]);
    const turn = Math.atan2(dot(points[0], cross(arrows[0], home)), dot(arrows[0], home));
    this.turn = turn + TAU * Math.round((this.turn - turn) / TAU);
    this.home = home;
  }

  close() {
    if (this.points.length > 2) this.isClosed = true;
  }
}

class LoopPanel extends Globe {
  constructor(canvas, loop) {
    super(canvas);
    this.loop = loop;
  }

  draw(camera, ink) {
    this.begin(camera, ink);
    const { pen, thick, loop: { points, arrows, isClosed, home, turn } } = this;
    this.glass();
    this.graticule(true);
    if (!points.length) {
      this.write("draw here", [this.centre[0], this.centre[1]], ink.muted);
      return;
    }
    const last = points[points.length - 1], back = [last, ...arc(last, points[0])];
    pen.beginPath();
    for (const x of [...points, ...back]) pen.lineTo(...this.project(x));
    pen.closePath();
    this.fill(ink.twist, 0.28);
    this.curve(points, 0, points.length - 1, true);
    this.stroke(ink.d3, 3 * thick);
    pen.setLineDash(isClosed ? [] : [5, 6]);
    this.curve(back, 0, back.length - 1, true);
    this.stroke(ink.d3, isClosed ? 3 * thick : 1.5 * thick);
    pen.setLineDash([]);
    const step = Math.max(1, Math.round(GHOSTS / SPACING));
    for (let k = step; k < points.length - 1; k += step) this.tangent(points[k], arrows[k], ink.muted, 0.4);
    if (points.length > 1) this.wedge(points[0], arrows[0], turn);
    this.tangent(points[0], arrows[0], ink.frame, 0.8);
    if (isClosed) this.tangent(points[0], home, ink.d1, 1);
    else this.tangent(last, arrows[arrows.length - 1], ink.d1, 1);
    pen.beginPath();
    pen.arc(...this.project(isClosed ? points[0] : last), 5 * thick, 0, TAU);
    this.fill(ink.d3);
  }

  tangent(x, v, colour, bold) {
    this.pointer(this.project(x), this.project(blend(1, x, SHAFT, v)), colour, bold);
  }

  wedge(x, v, turn) {
    const side = cross(x, v), count = Math.max(2, Math.ceil(Math.abs(turn % TAU) / 0.1));
    this.pen.beginPath();
    this.pen.moveTo(...this.project(x));
    for (let k = 0; k <= count; k++) {
      const angle = ((turn % TAU) * k) / count;
      this.pen.lineTo(...this.project(blend(1, x, 0.8 * SHAFT, blend(Math.cos(angle), v, Math.sin(angle), side))));
    }
    this.pen.closePath();
    this.fill(this.ink.twist, 0.75);
  }

  // The place on the near side under a point of the canvas; beyond the edge, the edge.
  under(x, y) {
    const [u, v] = [(x - this.centre[0]) / this.radius, (this.centre[1] - y) / this.radius];
    const far = Math.max(1, Math.hypot(u, v) / 0.999), [a, b] = [u / far, v / far];
    return unit(blend(1, blend(a, this.view[0], b, this.view[1]), Math.sqrt(Math.max(0, 1 - a * a - b * b)), this.view[2]));
  }
}
