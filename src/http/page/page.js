// The operator page: one live stream in, a few requests out. It shows how old what it shows is.
"use strict";

const $ = (id) => document.getElementById(id);
const degrees = (rad) => (rad === null || rad === undefined ? "–" : `${local((rad * 180 / Math.PI).toFixed(2).replace(/^-0\.00$/, "0.00"))}°`);
const STALE_MS = 2500;
const PATIENCE_MS = 5000;

const waterfall = new Waterfall($("waterfall"));
const force = new ForceTrace($("force"));
const stability = new StabilityChart($("stability"));

let state = null;
let lastMessage = 0;
let lastEventId = null;
let retryMs = 500;
let dirty = true;
let refusal = ""; // why the service does not let this page read

// ---- requests -------------------------------------------------------------------------------------

function headers(extra = {}) {
  const token = sessionStorage.getItem("token");
  return token ? { ...extra, Authorization: `Bearer ${token}` } : extra;
}

// Status and text of an answer; fails in words, within the patience of somebody who waits.
async function fetched(path, options) {
  try {
    const response = await fetch(path, { ...options, signal: AbortSignal.timeout(PATIENCE_MS) });
    return { response, text: await response.text() };
  } catch {
    throw new Error("the service does not answer");
  }
}

// Sends JSON; throws an Error whose message is for a person and whose status is the HTTP status.
async function request(method, path, body, extra = {}) {
  const options = { method, headers: headers(extra), cache: "no-store" };
  if (body !== undefined) {
    options.headers["Content-Type"] = "application/json";
    options.body = JSON.stringify(body);
  }
  const { response, text } = await fetched(path, options);
  let answer = null;
  try { answer = text ? JSON.parse(text) : null; } catch { /* not JSON: the status must do */ }
  if (!response.ok) {
    const details = answer && answer.errors ? answer.errors.map((e) => e.detail).join("; ") : "";
    const error = new Error([answer ? answer.detail : response.statusText, details].filter(Boolean).join(": "));
    error.status = response.status;
    if (answer && ["bad_token", "too_many_bad_tokens"].includes(answer.code)) forgetToken();
    throw error;
  }
  return { answer, etag: response.headers.get("ETag") };
}

// Too many wrong tokens (429) bar no good one.
const needsToken = (error) => [401, 403, 429].includes(error.status);

// A token that is revoked or out of date is worse than none: reading on the machine itself needs none.
function forgetToken() {
  if (!sessionStorage.getItem("token")) return;
  sessionStorage.removeItem("token");
  setText("take-back-note", "the access token is no longer valid and was forgotten");
}

// ---- the live stream ------------------------------------------------------------------------------

// EventSource cannot send a token, so the stream is read by hand.
async function listen() {
  for (;;) {
    const giveUp = new AbortController();
    const guard = setInterval(() => { if (Date.now() - lastMessage > 15000) giveUp.abort(); }, 5000);
    try {
      lastMessage = Math.max(lastMessage, Date.now() - STALE_MS - 1);
      const extra = lastEventId === null ? {} : { "Last-Event-ID": String(lastEventId) };
      const response = await fetch("/api/v1/stream", { headers: headers(extra), cache: "no-store", signal: giveUp.signal });
      if ((response.status === 401 || response.status === 429) && sessionStorage.getItem("token")) { forgetToken(); continue; }
      if (response.status === 401) { refusal = "token needed"; await pause(3000); continue; }
      if (response.status === 429) { refusal = "too many wrong tokens, a minute's pause"; await pause(60000); continue; }
      if (!response.ok) throw new Error(String(response.status));
      refusal = "";
      retryMs = 500;
      refreshLists();
      loadStability();
      loadPast();
      await readStream(response.body.getReader());
    } catch { /* the service is away; the note on the page says so */ } finally { clearInterval(guard); }
    await pause(retryMs);
    retryMs = Math.min(retryMs * 1.5, 4000);
  }
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

async function readStream(reader) {
  const decoder = new TextDecoder();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    rest += decoder.decode(value, { stream: true });
    let end;
    while ((end = rest.indexOf("\n\n")) >= 0) {
      dispatch(rest.slice(0, end));
      rest = rest.slice(end + 2);
    }
  }
}

