// What every drawing uses: canvases that are sharp on any screen, lines, discs.

// A canvas in memory, in device pixels, drawn on in CSS pixels.
function makeLayer(width, height) {
  const canvas = document.createElement("canvas");
  return { canvas, context: fitCanvas(canvas, width, height) };
}

function fitCanvas(canvas, width, height) {
  const ratio = devicePixelRatio;
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  return context;
}

function copyLayer(context, layer, { width, height }) {
  context.drawImage(layer.canvas, 0, 0, width, height);
}

function strokeLine(context, [beginX, beginY, endX, endY]) {
  context.beginPath();
  context.moveTo(beginX, beginY);
  context.lineTo(endX, endY);
  context.stroke();
}

function fillDisc(context, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}
