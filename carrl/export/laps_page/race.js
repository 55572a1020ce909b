// The laps, and where each car is at a moment. Lengths in metres, angles in radians, times in seconds.
// A lap's moments are `timeStep` apart, but for the last one, which is its end. A gap is by how much a lap came later
// to a station than the reference.

const LAP_COLOURS = ["lap-0", "lap-1", "lap-2", "lap-3", "lap-4", "lap-5"];

async function readRace() {
  const { arrays, ...race } = JSON.parse(byId("race").textContent);
  const laps = await Promise.all(race.laps.map(readLap));
  Object.assign(race, await unpacked(arrays), { laps, gateCount: 1, reference: 0, together: false });
  race.road = roadPath(race);
  setSteps(race);
  return race;
}

async function readLap({ arrays, ...lap }, index) {
  return { ...lap, ...(await unpacked(arrays)), index, colour: LAP_COLOURS[index] };
}

async function unpacked(arrays) {
  const values = await Promise.all(Object.values(arrays).map(unpack));
  return Object.fromEntries(Object.keys(arrays).map((name, i) => [name, values[i]]));
}

const referenceOf = (race) => race.laps[race.reference];

// How long the replay is: until the last car ends, or side by side until the reference does. The player, the slider and
// links count in steps of time.
function setSteps(race) {
  const longest = race.together ? referenceOf(race).duration : Math.max(...race.laps.map(({ duration }) => duration));
  race.steps = Math.ceil(longest / race.timeStep - 1e-9);
  race.stepNumbers = Array.from({ length: race.steps + 1 }, (_, step) => step);
  race.times = race.stepNumbers.map((step) => step * race.timeStep);
}

// x, y, heading, speed and station of a car at a time; after its end those of its end.
function carAt(race, lap, time) {
  const last = lap.stations.length - 1;
  const at = clamp(time, 0, lap.duration) / race.timeStep;
  const step = Math.min(Math.floor(at), last - 1);
  const span = Math.min((step + 1) * race.timeStep, lap.duration) - step * race.timeStep;
  const share = clamp(((at - step) * race.timeStep) / span, 0, 1);
  const between = (values, width, entry) => {
    const now = values[step * width + entry];
    return now + share * (values[(step + 1) * width + entry] - now);
  };
  const [x, y, heading] = [0, 1, 2].map((entry) => between(lap.poses, 3, entry));
  return { x, y, heading, speed: between(lap.speeds, 1, 0), station: between(lap.stations, 1, 0) };
}

// When a car came to a station; NaN if it did not.
function timeAt(race, lap, station) {
  const { stations, duration } = lap;
  if (station > lap.end + 1e-3) return NaN;
  const after = firstAtLeast(stations, Math.min(station, stations[stations.length - 1]));
  if (after === 0) return 0;
  const way = stations[after] - stations[after - 1];
  const [before, next] = [(after - 1) * race.timeStep, Math.min(after * race.timeStep, duration)];
  return before + ((Math.min(station, lap.end) - stations[after - 1]) / way) * (next - before);
}

// Index of the first of the growing values that is not below a value.
function firstAtLeast(values, value) {
  let [low, high] = [0, values.length - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

const gapAt = (race, lap, station) => timeAt(race, lap, station) - timeAt(race, referenceOf(race), station);

// The cars as they are shown at a position of the player: at the same time, or side by side at the reference's station.
function carsAt(race, position) {
  const time = position * race.timeStep;
  const { station } = carAt(race, referenceOf(race), time);
  return race.laps.map((lap) => {
    const own = race.together ? timeAt(race, lap, station) : time;
    const car = carAt(race, lap, Number.isNaN(own) ? lap.duration : own);
    return { ...car, lap, over: Number.isNaN(own) || own >= lap.duration, gap: gapAt(race, lap, car.station) };
  });
}

const formatTime = (seconds) => (seconds === null ? "–" : formatMeasured(seconds, 2));
const formatGap = (seconds) => (Number.isNaN(seconds) ? "–" : (seconds >= 0.005 ? "+" : "") + formatMeasured(seconds, 2));