function dispatch(block) {
  let kind = "message", data = "", id = null;
  for (const line of block.split("\n")) {
    if (line.startsWith("event:")) kind = line.slice(6).trim();
    else if (line.startsWith("data:")) data += line.slice(5).trim();
    else if (line.startsWith("id:")) id = Number(line.slice(3).trim());
  }
  if (id !== null && Number.isFinite(id)) lastEventId = id;
  if (!data) return; // a connection that is kept open says nothing about the picture
  lastMessage = Date.now();
  const value = JSON.parse(data);
  if (kind === "state") showState(value);
  else if (kind === "force") { force.add(value); dirty = true; }
  else if (kind === "spectrum") {
    const chatter = state ? state.chatter : {};
    waterfall.add(value, chatter.frequency_hz ?? null, chatter.band_hz || null);
    dirty = true;
  } else if (kind === "event") addEvent(value, true);
  else if (kind === "lag") refreshLists(); // some were missed
}

// ---- the past -------------------------------------------------------------------------------------

let pastAsked = 0;

// Both charts filled from the service's memory: at the start, after a pause, and for long ranges now and then.
async function loadPast() {
  pastAsked = Date.now();
  const seconds = Number($("range").value);
  try {
    const { answer } = await request("GET", `/api/v1/past?seconds=${seconds}`);
    if (seconds !== Number($("range").value)) return; // another one was chosen meanwhile
    answer.seconds = seconds;
    waterfall.load(answer, state ? state.chatter.band_hz : null);
    force.load(answer);
    dirty = true;
  } catch { /* what comes from now on is drawn all the same */ }
}

// A column of a long range is renewed when the next begins.
function renewPast() {
  const seconds = Number($("range").value);
  if (seconds > LIVE_S && Date.now() - pastAsked > Math.max(2000, seconds / COLUMNS * 1000)) loadPast();
}

// ---- the picture ----------------------------------------------------------------------------------

const VERDICTS = {
  quiet: ["✓", "Quiet", "no chatter"],
  suspected: ["?", "Suspected", "a line stands out of the noise"],
  chatter: ["▲", "CHATTER", "the cut vibrates by itself"],
  learning: ["…", "Learning", "the noise of this cut is being learned"],
  deaf: ["✕", "Deaf", "chatter cannot be heard"],
};

// Why a line that stands out is no chatter, and why none can be heard.
const REASONS = {
  ring_down: "a hit rings down", order: "an order of the spindle changed", mode: "noise through the bar's mode",
  interference: "a line that is not the cut's", above_push: "a line larger than the tool's push",
  band_out_of_reach: "the bar's band is out of reach", force_above_band: "the force is not estimated in the bar's band",
};

function showVerdict(className, [sign, word, detail]) {
  $("verdict").className = `verdict ${className}`;
  setText("verdict-sign", sign);
  setText("verdict-word", word);
  setText("verdict-detail", detail);
}

function showState(now) {
  state = now;
  const connected = now.source.connected;
  const verdict = now.chatter.state;
  const [sign, word, detail] = VERDICTS[verdict] || VERDICTS.learning;
  if (connected) showVerdict(verdict, [sign, word, REASONS[verdict !== "quiet" && now.chatter.reason] || detail]);
  else showVerdict("", ["–", "No samples", "the machine sends nothing"]);
  setText("frequency", now.chatter.frequency_hz ? `${fixed(now.chatter.frequency_hz, 1)} Hz` : "–");
  setText("power", connected && now.chatter.power_n2 !== null ? `${powerText(now.chatter.power_n2)} N²` : "–");
  setText("margin", marginText(connected ? now.axes : []));
  setText("lost", String(now.source.lost));
  setText("spindle", now.source.spindle_speed_rpm ? `${Math.round(now.source.spindle_speed_rpm)} rpm` : "–");
  const band = now.chatter.band_hz;
  setText("spectrum-note", band ? `watched band ${Math.round(band[0])} to ${Math.round(band[1])} Hz` : "");
  const verdictNow = connected ? (VERDICTS[verdict] || VERDICTS.learning)[1] : "No samples";
  setText("now", `${say(now.mode === "act" ? "Act" : now.mode === "advise" ? "Advise" : "Observe")} · ${say(verdictNow)}`);
  showMode(now);
  showPitch(now);
  showAxes(now.axes);
  if (now.open_alarms !== shownOpen) { shownOpen = now.open_alarms; refreshOpen(); }
  const speed = now.source.spindle_speed_rpm;
  const curve = stability.curve;
  if (curve && speed && Math.abs(speed - curve.spindle_speed_rpm) > 0.02 * speed && Date.now() - curveAsked > 5000) loadStability();
  $("alarms").hidden = now.open_alarms === 0;
  setText("alarms", `${now.open_alarms} open`);
  $("alarms-link").hidden = now.open_alarms === 0;
  setText("alarms-link", counted(now.open_alarms, "open alarm"));
  const store = now.store.healthy ? "" : ` · ${say(`history not writable, waiting: ${counted(now.store.unpersisted, "event")}`)}`;
  const replaced = now.store.replaced ? ` · ${say(`a damaged history was set aside: ${now.store.replaced}`)}` : "";
  setText("about", `version ${now.version}${store}${replaced}`);
  dirty = true;
}

