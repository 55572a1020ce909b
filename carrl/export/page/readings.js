// The episode and its moment in words and numbers.

const ENDINGS = {
  collision: "ended by a collision",
  "time limit": "cut at the time limit",
  "other end": "ended, not at a wall",
  "laps complete": "laps complete",
  unfinished: "unfinished in the log",
};

function showFacts(episode) {
  const badge = byId("ended");
  badge.textContent = ENDINGS[episode.ended];
  badge.classList.toggle("collision", episode.ended === "collision");
  byId("facts").textContent = [
    `Track ${episode.trackName}`,
    `${formatNumber(episode.trackLength, 0)} m`,
    formatCount(episode.gateCount, "gate"),
    `episode ${formatNumber(episode.episode, 0)}`,
    `car ${episode.car}`,
    formatCount(episode.steps, "step"),
    ...lapsInShort(episode),
    ...(missingSteps(episode) ? [`${formatNumber(missingSteps(episode), 0)} more not in the log`] : []),
  ].join(" · ");
  byId("return-total").textContent = `return ${formatReward(episode.returns[episode.steps])}`;
  byId("duration").textContent = `/ ${formatSeconds(episode.times[episode.steps])}`;
  byId("read-steps").textContent = `of ${formatNumber(episode.stepNumbers[episode.steps], 0)}`;
  showLegend(episode);
}

// How many laps there are and the fastest of those that count; nothing of an episode without a lap.
function lapsInShort(episode) {
  const times = episode.laps.filter(([, , counts]) => counts).map(([, seconds]) => seconds);
  if (!episode.laps.length) return [];
  const best = times.length ? `, ${episode.laps.length > 1 ? "best " : ""}${formatMeasured(Math.min(...times), 2)} s` : "";
  return [`${formatCount(episode.laps.length, "lap")}${best}`];
}

function showLegend(episode) {
  if (episode.speedSpan) {
    const [least, greatest] = episode.speedSpan.map((speed) => formatMeasured(speed, 1));
    byId("legend").setAttribute("aria-label", "Speed");
    byId("legend").replaceChildren(element("li", "", `speed ${least}`, element("span", "speed-bar"), `${greatest} m/s`));
    return;
  }
  const shares = actionShares(episode);
  const items = shares.map((share, action) => {
    const percent = element("span", "wide", `${Math.round(100 * share)} %`);
    return element("li", "", swatchOf(action), element("span", "", actionName(episode, action)), percent);
  });
  byId("legend").replaceChildren(...items);
}

// Called once; the returned function shows a position, and touches the page only where its step changes.
function makeReadings(episode) {
  const rows = makeValueRows(episode);
  const numbers = makeNumberCells(episode);
  const terms = makeTermCells(episode);
  const showLap = makeLapCell(episode);
  let shown = -1;
  return (position) => {
    const step = stepAt(position);
    byId("now").textContent = formatSeconds(timeAt(episode, position));
    if (step === shown) return;
    shown = step;
    showMoment(episode, step);
    showLap(step);
    showNumbers(episode, step, numbers);
    showSpeed(episode, step);
    if (episode.perAction) showValues(episode, step, rows);
    showTerms(episode, step, terms);
    showNearest(episode, step);
  };
}

// Seconds since the first recorded step.
function timeAt(episode, position) {
  const step = stepAt(position);
  const share = position - step;
  return share === 0 ? episode.times[step] : (1 - share) * episode.times[step] + share * episode.times[step + 1];
}

function showMoment(episode, step) {
  const over = step >= episode.steps;
  byId("read-step").textContent = formatNumber(episode.stepNumbers[step], 0);
  byId("read-action").replaceChildren(over ? element("span", "faint", episode.ended) : chosenAction(episode, step));
  byId("read-time").textContent = formatSeconds(episode.times[step]);
  byId("read-time").title = `${formatSeconds(episode.startTime + episode.times[step])} since the start of the run`;
  byId("read-gates").textContent = formatNumber(episode.gatesBefore + gatesPassedAt(episode, step), 0);
  byId("read-return").textContent = formatReward(episode.returns[step]);
  showReward(byId("read-reward"), over ? null : episode.rewards[step]);
}

