// Light and dark: as the system is, or as the button says. `ink` holds the colours for what draws on canvases.

const ink = {};
const INKS = ["ground", "card", "ink", "muted", "rule", "accent", "d1", "d2", "d3", "frame", "twist", "rotor", "box", "glass", "glass-edge", "grid"];
const theme = document.getElementById("theme"), systemIsDark = matchMedia("(prefers-color-scheme: dark)");
let afterTheme = () => {};

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  theme.textContent = name === "dark" ? "Light" : "Dark";
  theme.setAttribute("aria-pressed", name === "dark");
  const style = getComputedStyle(document.documentElement);
  for (const colour of INKS) ink[colour.replace("-e", "E")] = style.getPropertyValue(`--${colour}`).trim();
  afterTheme();
}

const toggleTheme = () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");

// From here on `redraw` follows every change; called once at the beginning.
function startTheme(redraw) {
  afterTheme = redraw;
  theme.addEventListener("click", toggleTheme);
  systemIsDark.addEventListener("change", () => setTheme(systemIsDark.matches ? "dark" : "light"));
  setTheme(systemIsDark.matches ? "dark" : "light");
}