// The smallest margin of the axes with its interval; without one, why the cut is not heard.
const DEAF = {
  speed_unknown: "speed not known", pitch_unknown: "pitch not known", chatter: "chatter", cut_unknown: "cut not known", noise_over_line: "noise hides the cut",
  interval_too_wide: "too uncertain", no_root_in_band: "no line in the band", force_above_band: "force not known in the band", settling: "settling",
};
function marginText(axes) {
  const known = axes.filter((axis) => typeof axis.stability_margin_1_s === "number");
  if (known.length === 0) return axes.map((axis) => DEAF[axis.stability_margin_state]).find(Boolean) || "–";
  const least = known.reduce((a, b) => (b.stability_margin_1_s < a.stability_margin_1_s ? b : a));
  const ends = [least.stability_margin_lo_1_s, least.stability_margin_hi_1_s].map((x) => fixed(x, 0));
  return `${fixed(least.stability_margin_1_s, 1)} 1/s (${ends[0]} to ${ends[1]})`;
}

const powerText = (n2) => (n2 >= 100 ? n2.toFixed(0) : n2 >= 1 ? fixed(n2, 1) : local(n2.toPrecision(2)));

// Touches the page only when the text changes: screen readers are told of changes.
function setText(id, english) {
  const element = $(id), text = say(english);
  if (element.textContent === text) return;
  element.textContent = text;
  if (element.firstChild) element.firstChild.english = english;
}

function showMode(now) {
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.setAttribute("aria-pressed", String(button.dataset.mode === now.mode));
  }
  setText("mode-reason", now.mode_reason);
  // Elsewhere nothing moves the turret, and the service refuses.
  $("hold").hidden = now.mode !== "act" && !now.turret_held;
  $("hold").setAttribute("aria-pressed", String(now.turret_held));
  setText("hold", now.turret_held ? "Held: let the turret go" : "Hold the turret");
  $("fault").hidden = !now.fault;
  $("clear-fault").hidden = !now.fault;
  setText("fault", now.fault ? `Latched fault: ${now.fault}` : "");
  const list = $("interlocks");
  const text = now.interlocks.map((i) => `${i.name} ${i.open ? "open" : "closed"}`).join("|") + language;
  if (list.dataset.text !== text) {
    list.dataset.text = text;
    list.replaceChildren(...now.interlocks.map((i) => make("li", i.open ? "open" : "", say(`${i.name}: ${i.open ? "open" : "closed"}`))));
  }
}

// What happens to the pitch while the cut is still silent, and why nothing does where its margin runs out.
const WAITS = {
  after_chatter: "chatter of the last minute decides", moving: "the turret is on its way",
  margin_not_read: "its margin is being read", moved_enough: "moved five times within a minute",
  estimate_not_valid: "estimate not valid",
};
function forestalledText(now) {
  if (now.pitch.waits) return `the margin runs out; the pitch waits: ${say(WAITS[now.pitch.waits] || now.pitch.waits)}`;
  const moved = now.mode === "advise" ? "advised before chatter, as the margin ran out" : "moved before chatter, as the margin ran out";
  return now.pitch.before_chatter ? moved : "";
}

function showPitch(now) {
  const pitch = now.pitch;
  setText("commanded-label", now.mode === "advise" ? "Advised" : "Commanded");
  setText("commanded", degrees(pitch.commanded_rad));
  setText("reported", degrees(pitch.reported_rad));
  setText("optimum", degrees(pitch.optimum_rad));
  setText("limit", degrees(pitch.limit_rad) + (pitch.limited ? " reached" : ""));
  const hold = pitch.hold_reason ? ` · holding: ${pitch.hold_reason.replaceAll("_", " ")}` : "";
  const speed = pitch.advised_speed_rpm ? ` · try ${Math.round(pitch.advised_speed_rpm)} rpm` : "";
  setText("turret", pitch.unavailable ? `no pitch control: ${pitch.unavailable}` : `turret: ${pitch.turret}${hold}${speed}`);
  setText("forestalled", forestalledText(now));
  stability.points = { commanded: pitch.commanded_rad, reported: pitch.reported_rad };
  stability.limit = pitch.limit_rad;
}

