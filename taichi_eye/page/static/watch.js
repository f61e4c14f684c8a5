"use strict";
// A run as it is computed: the newest frame, the traces so far, and a button that ends the run.

const at = (id) => document.getElementById(id);
const SAID = { begun: "setting up, kernels are compiled ...", running: "running", writing: "writing film, plots and page ...",
  complete: "complete", ended: "ended" };
let socket, over = false, failures = 0;

function connect() {
  socket = new WebSocket(`ws://${location.host}/frames`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { failures = 0; };
  socket.onmessage = (event) => take(event.data);
  socket.onclose = () => {
    if (over) return;
    failures += 1;
    at("state").textContent = "the run is not there any more";
    at("stop").disabled = true;
    setTimeout(connect, Math.min(500 * 2 ** failures, 10000));
  };
}

async function take(data) {
  const length = new DataView(data).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  over = head.state === "complete" || head.state === "ended";
  at("stop").disabled = over || head.state === "writing";
  if (head.folder) { at("folder").textContent = head.folder; document.title = head.folder; }
  let said = SAID[head.state];
  if (head.state === "running" && head.frame !== undefined) said += `: frame ${head.frame + 1} of ${head.frames}, ${head.now_ms.toFixed(2)} ms`;
  if (head.reason) said += `: ${head.reason}`;
  at("state").textContent = said;
  if (head.end_ms) at("far").value = (head.now_ms || 0) / head.end_ms;
  if (head.time_ms) plot(head);
  if (data.byteLength > 4 + length) {
    const image = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" }));
    const canvas = at("film");
    if (canvas.width !== image.width || canvas.height !== image.height) Object.assign(canvas, { width: image.width, height: image.height });
    canvas.getContext("2d").drawImage(image, 0, 0);
    if (document.body.dataset.late === undefined) document.body.dataset.late = Date.now() / 1000 - head.at;
    document.body.dataset.frame = head.frame;
  }
  document.body.dataset.state = head.state;
}

function plot(head) {
  const canvas = at("plot"), pen = canvas.getContext("2d");
  const [left, right, top, bottom] = [70, canvas.width - 70, 34, canvas.height - 34];
  const lines = [["apex displacement, mm", "apex_mm", "#14539a", []], ["puff at the apex, kPa", "puff_kpa", "#c9641a", [8, 4]],
    ["liquid under the apex, kPa", "pressure_kpa", "#3d8b57", [2, 3]]];
  const x = (time) => left + (time / head.end_ms) * (right - left);
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.font = "14px system-ui, sans-serif";
  pen.strokeStyle = "#d8dce0";
  pen.fillStyle = "#6b737c";
  pen.textAlign = "center";
  for (let k = 0; k <= 8; k += 1) {
    const time = head.end_ms * k / 8;
    pen.beginPath(); pen.moveTo(x(time), top); pen.lineTo(x(time), bottom); pen.stroke();
    pen.fillText(Number(time.toFixed(2)).toString(), x(time), bottom + 18);
  }
  pen.fillText("ms", right + 30, bottom + 18);
  lines.forEach(([name, which, colour, dash], k) => {
    const values = head[which], most = head.most[which], high = Math.max(0.01, most), low = Math.min(0, ...values);
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    pen.strokeStyle = pen.fillStyle = colour;
    pen.setLineDash(dash);
    pen.lineWidth = 2;
    pen.beginPath();
    head.time_ms.forEach((time, n) => pen[n ? "lineTo" : "moveTo"](x(time), y(values[n])));
    pen.stroke();
    pen.setLineDash([]);
    pen.lineWidth = 1;
    pen.textAlign = "left";
    pen.fillText(`${name}: now ${head.now[which].toPrecision(3)}, up to ${most.toPrecision(3)}`, left + k * 370, 16);
  });
}

at("stop").addEventListener("click", async () => {
  at("stop").disabled = true;
  at("state").textContent = "ending at the next sample ...";
  await fetch("stop", { method: "POST" });
});
connect();
