// What a car with pedals has: steering wheel, pedals, accelerations in units of g, and the speed over the steps.
// Each is drawn where the log has columns of these names, and the panel is hidden where it has none.

const GRAVITY = 9.81;
const ACCELERATIONS_KEPT = 30; // steps of the way within the circle of friction
const WHEEL_TURN = 2; // of the steering wheel for each turn of the control, rad

// The instruments that the log has columns for, as [name, function that draws it into a square].
function instrumentsOf(episode) {
  const found = [];
  if (valuesNamed(episode, "steer") ?? valuesNamed(episode, "steering")) found.push(drawWheel);
  if (hasPedals(episode)) found.push(drawPedals);
  if (valuesNamed(episode, "acceleration") && valuesNamed(episode, "lateral_acceleration")) found.push(drawFriction);
  return found;
}

const hasPedals = (episode) => ["pedal", "throttle", "brake"].some((name) => valuesNamed(episode, name));

function makeInstruments(episode, colours, canvas) {
  const drawn = instrumentsOf(episode);
  return makeChart(canvas, (_, size) => size, (context, { width, height }, position) => {
    const step = Math.min(stepAt(position), episode.steps - 1);
    drawn.forEach((draw, index) => {
      const slot = width / drawn.length;
      draw(context, episode, colours, { x: (index + 0.5) * slot, y: height / 2, radius: Math.min(slot, height) / 2 }, step);
    });
  });
}

const radiusOf = (place) => Math.max(place.radius - 18, 8);

function writeBelow(context, colours, { x, y }, radius, text) {
  context.font = AXIS_FONT;
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillStyle = colours.faint;
  context.fillText(text, x, y + radius + 4);
}

// Turned as the driver turns it: to the left for a control above 0.
function drawWheel(context, episode, colours, place, step) {
  const [control, angle] = ["steer", "steering"].map((name) => valuesNamed(episode, name)?.(step));
  const radius = radiusOf(place);
  context.save();
  context.translate(place.x, place.y - 8);
  context.rotate(-WHEEL_TURN * (control ?? angle));
  context.strokeStyle = colours.ink;
  context.lineCap = "butt";
  context.lineWidth = Math.max(0.16 * radius, 3);
  context.beginPath();
  context.arc(0, 0, 0.88 * radius, 0, 2 * Math.PI);
  context.stroke();
  context.lineWidth *= 0.8;
  for (const turn of [0, Math.PI / 2, Math.PI]) strokeLine(context, [0, 0, 0.88 * radius * Math.cos(turn), 0.88 * radius * Math.sin(turn)]);
  context.fillStyle = colours.good;
  fillDisc(context, 0, -0.88 * radius, Math.max(0.1 * radius, 2)); // the wheel's top
  context.restore();
  const degrees = angle === undefined ? "" : ` · ${angleOf(angle)}`;
  writeBelow(context, colours, { x: place.x, y: place.y - 8 }, radius, `${control === undefined ? "" : `steer ${formatMeasured(control, 2)}`}${degrees}`.replace(/^ · /, ""));
}

const angleOf = (angle) => `${formatNumber(Math.abs((angle * 180) / Math.PI), 0)}°${Math.abs(angle) < 0.0087 ? "" : angle > 0 ? " L" : " R"}`;

// How far each pedal is down, 0..1: of one pedal its sides, of two those of the controls, which lie in -1..1.
function pedalsAt(episode, step) {
  const both = valuesNamed(episode, "pedal")?.(step);
  if (both !== undefined) return [clamp(both, 0, 1), clamp(-both, 0, 1)];
  return ["throttle", "brake"].map((name) => {
    const value = valuesNamed(episode, name)?.(step);
    return value === undefined ? null : clamp((value + 1) / 2, 0, 1);
  });
}

