"use strict";
// An eye under the hand. While a slider is dragged its frame at this time comes through a socket, the newest request
// alone is answered; once it is let go the whole film comes as a stream, which is broken off before anything else is
// asked for. Every frame is kept here, so time itself is dragged without asking anybody.

const COLOURS = ["#14539a", "#c9641a"], MEASURED = "#46b06f", SHORT = new Set([
  "a1_time_ms", "a1_velocity_m_s", "a1_length_mm", "a1_deflection_mm", "hc_time_ms", "deformation_amplitude_mm",
  "hc_deflection_mm", "hc_circle_radius_mm", "peak_distance_mm", "da_ratio_2mm", "integrated_inverse_radius_per_mm",
  "a2_time_ms", "a2_velocity_m_s", "whole_eye_movement_mm", "central_thickness_um", "iop_nct_mmhg", "biop_mmhg",
  "sp_a1_mmhg_mm"]);
const at = (id) => document.getElementById(id);
const timings = { frame: [], film: [] };  // ms from the hand to the picture, as measured here
window.timings = timings;
const starts = new Map();  // when the hand asked, by number
const QUANTITIES = { deflection_mm: "apex deflection", deformation_mm: "apex deformation" };
let offer, socket, film = null, number = 0, measured = null, curves = null, playing = null, failures = 0, brightened = false;
const eyes = [0, 1].map((which) => ({ which, scene: null, values: {}, frames: [], run: null, parameters: {}, due: true,
  preview: null }));

function make(tag, settings = {}, ...children) {
  const element = Object.assign(document.createElement(tag), settings);
  element.append(...children);
  return element;
}

const scene = (eye) => offer.scenes.find((one) => one.name === eye.scene);
const shownEyes = () => (at("two").checked ? eyes : eyes.slice(0, 1));
const now = () => Number(at("now").value);
const figure = (value) => (value === null || value === undefined ? "-" : Number(value.toPrecision(4)).toString());

// ---- the socket

function connect() {
  socket = new WebSocket(`ws://${location.host}/hand`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { failures = 0; eyes.forEach((eye) => { eye.due = true; }); ask("film"); };
  socket.onmessage = (event) => take(event.data);
  socket.onclose = () => {
    at("state").textContent = "the program that computes has gone; start it again";
    failures += 1;
    setTimeout(connect, Math.min(500 * 2 ** failures, 10000));
  };
}

const refusals = () => document.querySelectorAll(".refused");

function ask(kind, only = null) {
  const wanted = shownEyes().filter((eye) => (only ? eye === only : eye.due));
  if (!wanted.length) return;
  number += 1;
  if (film) film.abort();
  film = null;
  for (const eye of wanted) refusals()[eye.which].textContent = "";
  const request = { number, time_ms: now(),
    eyes: wanted.map((eye) => ({ which: eye.which, scene: eye.scene, values: eye.values })) };
  if (kind === "film") whole(request, performance.now());
  else if (socket.readyState === WebSocket.OPEN) {
    starts.set(number, performance.now());
    socket.send(JSON.stringify(request));
  }
}

async function whole(request, start) {
  const mine = film = new AbortController();
  try {
    const answer = await fetch("film", { method: "POST", body: JSON.stringify(request), signal: mine.signal });
    if (!answer.ok) {
      const reason = await answer.text();
      for (const { which } of request.eyes) refused(eyes[which], reason);
      settle(request.number);
      return;
    }
    await messages(answer.body.getReader(), (data) => {
      if (film !== mine) return;
      if (unpack(data).head.kind !== "done") { take(data, request); return; }
      tabulate();
      draw();
      if (request.eyes.some(({ which }) => !eyes[which].due)) told("film", performance.now() - start);
      else at("state").textContent = "";
      settle(request.number);
    });
  } catch (problem) {
    if (problem.name !== "AbortError" && !(problem instanceof TypeError)) throw problem;  // overtaken, or the program has gone
  }
}

// What a stream brings, each message once it is whole.
async function messages(reader, each) {
  let head = new Uint8Array(4), body = null, filled = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    for (let at = 0; at < value.length;) {
      const room = body || head, part = value.subarray(at, at + room.length - filled);
      room.set(part, filled);
      filled += part.length;
      at += part.length;
      if (filled < room.length) continue;
      filled = 0;
      if (body === null) { body = new Uint8Array(new DataView(head.buffer).getUint32(0, true)); continue; }
      each(body.buffer);
      body = null;
    }
  }
}

