// Puts the parts together.

const race = await readRace();
const player = makePlayer(race, show);
const writeStep = makeLinkWriter(race);
const showCars = makeList(race, chooseReference);
let map;
let other;
let charts;

// Everything that has the size of the window, the colours of the theme or the reference in it.
function repaint() {
  const colours = readColours([...COLOUR_NAMES, ...LAP_COLOURS]);
  map = makeMap(race, byId("track"), colours);
  other = makeMap(race, byId("other"), colours);
  charts = {
    speed: makeSpeedChart(race, byId("speed-chart"), colours),
    gap: makeGapChart(race, byId("gap-chart"), colours),
  };
  byId("duration").textContent = `/ ${formatMeasured(race.steps * race.timeStep, 1)} s`;
  showTheme();
  player.redraw();
}

function show({ position, playing, following }) {
  const cars = carsAt(race, position);
  drawMap(map, cars, following);
  drawMap(other, cars, !following);
  for (const chart of Object.values(charts)) drawLapChart(chart, cars);
  showCars(cars);
  byId("now").textContent = formatMeasured(position * race.timeStep, 2) + " s";
  byId("together").setAttribute("aria-pressed", String(race.together));
  showControls(race, player);
  if (!playing) writeStep(stepAt(position));
}

// The reference's car stays where it is.
function chooseReference(index) {
  const { station } = carsAt(race, player.position)[index];
  race.reference = index;
  changeSteps(timeAt(race, referenceOf(race), station));
}

function toggleTogether() {
  const { station } = carAt(race, referenceOf(race), player.position * race.timeStep);
  race.together = !race.together;
  changeSteps(timeAt(race, referenceOf(race), station));
}

function changeSteps(time) {
  setSteps(race);
  byId("scrub").max = race.steps;
  player.seek(time / race.timeStep);
  repaint();
}

function goToLinkedStep() {
  const step = linkedStep(race);
  if (step === null) return;
  player.pause();
  player.seek(step);
}

byId("facts").textContent = [
  `${formatNumber(race.trackLength, 0)} m`,
  formatCount(race.laps.length, "lap"),
  "times and gaps in s",
].join(" · ");
byId("together").addEventListener("click", toggleTogether);
document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "d" && !event.ctrlKey && !event.metaKey && !event.altKey) toggleTogether();
});
repaint();
connectControls(race, player, [], repaint);
connectLapChart(race, player, byId("speed-chart"), () => charts.speed);
connectLapChart(race, player, byId("gap-chart"), () => charts.gap);
const sizes = new ResizeObserver(repaint);
for (const canvas of document.querySelectorAll("canvas")) sizes.observe(canvas);
darkScheme.addEventListener("change", repaint);
addEventListener("hashchange", goToLinkedStep);
goToLinkedStep();
if (linkAsksToPlay() && !matchMedia("(prefers-reduced-motion: reduce)").matches) player.play();

// What the page shows, to be read from outside.
window.carrl = Object.freeze({
  get time() { return player.position * race.timeStep; },
  get duration() { return race.steps * race.timeStep; },
  get playing() { return player.playing; },
  get following() { return player.following; },
  get together() { return race.together; },
  get dark() { return isDark(); },
  get cars() {
    return carsAt(race, player.position).map(({ x, y, heading, speed, station, gap }) => ({ x, y, heading, speed, station, gap }));
  },
  gap: (lap, station) => gapAt(race, race.laps[lap], station),
  place: (x, y) => [map.whole.toX(x), map.whole.toY(y)],
});
