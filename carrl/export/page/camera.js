// From metres on the track, y up, to CSS pixels on a canvas, y down.

// A camera over the rectangle at (left, top) of the canvas that shows (x, y) in its middle, at so many pixels per metre.
function makeCamera(rectangle, x, y, scale) {
  const middleX = rectangle.left + rectangle.width / 2;
  const middleY = rectangle.top + rectangle.height / 2;
  return {
    rectangle,
    scale,
    toX: (pointX) => middleX + (pointX - x) * scale,
    toY: (pointY) => middleY - (pointY - y) * scale,
    toMetres: (context) => context.transform(scale, 0, 0, -scale, middleX - x * scale, middleY + y * scale),
    touches: (beginX, beginY, endX, endY) =>
      Math.abs((beginX + endX) / 2 - x) * scale < rectangle.width / 2 + (Math.abs(endX - beginX) / 2) * scale + 4 &&
      Math.abs((beginY + endY) / 2 - y) * scale < rectangle.height / 2 + (Math.abs(endY - beginY) / 2) * scale + 4,
    sees: (pointX, pointY, margin) =>
      Math.abs(pointX - x) * scale < rectangle.width / 2 + margin &&
      Math.abs(pointY - y) * scale < rectangle.height / 2 + margin,
  };
}

// All of the track, with room for labels around it.
function wholeCamera(episode, rectangle, margin) {
  const [left, bottom, right, top] = episode.bounds;
  const scale = Math.min((rectangle.width - 2 * margin) / (right - left), (rectangle.height - 2 * margin) / (top - bottom));
  return makeCamera(rectangle, (left + right) / 2, (bottom + top) / 2, Math.max(scale, 1e-6));
}

// The car's surroundings, a little farther than its sensors reach, if that is not too far and shows enough of the car.
function followCamera(episode, rectangle, position, leastScale = 0) {
  const [x, y] = poseAt(episode, position);
  const scale = Math.max(Math.min(rectangle.width, rectangle.height) / (2.6 * episode.rangeSeen), leastScale);
  return makeCamera(rectangle, x, y, scale);
}

// The least of ..., 1, 2, 5, 10, 20, ... that is not below a value.
function roundNumber(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((digit) => digit * power).find((number) => number >= least * (1 - 1e-9));
}
