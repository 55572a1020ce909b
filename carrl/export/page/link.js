// Links to a moment: #step=123 shows that step, #play starts the replay. Steps count as the log counts them.

const WRITE_DELAY = 200; // ms; browsers refuse an address that changes too often

// The recorded step that the address names, or the next one; null if it names none.
function linkedStep(episode) {
  const text = new URLSearchParams(location.hash.slice(1)).get("step");
  if (text === null || !/^\d+$/.test(text)) return null;
  const step = episode.stepNumbers.findIndex((number) => number >= Number(text));
  return step < 0 ? episode.steps : step;
}

const linkAsksToPlay = () => new URLSearchParams(location.hash.slice(1)).has("play");

const linkTo = (episode, step) => `${location.href.split("#")[0]}#step=${episode.stepNumbers[step]}`;

// Keeps the address at the step that is shown, once it stays for a moment, unless somebody else has changed it by then.
function makeLinkWriter(episode) {
  let timer = 0;
  return (step) => {
    clearTimeout(timer);
    const before = location.hash;
    timer = setTimeout(() => location.hash === before && writeLink(episode, step), WRITE_DELAY);
  };
}

function writeLink(episode, step) {
  if (step === (linkedStep(episode) ?? 0)) return;
  try {
    history.replaceState(null, "", linkTo(episode, step));
  } catch {
    // Some browsers refuse it for a page that is a local file; the button still copies the link.
  }
}

async function copyLink(episode, step) {
  const link = linkTo(episode, step);
  const copied = (await copyText(link)) || copySelection(link);
  notify(copied ? `Link to step ${episode.stepNumbers[step]} copied` : link);
}

async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}

// The older way, where a page may not use the clipboard.
function copySelection(text) {
  const field = element("textarea", "", text);
  document.body.append(field);
  field.select();
  const copied = document.execCommand("copy");
  field.remove();
  return copied;
}

let noticeTimer = 0;

function notify(text) {
  const notice = byId("notice");
  notice.textContent = text;
  notice.classList.add("shown");
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => notice.classList.remove("shown"), 2400);
}
