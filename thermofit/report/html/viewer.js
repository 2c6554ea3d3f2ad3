"use strict";
// The viewer of a thermofit report: draws packed arrays on canvases. It asks for nothing that is not in the page.
(() => {
  const views = JSON.parse(document.getElementById("views").textContent);
  const $ = (id) => document.getElementById(id);
  const root = document.documentElement;
  const css = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const redraws = [];
  const redraw = () => redraws.forEach((draw) => draw());

  // --- arrays ---------------------------------------------------------------------------------------------------
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const shorts = (text) => { const b = bytes(text); return new Int16Array(b.buffer, 0, b.length >> 1); };
  function unpack(p) {
    if (!p) return null;
    if (!p.values) { p.values = Float32Array.from(shorts(p.data), (v) => (v === -32768 ? NaN : p.offset + p.step * v)); p.data = ""; }
    return p.values;
  }
  const fmt = (v, n = 4) => (v === null || v === undefined || !isFinite(v) ? "\u2013" : String(Number(v.toPrecision(n))));
  const option = (select, text, value) => { const o = document.createElement("option"); o.textContent = text; o.value = value; select.append(o); };
  const phaseAt = (phases, t) => { const p = (phases || []).find((q) => t >= q.t0 && t <= q.t1); return p ? p.label : ""; };
  const nearest = (list, v) => list.reduce((best, x, k) => (Math.abs(x - v) < Math.abs(list[best] - v) ? k : best), 0);

  // --- canvas ---------------------------------------------------------------------------------------------------
  function sized(canvas, w, h) {
    const scale = window.devicePixelRatio || 1;
    canvas.width = Math.round(w * scale); canvas.height = Math.round(h * scale);
    canvas.style.width = w + "px"; canvas.style.height = h + "px";
    const c = canvas.getContext("2d"); c.setTransform(scale, 0, 0, scale, 0, 0); c.clearRect(0, 0, w, h);
    return c;
  }
  function ticks(low, high, n) {
    const raw = (high - low) / Math.max(n, 1), base = 10 ** Math.floor(Math.log10(raw)), f = raw / base;
    const step = base * (f < 1.5 ? 1 : f < 3.5 ? 2 : f < 7.5 ? 5 : 10), out = [];
    for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) out.push(Math.abs(v) < 1e-9 * step ? 0 : v);
    return { step, out };
  }
  const tick = (v, step) => (Math.abs(v) >= 1e5 || (v !== 0 && step < 1e-4) ? v.toExponential(1) : v.toFixed(Math.min(6, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))));

  // series: {x, y, kind: "dots" | "line" | "band", colour, low, high, label}; options: {x, y, title, at, phases, level}
  function plot(canvas, series, options) {
    if (!canvas) return;
    const w = Math.max(220, Math.floor(canvas.parentElement.clientWidth)), h = Math.round(Math.min(280, Math.max(190, 0.56 * w)));
    const c = sized(canvas, w, h), left = 58, right = 10, top = 24, bottom = 38;
    const xs = [], ys = [];
    for (const s of series) for (let k = 0; k < s.x.length; k++) {
      const x = s.x[k], lists = s.kind === "band" ? [s.low[k], s.high[k]] : [s.y[k]];
      if (x === null || !isFinite(x)) continue;
      for (const y of lists) if (y !== null && isFinite(y)) { xs.push(x); ys.push(y); }
    }
    c.font = "12px system-ui, sans-serif"; c.fillStyle = css("--ink"); c.textBaseline = "alphabetic";
    if (!xs.length) { c.fillStyle = css("--soft"); c.fillText(options.none || "nothing was measured here", 12, 40); return; }
    const span = (v, keep) => {
      let low = v.reduce((a, b) => Math.min(a, b), Infinity), high = v.reduce((a, b) => Math.max(a, b), -Infinity);
      for (const k of keep || []) { low = Math.min(low, k); high = Math.max(high, k); }
      const pad = high > low ? 0.04 * (high - low) : Math.max(1e-6, 0.02 * Math.abs(high));
      return [low - pad, high + pad];
    };
    const [x0, x1] = options.spanX || span(xs), [y0, y1] = span(ys, options.keep);
    const px = (x) => left + ((x - x0) / (x1 - x0)) * (w - left - right), py = (y) => h - bottom - ((y - y0) / (y1 - y0)) * (h - top - bottom);
    c.strokeStyle = css("--line"); c.lineWidth = 1;
    const tx = ticks(x0, x1, Math.max(2, (w - left) / 80)), ty = ticks(y0, y1, Math.max(2, h / 50));
    c.textAlign = "center"; c.fillStyle = css("--soft");
    for (const v of tx.out) { c.beginPath(); c.moveTo(px(v), top); c.lineTo(px(v), h - bottom); c.stroke(); c.fillText(tick(v, tx.step), px(v), h - bottom + 14); }
    c.textAlign = "right";
    for (const v of ty.out) { c.beginPath(); c.moveTo(left, py(v)); c.lineTo(w - right, py(v)); c.stroke(); c.fillText(tick(v, ty.step), left - 5, py(v) + 4); }
    c.fillStyle = css("--ink"); c.textAlign = "center"; c.fillText(options.x, left + (w - left - right) / 2, h - 6);
    c.textAlign = "left"; c.fillText(options.y, 6, 14);
    c.save(); c.beginPath(); c.rect(left, top, w - left - right, h - top - bottom); c.clip();
    for (const level of options.level || []) { c.strokeStyle = css("--soft"); c.setLineDash([4, 3]); c.beginPath(); c.moveTo(left, py(level)); c.lineTo(w - right, py(level)); c.stroke(); c.setLineDash([]); }
    for (const s of series) {
      c.strokeStyle = c.fillStyle = s.colour; c.lineWidth = s.kind === "line" ? 1.6 : 1;
      if (s.kind === "dots") for (let k = 0; k < s.x.length; k++) { if (s.y[k] === null || !isFinite(s.y[k])) continue; c.beginPath(); c.arc(px(s.x[k]), py(s.y[k]), s.x.length > 400 ? 1.2 : 2, 0, 7); c.fill(); }
      else if (s.kind === "band") for (let k = 0; k < s.x.length; k++) { if (!isFinite(s.low[k]) || s.low[k] === null) continue; c.fillRect(px(s.x[k]) - 2, py(s.high[k]), 4, Math.max(1, py(s.low[k]) - py(s.high[k]))); }
      else { c.beginPath(); let on = false; for (let k = 0; k < s.x.length; k++) { const ok = s.y[k] !== null && isFinite(s.y[k]) && s.x[k] !== null && isFinite(s.x[k]); if (ok) { if (on) c.lineTo(px(s.x[k]), py(s.y[k])); else c.moveTo(px(s.x[k]), py(s.y[k])); } on = ok; } c.stroke(); }
    }
    if (options.at !== undefined && options.at !== null && isFinite(options.at)) { c.strokeStyle = css("--ink"); c.lineWidth = 1; c.beginPath(); c.moveTo(px(options.at), top); c.lineTo(px(options.at), h - bottom); c.stroke(); }
    if (options.spot && options.spot.every((v) => v !== null && isFinite(v))) { c.strokeStyle = css("--ink"); c.lineWidth = 2; c.beginPath(); c.arc(px(options.spot[0]), py(options.spot[1]), 5, 0, 7); c.stroke(); }
    c.restore();
    let x = w - right;
    c.textAlign = "right"; c.font = "11px system-ui, sans-serif";
    for (const s of series.filter((q) => q.label).reverse()) { c.fillStyle = s.colour; c.fillText(s.label, x, 14); x -= c.measureText(s.label).width + 12; }
  }

  // --- colours --------------------------------------------------------------------------------------------------
  const rgb = (text) => { const m = text.match(/^#(..)(..)(..)/); return m ? m.slice(1).map((v) => parseInt(v, 16)) : [128, 128, 128]; };
  const mix = (a, b, f) => a.map((v, k) => Math.round(v + f * (b[k] - v)));
  const along = (stops, f) => { const s = Math.min(Math.max(f, 0), 1) * (stops.length - 1), k = Math.min(Math.floor(s), stops.length - 2); return mix(stops[k], stops[k + 1], s - k); };
  const heat = [[13, 8, 135], [126, 3, 168], [204, 71, 120], [248, 149, 64], [240, 249, 33]];
  const viridis = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const signed = () => { const zero = rgb(css("--zero")); return [[5, 48, 97], [67, 147, 195], zero, [214, 96, 77], [103, 0, 31]]; };

  // --- maps -----------------------------------------------------------------------------------------------------
  const layers = [];
  for (const test of views.tests) {
    const lead = test.name ? test.name + ": " : "";
    for (const one of [...test.maps, ...Object.values(test.fields)]) Object.assign(one, test.grids[one.grid]);
    const rms = (p) => { const v = unpack(p); let s = 0, n = 0; for (const x of v) if (isFinite(x)) { s += x * x; n++; } return n ? Math.sqrt(s / n) : 0; };
    const maps = test.maps.map((m) => ({ ...m, test, kind: "residual", size: rms(m.before) })).sort((a, b) => b.size - a.size);
    for (const m of maps) layers.push({ ...m, title: lead + "residual of the " + m.label });
    const words = { u: ["displacement across the load (x), mm", "displacement along the load (y), mm"], theta: ["temperature, K"] };
    for (const [name, f] of Object.entries(test.fields)) (words[name] || []).forEach((label, k) => layers.push({ test, kind: "measured", title: lead + "measured " + label, field: f, time: f.time, xy: f.xy, raster: f.raster, component: k, words: ["measured", ""], before: f.value, after: null }));
  }
  const state = { layer: 0, time: 0, side: 0, point: 0, mode: "time", limit: "auto" };
  const valueOf = (layer, side, t, p) => { const pack = side && layer.after ? layer.after : layer.before, v = unpack(pack), n = layer.xy.length, m = layer.kind === "measured" ? pack.shape[2] : 1; return v[(t * n + p) * m + (layer.component || 0)]; };
  function picture(layer, side) {
    const n = layer.xy.length, out = new Float32Array(n);
    for (let p = 0; p < n; p++) {
      if (state.mode === "time") { out[p] = valueOf(layer, side, state.time, p); continue; }
      let sum = 0, square = 0, count = 0;
      for (let t = 0; t < layer.time.length; t++) { const v = valueOf(layer, side, t, p); if (isFinite(v)) { sum += v; square += v * v; count++; } }
      const measured = layer.kind === "measured";
      out[p] = !count ? NaN : state.mode === "rms" ? Math.sqrt(square / count) : measured ? sum / count : sum / Math.sqrt(count);
    }
    return out;
  }
  function limits(layer) {
    const values = [];
    for (const side of layer.after ? [0, 1] : [0]) for (const v of picture(layer, side)) if (isFinite(v)) values.push(v);
    if (!values.length) return [-1, 1];
    if (layer.kind === "measured") { values.sort((a, b) => a - b); const a = values[Math.floor(0.005 * values.length)], b = values[Math.ceil(0.995 * values.length) - 1]; return [a, b > a ? b : a + 1e-6]; }
    if (state.limit !== "auto") { const l = Number(state.limit); return [state.mode === "rms" ? 0 : -l, l]; }
    values.forEach((v, k) => { values[k] = Math.abs(v); }); values.sort((a, b) => a - b);
    const l = Math.max(3, values[Math.floor(0.99 * (values.length - 1))]);
    return [state.mode === "rms" ? 0 : -l, l];
  }
  function drawMap() {
    const canvas = $("map"), layer = layers[state.layer];
    if (!canvas || !layer) return;
    const r = layer.raster, index = r.index || (r.index = shorts(r.data)), values = picture(layer, state.side), [low, high] = limits(layer);
    const room = Math.max(160, canvas.closest(".card").clientWidth - 110), tall = Math.min(460, Math.max(300, window.innerHeight * 0.55));
    const f = Math.min(room / r.w, tall / r.h), w = Math.round(r.w * f), h = Math.round(r.h * f), c = sized(canvas, w, h);
    const stops = layer.kind === "measured" || state.mode === "rms" ? viridis : signed(), image = new ImageData(r.w, r.h);
    for (let k = 0; k < index.length; k++) { const v = index[k] < 0 ? NaN : values[index[k]]; if (!isFinite(v)) continue; const [a, b, d] = along(stops, (v - low) / (high - low)); image.data.set([a, b, d, 255], 4 * k); }
    const small = document.createElement("canvas"); small.width = r.w; small.height = r.h; small.getContext("2d").putImageData(image, 0, 0);
    c.imageSmoothingEnabled = false; c.drawImage(small, 0, 0, w, h); c.strokeStyle = css("--line"); c.strokeRect(0.5, 0.5, w - 1, h - 1);
    const [x, y] = layer.xy[state.point], sx = ((x - r.low[0]) / (r.high[0] - r.low[0])) * w, sy = ((r.high[1] - y) / (r.high[1] - r.low[1])) * h;
    c.lineWidth = 3; c.strokeStyle = "#000"; c.beginPath(); c.arc(sx, sy, 6, 0, 7); c.stroke(); c.lineWidth = 1.5; c.strokeStyle = "#fff"; c.stroke();
    const bar = sized($("scale"), 64, h), n = Math.max(1, h - 16);
    for (let k = 0; k < n; k++) { const [a, b, d] = along(stops, 1 - k / n); bar.fillStyle = `rgb(${a},${b},${d})`; bar.fillRect(4, 8 + k, 12, 1.5); }
    bar.fillStyle = css("--ink"); bar.font = "11px system-ui, sans-serif";
    const marks = ticks(low, high, 5);
    for (const v of marks.out) bar.fillText(tick(v, marks.step), 20, 12 + n * (1 - (v - low) / (high - low)));
    const model = layer.words[state.side && layer.after ? 1 : 0], side = layer.after ? (state.side ? "AFTER, " : "BEFORE, ") : "";
    const what = layer.kind === "measured" ? "measured" : state.mode === "rms" ? "rms, times the noise" : state.mode === "mean" ? "mean, in standard errors of white noise" : "times the noise";
    $("map-title").textContent = layer.kind === "measured" ? layer.title : `${side}${model}: ${what}`;
    const t = layer.time[state.time], phase = phaseAt(layer.test.phases, t);
    $("time-text").textContent = state.mode === "time" ? `${fmt(t)} s ${phase}` : "all times";
    $("time").setAttribute("aria-valuetext", $("time-text").textContent);
  }
  function curvesAt() {
    const layer = layers[state.layer];
    if (!layer || !$("plot-a")) return;
    const [x, y] = layer.xy[state.point], t = layer.time[state.time], dot = css("--dot"), model = css("--model"), band = css("--band");
    const at = (f) => f.xy.reduce((best, q, k) => (Math.hypot(q[0] - x, q[1] - y) < Math.hypot(f.xy[best][0] - x, f.xy[best][1] - y) ? k : best), 0);
    $("point-title").textContent = `Point at x = ${fmt(x, 3)} mm, y = ${fmt(y, 3)} mm`;
    const theta = layer.test.fields.theta, u = layer.test.fields.u, column = (pack, p, m, k, n) => { const v = unpack(pack); return v ? Array.from({ length: pack.shape[0] }, (_, i) => v[(i * n + p) * m + k]) : null; };
    if (theta) {
      const p = at(theta), n = theta.xy.length, rise = (list, zero) => list && list.map((v) => v - zero);
      const seen = rise(column(theta.value, p, 1, 0, n), theta.reference[p] ?? 0), made = theta.predicted && rise(column(theta.predicted, p, 1, 0, n), theta.reference_model[p] ?? 0);
      const series = [{ x: theta.time, low: seen.map((v) => v - 2 * theta.sigma), high: seen.map((v) => v + 2 * theta.sigma), kind: "band", colour: band }, { x: theta.time, y: seen, kind: "dots", colour: dot, label: "measured" }];
      // Where there are two models, each is what was measured plus its residual; the verified one may be a third.
      const late = layers.find((q) => q.channel === "dtheta" && q.after && q.noise && q.test === layer.test);
      if (late) { const k = at(late); for (const side of [0, 1]) series.push({ x: late.time, y: late.time.map((v, i) => seen[nearest(theta.time, v)] + late.noise * valueOf(late, side, i, k)), kind: "line", colour: side ? css("--other") : model, label: side ? "after" : "before" }); }
      else if (made) series.push({ x: theta.time, y: made, kind: "line", colour: model, label: theta.model });
      plot($("plot-a"), series, { x: "time in s", y: "rise in K", at: t });
    } else plot($("plot-a"), [], { none: "no temperatures were measured" });
    if (u && u.stretch) {
      const p = at(u), n = u.xy.length, seen = column(u.stretch, p, 1, 0, n), made = column(u.stretch_model, p, 1, 0, n), k = nearest(u.time, t);
      const series = [{ x: seen, y: u.stress, kind: "dots", colour: dot, label: "measured" }];
      if (made) series.push({ x: made, y: u.stress, kind: "line", colour: model, label: u.model });
      plot($("plot-b"), series, { x: "stretch along the load", y: "stress in MPa", spot: [seen[k], u.stress[k]], none: "this point has too few neighbours for a stretch" });
    } else plot($("plot-b"), [], { none: "no stress over stretch: force or displacements are missing" });
    const own = layer.kind === "residual" ? layer : layers.find((q) => q.kind === "residual" && q.test === layer.test);
    if (own) {
      const p = own === layer ? state.point : at(own), trace = (side) => own.time.map((_, i) => valueOf(own, side, i, p));
      const series = [{ x: own.time, y: trace(0), kind: "line", colour: model, label: own.after ? "before" : "residual" }];
      if (own.after) series.push({ x: own.time, y: trace(1), kind: "line", colour: css("--other"), label: "after" });
      plot($("plot-c"), series, { x: "time in s", y: "times noise", at: t, level: [-2, 2], keep: [-3, 3] });
    } else plot($("plot-c"), [], { none: "no residual: no model has been run against these data" });
  }
  function chooseLayer(k) {
    const before = layers[state.layer], t = before ? before.time[state.time] : 0, [x, y] = before ? before.xy[state.point] || [0, 0] : [0, 0];
    state.layer = k; const layer = layers[k];
    state.time = nearest(layer.time, t);
    state.point = layer.xy.reduce((best, q, i) => (Math.hypot(q[0] - x, q[1] - y) < Math.hypot(layer.xy[best][0] - x, layer.xy[best][1] - y) ? i : best), 0);
    $("time").max = layer.time.length - 1; $("time").value = state.time;
    for (const id of ["flicker", "swap"]) $(id).disabled = !layer.after;
    if (!layer.after) state.side = 0;
  }
  function worst(layer) {
    let best = 0, most = -1, where = 0;
    for (let t = 0; t < layer.time.length; t++) {
      let s = 0, n = 0, peak = -1, point = 0;
      for (let p = 0; p < layer.xy.length; p++) { const v = valueOf(layer, 0, t, p); if (isFinite(v)) { s += v * v; n++; if (Math.abs(v) > peak) { peak = Math.abs(v); point = p; } } }
      if (n > 3 && s / n > most) { most = s / n; best = t; where = point; }
    }
    return [best, where];
  }
  function blinking(button, set) {
    let timer = null;
    const stop = () => { clearInterval(timer); timer = null; button.setAttribute("aria-pressed", "false"); };
    button.addEventListener("click", () => { if (timer) { stop(); return; } button.setAttribute("aria-pressed", "true"); timer = setInterval(() => set((s) => 1 - s), 700); });
    return stop;
  }
  if ($("map") && layers.length) {
    layers.forEach((l, k) => option($("map-what"), l.title, k));
    const draw = () => { drawMap(); curvesAt(); };
    chooseLayer(0);
    const residual = layers.find((l) => l.kind === "residual");
    if (residual) [state.time, state.point] = worst(residual);
    $("time").value = state.time;
    $("map-what").addEventListener("change", (e) => { chooseLayer(Number(e.target.value)); draw(); });
    $("map-mode").addEventListener("change", (e) => { state.mode = e.target.value; draw(); });
    $("map-limit").addEventListener("change", (e) => { state.limit = e.target.value; draw(); });
    $("time").addEventListener("input", (e) => { state.time = Number(e.target.value); draw(); });
    const stop = blinking($("flicker"), (f) => { state.side = f(state.side); drawMap(); });
    $("swap").addEventListener("click", () => { stop(); state.side = 1 - state.side; drawMap(); });
    let playing = null;
    $("play").addEventListener("click", (e) => {
      if (playing) { clearInterval(playing); playing = null; } else playing = setInterval(() => { state.time = (state.time + 1) % layers[state.layer].time.length; $("time").value = state.time; draw(); }, 160);
      e.target.setAttribute("aria-pressed", String(Boolean(playing)));
    });
    $("map").addEventListener("click", (e) => {
      const box = $("map").getBoundingClientRect(), r = layers[state.layer].raster, i = Math.floor(((e.clientX - box.left) / box.width) * r.w), j = Math.floor(((e.clientY - box.top) / box.height) * r.h), p = r.index[j * r.w + i];
      if (p >= 0) { state.point = p; draw(); }
    });
    $("map").addEventListener("keydown", (e) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[e.key], xy = layers[state.layer].xy;
      if (!step) return;
      e.preventDefault();
      const [x, y] = xy[state.point]; let best = -1, least = Infinity;
      xy.forEach((q, k) => { const a = (q[0] - x) * step[0] + (q[1] - y) * step[1], b = Math.abs((q[0] - x) * step[1]) + Math.abs((q[1] - y) * step[0]); if (a > 1e-6 && a + 3 * b < least) { least = a + 3 * b; best = k; } });
      if (best >= 0) { state.point = best; draw(); }
    });
    redraws.push(draw);
  }

  // --- records --------------------------------------------------------------------------------------------------
  if ($("record") && views.records.length) {
    let number = 0, time = 0, side = 0;
    views.records.forEach((r, k) => option($("record"), r.name, k));
    const draw = () => {
      const r = views.records[number], q = r.curves, dot = css("--dot"), model = css("--model"), late = r.residuals.find((one) => one.channel === "stress" && one.after && one.sigma);
      const model_of = (z) => late && q.measured_stress && q.measured_stress.map((v, k) => (v === null || z[k] === null || late.sigma[k] === null ? null : v + z[k] * late.sigma[k]));
      const after = late && model_of(late.after), before = late ? model_of(late.before) : q.stress;
      const line = (x, y, label, colour) => ({ x, y, kind: "line", colour, label });
      const two = (m, p, l) => [{ x: m[0], y: m[1], kind: "dots", colour: dot, label: "measured" }, ...(p ? [line(p[0], p[1], l ? "before" : "verified", model)] : []), ...(l ? [line(l[0], l[1], "after", css("--other"))] : [])];
      const t = q.time[time], strain = q.measured_strain || q.strain;
      plot($("record-a"), strain && q.measured_stress ? two([strain, q.measured_stress], before && [late ? strain : q.strain, before], after && [strain, after]) : [], { x: "strain", y: "stress in MPa", spot: [strain && strain[time], q.measured_stress && q.measured_stress[time]] });
      if (q.measured_theta) plot($("record-b"), two([q.time, q.measured_theta], q.theta_sensor && [q.time, q.theta_sensor]), { x: "time in s", y: "temperature in K", at: t });
      else plot($("record-b"), q.measured_stress ? two([q.time, q.measured_stress], before && [q.time, before], after && [q.time, after]) : [], { x: "time in s", y: "stress in MPa", at: t });
      const series = [], all = [];
      for (const one of r.residuals) { const pick = side && one.after ? one.after : one.before; all.push(...one.before, ...(one.after || [])); series.push({ x: q.time, y: pick, kind: "line", colour: series.length ? css("--other") : model, label: one.label }); }
      const known = all.filter((v) => v !== null);
      plot($("record-c"), series, { x: "time in s", y: "times noise", at: t, level: [-2, 2], keep: [-3, 3, known.reduce((a, b) => Math.min(a, b), 0), known.reduce((a, b) => Math.max(a, b), 0)], none: "no residual: no model has been run" });
      const first = r.residuals[0], pair = first && first.after;
      $("record-flicker").disabled = !pair;
      $("record-title").textContent = first ? `Residual ${pair ? (side ? "AFTER, " : "BEFORE, ") : "of "}${first.words[side && pair ? 1 : 0]}` : "";
      $("record-time").max = q.time.length - 1; $("record-time").value = time; $("record-time-text").textContent = `${fmt(t)} s`;
    };
    const worstTime = () => { const r = views.records[number], list = r.residuals[0] ? r.residuals[0].before : []; time = list.reduce((best, v, k) => (Math.abs(v || 0) > Math.abs(list[best] || 0) ? k : best), 0); };
    worstTime();
    $("record").addEventListener("change", (e) => { number = Number(e.target.value); worstTime(); draw(); });
    $("record-time").addEventListener("input", (e) => { time = Number(e.target.value); draw(); });
    blinking($("record-flicker"), (f) => { side = f(side); draw(); });
    redraws.push(draw);
  }

  // --- camera ---------------------------------------------------------------------------------------------------
  if ($("camera-picture") && views.cameras.length) {
    let number = 0, frame = 0, hidden = new Set(["points that are compared"]);
    const colours = { line: "#00e5ff", mesh: "rgba(255,255,255,.45)", dots: "#7CFC00", ring: "#ff9d00", mark: "#ff2d55" };
    const draw = () => {
      const cam = views.cameras[number], canvas = $("camera-picture"), room = canvas.closest(".card").clientWidth - 34, turn = cam.h > cam.w && room > 620, W = turn ? cam.h : cam.w, H = turn ? cam.w : cam.h;
      const f = Math.min(room / W, (turn ? 420 : 640) / H, 8), c = sized(canvas, Math.round(W * f), Math.round(H * f)), raw = bytes(cam.frames[frame]), image = new ImageData(W, H);
      for (let i = 0; i < cam.h; i++) for (let j = 0; j < cam.w; j++) { const v = raw[i * cam.w + j], k = turn ? j * W + i : i * W + j; if (v) image.data.set([...along(heat, (v - 1) / 254), 255], 4 * k); }
      const small = document.createElement("canvas"); small.width = W; small.height = H; small.getContext("2d").putImageData(image, 0, 0);
      c.imageSmoothingEnabled = false; c.drawImage(small, 0, 0, W * f, H * f);
      const at = ([x, y]) => (turn ? [(y + 0.5) * f, (x + 0.5) * f] : [(x + 0.5) * f, (y + 0.5) * f]);
      for (const layer of cam.layers) {
        if (hidden.has(layer.label)) continue;
        c.strokeStyle = c.fillStyle = colours[layer.kind]; c.lineWidth = layer.kind === "line" ? 1.8 : layer.kind === "mesh" ? 0.6 : 1.6;
        for (const line of layer.lines) {
          if (layer.kind === "line" || layer.kind === "mesh") { c.beginPath(); line.forEach((p, k) => (k ? c.lineTo(...at(p)) : c.moveTo(...at(p)))); c.stroke(); }
          else for (const p of line) { const [x, y] = at(p); c.beginPath(); if (layer.kind === "dots") c.fillRect(x - 1.2, y - 1.2, 2.4, 2.4); else if (layer.kind === "ring") { c.arc(x, y, 2.4, 0, 7); c.stroke(); } else { c.moveTo(x - 6, y); c.lineTo(x + 6, y); c.moveTo(x, y - 6); c.lineTo(x, y + 6); c.stroke(); } }
        }
      }
      $("camera-title").textContent = `${fmt(cam.range_K[frame][0] - 273.15)} to ${fmt(cam.range_K[frame][1] - 273.15)} degC${turn ? ", turned by 90 degrees" : ""}. ${cam.says}`;
      $("camera-time").max = cam.frames.length - 1; $("camera-time").value = frame; $("camera-time-text").textContent = `${fmt(cam.time[frame])} s${frame === cam.start && cam.landmarks ? ", landmarks" : ""}`;
    };
    const boxes = () => {
      const holder = $("camera-layers"); holder.replaceChildren();
      for (const layer of views.cameras[number].layers) {
        const label = document.createElement("label"), box = document.createElement("input"), swatch = document.createElement("span");
        box.type = "checkbox"; box.checked = !hidden.has(layer.label); swatch.textContent = "\u25a0"; swatch.style.color = layer.kind === "mesh" ? "#999" : colours[layer.kind];
        box.addEventListener("change", () => { if (box.checked) hidden.delete(layer.label); else hidden.add(layer.label); draw(); });
        label.append(box, swatch, document.createTextNode(layer.label)); holder.append(label);
      }
    };
    if ($("camera-which")) { views.cameras.forEach((cam, k) => option($("camera-which"), cam.name, k)); $("camera-which").addEventListener("change", (e) => { number = Number(e.target.value); frame = views.cameras[number].start; boxes(); draw(); }); }
    $("camera-time").addEventListener("input", (e) => { frame = Number(e.target.value); draw(); });
    frame = views.cameras[0].start; boxes(); redraws.push(draw);
  }

  // --- profiles and the unlisted term ---------------------------------------------------------------------------
  document.querySelectorAll("canvas.profile").forEach((canvas, k) => {
    const p = views.profiles[k];
    redraws.push(() => plot(canvas, [{ x: p.value, y: p.rise, kind: "line", colour: css("--model") }], { x: p.name + (p.unit === "1" ? "" : " in " + p.unit), y: "rise", level: [3.84], keep: [0, 4] }));
  });
  if ($("unlisted-plot") && views.unlisted) {
    const o = views.unlisted;
    redraws.push(() => plot($("unlisted-plot"), [{ x: o.time_s, low: o.value.map((v, k) => v - 2 * o.sigma[k]), high: o.value.map((v, k) => v + 2 * o.sigma[k]), kind: "band", colour: css("--band") }, { x: o.time_s, y: o.value, kind: "line", colour: css("--model") }], { x: "time in s", y: "strength in " + o.unit, keep: [0], level: [0] }));
  }

  // --- page -----------------------------------------------------------------------------------------------------
  const button = $("theme");
  button.hidden = false;
  button.addEventListener("click", () => { const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches; root.dataset.theme = dark ? "light" : "dark"; redraw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let waiting = null;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(redraw, 120); });
  redraw();
  root.dataset.ready = "yes";
})();
