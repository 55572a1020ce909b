// The large canvas: the whole track or the car's surroundings, and the other of the two as a small inset.

const INSET_BELOW = 3; // pixels per metre of the whole track under which the car needs a close-up
const MAGNIFIED = 3; // how many times as large as on the whole track the close-up shows the car at least
const MARGIN = 34; // room for labels around the whole track, px

// Everything that depends on the canvas's size and on the colours; made anew when one of them changes.
function makeStage(episode, canvas, colours) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const context = fitCanvas(canvas, width, height);
  const full = { left: 0, top: 0, width, height };
  const whole = wholeCamera(episode, full, Math.min(MARGIN, width / 8));
  return {
    episode,
    colours,
    context,
    full,
    whole,
    road: drawnLayer(full, (layer) => {
      drawRoad(layer, episode, whole, colours);
      drawLabels(layer, episode, whole, colours);
    }),
    trail: { ...makeLayer(width, height), drawn: 0 },
    closeUp: whole.scale < INSET_BELOW ? insetPlace(episode, whole, full) : null,
    map: makeMap(episode, full, colours),
  };
}

function drawnLayer({ width, height }, draw) {
  const layer = makeLayer(width, height);
  draw(layer.context);
  return layer;
}

// The whole track in a corner, for the view that follows the car.
function makeMap(episode, full, colours) {
  const size = insetSize(full);
  const [left, bottom, right, top] = episode.bounds;
  const height = clamp((size * (top - bottom)) / (right - left), 0.5 * size, 1.3 * size);
  const frame = { left: full.width - size - 12, top: 12, width: size, height };
  const camera = wholeCamera(episode, frame, 10);
  const road = drawnLayer(full, (layer) => {
    fillFrame(layer, frame, colours);
    drawRoad(layer, episode, camera, colours);
  });
  return { frame, camera, road };
}

const insetSize = (full) => clamp(0.3 * Math.min(full.width, full.height), 84, 240);

// A square for the close-up, as far from the road as can be; the largest of three that is clear of it, else the smallest.
function insetPlace(episode, whole, full) {
  const largest = clamp(0.45 * Math.min(full.width, full.height), 96, 320);
  for (const size of [largest, 0.8 * largest, 0.6 * largest]) {
    const [frame, room] = freestSquare(episode, whole, full, size);
    if (room > 6 || size < 0.7 * largest) return frame;
  }
}

function freestSquare(episode, whole, full, size) {
  let best = [null, -Infinity];
  for (let row = 0; row <= 8; row++) {
    for (let column = 0; column <= 8; column++) {
      const left = 12 + ((full.width - size - 24) * column) / 8;
      const top = 12 + ((full.height - size - 48) * row) / 8;
      const room = roomAround(episode, whole, left + size / 2, top + size / 2) - size / 2;
      if (room > best[1]) best = [{ left, top, width: size, height: size }, room];
    }
  }
  return best;
}

// Half the side of the largest square around a place that the centreline does not enter.
function roomAround(episode, camera, x, y) {
  let least = Infinity;
  for (let i = 0; i < episode.centreline.length; i += 2) {
    const away = Math.max(Math.abs(camera.toX(episode.centreline[i]) - x), Math.abs(camera.toY(episode.centreline[i + 1]) - y));
    least = Math.min(least, away);
  }
  return least;
}

function drawStage(stage, position, following) {
  const { context, colours, full } = stage;
  context.fillStyle = colours.ground;
  context.fillRect(0, 0, full.width, full.height);
  if (following) drawFollowing(stage, position);
  else drawWhole(stage, position);
}

function drawWhole(stage, position) {
  const { episode, colours, context, whole } = stage;
  copyLayer(context, stage.road, stage.full);
  drawWholeTrail(stage, position);
  drawMoment(context, episode, whole, colours, position);
  if (stage.closeUp) drawCloseUp(stage, position);
}

// Whole steps are drawn once, onto a layer; the share of a step every time.
function drawWholeTrail(stage, position) {
  const { episode, colours, whole, trail, full } = stage;
  const step = stepAt(position);
  if (step < trail.drawn) {
    trail.context.clearRect(0, 0, full.width, full.height);
    trail.drawn = 0;
  }
  drawTrail(trail.context, episode, whole, colours, trail.drawn, step);
  trail.drawn = step;
  copyLayer(stage.context, trail, full);
  drawTrail(stage.context, episode, whole, colours, step, position);
}

function drawCloseUp(stage, position) {
  const { episode, colours, context, whole, closeUp } = stage;
  const camera = followCamera(episode, closeUp, position, MAGNIFIED * whole.scale);
  const [x, y] = poseAt(episode, position);
  const half = Math.max((closeUp.width / 2 / camera.scale) * whole.scale, 9);
  context.strokeStyle = colours.ink;
  context.lineWidth = 1;
  context.strokeRect(whole.toX(x) - half, whole.toY(y) - half, 2 * half, 2 * half);
  context.save();
  clipFrame(context, closeUp, colours);
  drawSurroundings(stage, camera, position);
  context.restore();
  strokeFrame(context, closeUp, colours);
}

function drawFollowing(stage, position) {
  const { episode, colours, context, full, map } = stage;
  const camera = followCamera(episode, full, position);
  drawSurroundings(stage, camera, position);
  drawScaleBar(context, camera, colours);
  copyLayer(context, map.road, full);
  for (const poses of episode.otherPoses) drawDot(stage, poseAt(episode, position, poses), colours["other-car"]);
  drawDot(stage, poseAt(episode, position), colours.car);
  strokeFrame(context, map.frame, colours);
}

// A car on the map.
function drawDot({ context, colours, map }, [x, y], fill) {
  context.fillStyle = fill;
  context.strokeStyle = colours.rim;
  context.lineWidth = 1.5;
  fillDisc(context, map.camera.toX(x), map.camera.toY(y), 4.5);
  context.stroke();
}

function drawSurroundings({ episode, colours, context }, camera, position) {
  drawRoad(context, episode, camera, colours);
  drawGateNumbers(context, episode, camera, colours, 1, []);
  drawTrail(context, episode, camera, colours, 0, position);
  drawMoment(context, episode, camera, colours, position);
}

function traceFrame(context, { left, top, width, height }) {
  context.beginPath();
  context.roundRect(left, top, width, height, 10);
}

function fillFrame(context, frame, colours) {
  context.fillStyle = colours.ground;
  traceFrame(context, frame);
  context.fill();
}

function clipFrame(context, frame, colours) {
  fillFrame(context, frame, colours);
  context.clip();
}

function strokeFrame(context, frame, colours) {
  context.strokeStyle = colours.faint;
  context.lineWidth = 1;
  traceFrame(context, frame);
  context.stroke();
}