function showAxes(axes) {
  force.show = axes.map((_, i) => i).filter((i) => axes[i].watched);
  axes = axes.map((axis, i) => ({ ...axis, place: i })).filter((axis) => force.show.includes(axis.place));
  const list = $("legend");
  const names = axes.map((axis) => axis.name).join(" ");
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...axes.map((axis) => {
      const item = make("li");
      const key = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      const bar = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      bar.setAttribute("width", "100%");
      bar.setAttribute("height", "100%");
      bar.style.fill = `var(${TRACE_COLOURS[axis.place % TRACE_COLOURS.length]})`;
      key.append(bar);
      item.append(key, make("span"));
      return item;
    }));
  }
  axes.forEach((axis, i) => {
    // A mean that cannot be observed is not a number, nor is anything of an axis that is silent.
    const mean = axis.force_mean_n === null ? "" : `${axis.force_mean_n.toFixed(0)} N `;
    const force = axis.force_deviation_n === null ? "–" : `${mean}± ${fixed(axis.force_deviation_n, 1)} N`;
    const offset = axis.offset_reported_m === null ? "" : ` · ${lengthText(axis.offset_reported_m)}`;
    const text = `${axis.name} ${force}${offset}`;
    const span = list.children[i].lastChild;
    if (span.textContent !== text) span.textContent = text;
  });
}

function make(tag, className = "", text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

function showLink(className, text) {
  $("link").className = `link ${className}`;
  setText("link", text);
}

// How old is what is shown? Said in words, and the numbers fade.
function watchAge() {
  const age = Date.now() - lastMessage;
  const away = lastMessage === 0 || age > STALE_MS;
  const silent = !away && state && !state.source.connected;
  const note = $("stale");
  document.body.classList.toggle("stale", Boolean(away || silent));
  note.hidden = !(away || silent) || lastMessage === 0;
  if (away) {
    if (state) showVerdict("", ["–", "No data", "nothing comes from the service"]);
    showLink("lost", refusal || (lastMessage ? "service away" : "connecting"));
    const why = refusal || "the service does not answer; trying again";
    note.textContent = say(`Stale since ${clockText(state ? new Date(state.time) : new Date(lastMessage))}: ${why}`);
  } else if (silent) {
    showLink("lost", "machine silent");
    const since = state.source.last_sample_at ? `since ${clockText(new Date(state.source.last_sample_at))}` : "so far";
    note.textContent = say(`No samples from the machine ${since}`);
  } else {
    showLink("live", "live");
  }
}

// Of another day with its date.
const momentText = (date) => (date.toDateString() === new Date().toDateString()
  ? clockText(date) : `${date.toLocaleDateString([], { year: "numeric", month: "2-digit", day: "2-digit" })} ${clockText(date)}`);
const clockText = (date) => date.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });

function frame() {
  if (dirty && !document.hidden) {
    dirty = false;
    waterfall.draw();
    force.draw();
    stability.draw();
  }
  requestAnimationFrame(frame);
}

// ---- lists ----------------------------------------------------------------------------------------

const SHOWN = 60;
const OPEN = 50;
let shownOpen = null;

// Alarms that nobody acknowledged, however many other events came after them.
async function refreshOpen() {
  try {
    const { answer } = await request("GET", `/api/v1/events?open_alarms=true&limit=${OPEN}`);
    const open = answer.events.filter((e) => !(e.silenced_until && new Date(e.silenced_until) > new Date()));
    $("open").hidden = open.length === 0;
    $("acknowledge-all").hidden = open.length < 2;
    $("open-alarms").replaceChildren(...open.map(eventItem));
  } catch { /* the stream's state says that the service is away */ }
}

async function acknowledgeAll(given) {
  for (const item of [...$("open-alarms").children]) {
    await request("POST", `/api/v1/events/${item.dataset.sequence}/acknowledge`, given);
  }
  refreshLists();
}

