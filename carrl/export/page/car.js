// What moves: the line that was driven, the gate just passed, the sensor's rays, the car.

const CAR_LEAST = 6.5; // radius of the smallest car that is drawn, px
const FLASH_STEPS = 8; // how long a gate that was passed shines

// The way driven between two positions, each step in the colour of its action or of its speed.
function drawTrail(context, episode, camera, colours, from, to) {
  context.lineWidth = clamp(0.5 * camera.scale, 2, 3.5);
  context.lineCap = context.lineJoin = "round";
  trailColours(episode, colours).forEach((colour, shade) => {
    context.strokeStyle = colour;
    context.beginPath();
    traceShade(context, episode, camera, shade, from, to);
    context.stroke();
  });
}

function traceShade(context, episode, camera, shade, from, to) {
  const { shades, poses } = episode;
  let joined = false;
  for (let step = stepAt(from); step < to; step++) {
    const at = 3 * step;
    const shown = shades[step] === shade && goesOn(episode, step) && camera.sees(poses[at], poses[at + 1], 80);
    if (shown) {
      const [x, y] = step + 1 <= to ? [poses[at + 3], poses[at + 4]] : poseAt(episode, to);
      if (!joined) context.moveTo(camera.toX(poses[at]), camera.toY(poses[at + 1]));
      context.lineTo(camera.toX(x), camera.toY(y));
    }
    joined = shown;
  }
}

// The gates passed in the last steps shine, less and less.
function drawFlash(context, episode, camera, colours, position) {
  for (let i = gatesPassedAt(episode, position) - 1; i >= 0; i--) {
    const [step, gate] = episode.passings[i];
    const age = (position - step - 1) / FLASH_STEPS;
    if (age >= 1) return;
    if (gate < 0) continue; // the log does not say which
    context.strokeStyle = faded(colours.good, 1 - age * age);
    context.lineCap = "round";
    context.lineWidth = clamp(0.8 * camera.scale, 3, 8);
    strokeLine(context, gateEnds(episode, camera, gate));
  }
}

// A line for each ray, and a dot where it ends at a wall and not at the sensor's range.
function drawRays(context, episode, camera, colours, position) {
  const [middleX, middleY, heading] = poseAt(episode, position);
  const x = middleX + episode.sensorMount * Math.cos(heading);
  const y = middleY + episode.sensorMount * Math.sin(heading);
  const thickness = clamp(0.2 * camera.scale, 1, 2);
  for (let ray = 0; ray < episode.rays; ray++) {
    const range = rangeAt(episode, position, ray);
    if (!Number.isFinite(range)) continue;
    const angle = heading + episode.sensorAngles[ray];
    const [endX, endY] = [camera.toX(x + range * Math.cos(angle)), camera.toY(y + range * Math.sin(angle))];
    const reading = range / episode.sensorRange;
    context.strokeStyle = context.fillStyle = nearnessColour(colours, reading);
    context.lineWidth = reading < 0.1 ? 2 * thickness : thickness;
    strokeLine(context, [camera.toX(x), camera.toY(y), endX, endY]);
    if (reading < 0.999) fillDisc(context, endX, endY, 1.6 * thickness + 0.8);
  }
}

// The other cars of the world, and the car on top of them.
function drawCars(context, episode, camera, colours, position) {
  for (const poses of episode.otherPoses) drawCar(context, episode, camera, colours, poseAt(episode, position, poses), colours["other-car"], 0);
  const steering = valuesNamed(episode, "steering")?.(stepAt(position)) ?? 0;
  drawCar(context, episode, camera, colours, poseAt(episode, position), colours.car, steering);
}

// A car's disc or rectangle, to scale unless that is too small to see, with its nose marked.
function drawCar(context, episode, camera, colours, [x, y, heading], fill, steering) {
  const radius = Math.max(episode.bodyRadius * camera.scale, CAR_LEAST);
  context.save();
  context.translate(camera.toX(x), camera.toY(y));
  context.rotate(-heading);
  context.lineWidth = clamp(0.2 * radius, 1.5, 3);
  context.lineJoin = "round";
  context.strokeStyle = colours.rim;
  context.fillStyle = fill;
  if (episode.bodySize) {
    drawRectangle(context, episode, camera, colours, fill, steering);
  } else {
    drawNose(context, radius);
    fillDisc(context, 0, 0, radius);
    context.stroke();
  }
  context.restore();
}

// Along the x axis of the context, with a windscreen, and front wheels as they stand where there is room for them.
function drawRectangle(context, episode, camera, colours, fill, steering) {
  const grown = Math.max(1, (2 * CAR_LEAST) / (episode.bodySize[0] * camera.scale));
  const [length, width] = episode.bodySize.map((size) => size * camera.scale * grown);
  context.lineWidth = clamp(0.06 * width, 1.2, 2.5);
  if (width >= 10) drawWheels(context, colours, length, width, steering);
  context.fillStyle = fill;
  context.beginPath();
  context.rect(-length / 2, -width / 2, length, width);
  context.fill();
  context.stroke();
  context.fillStyle = colours.rim;
  context.beginPath();
  context.moveTo(0.22 * length, -0.4 * width);
  context.lineTo(0.47 * length, 0);
  context.lineTo(0.22 * length, 0.4 * width);
  context.closePath();
  context.fill();
}

function drawWheels(context, colours, length, width, steering) {
  context.fillStyle = colours.rim;
  for (const [along, angle] of [[-0.3, 0], [0.3, -steering]]) {
    for (const side of [-1, 1]) {
      context.save();
      context.translate(along * length, side * 0.5 * width);
      context.rotate(angle);
      context.fillRect(-0.09 * length, -0.11 * width, 0.18 * length, 0.22 * width);
      context.restore();
    }
  }
}

function drawNose(context, radius) {
  context.beginPath();
  context.moveTo(0.6 * radius, -0.8 * radius);
  context.lineTo(1.75 * radius, 0);
  context.lineTo(0.6 * radius, 0.8 * radius);
  context.closePath();
  context.fill();
  context.stroke();
}

// A cross where the episode ended at a wall.
function drawCrash(context, episode, camera, colours, position) {
  if (episode.ended !== "collision" || position < episode.steps) return;
  const [x, y] = poseAt(episode, episode.steps);
  const reach = 1.7 * Math.max(episode.bodyRadius * camera.scale, CAR_LEAST);
  context.lineCap = "round";
  for (const [colour, width] of [[colours.ground, 7], [colours.bad, 4]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    for (const side of [-1, 1]) {
      const [dx, dy] = [reach, side * reach];
      strokeLine(context, [camera.toX(x) - dx, camera.toY(y) - dy, camera.toX(x) + dx, camera.toY(y) + dy]);
    }
  }
}

function drawMoment(context, episode, camera, colours, position) {
  drawFlash(context, episode, camera, colours, position);
  drawRays(context, episode, camera, colours, position);
  drawCrash(context, episode, camera, colours, position);
  drawCars(context, episode, camera, colours, position);
}
