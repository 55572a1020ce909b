// Puts the parts together.

const episode = await readEpisode();
const player = makePlayer(episode, show);
const showReadings = makeReadings(episode);
const writeStep = makeLinkWriter(episode);
const hasDials = instrumentsOf(episode).length > 0;
const hasSpeed = valuesNamed(episode, "speed") !== undefined;
byId("instruments").hidden = !hasDials && !hasSpeed;
byId("dials").hidden = !hasDials;
byId("speed-chart").hidden = !hasSpeed;
byId("sensors").hidden = episode.rays === 0;
let stage;
let charts;

// Everything that has the size of the window or the colours of the theme in it.
function repaint() {
  const colours = readColours();
  stage = makeStage(episode, byId("track"), colours);
  charts = {
    ...(episode.perAction && { values: makeValueChart(episode, colours, byId("value-chart")) }),
    rewards: makeRewardChart(episode, colours, byId("reward-chart")),
    ...(hasDials && { dials: makeInstruments(episode, colours, byId("dials")) }),
    ...(hasSpeed && { speeds: makeSpeedChart(episode, colours, byId("speed-chart")) }),
    sensors: makeSensorChart(episode, colours, byId("sensor-bars")),
    events: makeEventChart(episode, colours, byId("events")),
  };
  showTheme();
  player.redraw();
}

function show({ position, playing, following }) {
  drawStage(stage, position, following);
  for (const chart of Object.values(charts)) drawChart(chart, position);
  showReadings(position);
  showControls(episode, player);
  if (!playing) writeStep(stepAt(position));
}

function goToLinkedStep() {
  const step = linkedStep(episode);
  if (step === null) return;
  player.pause();
  player.seek(step);
}

function watchSize() {
  const callback = new ResizeObserver(repaint);
  for (const canvas of document.querySelectorAll("canvas")) callback.observe(canvas);
}

showFacts(episode);
repaint();
const seekable = [
  ...(episode.perAction ? [[byId("value-chart"), () => charts.values.plots]] : []),
  ...(hasSpeed ? [[byId("speed-chart"), () => charts.speeds.plots]] : []),
  [byId("reward-chart"), () => charts.rewards.plots.sum],
];
connectControls(episode, player, seekable, repaint);
watchSize();
darkScheme.addEventListener("change", repaint);
addEventListener("hashchange", goToLinkedStep);
goToLinkedStep();
if (linkAsksToPlay() && !matchMedia("(prefers-reduced-motion: reduce)").matches) player.play();

// What the page shows, to be read from outside.
window.carrl = Object.freeze({
  get step() { return episode.stepNumbers[stepAt(player.position)]; },
  get steps() { return episode.steps; },
  get playing() { return player.playing; },
  get speed() { return player.speed; },
  get following() { return player.following; },
  get dark() { return isDark(); },
  place(x, y) {
    const { whole } = stage;
    return [whole.toX(x), whole.toY(y)];
  },
});