function addEvent(event, newest) {
  const list = $("events");
  const old = list.querySelector(`[data-sequence="${event.sequence}"]`);
  const item = eventItem(event);
  if (old) old.replaceWith(item);
  else if (newest) list.prepend(item);
  else list.append(item);
  while (list.children.length > SHOWN) list.lastChild.remove();
  if (newest && (event.kind === "recording_saved" || event.kind === "diagnosis_done")) refreshLists();
}

function eventItem(event) {
  const item = make("li", event.severity);
  item.dataset.sequence = event.sequence;
  const time = make("time", "", momentText(new Date(event.time)));
  time.dateTime = event.time;
  const words = make("div");
  words.append(make("span", "kind", say(event.kind.replaceAll("_", " "))), document.createTextNode(` ${say(event.text)}`));
  const silenced = event.silenced_until && new Date(event.silenced_until) > new Date();
  if (event.acknowledged_by) words.append(make("div", "by", say(`acknowledged by ${event.acknowledged_by}`)));
  else if (silenced) words.append(make("div", "by", say(`silenced until ${momentText(new Date(event.silenced_until))}`)));
  const actions = make("div", "actions");
  if (event.severity === "alarm" && !event.acknowledged_by) {
    const acknowledge = make("button", "", say("Acknowledge"));
    acknowledge.addEventListener("click", () => ask({
      title: "Acknowledge", text: event.text, reason: "seen", judge: event.kind === "chatter_onset", run: (given) => change(`/api/v1/events/${event.sequence}/acknowledge`, given),
    }));
    const silence = make("button", "", say("Silence"));
    silence.addEventListener("click", () => ask({
      title: "Silence", text: event.text, minutes: true, run: (given) => change(`/api/v1/events/${event.sequence}/silence`, given),
    }));
    actions.append(acknowledge, silence);
  }
  item.append(time, words, actions);
  return item;
}

async function change(path, given) {
  const { answer } = await request("POST", path, given);
  if ($("events").querySelector(`[data-sequence="${answer.sequence}"]`)) addEvent(answer, false);
  refreshOpen();
}

async function refreshLists() {
  try {
    const { answer } = await request("GET", `/api/v1/events?limit=${SHOWN}`);
    $("events").replaceChildren(...answer.events.map(eventItem));
    // As it is now, also when the history was begun anew.
    if (answer.events.length) lastEventId = answer.events[0].sequence;
    refreshOpen();
    showCommissioning((await request("GET", "/api/v1/commissioning")).answer);
    const { can_diagnose } = (await request("GET", "/api/v1/config")).answer;
    const recordings = (await request("GET", "/api/v1/recordings?limit=8")).answer;
    $("recordings").replaceChildren(...recordings.map((recording) => recordingItem(recording, can_diagnose)));
    showCuts((await request("GET", "/api/v1/cuts?limit=1000")).answer);
    const diagnoses = (await request("GET", "/api/v1/diagnoses?limit=5")).answer;
    $("diagnoses-title").hidden = diagnoses.length === 0;
    $("diagnoses").replaceChildren(...diagnoses.map(diagnosisItem));
    if (diagnoses.some((d) => d.state === "queued" || d.state === "running")) setTimeout(refreshLists, 2000);
  } catch { /* the stream's state says that the service is away */ }
}

// What stands between this machine and mode act.
function showCommissioning(now) {
  const missing = now.items.filter((item) => !item.met && !item.accepted);
  $("commissioning").hidden = missing.length === 0;
  $("missing").replaceChildren(...missing.map((item) => make("li", "", say(`${item.name.replaceAll("_", " ")}: ${item.found} (${item.needed})`))));
}

// How many cuts the history holds, and how many of them chattered.
function showCuts({ cuts, next }) {
  $("cuts-title").hidden = $("cuts").hidden = cuts.length === 0;
  const chatter = cuts.filter((cut) => cut.outcome === "chatter").length;
  setText("cuts-text", `${cuts.length}${next ? "+" : ""}: ${chatter} ${say("chatter")}, ${cuts.length - chatter} ${say("stable")}`);
}

