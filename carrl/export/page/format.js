// Numbers as text, and other small things that every part uses.

const byId = (id) => document.getElementById(id);
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

function formatNumber(value, digits) {
  if (Number.isNaN(value)) return "NaN";
  const sign = value < 0 ? "−" : "";
  const size = Math.abs(value);
  if (size === Infinity) return sign + "∞";
  if (size >= 1e6 || (size > 0 && size < 1e-3)) return sign + size.toExponential(1);
  const text = size.toLocaleString("en-US", { minimumFractionDigits: digits, maximumFractionDigits: digits });
  return (Number(text.replaceAll(",", "")) === 0 ? "" : sign) + text;
}

// A measured value, of which less than half the last digit is nothing.
const formatMeasured = (value, digits) => formatNumber(Number(value.toFixed(digits)), digits);

// As many digits as a value needs: 50, 0.25, but at most two.
const formatReward = (value) => formatNumber(value, Number.isInteger(value) ? 0 : Math.abs(value) < 100 ? 2 : 1);
const formatSigned = (value) => (value > 0 ? "+" : "") + formatReward(value);
const formatSeconds = (value) => formatNumber(value, 1) + " s";
const formatCount = (count, noun) => `${formatNumber(count, 0)} ${noun}${count === 1 ? "" : "s"}`;

// An element with text, never with markup: names come from the log.
function element(tag, className, ...content) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.append(...content);
  return made;
}

// A small patch in the colour of an action.
function swatchOf(action) {
  const swatch = element("span", "swatch");
  swatch.style.color = `var(--${actionColour(action)})`;
  return swatch;
}

const actionColour = (action) => (action < 3 ? `action-${action}` : "action-other");
