// Drawing the loop: by mouse, finger or pen, and by keys.

function drawable(canvas, panel, changed) {
  const { loop } = panel;
  let isDown = false, cursor = null;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return panel.under(event.clientX - box.left, event.clientY - box.top);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    isDown = true;
    loop.clear();
    loop.to(place(event));
    changed(false);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!isDown) return;
    const x = place(event);
    if (dot(x, loop.points[loop.points.length - 1]) < Math.cos(SPACING / 2)) loop.to(x);
    changed(false);
  });
  const end = () => {
    if (!isDown) return;
    isDown = false;
    loop.close();
    changed(true);
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    const turn = TURNS[event.key];
    if (turn) {
      if (loop.isClosed) loop.clear();
      if (!loop.points.length) loop.to(cursor = panel.under(...panel.centre));
      cursor = loop.points[loop.points.length - 1];
      const next = unit(blend(1, cursor, 0.1, blend(turn[0], panel.view[0], turn[1], panel.view[1])));
      if (dot(next, panel.view[2]) > 0.02) loop.to(next);
      changed(false);
    } else if (event.key === "Enter") {
      loop.close();
      changed(true);
    } else if (event.key === "Escape") {
      loop.clear();
      changed(true);
    } else return;
    event.preventDefault();
    event.stopPropagation();
  });
}

// Loops of known area: a triangle with three right angles is an eighth of the sphere, 90°.
function drawTriangle(loop) {
  loop.clear();
  for (const corner of [...OCTANT, OCTANT[0]]) loop.to(corner);
  loop.close();
}

// A circle about x with the area given, anticlockwise.
function drawCircle(loop, x, area) {
  const height = 1 - area / TAU, radius = Math.sqrt(1 - height * height), a = unit(cross([0, 0, 1], x)), b = cross(x, a);
  loop.clear();
  for (let k = 0; k <= 360; k++) {
    const angle = (k * TAU) / 360;
    loop.to(blend(height, x, radius, blend(Math.cos(angle), a, Math.sin(angle), b)));
  }
  loop.close();
}