function unpack(data) {
  const length = new DataView(data).getUint32(0, true);
  return { head: JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))), pixels: new Uint8Array(data, 4 + length) };
}

// Nothing of an eye that is not there any more stays in sight.
function refused(eye, reason) {
  refusals()[eye.which].textContent = reason;
  Object.assign(eye, { frames: [], run: null, parameters: {}, due: true, preview: null });
  const canvas = document.querySelectorAll(".eye canvas")[eye.which];
  canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
  document.querySelectorAll(".foot code")[eye.which].textContent = "";
  tabulate();
  plot();
}

function ran(eye, head) {
  eye.run = head;
  document.querySelectorAll(".foot code")[eye.which].textContent = head.command;
  refusals()[eye.which].textContent = head.stop;
}

function take(data, request = null) {
  const { head, pixels } = unpack(data), eye = eyes[head.which];
  if (head.kind === "refused") {
    if (!request && film) return;
    if (eye) refused(eye, head.reason);
    else at("state").textContent = head.reason;  // of a request that is none: whose eye it is cannot be told
  } else if (head.kind === "frame") {
    if (film) return;  // the whole film is on its way
    eye.preview = pixels;
    ran(eye, head);
    draw();
    told("frame", performance.now() - starts.get(head.number));
    for (const old of starts.keys()) if (old <= head.number) starts.delete(old);
  } else if (head.kind === "run") {
    eye.frames = [];
    ran(eye, head);
  } else if (head.kind === "frames") {
    const size = scene(eye).width * scene(eye).height;
    const before = eye.frames.length, wanted = frameAt(eye, now());
    for (let k = 0; k * size < pixels.length; k += 1) eye.frames[head.first + k] = pixels.subarray(k * size, (k + 1) * size);
    if (wanted < eye.frames.length && (eye.preview || before <= wanted)) { eye.preview = null; drawEye(eye); }
  } else if (head.kind === "parameters") {
    eye.parameters = head.values;
    eye.due = false;
  } else if (head.kind === "fold") {
    refusals()[eye.which].textContent = `a finer run ends: ${head.reason}`;
  }
}

function told(kind, took) {
  timings[kind].push(took);
  at("state").textContent = kind === "film" ? `whole film in ${took.toFixed(0)} ms` : `frame in ${took.toFixed(0)} ms`;
}

function settle(answered) {
  document.body.dataset.settled = answered;  // the last request that was answered to its end
}

// ---- pictures

const paint = { image: null, words: null, gain: 0, table: new Uint32Array(256) };

function frameAt(eye, time) {
  const last = eye.run ? eye.run.time_ms.length - 1 : 0;
  return Math.max(0, Math.min(Math.floor(time / scene(eye).interval_ms + 1e-9), last));
}

function drawEye(eye) {
  const canvas = document.querySelectorAll(".eye canvas")[eye.which], { width, height } = scene(eye);
  const grey = eye.preview || eye.frames[frameAt(eye, now())];
  if (!grey || grey.length !== width * height) return;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const gain = brightened ? Number(at("gain").value) : scene(eye).gain;
  if (gain !== paint.gain) {
    paint.gain = gain;
    for (let k = 0; k < 256; k += 1) paint.table[k] = 0xff000000 | (Math.min(255, Math.round(k * gain)) * 0x010101);
  }
  if (!paint.image || paint.image.width !== width || paint.image.height !== height) {
    paint.image = new ImageData(width, height);
    paint.words = new Uint32Array(paint.image.data.buffer);
  }
  for (let k = 0; k < grey.length; k += 1) paint.words[k] = paint.table[grey[k]];
  const pen = canvas.getContext("2d");
  pen.putImageData(paint.image, 0, 0);
  if (curves) trace(pen, scene(eye));
}

