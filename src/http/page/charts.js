// Drawing: spectrum over time, force traces, stability curve. No data is fetched here.
"use strict";

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Colours come from CSS; a canvas needs them resolved for the theme in force.
function resolved(name) {
  const probe = document.createElement("i");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const colour = getComputedStyle(probe).color;
  probe.remove();
  return colour;
}

// Sizes a canvas to its box and the screen's density; answers its context in CSS pixels.
function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  return { context, width, height };
}

// Dark violet to yellow, evenly spaced in lightness (points of the inferno map).
const HEAT = [[0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50], [252, 255, 164]];
const HEAT_TABLE = Array.from({ length: 256 }, (_, i) => {
  const x = i / 255 * (HEAT.length - 1), k = Math.min(Math.floor(x), HEAT.length - 2), f = x - k;
  return HEAT[k].map((v, c) => Math.round(v + f * (HEAT[k + 1][c] - v)));
});

const COLUMNS = 400;
const BRIDGED = 5; // columns that one picture may stand for
const RANGE = 120; // half decibels from floor to brightest: 60 dB
const LIVE_S = 20; // longer ranges are asked for again instead of drawn as they come

const newtons = (level) => 10 ** ((level / 2 - 80) / 20);
const inNewtons = (n) => local(`${n >= 100 ? n.toFixed(0) : n.toPrecision(2).replace(/e.*/, "")} N`);
const agoText = (s) => local(s < 0.05 ? say("now") : s < 100 ? `-${+s.toFixed(1)} s` : s < 6000 ? `-${+(s / 60).toFixed(1)} min` : `-${+(s / 3600).toFixed(1)} h`);
// Median distance of ages that fall.
const usualStep = (ages) => ages.slice(1).map((age, k) => ages[k] - age).sort((a, b) => a - b)[(ages.length - 1) >> 1] ?? 0;
const shades = (levels, floor) => levels.map((l) => Math.max(0, Math.min(255, Math.round((l - floor) / RANGE * 255))));

// Margins of both charts over time: one moment stands at one place in both.
const LEFT = 52, RIGHT = 58;
const cursor = { share: null }; // where the pointer is, 0 to 1 of the range

