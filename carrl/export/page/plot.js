// Plots over the steps of the episode. A plot maps steps and values to the pixels of a rectangle.

const AXIS_FONT = "11px system-ui, sans-serif";

function makePlot(rectangle, steps, [low, high]) {
  const { left, top, right, bottom } = rectangle;
  return {
    ...rectangle,
    steps,
    low,
    high,
    toX: (step) => left + ((right - left) * step) / steps,
    toY: (value) => bottom - ((bottom - top) * (value - low)) / (high - low),
  };
}

// Least and greatest finite value, a little apart, with zero among them if asked for.
function spanOf(values, { withZero = false } = {}) {
  let [low, high] = withZero ? [0, 0] : [Infinity, -Infinity];
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (low > high) return [0, 1];
  const least = Math.max(1e-6 * Math.max(Math.abs(low), Math.abs(high)), 1e-9);
  return high - low < least ? [low - 0.5 - least, high + 0.5 + least] : [low, high];
}

// Round values, at most so many, between low and high.
function ticksOf(low, high, most) {
  const gap = roundNumber((high - low) / most);
  const ticks = [];
  for (let i = Math.ceil(low / gap - 1e-9); i * gap <= high + 1e-9 * gap; i++) ticks.push(i * gap);
  const digits = clamp(-Math.floor(Math.log10(gap) + 1e-9), 0, 6);
  return ticks.map((value) => ({ value, text: formatNumber(value, digits) }));
}

// Lines across the plot with their values at the left.
function drawValueAxis(context, plot, colours, most) {
  context.font = AXIS_FONT;
  context.textAlign = "right";
  context.textBaseline = "middle";
  context.lineWidth = 1;
  for (const { value, text } of ticksOf(plot.low, plot.high, most)) {
    const y = Math.round(plot.toY(value)) + 0.5;
    context.strokeStyle = value === 0 ? colours.faint : colours.line;
    context.beginPath();
    context.moveTo(plot.left, y);
    context.lineTo(plot.right, y);
    context.stroke();
    context.fillStyle = colours.faint;
    context.fillText(text, plot.left - 6, y);
  }
}

// Numbers of steps below the plot.
function drawStepAxis(context, plot, colours, stepNumbers) {
  context.font = AXIS_FONT;
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillStyle = colours.faint;
  for (const { value: step } of ticksOf(0, plot.steps, Math.max(1, (plot.right - plot.left) / 56))) {
    if (!Number.isInteger(step)) continue;
    const text = formatNumber(stepNumbers[step], 0);
    const rightmost = context.canvas.width / devicePixelRatio - context.measureText(text).width / 2;
    context.fillText(text, Math.min(plot.toX(step), rightmost), plot.bottom + 5);
  }
}

// A line through valueAt(0), ..., valueAt(count - 1); it has gaps where there is no number. Where many steps share a pixel,
// it is their mean, before a pale band from the least to the greatest, so that no peak is lost.
function drawLine(context, plot, count, valueAt, colour) {
  context.strokeStyle = colour;
  context.lineJoin = "round";
  if (count <= 2 * (plot.right - plot.left)) {
    strokePoints(context, plot, Array.from({ length: count }, (_, step) => [plot.toX(step), valueAt(step)]));
    return;
  }
  const columns = columnsOf(plot, count, valueAt);
  context.fillStyle = faded(colour, 0.22);
  for (const { x, low, high } of columns) {
    if (low < high) context.fillRect(x - 0.5, plot.toY(high), 1, plot.toY(low) - plot.toY(high));
  }
  strokePoints(context, plot, columns.map(({ x, mean }) => [x, mean]));
}

// A line through points [x in pixels, value].
function strokePoints(context, plot, points) {
  context.beginPath();
  let joined = false;
  for (const [x, value] of points) {
    const shown = Number.isFinite(value);
    if (shown) context[joined ? "lineTo" : "moveTo"](x, plot.toY(value));
    joined = shown;
  }
  context.stroke();
}

// For each column of pixels its middle, and of the finite values in it the least, greatest and mean, and the share of the
// steps that have a value other than zero; low > high where there is none.
function columnsOf(plot, count, valueAt) {
  const columns = Math.max(1, Math.floor(plot.right - plot.left));
  return Array.from({ length: columns }, (_, column) => {
    const begin = Math.floor((column * plot.steps) / columns);
    const end = Math.min(count, Math.ceil(((column + 1) * plot.steps) / columns));
    return { x: plot.left + column + 0.5, ...summaryOf(begin, end, valueAt) };
  });
}

function summaryOf(begin, end, valueAt) {
  let [low, high, sum, finite, counted] = [Infinity, -Infinity, 0, 0, 0];
  for (let step = begin; step < end; step++) {
    const value = valueAt(step);
    if (!Number.isFinite(value)) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
    sum += value;
    finite += 1;
    if (value !== 0) counted += 1;
  }
  return { low, high, mean: sum / finite, share: counted / (end - begin) };
}

// Bars from zero, one for each step that is not zero. Where many steps share a pixel, the greatest of each sign, the paler
// the fewer they are.
function drawBars(context, plot, count, valueAt, colourOf) {
  const width = (plot.right - plot.left) / plot.steps;
  if (width >= 1) {
    const gap = width > 4 ? 1 : 0;
    for (let step = 0; step < count; step++) {
      drawBar(context, plot, plot.toX(step) + gap / 2, Math.max(width - gap, 2), valueAt(step), colourOf(valueAt(step)));
    }
    return;
  }
  for (const { x, low, high, share } of columnsOf(plot, count, valueAt)) {
    for (const value of [Math.min(low, 0), Math.max(high, 0)]) {
      drawBar(context, plot, x - 0.5, 1, value, faded(colourOf(value), clamp(Math.sqrt(share), 0.3, 1)));
    }
  }
}

function drawBar(context, plot, x, width, value, colour) {
  if (!Number.isFinite(value) || value === 0) return;
  const zero = plot.toY(0);
  const height = Math.max(Math.abs(plot.toY(value) - zero), 1);
  context.fillStyle = colour;
  context.fillRect(x, value > 0 ? zero - height : zero, width, height);
}

// A thin line at a position, from the top of one plot to the bottom of the same or of another one.
function drawPlayhead(context, colours, x, top, bottom) {
  context.strokeStyle = colours.ink;
  context.lineWidth = 1.5;
  strokeLine(context, [x, top, x, bottom]);
}

function drawDot(context, colours, x, y, colour, radius) {
  if (!Number.isFinite(y)) return;
  context.fillStyle = colours.card;
  fillDisc(context, x, y, radius + 1.5);
  context.fillStyle = colour;
  fillDisc(context, x, y, radius);
}