// The edge of the measured film at this time, over the frame.
function trace(pen, { pixel_mm: [width, height], apex_px: [column, row] }) {
  const time = now(), { time_ms: times } = curves;
  let near = 0;
  times.forEach((one, k) => { if (Math.abs(one - time) < Math.abs(times[near] - time)) near = k; });
  pen.strokeStyle = MEASURED;
  pen.lineWidth = 1.5;
  pen.setLineDash([6, 3]);
  pen.beginPath();
  let drawn = false;
  curves.height_mm[near].forEach((value, k) => {
    if (value === null) { drawn = false; return; }
    pen[drawn ? "lineTo" : "moveTo"](column + curves.x_mm[k] / width, row - value / height);
    drawn = true;
  });
  pen.stroke();
  pen.setLineDash([]);
}

// Time moves: a frame that was drawn for another time goes.
function turn() {
  for (const eye of eyes) eye.preview = null;
  draw();
}

function draw() {
  for (const eye of shownEyes()) drawEye(eye);
  at("shown").textContent = `${now().toFixed(2)} ms`;
  plot();
}

function nice(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 2.5, 5, 10].find((m) => m * power >= rough * (1 - 1e-9)) * power;
}

function plot() {
  const canvas = at("plot"), pen = canvas.getContext("2d"), what = at("what").value;
  const [left, right, top, bottom] = [56, canvas.width - 56, 30, canvas.height - 44];
  const drawn = shownEyes().filter((eye) => eye.run);
  const end = Math.max(...shownEyes().map((eye) => scene(eye).duration_ms));
  const laid = measured && measured.what === what ? measured : null;  // the other quantity is another curve
  const most = Math.max(0.05, ...drawn.map((eye) => Math.max(...eye.run[what])), ...(laid ? laid.displacement_mm : []));
  const load = Math.max(0.1, ...drawn.map((eye) => Math.max(...eye.run.puff_kpa)));
  const step = nice(most / 4), high = step * Math.ceil(most * 1.05 / step);
  const low = -0.06 * high;
  const x = (time) => left + (time / end) * (right - left);
  const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.font = "13px system-ui, sans-serif";
  pen.lineWidth = 1;
  pen.strokeStyle = "#e4e7ea";
  pen.fillStyle = "#6b737c";
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (let value = 0; value <= high + 1e-9; value += step) {
    pen.beginPath(); pen.moveTo(left, y(value)); pen.lineTo(right, y(value)); pen.stroke();
    pen.fillText(Number(value.toFixed(4)).toString(), left - 8, y(value));
  }
  pen.textAlign = "center";
  pen.textBaseline = "top";
  const tick = nice(end / 7);
  for (let time = 0; time <= end + 1e-9; time += tick) pen.fillText(Number(time.toFixed(3)).toString(), x(time), bottom + 8);
  pen.fillText("time, ms", (left + right) / 2, bottom + 26);
  pen.textAlign = "left";
  pen.fillText(`${QUANTITIES[what]}, mm`, left - 50, 4);
  pen.textAlign = "right";
  pen.fillText(`puff (shaded), up to ${load.toFixed(1)} kPa`, right + 50, 4);
  const line = (times, values, colour, dash, width, scale = 1) => {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.setLineDash(dash);
    pen.beginPath();
    times.forEach((time, k) => pen[k ? "lineTo" : "moveTo"](x(time), y(values[k] * scale)));
    pen.stroke(); pen.setLineDash([]);
  };
  drawn.forEach((eye) => {
    const { time_ms: times, puff_kpa: puff } = eye.run;
    pen.fillStyle = "rgba(110, 120, 130, 0.10)";
    pen.beginPath(); pen.moveTo(x(times[0]), y(0));
    times.forEach((time, k) => pen.lineTo(x(time), y(puff[k] / load * high * 0.95)));
    pen.lineTo(x(times[times.length - 1]), y(0)); pen.fill();
  });
  if (laid) {
    pen.fillStyle = MEASURED;
    laid.time_ms.forEach((time, k) => {
      if (time >= 0 && time <= end) { pen.beginPath(); pen.arc(x(time), y(laid.displacement_mm[k]), 2.4, 0, 7); pen.fill(); }
    });
  }
  drawn.forEach((eye) => {
    line(eye.run.time_ms, eye.run[what], COLOURS[eye.which], eye.which ? [8, 4] : [], 2.2);
    if (eye.due) return;
    for (const [mark, key] of [["A1", "a1_time_ms"], ["HC", "hc_time_ms"], ["A2", "a2_time_ms"]]) {
      const time = eye.parameters[key];
      if (time === null || time === undefined) continue;
      line([time, time], [0, high], COLOURS[eye.which], eye.which ? [2, 5] : [2, 3], 0.9);
      pen.fillStyle = COLOURS[eye.which];
      pen.textAlign = eye.which ? "left" : "right";
      pen.fillText(mark, x(time) + (eye.which ? 3 : -3), y(high) + 2 + 15 * eye.which);
    }
  });
  line([now(), now()], [low, high], "#22262b", [], 1);
}

