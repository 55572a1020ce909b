// Speed and gap over the way along the road: a picture of the laps that is drawn once, and the moment on top of it.

const LEFT = 44;
const RIGHT = 14;
const FOOT = 20;
const HEADING = 20;
const SECTORS = 3;

function makeLapChart(race, canvas, colours, valueAt, { withZero, heading }) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const layer = makeLayer(width, height);
  const rectangle = { left: LEFT, top: HEADING, right: width - RIGHT, bottom: height - FOOT };
  const lines = race.laps.map((lap) => lineOf(race, lap, rectangle, valueAt));
  const values = lines.flatMap((line) => line.map(([, value]) => value));
  const [low, high] = spanOf(values, { withZero });
  const room = 0.05 * (high - low);
  const plot = makePlot(rectangle, race.trackLength, [low < 0 || !withZero ? low - room : low, high + room]);
  drawSectors(layer.context, plot, colours, heading);
  drawValueAxis(layer.context, plot, colours, height < 150 ? 3 : 5);
  drawDistanceAxis(layer.context, plot, colours);
  writeHeading(layer.context, plot, colours, heading);
  lines.forEach((line, index) => {
    layer.context.strokeStyle = colours[LAP_COLOURS[index]];
    layer.context.lineWidth = index === race.reference ? 2 : 1.6;
    layer.context.lineJoin = "round";
    strokePoints(layer.context, plot, line.map(([station, value]) => [plot.toX(station), value]));
  });
  return { race, colours, context: fitCanvas(canvas, width, height), layer, size: { width, height }, plot, valueAt };
}

// A point for each pixel: [station, value].
function lineOf(race, lap, { left, right }, valueAt) {
  const count = Math.max(2, Math.round(right - left));
  return Array.from({ length: count + 1 }, (_, i) => {
    const station = (race.trackLength * i) / count;
    return [station, valueAt(lap, station)];
  });
}

// Their numbers stand beside the heading, where there is room.
function drawSectors(context, plot, colours, heading) {
  context.font = AXIS_FONT;
  context.textAlign = "center";
  context.textBaseline = "bottom";
  context.lineWidth = 1;
  context.strokeStyle = colours.line;
  context.fillStyle = colours.faint;
  const headingEnd = context.measureText(heading).width + 16;
  for (let sector = 0; sector < SECTORS; sector++) {
    const x = Math.round(plot.toX((plot.steps * sector) / SECTORS)) + 0.5;
    strokeLine(context, [x, plot.top, x, plot.bottom]);
    const middle = plot.toX((plot.steps * (sector + 0.5)) / SECTORS);
    if (middle > headingEnd) context.fillText(`S${sector + 1}`, middle, plot.top - 4);
  }
}

function drawDistanceAxis(context, plot, colours) {
  context.font = AXIS_FONT;
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillStyle = colours.faint;
  for (const { value, text } of ticksOf(0, plot.steps, Math.max(2, (plot.right - plot.left) / 90))) {
    context.fillText(value === 0 ? "0 m" : text, plot.toX(value), plot.bottom + 5);
  }
}

function writeHeading(context, plot, colours, text) {
  context.font = AXIS_FONT;
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillStyle = colours.ink;
  context.fillText(text, 2, plot.top - 4);
}

function drawLapChart({ race, colours, context, layer, size, plot, valueAt }, cars) {
  context.clearRect(0, 0, size.width, size.height);
  copyLayer(context, layer, size);
  drawPlayhead(context, colours, plot.toX(cars[race.reference].station), plot.top - 2, plot.bottom);
  for (const { lap, station } of cars) {
    drawDot(context, colours, plot.toX(station), plot.toY(valueAt(lap, station)), colours[lap.colour], 4);
  }
}

const makeSpeedChart = (race, canvas, colours) => {
  const speedAt = (lap, station) => {
    const time = timeAt(race, lap, station);
    return Number.isNaN(time) ? NaN : carAt(race, lap, time).speed;
  };
  return makeLapChart(race, canvas, colours, speedAt, { withZero: true, heading: "speed, m/s" });
};

const makeGapChart = (race, canvas, colours) => {
  const heading = `gap to ${referenceOf(race).name}, s; up: behind`;
  return makeLapChart(race, canvas, colours, (lap, station) => gapAt(race, lap, station), { withZero: true, heading });
};

// A click goes to where the reference's car is at the place under the pointer, a drag takes it along.
function connectLapChart(race, player, canvas, chartOf) {
  const seek = (event) => {
    const { plot } = chartOf();
    const share = (event.clientX - canvas.getBoundingClientRect().left - plot.left) / (plot.right - plot.left);
    const reference = referenceOf(race);
    player.pause();
    player.seek(timeAt(race, reference, clamp(share * race.trackLength, 0, reference.end)) / race.timeStep);
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    seek(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) seek(event);
  });
}
