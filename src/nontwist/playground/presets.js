// Where to begin, with what to watch. Numbers of the paper's cases as in nontwist.paper.cases.

const PAPER = [3, 2, 1, 0, 0, 1 / 7], UPRIGHT = [0, 0, 0, 1], STILL = [0, 0, 0];
const LEANING = [Math.sin(0.01), 0, 0, Math.cos(0.01)];

const PRESETS = [
  { name: "One kick", speed: 0.5, velocity: [2.2, 1.6, 0], inertia: [2.6, 0.9, 0.45, 0, 0, 0],
    watch: "Both start in the same way, without spin. The standard body soon turns about its own axis d₃: the wedge is its twist. " +
      "The other may not, and its axis moves along a great circle." },
  { name: "Case 1", speed: 0.2, velocity: [6, -18, 0], inertia: PAPER,
    watch: "The paper's first case: free motion. The non-twisting body turns steadily about a direction fixed in " +
      "space. The standard one wobbles, and twists back and forth." },
  { name: "Case 2", speed: 0.5, velocity: STILL, inertia: PAPER, pulse: [-2472.5 / 20, -1075 / 20, 0],
    watch: "The paper's second case: at rest, then pushed for one second by a moment fixed in the body. After the push, " +
      "energy and momentum are conserved." },
  { name: "Case 3", speed: 0.5, velocity: [1.5, 4.5, 0], inertia: PAPER, pulse: [-1236.25 / 20, -537.5 / 20, 0],
    watch: "The paper's third case: in motion, and pushed for one second. After the push the axis of the non-twisting " +
      "body moves along a new great circle." },
  { name: "Tennis racket", speed: 1, velocity: [0.02, 4, 0], inertia: [2.6, 0.9, 0.45, 0, 0, 0],
    watch: "The Dzhanibekov effect: spun about its middle axis, the standard body flips over again and again. " +
      "The other may not twist, so it cannot flip: it keeps turning about d₂." },
  { name: "Sleeping top", speed: 1, velocity: [0, 0, 6], inertia: [0.8, 0.8, 0.3, 0, 0, 0], gravity: 9.81, attitude: LEANING,
    watch: "Two tops, almost upright, spun about d₃. Spin keeps the heavy top up: it sleeps. " +
      "The other may not spin, so the same kick does nothing, and it falls." },
  { name: "Suslov's settling", speed: 1, velocity: [-2.4, 1.2, 0], inertia: [2, 1.2, 0.9, 0.55, 0, 0],
    watch: "The box is tilted relative to d₃. A body that may not spin about such an axis settles: Suslov's body ends in a steady " +
      "rotation about d₁, although it loses no energy. The standard body never settles." },
];

function inputsOf({ inertia, velocity, attitude = UPRIGHT, gravity = 0, pulse = STILL }) {
  return { inertia: [...inertia], attitude: [...attitude], velocity: [...velocity], gravity: [gravity], pulse: [...pulse] };
}
