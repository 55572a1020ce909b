// The colours of the style sheet as the canvases need them, light or dark.

const COLOUR_NAMES = [
  "card", "line", "ink", "faint", "button", "ground", "road", "wall", "gate", "rim", "car", "other-car",
  "action-0", "action-1", "action-2", "action-other", "good", "bad",
  "speed-0", "speed-1", "speed-2", "speed-3", "speed-4",
];
const darkScheme = matchMedia("(prefers-color-scheme: dark)");

const isDark = () => (document.documentElement.dataset.theme ?? (darkScheme.matches ? "dark" : "light")) === "dark";

// A property may hold light-dark(...); only a colour that is in use is resolved to numbers.
function readColours(names = COLOUR_NAMES) {
  const probe = byId("probe");
  const colours = {};
  for (const name of names) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
  return colours;
}

// A colour between two, share 0..1 of the way.
function mix(from, to, share) {
  const [a, b] = [from, to].map((colour) => colour.match(/[\d.]+/g).map(Number));
  return `rgb(${[0, 1, 2].map((i) => Math.round(a[i] + share * (b[i] - a[i]))).join(" ")})`;
}

function faded(colour, opacity) {
  return `rgb(${colour.match(/[\d.]+/g).slice(0, 3).join(" ")} / ${opacity})`;
}

// Bad near the wall, good from a third of the sensor's range on.
function nearnessColour(colours, reading) {
  return mix(colours.bad, colours.good, clamp((reading - 0.1) / 0.25, 0, 1));
}

function showTheme() {
  byId("theme").setAttribute("aria-pressed", String(isDark()));
}

function toggleTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
}
