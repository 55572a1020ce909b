// Buttons, slider, charts and keys: what a person does becomes a call of the player.

// `charts` are pairs of a canvas and a function that returns its plot, which changes with its size.
function connectControls(episode, player, charts, repaint) {
  connectButtons(episode, player, repaint);
  connectSpeeds(player);
  connectSlider(episode, player);
  for (const [canvas, plotOf] of charts) connectChart(episode, player, canvas, plotOf);
  connectKeys(episode, player, repaint);
}

function connectButtons(episode, player, repaint) {
  const actions = {
    "play-pause": player.toggle,
    back: () => player.move(-1),
    ahead: () => player.move(1),
    follow: player.toggleFollowing,
    theme: () => changeTheme(repaint),
    "copy-link": () => copyLink(episode, stepAt(player.position)),
    "show-keys": toggleKeys,
  };
  for (const [id, act] of Object.entries(actions)) byId(id).addEventListener("click", () => act());
}

function changeTheme(repaint) {
  toggleTheme();
  repaint();
}

function toggleKeys() {
  const dialog = byId("keys");
  if (dialog.open) dialog.close();
  else dialog.showModal();
}

function connectSpeeds(player) {
  const select = byId("speed");
  select.append(...SPEEDS.map((speed) => new Option(`${speed}×`, speed)));
  select.addEventListener("change", () => player.setSpeed(Number(select.value)));
}

function connectSlider(episode, player) {
  const slider = byId("scrub");
  slider.max = episode.steps;
  slider.addEventListener("input", () => {
    player.pause();
    player.seek(Number(slider.value));
  });
}

// A click goes to the step under the pointer, a drag takes it along.
function connectChart(episode, player, canvas, plotOf) {
  const seek = (event) => {
    const plot = plotOf();
    const x = event.clientX - canvas.getBoundingClientRect().left;
    player.pause();
    player.seek(((x - plot.left) / (plot.right - plot.left)) * episode.steps);
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    seek(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) seek(event);
  });
}

function connectKeys(episode, player, repaint) {
  const keys = {
    " ": () => player.toggle(),
    ArrowLeft: (event) => player.move(event.shiftKey ? -10 : -1),
    ArrowRight: (event) => player.move(event.shiftKey ? 10 : 1),
    Home: () => player.move(-episode.steps),
    End: () => player.move(episode.steps),
    "[": () => player.changeSpeed(-1),
    "]": () => player.changeSpeed(1),
    "-": () => player.changeSpeed(-1),
    "+": () => player.changeSpeed(1),
    "=": () => player.changeSpeed(1), // the key of + without Shift
    f: () => player.toggleFollowing(),
    c: () => copyLink(episode, stepAt(player.position)),
    t: () => changeTheme(repaint),
    "?": toggleKeys,
  };
  document.addEventListener("keydown", (event) => {
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey || belongsToElement(event)) return;
    event.preventDefault();
    act(event);
  });
}

// Space presses the button that has the focus, arrows choose within a list; with the keys shown, only ? does something.
function belongsToElement({ key, target }) {
  if (byId("keys").open) return key !== "?";
  if (target instanceof HTMLSelectElement) return ![..."[]+-=?"].includes(key);
  return target instanceof HTMLButtonElement && key === " ";
}

// What the controls show follows the player.
function showControls(episode, player) {
  const step = stepAt(player.position);
  const slider = byId("scrub");
  slider.value = step;
  slider.setAttribute("aria-valuetext", `step ${episode.stepNumbers[step]}, ${formatSeconds(episode.times[step])}`);
  slider.style.setProperty("--played", `${(100 * player.position) / episode.steps}%`);
  const play = byId("play-pause");
  play.classList.toggle("playing", player.playing);
  play.setAttribute("aria-label", player.playing ? "Pause" : "Play");
  byId("follow").setAttribute("aria-pressed", String(player.following));
  byId("speed").value = String(player.speed);
}
