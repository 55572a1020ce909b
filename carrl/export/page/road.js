// What stays the same while the episode is replayed: road, walls, gates, start, scale bar.

const LABEL_FONT = "12px system-ui, sans-serif";
const MOST_NUMBERS = 24; // gates that are numbered on a whole track

// The walls as a path in metres. The road lies between the two: one forwards and the other backwards leave a hole.
function roadPath(episode) {
  const path = new Path2D();
  let begin = 0;
  episode.wallLines.forEach((count, line) => {
    const order = Array.from({ length: count }, (_, i) => 2 * (begin + (line % 2 ? count - 1 - i : i)));
    order.forEach((at, i) => path[i ? "lineTo" : "moveTo"](episode.wallPoints[at], episode.wallPoints[at + 1]));
    begin += count;
  });
  return path;
}

function drawRoad(context, episode, camera, colours) {
  context.save();
  camera.toMetres(context);
  context.fillStyle = colours.road;
  context.fill(episode.road, episode.wallLines.length === 2 ? "nonzero" : "evenodd");
  context.restore();
  drawGates(context, episode, camera, colours);
  drawWalls(context, episode, camera, colours);
}

// Only those that may be seen: of a long circuit that is a small part.
function drawWalls(context, episode, camera, colours) {
  context.strokeStyle = colours.wall;
  context.lineWidth = clamp(0.25 * camera.scale, 0.75, 2.5);
  context.lineCap = "round";
  context.beginPath();
  let begin = 0;
  for (const count of episode.wallLines) {
    for (let at = 2 * begin; at < 2 * (begin + count - 1); at += 2) {
      const [x, y, nextX, nextY] = episode.wallPoints.subarray(at, at + 4);
      if (!camera.touches(x, y, nextX, nextY)) continue;
      context.moveTo(camera.toX(x), camera.toY(y));
      context.lineTo(camera.toX(nextX), camera.toY(nextY));
    }
    begin += count;
  }
  context.stroke();
}

// Left end, then right end, in pixels.
function gateEnds(episode, camera, gate) {
  const [leftX, leftY, rightX, rightY] = episode.gates.subarray(4 * gate, 4 * gate + 4);
  return [camera.toX(leftX), camera.toY(leftY), camera.toX(rightX), camera.toY(rightY)];
}

function drawGates(context, episode, camera, colours) {
  context.strokeStyle = colours.gate;
  context.lineCap = "butt";
  context.lineWidth = clamp(0.4 * camera.scale, 0.5, 4);
  for (let gate = 0; gate < episode.gateCount - 1; gate++) strokeLine(context, gateEnds(episode, camera, gate));
  drawStartLine(context, gateEnds(episode, camera, episode.gateCount - 1), camera);
}

// Black and white, in either theme.
function drawStartLine(context, ends, camera) {
  const size = clamp(0.5 * camera.scale, 2, 6);
  context.lineWidth = size;
  context.strokeStyle = "#000000";
  strokeLine(context, ends);
  context.setLineDash([size, size]);
  context.strokeStyle = "#ffffff";
  strokeLine(context, ends);
  context.setLineDash([]);
}

// Numbers of the gates, an arrow at the start, a scale bar: over the road, in ink.
function drawLabels(context, episode, camera, colours) {
  const taken = drawStart(context, episode, camera, colours);
  const every = roundNumber(Math.max(1, episode.gateCount / MOST_NUMBERS));
  drawGateNumbers(context, episode, camera, colours, every, taken);
  drawScaleBar(context, camera, colours);
}

// Beside those gates that are seen; none so near to a place that is taken that they would touch.
function drawGateNumbers(context, episode, camera, colours, every, taken) {
  for (let gate = every - 1; gate < episode.gateCount - 1; gate += every) {
    if (!camera.sees(episode.gates[4 * gate], episode.gates[4 * gate + 1], 20)) continue;
    const place = roomierSide(episode, camera, gateEnds(episode, camera, gate), 13);
    if (taken.some(([x, y]) => Math.hypot(x - place.x, y - place.y) < 26)) continue;
    taken.push([place.x, place.y]);
    writeLabel(context, colours, String(gate + 1), place.x, place.y);
  }
}

function writeLabel(context, colours, text, x, y) {
  context.font = LABEL_FONT;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeStyle = colours.ground;
  context.strokeText(text, x, y);
  context.fillStyle = colours.ink;
  context.fillText(text, x, y);
}

// Beside an end of the gate, outside the road: the end that is farther from all of the road.
function roomierSide(episode, camera, [leftX, leftY, rightX, rightY], distance) {
  const length = Math.hypot(leftX - rightX, leftY - rightY) || 1;
  const [outX, outY] = [((leftX - rightX) / length) * distance, ((leftY - rightY) / length) * distance];
  const places = [
    { x: leftX + outX, y: leftY + outY },
    { x: rightX - outX, y: rightY - outY },
  ];
  const [left, right] = places.map((place) => roomAt(episode, camera, place));
  return left > right ? places[0] : places[1];
}

// Distance to the nearest point of the centreline, in pixels.
function roomAt(episode, camera, place) {
  let least = Infinity;
  for (let i = 0; i < episode.centreline.length; i += 2) {
    const distance = Math.hypot(camera.toX(episode.centreline[i]) - place.x, camera.toY(episode.centreline[i + 1]) - place.y);
    least = Math.min(least, distance);
  }
  return least;
}

// An arrow in the driving direction beside the start line, which is the last gate; returns the places it covers.
function drawStart(context, episode, camera, colours) {
  const ends = gateEnds(episode, camera, episode.gateCount - 1);
  const [leftX, leftY, rightX, rightY] = ends;
  const length = Math.hypot(rightX - leftX, rightY - leftY) || 1;
  const [forwardX, forwardY] = [(rightY - leftY) / length, -(rightX - leftX) / length];
  const { x, y } = roomierSide(episode, camera, ends, 14);
  context.strokeStyle = context.fillStyle = colours.ink;
  drawArrow(context, x, y, forwardX, forwardY, 26);
  const gap = 10 + 12 * Math.abs(forwardX);
  const word = [x - gap * forwardX, y - gap * forwardY];
  writeLabel(context, colours, "start", ...word);
  return [word, [x, y]];
}

function drawArrow(context, x, y, forwardX, forwardY, length) {
  const [tipX, tipY] = [x + length * forwardX, y + length * forwardY];
  const [baseX, baseY] = [tipX - 8 * forwardX, tipY - 8 * forwardY];
  context.lineWidth = 1.5;
  strokeLine(context, [x, y, baseX, baseY]);
  context.beginPath();
  context.moveTo(tipX, tipY);
  context.lineTo(baseX - 3.5 * forwardY, baseY + 3.5 * forwardX);
  context.lineTo(baseX + 3.5 * forwardY, baseY - 3.5 * forwardX);
  context.fill();
}

function drawScaleBar(context, camera, colours) {
  const metres = roundNumber(48 / camera.scale);
  const left = camera.rectangle.left + 16.5;
  const right = left + metres * camera.scale;
  const y = camera.rectangle.top + camera.rectangle.height - 16.5;
  context.strokeStyle = colours.ink;
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(left, y - 4);
  context.lineTo(left, y);
  context.lineTo(right, y);
  context.lineTo(right, y - 4);
  context.stroke();
  writeLabel(context, colours, `${formatNumber(metres, metres < 1 ? 1 : 0)} m`, (left + right) / 2, y - 9);
}