function tabulate() {
  const [head, body] = [document.querySelector("#table thead"), document.querySelector("#table tbody")];
  const shown = shownEyes();
  head.replaceChildren(make("tr", {}, make("th", { textContent: "parameter" }), ...shown.map((eye) =>
    make("th", { className: `n ${eye.which ? "other" : "one"}`, textContent: eye.scene })), make("th", { textContent: "unit" }),
    make("th", { className: "n", textContent: "healthy eyes" })));
  body.replaceChildren(...offer.parameters.filter((one) => SHORT.has(one.name)).map((one) => {
    const row = make("tr", { title: one.said }, make("td", { textContent: one.said.split(":")[0] }));
    row.dataset.name = one.name;
    for (const eye of shown) {
      const value = eye.parameters[one.name];
      const cell = make("td", { className: "n", textContent: figure(value) });
      if (one.norm && value !== null && value !== undefined) {
        const z = (value - one.norm[0]) / one.norm[1];
        cell.title = `z ${z.toFixed(1)}`;
        if (Math.abs(z) > offer.far) cell.classList.add("far");
      }
      row.append(cell);
    }
    row.append(make("td", { textContent: one.unit }),
      make("td", { className: "n", textContent: one.norm ? `${one.norm[0]} \u00b1 ${one.norm[1]}` : "",
        title: one.norm ? one.norm[2] : "" }));
    return row;
  }));
}

// ---- what the hand moves

function moved(eye, slider, value, whole) {
  eye.values[slider.name] = value;
  const told = Object.keys(eye.parameters).length;
  Object.assign(eye, { due: true, frames: [], parameters: {} });  // what there was is of another eye
  if (told) tabulate();
  pause();
  ask(whole ? "film" : "frame", whole ? null : eye);
}

function sliders(eye) {
  const own = scene(eye).values;
  return offer.sliders.filter((slider) => slider.name in own).map((slider) => {
    const start = own[slider.name];
    // a scene's own value may lie between the steps, or beyond the ends
    const input = make("input", { type: "range", min: Math.min(slider.low, start), max: Math.max(slider.high, start),
      step: "any", value: start, title: slider.doc });
    input.dataset.name = slider.name;
    input.setAttribute("aria-label", slider.label);
    const output = make("output", { textContent: `${figure(start)} ${slider.unit}` });
    const row = make("div", { className: "slider" }, make("label", { textContent: slider.label, title: slider.doc }), input, output);
    const value = () => Number((Math.round(Number(input.value) / slider.step) * slider.step).toPrecision(12));
    const tell = (whole) => {
      output.textContent = `${figure(value())} ${slider.unit}`;
      row.classList.add("moved");
      moved(eye, slider, value(), whole);
    };
    input.addEventListener("input", () => tell(false));
    input.addEventListener("change", () => tell(true));
    return row;
  });
}

