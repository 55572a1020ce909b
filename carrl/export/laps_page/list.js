// The laps in a table: their times, and how fast and how far behind each car is now.

// Called once; the returned function shows the cars of a moment. `choose(index)` is told of another reference.
function makeList(race, choose) {
  const best = bestOf(race);
  const rows = race.laps.map((lap) => makeRow(race, lap, best, choose));
  byId("laps").replaceChildren(...rows.map(({ row }) => row));
  return (cars) => cars.forEach((car, index) => showCar(race, rows[index], car));
}

// The least time of each sector and of the lap; Infinity where there is none.
function bestOf(race) {
  const least = (times) => Math.min(...times.map((time) => time ?? Infinity));
  return {
    lap: least(race.laps.map(({ lapTime }) => lapTime)),
    sectors: race.laps[0].sectors.map((_, sector) => least(race.laps.map(({ sectors }) => sectors[sector]))),
  };
}

function makeRow(race, lap, best, choose) {
  const radio = element("input", "");
  Object.assign(radio, { type: "radio", name: "reference", checked: lap.index === race.reference });
  radio.setAttribute("aria-label", `Gaps to ${lap.name}`);
  radio.addEventListener("change", () => choose(lap.index));
  const swatch = element("span", "swatch");
  swatch.style.color = `var(--${lap.colour})`;
  const label = element("label", "lap-name", radio, swatch, element("span", "", lap.name, describe(lap)));
  const speed = element("td", "");
  const gap = element("td", "gap");
  const time = (value, least, name) => element("td", `${name}${value === least ? " best" : ""}`, formatTime(value));
  const sectors = lap.sectors.map((value, sector) => time(value, best.sectors[sector], "sector"));
  const row = element("tr", "", element("th", "", label), time(lap.lapTime, best.lap, ""), ...sectors, speed, gap);
  row.querySelector("th").scope = "row";
  return { row, speed, gap };
}

function describe(lap) {
  const notes = [
    ...(lap.standing ? ["from rest"] : []),
    ...(lap.lapTime === null ? [`ended at ${formatNumber(lap.end, 0)} m`] : []),
  ];
  return element("span", "faint note", notes.join(", "));
}

function showCar(race, { row, speed, gap }, car) {
  row.classList.toggle("reference", car.lap.index === race.reference);
  speed.textContent = formatMeasured(car.speed, 1);
  gap.textContent = car.lap.index === race.reference ? "" : formatGap(car.gap);
}
