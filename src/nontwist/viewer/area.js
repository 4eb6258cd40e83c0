// The area that the path of an axis encloses with the great circle back to its start, as a fan of thin triangles from the
// start. Drawn in one piece, so that what is gone round in both directions cancels, as it does in the solid angle.

const RIBS = 300, PIECES = 8; // triangles at most, and how many parts of each are near or far on their own

function fillArea(globe, points, here, tip, near) {
  const { pen, ink, view } = globe, first = points[0], every = Math.max(1, Math.ceil(here / RIBS)), ribs = [];
  for (let k = 0; k <= here; k += every) ribs.push(rib(first, points[k]));
  ribs.push(rib(first, tip));
  pen.beginPath();
  for (let k = 1; k < ribs.length; k++) {
    for (let i = 0; i < PIECES; i++) {
      const corners = [ribs[k - 1][i], ribs[k - 1][i + 1], ribs[k][i + 1], ribs[k][i]];
      if ((dot(view[2], corners[0]) + dot(view[2], corners[2]) >= 0) !== near) continue;
      corners.forEach((x, j) => pen[j ? "lineTo" : "moveTo"](...globe.project(x)));
      pen.closePath();
    }
  }
  globe.fill(ink.twist, near ? 0.26 : 0.13);
  const home = rib(first, tip, 60);
  globe.curve(home, 0, 60, near);
  pen.setLineDash([4, 5]);
  globe.stroke(ink.twist, 1.6 * globe.thick, near ? 0.9 : 0.4);
  pen.setLineDash([]);
}

// The shortest arc from a to b in equal pieces.
function rib(a, b, count = PIECES) {
  const n = cross(a, b), sine = size(n), angle = Math.atan2(sine, dot(a, b));
  if (sine < 1e-9) return Array.from({ length: count + 1 }, () => a);
  const side = cross(scaled(1 / sine, n), a);
  return Array.from({ length: count + 1 }, (_, i) => blend(Math.cos((angle * i) / count), a, Math.sin((angle * i) / count), side));
}