function panel(eye) {
  const choice = make("select", {}, ...offer.scenes.map((one) => make("option", { value: one.name, textContent: one.name })));
  choice.setAttribute("aria-label", "scene");
  choice.value = eye.scene;
  const room = make("div", { className: "sliders" }, ...sliders(eye));
  const back = make("button", { className: "back", textContent: "back to the scene" });
  const start = () => {
    if (!eye.which) brightness();
    Object.assign(eye, { values: {}, frames: [], run: null, parameters: {}, due: true, preview: null });
    room.replaceChildren(...sliders(eye));
    at("now").max = Math.max(...shownEyes().map((one) => scene(one).duration_ms));
    tabulate();
    ask("film");
  };
  choice.addEventListener("change", () => { eye.scene = choice.value; start(); });
  back.addEventListener("click", start);
  const keep = make("button", { className: "keep", textContent: "save as scene" });
  keep.addEventListener("click", () => save(eye));
  // a browser gives its clipboard to pages of this machine, not to those that come over a network in the clear
  const copy = make("button", { textContent: "copy", hidden: !navigator.clipboard });
  const code = make("code", { title: "run with the model of the scene" });
  copy.addEventListener("click", () => navigator.clipboard.writeText(code.textContent));
  return make("section", { className: eye.which ? "eye other" : "eye" }, make("div", { className: "top" }, choice, back, keep),
    make("canvas", { width: scene(eye).width, height: scene(eye).height }), make("p", { className: "refused" }), room,
    make("div", { className: "foot" }, make("span", { className: "note", textContent: "full model:" }), code, copy));
}

async function save(eye) {
  const answer = await fetch("scene", { method: "POST", body: JSON.stringify({ scene: eye.scene, values: eye.values }) });
  if (!answer.ok) { document.querySelectorAll(".refused")[eye.which].textContent = await answer.text(); return; }
  const link = make("a", { href: URL.createObjectURL(await answer.blob()), download: "my_eye.toml" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

async function lay(file) {
  if (!file) return;
  const said = at("said");
  said.className = "note";
  said.textContent = "reading ...";
  try {
    const answer = await fetch(`measured?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    if (!answer.ok) throw new Error(await answer.text());
    const found = await answer.json();
    if (found.height_mm) curves = found;
    else {
      measured = { ...found, what: found.column === "deflection_mm" ? "deflection_mm" : "deformation_mm" };
      at("what").value = measured.what;
    }
    say();
    at("forget").hidden = false;
  } catch (problem) {
    said.className = "refused";
    said.textContent = problem instanceof TypeError ? "refused: the file is too large, or the program has gone" : problem.message;
  }
  at("measured").value = "";
  draw();
}

// What is laid over, and of which quantity.
function say() {
  const lines = [];
  if (measured) {
    const shown = measured.what === at("what").value ? "" : ", shown while that is selected";
    lines.push([`${measured.name} (${QUANTITIES[measured.what]}${shown})`, ...measured.notes].join("; "));
  }
  if (curves) lines.push([curves.name, ...curves.notes].join("; "));
  at("said").className = "note";
  at("said").textContent = lines.length ? `laid over, in green: ${lines.join(". ")}` : "";
}

function pause() {
  clearInterval(playing);
  playing = null;
  at("run").textContent = "\u25b6";
}

function play() {
  if (playing) { pause(); return; }
  at("run").textContent = "\u23f8";
  const interval = scene(eyes[0]).interval_ms;
  playing = setInterval(() => {
    const later = now() + interval;
    at("now").value = later > Number(at("now").max) ? 0 : later;
    turn();
  }, 40);
}

// As bright as every other picture of the scene, until the hand says otherwise.
function brightness() {
  if (!brightened) at("gain").value = scene(eyes[0]).gain;
}

async function begin() {
  offer = await (await fetch("eyes")).json();
  const names = offer.scenes.map((one) => one.name);
  eyes[0].scene = names[0];
  eyes[1].scene = names.find((name) => name === "keratoconus" && name !== names[0]) || names[1] || names[0];
  at("eyes").replaceChildren(...eyes.map(panel));
  at("now").max = Math.max(...eyes.map((eye) => scene(eye).duration_ms));
  at("now").value = Math.min(16.5, Number(at("now").max));
  at("now").addEventListener("input", () => { pause(); turn(); });
  at("run").addEventListener("click", play);
  brightness();
  at("gain").addEventListener("input", () => { brightened = true; draw(); });
  at("what").addEventListener("change", () => { say(); plot(); });
  at("measured").addEventListener("change", (event) => lay(event.target.files[0]));
  at("forget").addEventListener("click", () => {
    measured = curves = null;
    at("forget").hidden = true;
    say();
    draw();
  });
  at("two").addEventListener("change", () => {
    document.querySelectorAll(".eye")[1].hidden = !at("two").checked;
    tabulate(); ask("film"); draw();
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === " " && event.target === document.body) { event.preventDefault(); play(); }
  });
  tabulate();
  connect();
}

begin();
