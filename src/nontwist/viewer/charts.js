// Curves on a canvas: ranges, round ticks, grid, lines.

const DASHES = [[], [7, 4], [2, 3]];

// Round numbers, about `count` of them and at least two, from low to high.
function ticksOf(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((x) => x * power >= raw * 0.999);
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  if (last - first < 1) return ticksOf(low, high, 2 * count);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return Array.from({ length: last - first + 1 }, (_, k) => ({ value: (first + k) * step, text: tickText((first + k) * step, step, digits) }));
}

function tickText(value, step, digits) {
  const text = digits > 5 || step >= 1e6 ? (value === 0 ? "0" : value.toExponential(1)) : value.toFixed(digits);
  return text.replace(/-/g, "−");
}

// Draw curves [{times, values, colour, dash}] into the box {left, right, top, bottom} of the canvas.
function drawChart(pen, box, [start, end], [low, high], xticks, curves, marks, ink) {
  const x = (t) => box.left + ((t - start) / (end - start)) * (box.right - box.left);
  const y = (v) => box.bottom - ((v - low) / (high - low)) * (box.bottom - box.top);
  const line = (x0, y0, x1, y1, colour, width) => {
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    Object.assign(pen, { strokeStyle: colour, lineWidth: width });
    pen.stroke();
  };
  pen.setLineDash([]);
  pen.font = '11px system-ui, "Liberation Sans", Arial, sans-serif';
  Object.assign(pen, { textAlign: "right", textBaseline: "middle" });
  for (const { value } of xticks) line(x(value), box.top, x(value), box.bottom, ink.rule, 1);
  for (const { value, text } of ticksOf(low, high, 4)) {
    line(box.left, y(value), box.right, y(value), value === 0 ? ink.grid : ink.rule, 1);
    pen.fillStyle = ink.muted;
    pen.fillText(text, box.left - 6, y(value));
  }
  pen.setLineDash([2, 3]);
  for (const time of marks) line(x(time), box.top, x(time), box.bottom, ink.accent, 1.2);
  pen.setLineDash([]);
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top - 2, box.right - box.left + 2, box.bottom - box.top + 4);
  pen.clip();
  for (const { times, values, colour, dash } of curves) {
    pen.beginPath();
    for (let k = 0; k < times.length; k++) pen.lineTo(x(times[k] + start), y(values[k]));
    pen.setLineDash(dash);
    Object.assign(pen, { strokeStyle: colour, lineWidth: 1.8, lineJoin: "round" });
    pen.stroke();
  }
  pen.restore();
}
