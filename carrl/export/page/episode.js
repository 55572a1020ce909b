// The episode as the log has it, and what follows from it.
// T steps, R rays, A actions, K terms of the reward. Lengths in metres, angles in radians, times in seconds.
// A series has numbers of the log by its entries, [T, entries] or [T + 1, entries]; `perAction` is one of a number for each action, if any.
// A position is a recorded step and the share of it that is driven, 0..T; at T the last step is done. A step's number is
// that within the episode: it is larger where the log lacks steps.

async function readEpisode() {
  const { arrays, ...episode } = JSON.parse(byId("episode").textContent);
  const unpacked = await Promise.all(Object.values(arrays).map(unpack));
  Object.keys(arrays).forEach((name, i) => (episode[name] = unpacked[i]));
  episode.series.forEach((series, i) => (series.values = episode[`series${i}`]));
  episode.perAction = episode.series.find(({ entries }) => String(entries) === String(episode.actionNames));
  episode.steps = episode.actions.length;
  episode.rays = episode.sensorAngles.length;
  const places = 3 * (episode.steps + 1);
  episode.otherPoses = Array.from({ length: episode.others.length / places }, (_, car) => episode.others.subarray(car * places, (car + 1) * places));
  episode.returns = runningSum(episode.rewards);
  episode.gateCount = episode.gates.length / 4;
  episode.road = roadPath(episode);
  return episode;
}

function runningSum(values) {
  const sums = new Float64Array(values.length + 1);
  values.forEach((value, i) => (sums[i + 1] = sums[i] + value));
  return sums;
}

// Whether the log has the step after a step, so that the way between them is known.
const goesOn = (episode, step) => episode.stepNumbers[step + 1] - episode.stepNumbers[step] === 1;

// How many steps the log lacks, from the beginning of the episode to the last one.
const missingSteps = (episode) => episode.stepNumbers[episode.steps] - episode.steps;

// x, y and heading of the car, or of another one with these poses; between two steps the way it turns is the shorter one.
function poseAt(episode, position, poses = episode.poses) {
  const step = stepAt(position);
  const share = position - step;
  const [x, y, heading] = poses.subarray(3 * step, 3 * step + 3);
  if (share === 0 || !goesOn(episode, step)) return [x, y, heading];
  const [nextX, nextY, nextHeading] = poses.subarray(3 * step + 3, 3 * step + 6);
  const turn = Math.atan2(Math.sin(nextHeading - heading), Math.cos(nextHeading - heading));
  return [x + share * (nextX - x), y + share * (nextY - y), heading + share * turn];
}

// What a ray reads; a reading that jumps, as from one wall to another, stays until the step is done.
function rangeAt(episode, position, ray) {
  const step = stepAt(position);
  const now = episode.ranges[step * episode.rays + ray];
  if (position === step || !goesOn(episode, step)) return now;
  const next = episode.ranges[(step + 1) * episode.rays + ray];
  return Math.abs(next - now) < 0.2 * episode.sensorRange ? now + (position - step) * (next - now) : now;
}

// How many gates were passed in the steps before a position.
function gatesPassedAt(episode, position) {
  const step = stepAt(position);
  let low = 0;
  let high = episode.passings.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (episode.passings[middle][0] < step) low = middle + 1;
    else high = middle;
  }
  return low;
}

// A function from a step to the value of an entry of the log's columns, such as "speed"; undefined if it has none such.
function valuesNamed(episode, name) {
  for (const { entries, values } of episode.series) {
    const index = entries.indexOf(name);
    if (index >= 0) return (step) => values[step * entries.length + index];
  }
  return undefined;
}

// The colours of the line driven, which the shades of the steps count: by speed, or if that does not vary by action.
function trailColours(episode, colours) {
  if (!episode.speedSpan) return episode.actionNames.map((_, action) => colours[actionColour(action)]);
  return Array.from({ length: episode.shadeCount }, (_, shade) => {
    const place = (4 * shade) / (episode.shadeCount - 1);
    const before = Math.min(Math.floor(place), 3);
    return mix(colours[`speed-${before}`], colours[`speed-${before + 1}`], place - before);
  });
}

const actionName = (episode, action) => episode.actionNames[action] ?? `action ${action}`;

// Share of the steps in which each action was chosen.
function actionShares(episode) {
  const counts = new Array(episode.actionNames.length).fill(0);
  for (const action of episode.actions) counts[action] += 1;
  return counts.map((count) => count / episode.steps);
}
