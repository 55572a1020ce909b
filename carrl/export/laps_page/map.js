// The road, the way of each lap, and an arrowhead for each car: on the whole track, or about the reference's car.

const ROADS_SEEN = 8; // the surroundings are at least so many widths of the road wide and high
const CLOSER = 2; // and at least so many times larger than the whole track
const HEAD = 9; // half the length of an arrowhead, px

function makeMap(race, canvas, colours) {
  const full = { left: 0, top: 0, width: canvas.clientWidth, height: canvas.clientHeight };
  const context = fitCanvas(canvas, full.width, full.height);
  const whole = wholeCamera(race, full, Math.min(30, full.width / 10));
  const road = makeLayer(full.width, full.height);
  drawLines(road.context, race, whole, colours, 1.25);
  drawStart(road.context, race, whole, colours);
  return { race, colours, context, full, whole, road };
}

function drawMap(map, cars, isCloseUp) {
  const { race, colours, context, full, whole } = map;
  context.fillStyle = colours.ground;
  context.fillRect(0, 0, full.width, full.height);
  const camera = isCloseUp ? cameraAbout(map, cars[race.reference]) : whole;
  if (isCloseUp) drawLines(context, race, camera, colours, 2);
  else copyLayer(context, map.road, full);
  // The reference is drawn last, so that it is seen where cars are in one place.
  for (const car of cars) if (car.lap.index !== race.reference) drawMarker(context, camera, colours, car);
  drawMarker(context, camera, colours, cars[race.reference]);
}

function cameraAbout({ race, full, whole }, { x, y }) {
  const scale = Math.min(full.width, full.height) / (ROADS_SEEN * race.roadWidth);
  return makeCamera(full, x, y, Math.max(scale, CLOSER * whole.scale));
}

function drawLines(context, race, camera, colours, width) {
  drawRoad(context, race, camera, colours);
  for (const lap of race.laps) drawWay(context, race, lap, camera, colours, width);
  drawScaleBar(context, camera, colours);
}

function drawWay(context, race, { poses, colour }, camera, colours, width) {
  context.strokeStyle = faded(colours[colour], 0.8);
  context.lineWidth = width;
  context.lineJoin = "round";
  context.beginPath();
  let joined = false;
  for (let at = 0; at < poses.length; at += 3) {
    const seen = camera.sees(poses[at], poses[at + 1], 200);
    if (seen) context[joined ? "lineTo" : "moveTo"](camera.toX(poses[at]), camera.toY(poses[at + 1]));
    joined = seen;
  }
  context.stroke();
}

function drawMarker(context, camera, colours, { x, y, heading, lap }) {
  context.save();
  context.translate(camera.toX(x), camera.toY(y));
  context.rotate(-heading);
  context.beginPath();
  context.moveTo(1.2 * HEAD, 0);
  context.lineTo(-HEAD, 0.85 * HEAD);
  context.lineTo(-0.5 * HEAD, 0);
  context.lineTo(-HEAD, -0.85 * HEAD);
  context.closePath();
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = colours.card;
  context.stroke();
  context.fillStyle = colours[lap.colour];
  context.fill();
  context.restore();
}
