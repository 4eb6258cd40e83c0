// The dial: the body seen along its third director, which points at the reader. What is carried along without twist
// stays upright, so the wedge from there to the body's first director is the twist, face on, however the body lies.

function drawDial(canvas, { twist, half, edges, centre, labels }, ink) {
  const { pen, radius, at, line, wedge } = face(canvas, ink);
  outline(at, twist, half, edges, centre, (points) => {
    pen.beginPath();
    points.forEach((point) => pen.lineTo(...point));
    pen.closePath();
    Object.assign(pen, { fillStyle: ink.box, globalAlpha: 0.45 });
    pen.fill();
    pen.globalAlpha = 1;
  });
  wedge(twist, ink.twist);
  for (let k = 0; k < 24; k++) line(ink.frame, 1, at((k * TAU) / 24, k % 6 ? 0.94 : 0.88), at((k * TAU) / 24, 1));
  line(ink.frame, 2, at(0, 0), at(0, 0.97));
  line(ink.d2, 2.4, at(0, 0), at(twist + TAU / 4, 0.6));
  line(ink.d1, 3.4, at(0, 0), at(twist, 0.86));
  pen.beginPath();
  pen.arc(...at(0, 0), 4, 0, TAU);
  pen.fillStyle = ink.d3;
  pen.fill();
  if (radius < 60) return;
  pen.font = '600 13px system-ui, "Liberation Sans", Arial, sans-serif';
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  [[twist - 0.2, 0.72], [twist + TAU / 4 + 0.28, 0.5]].forEach(([angle, r], i) => {
    Object.assign(pen, { strokeStyle: ink.glass, lineWidth: 3, fillStyle: ink.ink });
    pen.strokeText(labels[i], ...at(angle, r));
    pen.fillText(labels[i], ...at(angle, r));
  });
}

// An angle as a wedge, from upright to the left.
function drawWedge(canvas, angle, colour, ink) {
  const { at, line, wedge } = face(canvas, ink);
  wedge(angle, colour);
  line(ink.frame, 1.5, at(0, 0), at(0, 0.97));
  line(colour, 2.5, at(0, 0), at(angle, 0.9));
}

// A round face, and what draws on it by angle and part of the radius.
function face(canvas, ink) {
  const pen = canvas.getContext("2d"), [width, height] = cleared(canvas, pen);
  const radius = 0.46 * Math.min(width, height), [x0, y0] = [width / 2, height / 2];
  const at = (angle, r) => [x0 - r * radius * Math.sin(angle), y0 - r * radius * Math.cos(angle)]; // from above, to the left
  const line = (colour, thick, from, to) => {
    pen.beginPath();
    pen.moveTo(...from);
    pen.lineTo(...to);
    Object.assign(pen, { strokeStyle: colour, lineWidth: thick });
    pen.stroke();
  };
  const sector = (r, to, colour, alpha) => {
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.arc(x0, y0, r * radius, -Math.PI / 2, -Math.PI / 2 - to, to > 0);
    pen.closePath();
    Object.assign(pen, { fillStyle: colour, globalAlpha: alpha });
    pen.fill();
    pen.globalAlpha = 1;
  };
  const wedge = (angle, colour) => {
    if (Math.abs(angle) >= TAU) sector(0.9, Math.sign(angle) * TAU, colour, 0.28); // whole turns
    sector(0.9, angle % TAU, colour, 0.62);
  };
  pen.lineCap = pen.lineJoin = "round";
  sector(1, TAU, ink.glass, 1);
  pen.beginPath();
  pen.arc(x0, y0, radius, 0, TAU);
  Object.assign(pen, { strokeStyle: ink.grid, lineWidth: 1 });
  pen.stroke();
  return { pen, radius, at, line, wedge };
}

// The faces of the box as seen along the third director: edges in components of the triad.
function outline(at, twist, half, edges, centre = [0, 0, 0], fill) {
  for (let i = 0; i < 3; i++) {
    const sign = edges[i][2] < 0 ? -1 : 1;
    const [a, b] = [1, 2].map((j) => scaled(half[(i + j) % 3], edges[(i + j) % 3]));
    if (Math.abs(edges[i][2]) < 1e-9) continue;
    fill([[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([p, q]) => {
      const x = blend(1, blend(1, centre, sign * half[i], edges[i]), 1, blend(p, a, q, b));
      return at(twist + Math.atan2(x[1], x[0]), 1.15 * Math.hypot(x[0], x[1]));
    }));
  }
}
