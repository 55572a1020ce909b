// The charts: a picture of the whole episode that is drawn once, and what belongs to the moment on top of it.

const AXIS_WIDTH = 44;
const BARS_WIDTH = 66;
const FOOT = 20;

// Draws `still(context, size)` once, which returns the plots, and `moment(context, plots, position)` for every position.
function makeChart(canvas, still, moment) {
  const size = { width: canvas.clientWidth, height: canvas.clientHeight };
  const layer = makeLayer(size.width, size.height);
  const context = fitCanvas(canvas, size.width, size.height);
  return { size, layer, context, moment, plots: still(layer.context, size) };
}

function drawChart(chart, position) {
  const { context, size } = chart;
  context.clearRect(0, 0, size.width, size.height);
  copyLayer(context, chart.layer, size);
  chart.moment(context, chart.plots, position);
}

// A number for each action: a line for each, below it the chosen actions as a ribbon, beside it the step's values as bars.
function makeValueChart(episode, colours, canvas) {
  return makeChart(
    canvas,
    (context, size) => drawValueLines(context, episode, colours, size),
    (context, plot, position) => drawValueMoment(context, episode, colours, plot, position),
  );
}

const valueOf = (episode, step, action) => episode.perAction.values[step * episode.actionNames.length + action];

function drawValueLines(context, episode, colours, { width, height }) {
  const rectangle = { left: AXIS_WIDTH, top: 8, right: width - BARS_WIDTH, bottom: height - FOOT - 10 };
  const plot = makePlot(rectangle, episode.steps, widened(spanOf(episode.perAction.values)));
  drawValueAxis(context, { ...plot, right: width }, colours, plot.bottom - plot.top < 90 ? 3 : 5);
  context.lineWidth = 1.4;
  episode.actionNames.forEach((_, action) => {
    drawLine(context, plot, episode.steps, (step) => valueOf(episode, step, action), colours[actionColour(action)]);
  });
  drawRibbon(context, episode, colours, plot, plot.bottom + 4);
  drawStepAxis(context, { ...plot, bottom: plot.bottom + 10 }, colours, episode.stepNumbers);
  return plot;
}

function drawValueMoment(context, episode, colours, plot, position) {
  drawPlayhead(context, colours, plot.toX(position), plot.top - 4, plot.bottom + 10);
  if (position >= episode.steps) return;
  const step = stepAt(position);
  episode.actionNames.forEach((_, action) => {
    const taken = action === episode.actions[step];
    const y = plot.toY(valueOf(episode, step, action));
    drawDot(context, colours, plot.toX(position), y, colours[actionColour(action)], taken ? 4.5 : 2.5);
    drawValueBar(context, episode, colours, plot, action, y, taken);
  });
}

const widened = ([low, high]) => [low - 0.06 * (high - low), high + 0.06 * (high - low)];

// Beside the plot, on the same axis; the chosen action's is full, the others are pale.
function drawValueBar(context, episode, colours, plot, action, y, taken) {
  if (!Number.isFinite(y)) return;
  const slot = (BARS_WIDTH - 10) / episode.actionNames.length;
  const left = plot.right + 10 + action * slot;
  const zero = clamp(plot.toY(0), plot.top, plot.bottom);
  context.fillStyle = faded(colours[actionColour(action)], taken ? 1 : 0.35);
  context.fillRect(left, Math.min(y, zero), Math.max(slot - 4, 1), Math.max(Math.abs(zero - y), 1.5));
  if (!taken) return;
  const middle = left + (slot - 4) / 2;
  context.fillStyle = colours.ink;
  context.beginPath();
  context.moveTo(middle, plot.bottom + 4);
  context.lineTo(middle - 4, plot.bottom + 11);
  context.lineTo(middle + 4, plot.bottom + 11);
  context.fill();
}

// The action of each step; of many steps in a pixel that of the first.
function drawRibbon(context, episode, colours, plot, top) {
  const width = Math.max(1, (plot.right - plot.left) / plot.steps);
  const stride = Math.max(1, Math.floor(plot.steps / (plot.right - plot.left)));
  for (let step = 0; step < plot.steps; step += stride) {
    context.fillStyle = colours[actionColour(episode.actions[step])];
    context.fillRect(plot.toX(step), top, width + 0.4, 4);
  }
}

// Above the return so far as a line, below the reward of each step as bars.
function makeRewardChart(episode, colours, canvas) {
  return makeChart(
    canvas,
    (context, size) => drawRewards(context, episode, colours, size),
    (context, plots, position) => drawRewardMoment(context, episode, colours, plots, position),
  );
}