// The time of the last lap that was completed before a step; no cell if there is none.
function makeLapCell(episode) {
  if (!episode.laps.length) return () => {};
  const place = element("dd", "");
  place.id = "read-lap";
  byId("read-return").parentElement.before(element("div", "", element("dt", "", "Last lap"), place));
  return (step) => {
    const last = episode.laps.findLast(([row]) => row < step);
    if (!last) return void (place.textContent = "–");
    const [, seconds, counts] = last;
    place.textContent = `${formatMeasured(seconds, 2)} s${counts ? "" : ", with contact"}`;
  };
}

function showSpeed(episode, step) {
  const speed = valuesNamed(episode, "speed")?.(step);
  if (speed !== undefined) byId("read-speed").textContent = `${formatMeasured(speed, 1)} m/s · ${formatMeasured(3.6 * speed, 0)} km/h`;
}

function chosenAction(episode, step) {
  if (!episode.hasNamedActions) {
    const controls = episode.controlNames.map((name) => `${name} ${formatSigned(valuesNamed(episode, name)(step))}`);
    return element("span", "controls", ...controls.map((text) => element("span", "", text)));
  }
  const action = episode.actions[step];
  const random = episode.exploratory[step] === 1;
  return element(
    "span", "chosen", swatchOf(action), element("span", "", actionName(episode, action)),
    element("span", random ? "chip random" : "chip", random ? "exploratory" : "greedy"),
  );
}

function showReward(place, reward) {
  place.textContent = reward === null ? "–" : formatSigned(reward);
  place.className = reward > 0 ? "good" : reward < 0 ? "bad" : "";
}

// A cell for each entry of the series that are not charts or instruments.
function makeNumberCells(episode) {
  const shown = new Set(["speed", "steering", "acceleration", "lateral_acceleration", ...episode.controlNames]);
  const cells = episode.series.filter((series) => series !== episode.perAction).flatMap(({ entries, values }) => {
    return entries.flatMap((entry, index) => {
      if (shown.has(entry)) return [];
      const place = element("dd", "");
      place.id = `read-${entry.replaceAll(/\W+/g, "-")}`;
      byId("read-return").parentElement.before(element("div", "", element("dt", "", entry.replaceAll("_", " ")), place));
      return { place, unit: episode.units[entry], valueAt: (step) => values[step * entries.length + index] };
    });
  });
  return cells;
}

function showNumbers(episode, step, cells) {
  for (const { place, unit, valueAt } of cells) {
    const value = valueAt(step); // of some there is none after the last step
    place.textContent = value === undefined ? "–" : unit ? `${formatMeasured(value, 2)} ${unit}` : formatNumber(value, 3);
  }
}

function makeTermCells(episode) {
  const values = episode.termNames.map(() => element("dd", ""));
  const cells = values.map((value, term) => element("div", "", element("dt", "", episode.termNames[term]), value));
  byId("terms").replaceChildren(...cells);
  return values;
}

function showTerms(episode, step, places) {
  places.forEach((place, term) => {
    const value = step >= episode.steps ? null : episode.terms[step * places.length + term];
    showReward(place, value);
    place.parentElement.classList.toggle("none", !value);
  });
}

function makeValueRows(episode) {
  if (!episode.perAction) byId("values").style.display = "none";
  byId("values-name").textContent = episode.perAction?.title ?? "";
  const rows = episode.actionNames.map((name, action) => {
    const value = element("span", "value");
    const row = element("li", "", swatchOf(action), element("span", "", name), value);
    return { row, value };
  });
  byId("value-list").replaceChildren(...rows.map(({ row }) => row));
  return rows;
}

function showValues(episode, step, rows) {
  const over = step >= episode.steps;
  rows.forEach(({ row, value }, action) => {
    value.textContent = over ? "–" : formatNumber(valueOf(episode, step, action), 2);
    row.classList.toggle("taken", !over && action === episode.actions[step]);
  });
}

function showNearest(episode, step) {
  let [least, angle] = [Infinity, 0];
  for (let ray = 0; ray < episode.rays; ray++) {
    const range = rangeAt(episode, step, ray);
    if (range < least) [least, angle] = [range, episode.sensorAngles[ray]];
  }
  byId("nearest").textContent = least === Infinity ? "no reading" : `nearest ${formatNumber(least, 1)} m, ${angleName(angle)}`;
}