// Tells where in the range the pointer is (null: outside), and how far below the canvas's upper edge.
function pointer(canvas, moved) {
  canvas.addEventListener("pointermove", (move) => {
    const box = canvas.getBoundingClientRect();
    const share = (move.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    moved(share >= 0 && share <= 1 ? share : null, move.clientY - box.top);
  });
  canvas.addEventListener("pointerleave", () => moved(null, 0));
}

// The line of the pointer.
function drawCursor(context, plotWidth, plotHeight, colour) {
  if (cursor.share === null) return;
  context.fillStyle = colour;
  context.fillRect(Math.round(LEFT + plotWidth * cursor.share), 2, 1, plotHeight);
}

class Waterfall {
  constructor(canvas) {
    this.canvas = canvas;
    this.image = document.createElement("canvas");
    this.image.width = COLUMNS;
    this.rangeS = LIVE_S;
    this.floor = 60;
    this.grid = null;
    this.band = null;
    this.last = { t_s: 0, at: Date.now() };
    this.clear();
  }

  clear() {
    this.line = new Array(COLUMNS).fill(null);
    this.columns = new Array(COLUMNS).fill(null);
    if (this.grid) this.image.getContext("2d").clearRect(0, 0, COLUMNS, this.grid.count);
  }

  use(first, step, count) {
    if (this.grid && this.grid.count === count && this.grid.first === first) return;
    this.grid = { first, step, count };
    this.image.height = count;
    this.clear();
  }

  // What the page was not open for; `past` as the service gives it.
  load(past, band) {
    this.rangeS = past.seconds;
    if (past.bins === 0) { this.clear(); return; }
    this.band = band || this.band;
    this.use(past.first_hz, past.step_hz, past.bins);
    this.clear();
    const levels = Uint8Array.from(atob(past.levels), (c) => c.charCodeAt(0));
    const sorted = Uint8Array.from(levels).sort();
    this.floor = Math.min(sorted[Math.floor(sorted.length * 0.2)], 150);
    const place = past.age_s.map((age) => COLUMNS - 1 - Math.floor(age / this.rangeS * COLUMNS));
    const apart = Math.max(BRIDGED, 1.5 * usualStep(past.age_s) / this.rangeS * COLUMNS);
    place.forEach((x, k) => {
      // A column stands until the next one, where that is not far: a pause stays empty.
      const next = k + 1 < place.length ? place[k + 1] : COLUMNS;
      const last = next - x <= apart ? Math.max(next, x + 1) : x + 1;
      const column = levels.subarray(k * past.bins, (k + 1) * past.bins);
      for (let at = Math.max(x, 0); at < Math.min(last, COLUMNS); at++) this.put(at, column, past.line_hz[k]);
    });
    this.last = { t_s: 0, at: Date.now() };
  }

  put(x, levels, hz) {
    const context = this.image.getContext("2d");
    const column = context.createImageData(1, levels.length);
    const shade = shades(Array.from(levels), this.floor);
    for (let bin = 0; bin < levels.length; bin++) {
      const [r, g, b] = HEAT_TABLE[shade[bin]];
      const at = 4 * (levels.length - 1 - bin); // high frequency on top
      column.data[at] = r; column.data[at + 1] = g; column.data[at + 2] = b; column.data[at + 3] = 255;
    }
    context.putImageData(column, x, 0);
    this.columns[x] = levels;
    this.line[x] = hz ?? null;
  }

  add(frame, trackedHz, band) {
    const levels = Uint8Array.from(atob(frame.levels), (c) => c.charCodeAt(0));
    if (levels.length === 0) return;
    this.band = band;
    if (this.rangeS > LIVE_S) return; // asked for again now and then
    this.use(frame.first_hz, frame.step_hz, levels.length);
    // The quiet floor follows slowly, so that a rise shows as a rise.
    const sorted = Uint8Array.from(levels).sort();
    const quiet = sorted[Math.floor(sorted.length * 0.2)];
    this.floor += 0.02 * (Math.min(quiet, 150) - this.floor);
    // Time goes on while nothing comes: a dropped picture is bridged, a pause stays empty.
    const machine = frame.t_s - this.last.t_s, wall = (Date.now() - this.last.at) / 1000;
    const passed = machine > 0 && machine < 60 && this.last.t_s > 0 ? machine : wall;
    const steps = Math.max(1, Math.min(COLUMNS, Math.round(passed / (this.rangeS / COLUMNS))));
    this.last = { t_s: frame.t_s, at: Date.now() };
    const context = this.image.getContext("2d");
    context.globalCompositeOperation = "copy"; // what is empty stays so
    context.drawImage(this.image, -steps, 0);
    context.globalCompositeOperation = "source-over";
    for (let k = 0; k < steps; k++) { this.line.push(null); this.columns.push(null); }
    this.line.splice(0, steps);
    this.columns.splice(0, steps);
    for (let back = 1; back <= (steps <= BRIDGED ? steps : 1); back++) this.put(COLUMNS - back, levels, trackedHz);
  }

  layout(width, height) {
    const bottom = 20;
    return { left: LEFT, plotWidth: width - LEFT - RIGHT, plotHeight: height - bottom - 4 };
  }

  // What stands at a share of the range, at a height or (null) at the line that is tracked.
  read(share, py) {
    if (!this.grid || share === null) return "";
    const { plotHeight } = this.layout(this.canvas.clientWidth, this.canvas.clientHeight);
    const x = Math.min(Math.floor(share * COLUMNS), COLUMNS - 1);
    const column = this.columns[x];
    const place = py === null ? (this.line[x] - this.grid.first) / this.grid.step : (1 - (py - 2) / plotHeight) * (this.grid.count - 1);
    const bin = Math.round(place);
    if (!column || (py === null && this.line[x] === null) || bin < 0 || bin >= this.grid.count) return "";
    const age = (COLUMNS - 1 - x) / COLUMNS * this.rangeS;
    return `${agoText(age)} · ${(this.grid.first + bin * this.grid.step).toFixed(0)} Hz · ${inNewtons(newtons(column[bin]))}`;
  }

  draw() {
    const { context, width, height } = prepare(this.canvas);
    const { left, plotWidth, plotHeight } = this.layout(width, height);
    context.fillStyle = resolved("--soft");
    if (!this.grid) {
      context.fillText(say("no spectrum yet"), left, height / 2);
      return;
    }
    const { first, step, count } = this.grid, last = first + step * (count - 1);
    const y = (hz) => 2 + plotHeight * (1 - (hz - first) / (last - first));
    context.imageSmoothingEnabled = false;
    // Nothing is known where this is seen: silence is dark.
    context.fillStyle = resolved("--unknown");
    context.fillRect(left, 2, plotWidth, plotHeight);
    context.fillStyle = resolved("--soft");
    context.drawImage(this.image, left, 2, plotWidth, plotHeight);
    context.textAlign = "right";
    for (let hz = Math.ceil(first / 50) * 50; hz <= last; hz += 50) {
      context.fillText(`${hz} Hz`, left - 5, Math.min(Math.max(y(hz) + 4, 12), plotHeight));
    }
    context.textAlign = "center";
    for (let k = 4; k >= 0; k--) {
      const x = left + plotWidth * (1 - k / 4);
      context.fillText(agoText(this.rangeS * k / 4), Math.max(x, left + 14), height - 5);
    }
    this.scale(context, left + plotWidth + 8, plotHeight);
    if (this.band) {
      context.strokeStyle = "rgb(255 255 255 / .75)";
      context.setLineDash([6, 5]);
      for (const hz of this.band.filter((hz) => hz > first && hz < last)) {
        context.beginPath(); context.moveTo(left, y(hz)); context.lineTo(left + plotWidth, y(hz)); context.stroke();
      }
      context.setLineDash([]);
    }
    context.fillStyle = "rgb(120 255 255)";
    this.line.forEach((hz, i) => {
      if (hz === null || hz < first || hz > last) return;
      context.fillRect(left + plotWidth * i / COLUMNS, y(hz) - 1.5, Math.max(plotWidth / COLUMNS, 1.5), 3);
    });
    drawCursor(context, plotWidth, plotHeight, "rgb(255 255 255)");
  }

  // What the colours mean, in newtons of amplitude.
  scale(context, x, plotHeight) {
    const fill = context.createLinearGradient(0, 2 + plotHeight, 0, 2);
    HEAT.forEach((c, i) => fill.addColorStop(i / (HEAT.length - 1), `rgb(${c.join(" ")})`));
    context.fillStyle = fill;
    context.fillRect(x, 2, 8, plotHeight);
    context.fillStyle = resolved("--soft");
    context.textAlign = "left";
    for (let k = 0; k <= 3; k++) {
      const at = 2 + plotHeight * (1 - k / 3);
      context.fillText(inNewtons(newtons(this.floor + RANGE * k / 3)), x + 11, Math.min(Math.max(at + 4, 11), plotHeight));
    }
    context.textAlign = "center";
  }
}

const TRACE_COLOURS = ["--accent", "--warn", "--good", "--bad", "--soft", "--ink"];

class ForceTrace {
  constructor(canvas) {
    this.canvas = canvas;
    this.slices = []; // {t, values: [[min, max], ...]}
    this.show = [];
    this.scale = 10;
    this.rangeS = LIVE_S;
    this.wide = 0.005; // s that a slice stands for
  }

  // What the page was not open for, on the machine's clock, as what comes live is.
  load(past) {
    this.rangeS = past.seconds;
    const newest = (past.newest_t_s ?? 0) + (past.age_s.length ? past.age_s[past.age_s.length - 1] : 0);
    this.wide = past.age_s.length > 1 ? usualStep(past.age_s) : 1;
    this.slices = past.age_s.map((age, k) => ({ t: newest - age, values: past.force_n.map((axis) => axis[k]) }));
  }

  // What stands at a share of the range.
  read(share) {
    if (share === null || !this.slices.length) return "";
    const age = (1 - share) * this.rangeS;
    const t = this.slices[this.slices.length - 1].t - age;
    const near = this.slices.reduce((best, s) => (Math.abs(s.t - t) < Math.abs(best.t - t) ? s : best));
    const values = this.show.map((axis) => near.values[axis]).filter(Boolean).map((v) => `${v[0].toFixed(0)} … ${v[1].toFixed(0)} N`);
    return `${agoText(age)} · ${values.join(" · ")}`;
  }

  add(frame) {
    if (this.rangeS > LIVE_S) return; // asked for again now and then
    const count = Math.max(0, ...frame.axes.map((slices) => slices.length));
    // What is known of this time already is replaced: the past and the stream overlap, a clock begins again.
    const began = frame.t_s - (count - 0.5) * frame.slice_s;
    while (this.slices.length && this.slices[this.slices.length - 1].t > began) this.slices.pop();
    for (let k = 0; k < count; k++) {
      this.slices.push({ t: frame.t_s - (count - 1 - k) * frame.slice_s, values: frame.axes.map((a) => a[k]) });
    }
    const oldest = frame.t_s - this.rangeS;
    let drop = 0;
    while (drop < this.slices.length && this.slices[drop].t < oldest) drop++;
    if (drop) this.slices.splice(0, drop);
  }

  draw() {
    const { context, width, height } = prepare(this.canvas);
    const left = LEFT, bottom = 20, plotWidth = width - left - RIGHT, plotHeight = height - bottom - 4;
    const newest = this.slices.length ? this.slices[this.slices.length - 1].t : 0;
    let low = 0, high = 0;
    for (const slice of this.slices) {
      for (const axis of this.show) {
        const v = slice.values[axis];
        if (v) { low = Math.min(low, v[0]); high = Math.max(high, v[1]); }
      }
    }
    const wanted = Math.max(Math.abs(low), Math.abs(high), 5) * 1.1;
    this.scale = wanted > this.scale ? wanted : this.scale + 0.03 * (wanted - this.scale);
    const y = (n) => 2 + plotHeight / 2 * (1 - n / this.scale);
    context.strokeStyle = resolved("--edge");
    context.fillStyle = resolved("--soft");
    context.textAlign = "right";
    const tick = niceStep(this.scale);
    for (let n = -Math.floor(this.scale / tick) * tick; n <= this.scale; n += tick) {
      context.beginPath(); context.moveTo(left, y(n)); context.lineTo(left + plotWidth, y(n)); context.stroke();
      if (y(n) > 8 && y(n) < plotHeight) context.fillText(`${Math.round(n)} N`, left - 5, y(n) + 4);
    }
    context.textAlign = "center";
    for (let k = 4; k >= 0; k--) {
      const x = left + plotWidth * (1 - k / 4);
      context.fillText(agoText(this.rangeS * k / 4), Math.max(x, left + 14), height - 5);
    }
    for (const axis of this.show) {
      context.fillStyle = resolved(TRACE_COLOURS[axis % TRACE_COLOURS.length]);
      context.globalAlpha = 0.75;
      this.slices.forEach((slice, k) => {
        const v = slice.values[axis];
        if (!v) return;
        // It stands until the next one, where that is not far.
        const gap = (this.slices[k + 1] ?? slice).t - slice.t;
        const wide = gap > 0 && gap <= BRIDGED * this.wide ? gap : this.wide;
        const x = left + plotWidth * (1 - (newest - slice.t) / this.rangeS);
        context.fillRect(x, y(v[1]), Math.max(plotWidth * wide / this.rangeS, 1), Math.max(y(v[0]) - y(v[1]), 1));
      });
      context.globalAlpha = 1;
    }
    drawCursor(context, plotWidth, plotHeight, resolved("--ink"));
  }
}

function niceStep(range) {
  const power = 10 ** Math.floor(Math.log10(range));
  return [0.2, 0.5, 1, 2, 5].map((f) => f * power).find((step) => range / step <= 3) || power;
}

class StabilityChart {
  constructor(canvas) {
    this.canvas = canvas;
    this.curve = null; // {pitch_rad: [], growth_1_s: []}
    this.points = {};
    this.limit = null;
  }

  draw() {
    const { context, width, height } = prepare(this.canvas);
    context.fillStyle = resolved("--soft");
    if (!this.curve || this.curve.pitch_rad.length < 2) {
      context.fillText(say("no stability curve"), 10, height / 2);
      return;
    }
    const left = 56, bottom = 20, plotWidth = width - left - 6, plotHeight = height - bottom - 6;
    const pitch = this.curve.pitch_rad, growth = this.curve.growth_1_s;
    const far = pitch[pitch.length - 1];
    const most = Math.max(10, ...growth) * 1.15, least = Math.min(-10, Math.max(-60, Math.min(...growth))) * 1.1;
    const x = (rad) => left + plotWidth * rad / far;
    const y = (g) => 4 + plotHeight * (most - Math.max(least, Math.min(most, g))) / (most - least);
    context.fillStyle = resolved("--bad-ground");
    context.fillRect(left, 4, plotWidth, y(0) - 4);
    context.fillStyle = resolved("--ground");
    context.fillRect(left, y(0), plotWidth, 4 + plotHeight - y(0));
    context.fillStyle = resolved("--soft"); context.textAlign = "right";
    const tick = niceStep((most - least) / 2);
    for (let g = Math.ceil(least / tick) * tick; g <= most; g += tick) {
      if (y(g) > 10 && y(g) < plotHeight) context.fillText(`${Math.round(g)} 1/s`, left - 4, y(g) + 4);
    }
    context.strokeStyle = resolved("--soft");
    context.beginPath(); context.moveTo(left, y(0)); context.lineTo(left + plotWidth, y(0)); context.stroke();
    context.fillStyle = resolved("--bad"); context.textAlign = "center";
    context.fillText(say("grows"), left + plotWidth / 2, 18);
    context.textAlign = "left";
    context.fillStyle = resolved("--soft");
    context.fillText(say("dies out"), left + 4, plotHeight);
    context.strokeStyle = resolved("--ink"); context.lineWidth = 2;
    context.beginPath();
    pitch.forEach((p, i) => (i ? context.lineTo(x(p), y(growth[i])) : context.moveTo(x(p), y(growth[i]))));
    context.stroke(); context.lineWidth = 1;
    context.fillStyle = resolved("--soft"); context.textAlign = "center";
    for (let deg = 0; deg <= far * 57.3; deg += 2) context.fillText(`${deg}°`, Math.min(x(deg / 57.2958), width - 12), height - 5);
    if (this.limit !== null && this.limit < far) {
      context.setLineDash([4, 4]); context.strokeStyle = resolved("--warn");
      context.beginPath(); context.moveTo(x(this.limit), 4); context.lineTo(x(this.limit), 4 + plotHeight); context.stroke();
      context.setLineDash([]);
    }
    const at = (rad) => { // growth on the curve
      const k = Math.min(pitch.length - 1, Math.max(0, Math.round(rad / far * (pitch.length - 1))));
      return growth[k];
    };
    for (const [name, colour] of [["commanded", "--accent"], ["reported", "--ink"]]) {
      const rad = this.points[name];
      if (rad === null || rad === undefined || rad > far || rad < 0) continue;
      context.fillStyle = resolved(colour); context.strokeStyle = resolved("--panel");
      context.beginPath(); context.arc(x(rad), y(at(rad)), name === "reported" ? 7 : 5, 0, 7); context.fill(); context.stroke();
    }
  }
}

// A recording played again: frequency of the strongest line and its power over time, chatter shaded.
function drawReplay(canvas, track) {
  const { context, width, height } = prepare(canvas);
  const t = track.t_s, n = t.length;
  if (n < 2) return;
  const left = 48, right = 48, top = 10, bottom = 24, w = width - left - right, h = height - top - bottom;
  const x = (s) => left + (s - t[0]) / (t[n - 1] - t[0]) * w;
  const heard = track.frequency_hz.filter((f) => f !== null);
  const low = heard.length ? heard.reduce((a, b) => Math.min(a, b)) - 20 : 0;
  const high = heard.length ? heard.reduce((a, b) => Math.max(a, b)) + 20 : 1;
  const level = track.power_n2.map((p) => 10 * Math.log10(Math.max(p, 1e-9)));
  const floor = level.reduce((a, b) => Math.min(a, b)), peak = Math.max(floor + 10, level.reduce((a, b) => Math.max(a, b)));
  const yf = (f) => top + h - (f - low) / (high - low) * h, yp = (p) => top + h - (p - floor) / (peak - floor) * h;
  context.fillStyle = resolved("--bad");
  context.globalAlpha = 0.18;
  for (let i = 1; i < n; i += 1) if (track.chatter[i]) context.fillRect(x(t[i - 1]), top, Math.max(1, x(t[i]) - x(t[i - 1])), h);
  context.globalAlpha = 1;
  context.lineWidth = 1.5;
  context.strokeStyle = resolved("--soft");
  context.beginPath();
  level.forEach((p, i) => (i === 0 ? context.moveTo(x(t[i]), yp(p)) : context.lineTo(x(t[i]), yp(p))));
  context.stroke();
  context.fillStyle = resolved("--ink");
  track.frequency_hz.forEach((f, i) => { if (f !== null) context.fillRect(x(t[i]) - 1, yf(f) - 1, 2.5, 2.5); });
  context.fillStyle = resolved("--soft");
  context.fillText(`${high.toFixed(0)} Hz`, 2, top + 10);
  context.fillText(`${low.toFixed(0)} Hz`, 2, top + h);
  context.fillText(`${peak.toFixed(0)} dB`, width - right + 6, top + 10);
  context.fillText(`${floor.toFixed(0)} dB`, width - right + 6, top + h);
  context.fillText(`${fixed(t[0], 1)} s`, left, height - 6);
  context.fillText(`${fixed(t[n - 1], 1)} s`, width - right - 30, height - 6);
}