function drawRewards(context, episode, colours, { width, height }) {
  const { steps, returns, rewards, stepNumbers } = episode;
  const middle = 14 + 0.5 * (height - FOOT - 14);
  const side = { left: AXIS_WIDTH, right: width - 16 };
  const sum = makePlot({ ...side, top: 18, bottom: middle - 10 }, steps, spanOf(returns, { withZero: true }));
  const each = makePlot({ ...side, top: middle + 20, bottom: height - FOOT }, steps, spanOf(rewards, { withZero: true }));
  drawValueAxis(context, sum, colours, 3);
  drawValueAxis(context, each, colours, 3);
  drawHeading(context, colours, "return so far", sum);
  drawHeading(context, colours, "reward of the step", each);
  context.lineWidth = 1.6;
  drawLine(context, sum, steps + 1, (step) => returns[step], colours.ink);
  drawBars(context, each, steps, (step) => rewards[step], (value) => (value > 0 ? colours.good : colours.bad));
  drawStepAxis(context, each, colours, stepNumbers);
  return { sum, each };
}

function drawRewardMoment(context, episode, colours, { sum, each }, position) {
  const x = sum.toX(position);
  drawPlayhead(context, colours, x, sum.top - 2, sum.bottom);
  drawPlayhead(context, colours, x, each.top - 2, each.bottom);
  drawDot(context, colours, x, sum.toY(episode.returns[stepAt(position)]), colours.ink, 3.5);
}

function drawHeading(context, colours, text, plot) {
  context.font = AXIS_FONT;
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillStyle = colours.faint;
  context.fillText(text, plot.left, plot.top - 4);
}

// What each ray reads, from left to right as the car sees it.
function makeSensorChart(episode, colours, canvas) {
  const moment = (context, size, position) => drawSensorBars(context, episode, colours, size, position);
  return makeChart(canvas, (_, size) => size, moment);
}

function drawSensorBars(context, episode, colours, { width, height }, position) {
  const slot = width / episode.rays;
  const labelled = slot >= 34;
  const [top, bottom] = labelled ? [16, height - 16] : [2, height - 2];
  const barWidth = Math.max(slot * 0.7, 1);
  context.font = AXIS_FONT;
  context.textAlign = "center";
  for (let ray = 0; ray < episode.rays; ray++) {
    const middle = width - (ray + 0.5) * slot;
    const range = rangeAt(episode, position, ray);
    const share = clamp(range / episode.sensorRange, 0, 1) || 0;
    context.fillStyle = colours.button;
    context.fillRect(middle - barWidth / 2, top, barWidth, bottom - top);
    context.fillStyle = nearnessColour(colours, share);
    context.fillRect(middle - barWidth / 2, bottom - share * (bottom - top), barWidth, share * (bottom - top));
    if (labelled) labelSensor(context, colours, middle, height, formatNumber(range, 1), angleName(episode.sensorAngles[ray]));
  }
}

function labelSensor(context, colours, middle, height, reading, angle) {
  context.fillStyle = colours.ink;
  context.textBaseline = "top";
  context.fillText(reading, middle, 0);
  context.fillStyle = colours.faint;
  context.textBaseline = "bottom";
  context.fillText(angle, middle, height);
}

// Such as "30° left".
function angleName(angle) {
  const degrees = Math.round((angle * 180) / Math.PI);
  return degrees === 0 ? "ahead" : `${Math.abs(degrees)}° ${degrees > 0 ? "L" : "R"}`;
}

// Above the slider: where gates were passed, where the car was too near to a wall or hit it.
function makeEventChart(episode, colours, canvas) {
  return makeChart(canvas, (context, size) => drawEvents(context, episode, colours, size), () => {});
}

function drawEvents(context, episode, colours, { width, height }) {
  const thumb = 10; // half of the slider's, so that its middle stands below the marks
  const plot = makePlot({ left: thumb, right: width - thumb, top: 0, bottom: height }, episode.steps, [0, 1]);
  context.fillStyle = colours.bad;
  for (let step = 0; step < episode.steps; step++) {
    if (touchesWall(episode, step)) context.fillRect(plot.toX(step + 1) - 1, 6, 2, 5);
  }
  if (episode.passings.length > width / 4) return; // they would melt into one bar
  context.fillStyle = colours.good;
  for (const [step] of episode.passings) context.fillRect(plot.toX(step + 1) - 1, 1, 2, 10);
}

function touchesWall(episode, step) {
  return episode.termNames.some((name, term) => {
    return (name === "collision" || name === "proximity") && episode.terms[step * episode.termNames.length + term] < 0;
  });
}
