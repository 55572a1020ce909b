// The moment that is shown, and how it moves on. All else on the page is drawn from this state.

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const LONGEST_FRAME = 0.25; // s; after a pause of the browser the replay goes on where it was

// Index of the step that is driven at a position; the number of steps after the last one.
const stepAt = (position) => Math.floor(position);

// `show(player)` is called once for each frame in which something changed.
function makePlayer(episode, show) {
  const player = { position: 0, playing: false, speed: 1, following: false };
  let frame = 0;
  let last = 0;

  function drawFrame(now) {
    frame = 0;
    if (player.playing) advance(clamp((now - last) / 1000, 0, LONGEST_FRAME));
    last = now;
    show(player);
    if (player.playing) player.redraw();
  }

  function advance(seconds) {
    player.position = Math.min(player.position + (seconds * player.speed) / episode.timeStep, episode.steps);
    player.playing = player.position < episode.steps;
  }

  player.redraw = () => {
    frame ||= requestAnimationFrame(drawFrame);
  };
  player.play = () => {
    if (player.position >= episode.steps) player.position = 0;
    player.playing = true;
    last = performance.now();
    player.redraw();
  };
  player.pause = () => {
    player.position = stepAt(player.position);
    player.playing = false;
    player.redraw();
  };
  player.toggle = () => (player.playing ? player.pause() : player.play());
  player.seek = (step) => {
    player.position = clamp(Math.round(step), 0, episode.steps);
    player.redraw();
  };
  player.move = (steps) => {
    player.pause();
    player.seek(player.position + steps);
  };
  player.setSpeed = (speed) => {
    player.speed = speed;
    player.redraw();
  };
  player.changeSpeed = (by) => {
    player.setSpeed(SPEEDS[clamp(SPEEDS.indexOf(player.speed) + by, 0, SPEEDS.length - 1)]);
  };
  player.toggleFollowing = () => {
    player.following = !player.following;
    player.redraw();
  };
  return player;
}
