// The unit sphere in orthographic projection, and what is drawn on it and in it.

// Rows: right, up, towards the reader; azimuth and elevation count in the axes `upright`, rows, the third of which is up.
function viewFrom({ azimuth, elevation, upright = [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }) {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]].map((row) => outOf(upright, row));
}

const GRATICULE = [];
for (let m = 0; m < 6; m++) GRATICULE.push(circle([Math.cos(m * TAU / 12), Math.sin(m * TAU / 12), 0], [0, 0, 1], 1, 0));
for (const z of [-0.5, 0, 0.5]) GRATICULE.push(circle([1, 0, 0], [0, 1, 0], Math.sqrt(1 - z * z), z));

function cleared(canvas, pen) {
  const ratio = Math.min(3, window.devicePixelRatio || 1), [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== across || canvas.height !== down) Object.assign(canvas, { width: across, height: down });
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return [width, height];
}

function circle(a, b, radius, z) {
  return Array.from({ length: 91 }, (_, k) => {
    const x = blend(radius * Math.cos(k * TAU / 90), a, radius * Math.sin(k * TAU / 90), b);
    return [x[0], x[1], x[2] + z];
  });
}

class Globe {
  constructor(canvas) {
    Object.assign(this, { canvas, pen: canvas.getContext("2d") });
  }

  // Clear the canvas, at the resolution of the screen, and take the view of the camera.
  begin(camera, ink) {
    const { canvas, pen } = this, [width, height] = cleared(canvas, pen);
    pen.lineCap = pen.lineJoin = "round";
    this.radius = Math.min(width, height) * 0.415;
    this.centre = [width / 2, height / 2];
    this.view = viewFrom(camera);
    this.ink = ink;
    this.taken = []; // places of labels that those of the axes make room for
    this.thick = Math.min(1.25, Math.max(0.6, this.radius / 170));
  }

  project(x) {
    const [right, up] = this.view;
    return [this.centre[0] + this.radius * dot(right, x), this.centre[1] - this.radius * dot(up, x)];
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

  // A curve on the sphere, the near or the far half of it; without arrays of its own, since most of a frame is spent here.
  curve(points, first, last, near) {
    const { pen, radius, centre: [x0, y0], view: [right, up, towards] } = this;
    pen.beginPath();
    for (let k = first, drawn = false; k <= last; k++) {
      const x = points[k], here = (dot(towards, x) >= 0) === near;
      if (here && drawn) pen.lineTo(x0 + radius * dot(right, x), y0 - radius * dot(up, x));
      else if (here) pen.moveTo(x0 + radius * dot(right, x), y0 - radius * dot(up, x));
      drawn = here;
    }
  }

  graticule(near) {
    for (const line of GRATICULE) {
      this.curve(line, 0, line.length - 1, near);
      this.stroke(this.ink.grid, 0.7, near ? 0.55 : 0.3);
    }
  }

  axes(near) {
    ["x", "y", "z"].forEach((name, i) => {
      const e = [0, 0, 0];
      e[i] = 1;
      if ((dot(e, this.view[2]) >= 0) !== near) return;
      this.pen.beginPath();
      this.pen.moveTo(...this.project(e));
      this.pen.lineTo(...this.project(scaled(1.08, e)));
      this.stroke(this.ink.muted, 1.2, near ? 1 : 0.5);
      const place = this.project(scaled(1.15, e));
      const isFree = this.taken.every(([x, y]) => Math.hypot(x - place[0], y - place[1]) > 20 * this.thick);
      if (isFree) this.write(name, place, this.ink.muted);
    });
  }

  arrow({ d, length, name, from }) {
    const bold = name === "frame" ? 0.55 : 1;
    this.pointer(this.project(scaled(Math.min(from, length), d)), this.project(scaled(length, d)), this.ink[name], bold);
  }

  // An arrow from one place of the canvas to another, with an edge that sets it off.
  pointer([x0, y0], [x1, y1], colour, bold) {
    const { pen, ink, thick } = this, length = Math.hypot(x1 - x0, y1 - y0);
    const head = Math.min(15 * bold * thick, 0.9 * length), wide = 6 * bold * thick;
    if (length < 0.5) return;
    const [ux, uy] = [(x1 - x0) / length, (y1 - y0) / length], [bx, by] = [x1 - head * ux, y1 - head * uy];
    for (const [shade, extra] of [[ink.card, 2.2], [colour, 0]]) {
      pen.beginPath();
      pen.moveTo(x0, y0);
      pen.lineTo(bx, by);
      this.stroke(shade, 4.4 * bold * thick + extra);
      pen.beginPath();
      pen.moveTo(x1, y1);
      pen.lineTo(bx - wide * uy, by + wide * ux);
      pen.lineTo(bx + wide * uy, by - wide * ux);
      pen.closePath();
      this.fill(shade);
      if (extra) this.stroke(shade, extra);
    }
  }

  write(text, [x, y], colour) {
    const { pen, ink } = this;
    pen.font = `600 ${Math.round(Math.max(11, 16 * this.thick))}px system-ui, "Liberation Sans", Arial, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    Object.assign(pen, { strokeStyle: ink.card, lineWidth: 3, fillStyle: colour });
    pen.strokeText(text, x, y);
    pen.fillText(text, x, y);
  }
}