function drawPedals(context, episode, colours, place, step) {
  const radius = radiusOf(place);
  const width = 0.5 * radius;
  const [top, bottom] = [place.y - 8 - radius, place.y - 8 + radius];
  const [throttle, brake] = pedalsAt(episode, step);
  [["brake", brake, colours.bad, -0.75], ["throttle", throttle, colours.good, 0.75]].forEach(([name, down, colour, side]) => {
    if (down === null) return;
    const middle = place.x + side * width;
    context.fillStyle = colours.button;
    context.fillRect(middle - width / 2, top, width, bottom - top);
    context.fillStyle = colour;
    context.fillRect(middle - width / 2, bottom - down * (bottom - top), width, down * (bottom - top));
    writeBelow(context, colours, { x: place.x + 1.5 * side * width, y: place.y - 8 }, radius, name);
  });
}

// Ahead is up and left is left; the circle is as much as the tyres hold, where that is known.
function drawFriction(context, episode, colours, place, step) {
  const radius = radiusOf(place);
  const [ahead, aside] = ["acceleration", "lateral_acceleration"].map((name) => valuesNamed(episode, name));
  const span = episode.friction ? 1.15 * episode.friction : frictionSpan(episode, ahead, aside);
  const scale = radius / span;
  const [x, y] = [place.x, place.y - 8];
  const at = (index) => [x - (aside(index) / GRAVITY) * scale, y - (ahead(index) / GRAVITY) * scale];
  context.lineWidth = 1;
  context.strokeStyle = colours.line;
  strokeLine(context, [x - radius, y, x + radius, y]);
  strokeLine(context, [x, y - radius, x, y + radius]);
  const rings = ticksOf(0, span, 2).filter(({ value }) => value > 0);
  for (const { value } of rings) strokeCircle(context, x, y, value * scale);
  labelRing(context, colours, rings.at(-1), x, y, scale);
  if (episode.friction) {
    context.strokeStyle = colours.bad;
    context.setLineDash([4, 3]);
    strokeCircle(context, x, y, episode.friction * scale);
    context.setLineDash([]);
  }
  context.lineWidth = 2;
  for (let index = Math.max(1, step - ACCELERATIONS_KEPT); index <= step; index++) {
    context.strokeStyle = faded(colours.ink, 0.5 * (1 - (step - index) / ACCELERATIONS_KEPT));
    strokeLine(context, [...at(index - 1), ...at(index)]);
  }
  drawDot(context, colours, ...at(step), colours["action-1"], 4);
  const force = Math.hypot(ahead(step), aside(step)) / GRAVITY;
  const most = episode.friction ? ` of ${formatNumber(episode.friction, 2)}` : "";
  writeBelow(context, colours, { x, y }, radius, `${formatMeasured(force, 2)}${most} g`);
}

function labelRing(context, colours, { value, text }, x, y, scale) {
  context.font = AXIS_FONT;
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillStyle = colours.faint;
  context.fillText(`${text} g`, x + 0.72 * value * scale + 2, y - 0.72 * value * scale);
}

function frictionSpan(episode, ahead, aside) {
  let most = 0.2;
  for (let step = 0; step < episode.steps; step++) {
    const force = Math.hypot(ahead(step), aside(step)) / GRAVITY;
    if (force > most) most = force;
  }
  return 1.05 * most;
}

function strokeCircle(context, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.stroke();
}

// The speed as a line in the colours of the way on the track.
function makeSpeedChart(episode, colours, canvas) {
  return makeChart(
    canvas,
    (context, size) => drawSpeeds(context, episode, colours, size),
    (context, plot, position) => {
      drawPlayhead(context, colours, plot.toX(position), plot.top - 2, plot.bottom);
      drawDot(context, colours, plot.toX(stepAt(position)), plot.toY(valuesNamed(episode, "speed")(stepAt(position))), colours.ink, 3.5);
    },
  );
}

function drawSpeeds(context, episode, colours, { width, height }) {
  const speed = valuesNamed(episode, "speed");
  const speeds = Array.from({ length: episode.steps + 1 }, (_, step) => speed(step));
  const plot = makePlot({ left: AXIS_WIDTH, right: width - 16, top: 18, bottom: height - FOOT }, episode.steps, spanOf(speeds, { withZero: true }));
  drawValueAxis(context, plot, colours, 3);
  drawHeading(context, colours, "speed, m/s", plot);
  context.lineWidth = 1.8;
  drawLine(context, plot, episode.steps + 1, speed, colours.ink);
  drawStepAxis(context, plot, colours, episode.stepNumbers);
  return plot;
}