function recordingItem(recording, canDiagnose) {
  const item = make("li");
  const link = make("a", "", "Parquet");
  link.href = `/api/v1/recordings/${recording.id}/file.parquet`;
  link.download = `${recording.id}.parquet`;
  const diagnose = make("button", "", say("Diagnose"));
  diagnose.disabled = !canDiagnose;
  if (!canDiagnose) diagnose.title = say("machine.model is not configured: there is no model to start from");
  diagnose.addEventListener("click", () => ask({
    title: "Diagnose this recording",
    text: `What physics does the machine model leave out? Looks at ${recording.id}.`,
    run: async (given) => { await request("POST", "/api/v1/diagnoses", { ...given, recordings: [recording.id] }); refreshLists(); },
  }));
  const replay = make("button", "", say("Replay"));
  replay.addEventListener("click", () => showReplay(recording.id));
  const kind = say(recording.id.split("-")[0].replaceAll("_", " "));
  item.append(make("span", "", `${kind} ${momentText(new Date(recording.written_at))} (${fixed(recording.bytes / 1e6, 1)} MB)`), link, replay, diagnose);
  return item;
}

// The recording through the pipeline again, with the configuration in force.
async function showReplay(id) {
  $("replay-events").replaceChildren();
  setText("replay-note", `${id}: playing it again …`);
  $("replay").showModal();
  try {
    const { answer } = await request("GET", `/api/v1/recordings/${id}/replay`);
    setText("replay-note", `${id}: dots line frequency, curve its power (dB re 1 N²), shaded chatter`);
    drawReplay($("replay-chart"), answer.track);
    $("replay-events").replaceChildren(...answer.events.map((event) => {
      const hz = event.frequency_hz ? `, ${fixed(event.frequency_hz, 1)} Hz` : "";
      return make("li", "", `${fixed(event.t_s, 3)} s: ${say(event.kind.replaceAll("_", " "))}${hz}`);
    }));
  } catch (error) { setText("replay-note", `${id}: ${error.message || "the service does not answer"}`); }
}

function diagnosisItem(diagnosis) {
  const item = make("li");
  const told = diagnosis.result && (diagnosis.result.no_evidence ? say("Nothing can be told of the drive here") : say(diagnosis.result.verdict.replaceAll("_", " ")));
  const verdict = told || diagnosis.error || `${say(diagnosis.state)} ${diagnosis.elapsed_s.toFixed(0)} s`;
  item.append(make("span", "", diagnosis.cuts === null ? verdict : `${say("Past cuts")}: ${verdict}`));
  if (diagnosis.result && diagnosis.result.no_evidence) item.append(make("span", "by", diagnosis.result.no_evidence));
  else if (diagnosis.axes_not_looked_at.length) item.append(make("span", "by", say(`not looked at: ${diagnosis.axes_not_looked_at.join(", ")}`)));
  if (diagnosis.state === "running" || diagnosis.state === "queued") {
    const cancel = make("button", "", say("Cancel"));
    cancel.addEventListener("click", () => ask({
      title: "Cancel", text: `diagnosis ${diagnosis.id}`, run: async (given) => { await request("POST", `/api/v1/diagnoses/${diagnosis.id}/cancel`, given); refreshLists(); },
    }));
    item.append(cancel);
  }
  if (diagnosis.state === "running") {
    const bar = make("progress");
    bar.value = diagnosis.progress;
    bar.max = 1;
    bar.setAttribute("aria-label", say("Diagnoses"));
    item.append(bar, make("span", "by", diagnosis.step || ""));
  }
  if (diagnosis.state === "done") {
    const link = make("a", "", say("Report"));
    link.href = `/api/v1/diagnoses/${diagnosis.id}/report.html`;
    link.target = "_blank";
    link.rel = "noopener";
    item.append(link);
    if (diagnosis.cuts !== null) {
      // Nothing takes it by itself: a person names it in the configuration.
      const scenario = make("a", "", "scenario.toml");
      scenario.href = `/api/v1/diagnoses/${diagnosis.id}/scenario.toml`;
      scenario.download = "scenario.toml";
      const accept = make("button", "", say("Accept"));
      accept.addEventListener("click", () => ask({
        title: "Accept this scenario", text: "It is written beside the history. Nothing changes until the configuration names it and the service starts anew.",
        run: async (given) => {
          const { answer } = await request("POST", `/api/v1/diagnoses/${diagnosis.id}/accept`, given);
          item.append(make("span", "by", answer.next));
        },
      }));
      item.append(scenario, accept);
    }
  }
  return item;
}

let curveAsked = 0;

async function loadStability() {
  curveAsked = Date.now();
  try {
    const { answer } = await request("GET", "/api/v1/stability");
    stability.curve = answer;
    setText("stability-note", `${answer.chatter_model} at ${Math.round(answer.spindle_speed_rpm)} rpm; ● actual, small dot commanded, dashed limit`);
    dirty = true;
  } catch { setText("stability-note", ""); }
}

// ---- questions ------------------------------------------------------------------------------------

// One dialog for everything that changes something: says what, asks why, shows what went wrong.
function ask({ title, text, minutes = false, reason = "", token = false, judge = false, run }) {
  $("ask-title").textContent = say(title);
  $("ask-text").textContent = say(text);
  $("ask-error").hidden = true;
  $("ask-reason-row").hidden = false;
  $("ask-reason").required = true;
  $("ask-reason").value = reason;
  $("ask-minutes-row").hidden = !minutes;
  $("ask-right-row").hidden = !judge;
  $("ask-right").value = "";
  $("ask-token-row").hidden = !token;
  $("ask-token").value = "";
  $("ask").onsubmit = async (submit) => {
    submit.preventDefault();
    if ($("ask-token").value) sessionStorage.setItem("token", $("ask-token").value.trim());
    const given = { reason: $("ask-reason").value };
    if (minutes) given.minutes = Number($("ask-minutes").value);
    if (judge && $("ask-right").value) given.right = $("ask-right").value === "true";
    $("ask-ok").disabled = true;
    try {
      await run(given);
      $("ask").close();
    } catch (error) {
      $("ask-error").hidden = false;
      setText("ask-error", error.message || "the service does not answer");
      $("ask-token-row").hidden = !needsToken(error);
      if (needsToken(error)) $("ask-token").focus(); // what is pasted next is a token
    } finally { $("ask-ok").disabled = false; }
  };
  closeDialogs();
  $("ask").showModal();
  // A token that is pasted must not land where it can be read.
  if (token) $("ask-token").focus();
  else $("ask-reason").select();
}

function closeDialogs() {
  for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
}

const MODE_TEXT = {
  observe: "The service only watches. A turret that stands away from equal pitch returns.",
  advise: "The service shows what it would command. Nothing moves.",
  act: "The service MOVES THE TURRET within the commissioned limits. Is the machine safe for that?",
};

function askMode(mode) {
  ask({
    title: `Mode ${mode}`, text: MODE_TEXT[mode],
    run: async (given) => {
      const { etag } = await request("GET", "/api/v1/mode");
      await request("PUT", "/api/v1/mode", { ...given, mode }, { "If-Match": etag });
    },
  });
}

// One action: it is done first; only who has no token is asked for one.
async function takeBack() {
  setText("take-back-note", "asking for equal pitch …");
  const reason = "taken back on the page";
  const done = () => setText("take-back-note", `turret taken back at ${clockText(new Date())}`);
  try {
    await request("POST", "/api/v1/override", { reason });
    closeDialogs();
    done();
  } catch (error) {
    const at = clockText(new Date());
    setText("take-back-note", needsToken(error) ? "" : `NOT taken back at ${at}: ${error.message}`);
    if (needsToken(error)) ask({ title: "Take the turret back", text: "Equal pitch, mode observe, at once.", reason, token: true,
      run: async (given) => { await request("POST", "/api/v1/override", given); done(); } });
  }
}

function askHold() {
  const hold = $("hold").getAttribute("aria-pressed") !== "true";
  ask({
    title: hold ? "Hold the turret" : "Let the turret go",
    text: hold ? "It stays where it is until it is let go or the mode changes." : "Commands may move it again.",
    run: (given) => request("PUT", "/api/v1/hold", { ...given, hold }),
  });
}

function askToken() {
  ask({ title: "Access token", text: "Kept until this tab is closed. Empty forgets it.", run: async () => {
    if (!$("ask-token").value) sessionStorage.removeItem("token");
    await request("GET", "/api/v1/mode");
    refreshLists();
  } });
  $("ask-reason-row").hidden = true;
  $("ask-reason").required = false;
  $("ask-token-row").hidden = false;
  $("ask-token").focus();
}

function toggleTheme() {
  const dark = getComputedStyle(document.documentElement).colorScheme === "dark" ||
    (!document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  localStorage.setItem("theme", document.documentElement.dataset.theme);
  dirty = true;
}

// ---- language, units, keys --------------------------------------------------------------------------

let inch = localStorage.getItem("unit") === "inch";
const lengthText = (m) => local((inch ? `${(m / 0.0254).toFixed(4)} in` : `${(m * 1000).toFixed(3)} mm`).replace(/^-(0\.0+ )/, "$1"));

function toggleUnit() {
  inch = !inch;
  localStorage.setItem("unit", inch ? "inch" : "mm");
  $("unit").textContent = inch ? "inch" : "mm";
  if (state) showState(state);
}

function showKeys() {
  closeDialogs();
  $("keys-list").showModal();
}

function speak(chosen) {
  language = chosen;
  localStorage.setItem("language", chosen);
  sayAll();
  if (state) showState(state);
  refreshLists();
}

$("language").value = language;
$("language").addEventListener("change", () => speak($("language").value));
$("unit").textContent = inch ? "inch" : "mm";
$("unit").addEventListener("click", toggleUnit);
$("keys").addEventListener("click", showKeys);
$("keys-close").addEventListener("click", closeDialogs);
$("range").addEventListener("change", loadPast);
for (const chart of [waterfall, force]) {
  pointer(chart.canvas, (share, y) => {
    cursor.share = share;
    $("spectrum-cursor").textContent = waterfall.read(share, chart === waterfall ? y : null);
    $("force-note").textContent = force.read(share);
    dirty = true;
  });
}
sayAll();

const saved = localStorage.getItem("theme");
if (saved === "light" || saved === "dark") document.documentElement.dataset.theme = saved;
for (const button of document.querySelectorAll("[data-mode]")) button.addEventListener("click", () => askMode(button.dataset.mode));
for (const button of document.querySelectorAll("#take-back, [data-take-back]")) button.addEventListener("click", takeBack);
$("hold").addEventListener("click", askHold);
$("acknowledge-all").addEventListener("click", () => ask({
  title: "Acknowledge all of these", text: counted($("open-alarms").children.length, "alarm"), reason: "seen", run: acknowledgeAll,
}));
$("clear-fault").addEventListener("click", () => ask({
  title: "Clear the fault", text: state && state.fault ? state.fault : "", run: (given) => request("POST", "/api/v1/fault/clear", given),
}));
$("save").addEventListener("click", () => ask({
  title: "Save the last seconds", text: "Writes the black box as a recording.", run: (given) => request("POST", "/api/v1/recordings", given),
}));
$("diagnose-cuts").addEventListener("click", () => ask({
  title: "Diagnose the past cuts", text: "What physics does the stated cut leave out?",
  run: async (given) => { await request("POST", "/api/v1/cuts/diagnose", given); refreshLists(); },
}));
$("token").addEventListener("click", askToken);
$("theme").addEventListener("click", toggleTheme);
$("replay-close").addEventListener("click", () => $("replay").close());
$("ask-cancel").addEventListener("click", () => $("ask").close());
document.addEventListener("keydown", (key) => {
  // The way back works from everywhere; where somebody writes, with Alt.
  const writes = /INPUT|TEXTAREA/.test(key.target.tagName);
  if ((key.code === "KeyR" || key.key.toLowerCase() === "r") && !key.ctrlKey && !key.metaKey && (key.altKey || !writes)) {
    key.preventDefault();
    takeBack();
    return;
  }
  if (key.ctrlKey || key.altKey || key.metaKey || writes || document.querySelector("dialog[open]")) return;
  const act = { 1: () => askMode("observe"), 2: () => askMode("advise"), 3: () => askMode("act"), t: toggleTheme, u: toggleUnit, "?": showKeys }[key.key.toLowerCase()];
  if (act) { key.preventDefault(); act(); }
});
// A plain link sends no token: what it leads to is fetched with it and saved.
document.addEventListener("click", async (click) => {
  const link = click.target.closest('a[href^="/api/v1/"]');
  if (!link || !sessionStorage.getItem("token")) return;
  click.preventDefault();
  const answer = await fetch(link.href, { headers: headers(), cache: "no-store" }).catch(() => null);
  if (!answer || !answer.ok) {
    link.after(make("span", "by", answer ? ` refused: ${answer.status}` : " the service does not answer"));
    return;
  }
  const file = make("a");
  file.href = URL.createObjectURL(await answer.blob());
  file.download = link.download || link.pathname.split("/").pop();
  file.click();
  setTimeout(() => URL.revokeObjectURL(file.href), 60000);
});
window.addEventListener("resize", () => { dirty = true; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
setInterval(watchAge, 500);
setInterval(renewPast, 1000);
requestAnimationFrame(frame);
listen();
