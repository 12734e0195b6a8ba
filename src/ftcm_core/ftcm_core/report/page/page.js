// SPDX-License-Identifier: Apache-2.0
// Draws the plots of a report on canvases: zoom by dragging, values under the pointer, runs shown or hidden.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const root = document.documentElement;
  const DASHES = [[1.5, 2], [6, 2], [], [6, 2, 1.5, 2], [4, 2, 1.5, 2, 1.5, 2], [9, 3]];
  const COLOURS = 6;
  const ROUGH = 40; // so often a curve may cross its own range and still be a line
  const SIGNED = ["error", "sliding", "velocity"]; // of these the size counts, over decades
  const MARGIN = { left: 58, right: 8, top: 6, bottom: 20 };
  const charts = [];
  const hidden = new Set();
  let colours = {};

  function readColours() {
    const found = getComputedStyle(root);
    const names = ["paper", "ink", "soft", "line", "shade", "onset", "decision"];
    for (let k = 0; k < COLOURS; k++) names.push("run-" + k);
    for (const name of names) colours[name] = found.getPropertyValue("--" + name).trim();
  }
  const colourOf = run => colours["run-" + (run % COLOURS)];
  const dashOf = run => DASHES[(run + Math.floor(run / COLOURS)) % DASHES.length];
  const kindOf = run => (run + Math.floor(run / COLOURS)) % 3;

  // A disc, a square or a triangle.
  function shape(context, run, x, y, size = 4) {
    const kind = kindOf(run);
    context.beginPath();
    if (kind === 0) context.arc(x, y, size, 0, 7);
    else if (kind === 1) context.rect(x - 0.88 * size, y - 0.88 * size, 1.76 * size, 1.76 * size);
    else { context.moveTo(x, y - 1.25 * size); context.lineTo(x + 1.25 * size, y + size); context.lineTo(x - 1.25 * size, y + size); context.closePath(); }
    context.fill();
  }

  function decode(text, Type) {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    return new Type(bytes.buffer);
  }

  function make(tag, parent, about = {}, text = "") {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(about)) element.setAttribute(name, value);
    if (text) element.textContent = text;
    if (parent) parent.append(element);
    return element;
  }

  // ---- numbers as text ----

  const SUPERSCRIPT = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const power = n => "10" + (n < 0 ? "⁻" : "") + String(Math.abs(n)).replace(/\d/g, d => SUPERSCRIPT[d]);

  function short(x, digits = 4) {
    if (!Number.isFinite(x)) return "–";
    const size = Math.abs(x);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) return x.toExponential(digits - 1).replace("-", "−").replace("e−", "e-").replace("e+", "e");
    return String(Number(x.toPrecision(digits))).replace("-", "−");
  }

  // Round numbers that divide a range: about as many as fit.
  function ticks(lo, hi, count) {
    const raw = (hi - lo) / Math.max(1, count);
    const unit = 10 ** Math.floor(Math.log10(raw));
    const step = unit * [1, 2, 5, 10].find(f => f * unit >= raw * 0.7);
    const found = [];
    for (let k = Math.ceil(lo / step - 1e-9); k * step <= hi + 1e-9 * step; k++) found.push(k * step);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const largest = Math.max(Math.abs(lo), Math.abs(hi));
    const text = largest >= 1e5 || largest < 1e-3 ? x => short(x, 3)
      : x => (Math.abs(x) < step / 1e3 ? 0 : x).toFixed(digits).replace("-", "−");
    return found.map(x => [x, text(x)]);
  }

  function decades(lo, hi, count) {
    const first = Math.ceil(lo - 1e-9), last = Math.floor(hi + 1e-9);
    if (last <= first) return ticks(lo, hi, Math.min(count, 4)).map(([x]) => [x, short(10 ** x, 3)]);
    const every = Math.max(1, Math.ceil((last - first + 1) / Math.max(1, count)));
    const found = [];
    for (let n = first; n <= last; n++) if ((last - n) % every === 0) found.push([n, power(n)]);
    return found;
  }

  // ---- what charts of the same horizontal axis share: the range in view ----

  class View {
    constructor(lo, hi) { this.whole = [lo, hi]; [this.lo, this.hi] = this.whole; this.charts = []; this.changed = () => {}; }
    set(lo, hi) {
      if (!(hi > lo)) return;
      [this.lo, this.hi] = [lo, hi];
      this.changed();
      this.charts.forEach(chart => chart.later());
    }
    point(x) { this.charts.forEach(chart => chart.point(x)); }
  }

  // First place in ascending numbers with a value of at least x.
  function search(values, x) {
    let lo = 0, hi = values.length;
    while (lo < hi) { const mid = (lo + hi) >> 1; if (values[mid] < x) lo = mid + 1; else hi = mid; }
    return lo;
  }

  class Chart {
    // curves: run, x, y, name, dotted, stepped, ended. options: log (of y), logX, height, marks, floor.
    constructor(parent, view, title, curves, options = {}) {
      Object.assign(this, { view, curves, options, log: !!options.log });
      this.panel = make("div", parent, { class: "panel " + (options.class || "") });
      const heading = make("h4", this.panel);
      make("span", heading, {}, title);
      this.said = make("span", heading, { class: "said", "aria-live": "off" });
      this.box = make("div", this.panel, { class: "chart" });
      this.canvas = make("canvas", this.box, { role: "img", "aria-label": (options.label || "") + " " + title });
      this.line = make("i", this.box, { class: "at" });
      this.drag = make("i", this.box, { class: "drag" });
      this.pointer();
      view.charts.push(this);
      charts.push(this);
    }
    get height() { return this.options.height || (root.classList.contains("printing") ? 130 : 170); }
    get shown() { return this.curves.filter(c => !hidden.has(c.run)); }
    warp(x) { return this.options.logX ? Math.log10(x) : x; }
    unwarp(x) { return this.options.logX ? 10 ** x : x; }
    level(y) { return this.log ? (y === 0 ? NaN : Math.log10(Math.abs(y))) : y; }
    later() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => { this.waiting = false; this.draw(); });
    }

    // Part of a curve that is in view, with one point beyond on each side.
    part(curve) {
      const lo = this.unwarp(this.view.lo), hi = this.unwarp(this.view.hi);
      return [Math.max(0, search(curve.x, lo) - 1), Math.min(curve.x.length, search(curve.x, hi) + 1)];
    }

    limits() {
      if (this.options.range) return this.options.range;
      const sound = this.shown.filter(c => c.ended == null);
      const counted = sound.length ? sound : this.shown;
      const from = this.unwarp(this.view.lo) - 1e-9, to = this.unwarp(this.view.hi) + 1e-9;
      let found = new Float64Array(counted.reduce((sum, curve) => sum + curve.x.length, 0)), count = 0;
      for (const curve of counted) {
        const [a, b] = this.part(curve);
        for (let i = a; i < b; i++) {
          const y = this.level(curve.y[i]);
          if (Number.isFinite(y) && curve.x[i] >= from && curve.x[i] <= to) found[count++] = y;
        }
      }
      if (!count) return this.log ? [-1, 0] : [0, 1];
      found = found.subarray(0, count).sort();
      const at = share => found[Math.round(share * (found.length - 1))];
      let [lo, hi] = sound.length ? [found[0], found[found.length - 1]] : [at(0.1), at(0.9)];
      if (this.log) {
        lo = Math.max(lo, at(0.01) - 1.5, -14);
        hi = Math.max(hi, lo + 0.5);
        return [lo - 0.1, hi + 0.15];
      }
      const pad = 0.06 * (hi - lo) || 0.06 * Math.abs(hi) || 1e-6;
      return [lo - pad, hi + pad];
    }

    prepare() {
      const width = this.box.clientWidth;
      if (!width) return null;
      const ratio = root.classList.contains("printing") ? 2 : Math.max(1, window.devicePixelRatio || 1);
      const height = this.height;
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      this.canvas.style.width = width + "px";
      this.canvas.style.height = height + "px";
      const context = this.canvas.getContext("2d");
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
      this.left = this.options.left || MARGIN.left;
      this.area = { x: this.left, y: MARGIN.top, w: Math.max(10, width - this.left - MARGIN.right), h: height - MARGIN.top - MARGIN.bottom };
      const { x, w } = this.area, { lo, hi } = this.view;
      this.px = value => x + (this.warp(value) - lo) / (hi - lo) * w;
      return context;
    }

    axisX(context) {
      const { x, y, w, h } = this.area;
      context.fillStyle = colours.soft;
      context.strokeStyle = colours.line;
      context.lineWidth = 1;
      context.textAlign = "center";
      context.textBaseline = "top";
      const marks = (this.options.logX ? decades : ticks)(this.view.lo, this.view.hi, w / 70);
      for (const [value, text] of marks) {
        const at = x + (value - this.view.lo) / (this.view.hi - this.view.lo) * w;
        context.beginPath(); context.moveTo(at, y); context.lineTo(at, y + h); context.stroke();
        const half = context.measureText(text).width / 2;
        context.fillText(text, Math.min(Math.max(at, half), x + w + MARGIN.right - half), y + h + 5);
      }
    }

    axisY(context, lo, hi) {
      const { x, y, w, h } = this.area;
      this.py = value => y + h - (this.level(value) - lo) / (hi - lo) * h;
      context.textAlign = "right";
      context.textBaseline = "middle";
      for (const [value, text] of (this.log ? decades : ticks)(lo, hi, h / 32)) {
        const at = y + h - (value - lo) / (hi - lo) * h;
        context.beginPath(); context.moveTo(x, at); context.lineTo(x + w, at); context.stroke();
        context.fillText(text, x - 5, at);
      }
    }

    inside(context, paint) {
      const { x, y, w, h } = this.area;
      context.save();
      context.beginPath(); context.rect(x, y, w, h); context.clip();
      paint();
      context.restore();
      context.strokeStyle = colours.line;
      context.strokeRect(x, y, w, h);
    }

    // How often a curve goes up and down its own range, in view.
    roughness(curve) {
      const [a, b] = this.part(curve);
      let way = 0, lo = Infinity, hi = -Infinity, before = NaN;
      for (let i = a; i < b; i++) {
        const y = this.level(curve.y[i]);
        if (!Number.isFinite(y)) continue;
        if (Number.isFinite(before)) way += Math.abs(y - before);
        lo = Math.min(lo, y); hi = Math.max(hi, y); before = y;
      }
      return hi > lo ? way / (hi - lo) : 0;
    }

    draw() {
      const context = this.prepare();
      if (!context) return;
      this.axisX(context);
      this.axisY(context, ...this.limits());
      this.inside(context, () => {
        if (this.options.marks) this.options.marks(this, context);
        const order = this.shown.map(curve => ({ curve, rough: this.roughness(curve) }));
        order.sort((p, q) => (!!p.curve.dotted - !!q.curve.dotted) || (q.rough - p.rough));
        for (const { curve, rough } of order) {
          if (curve.dotted) this.dots(context, curve);
          else if (rough > ROUGH && this.part(curve)[1] - this.part(curve)[0] > 2 * this.area.w) this.band(context, curve);
          else this.stroke(context, curve, rough > ROUGH);
        }
      });
      this.line.style.display = "none";
    }

    // What goes up and down many times within a pixel: the area between its smallest and largest values.
    band(context, curve) {
      const [a, b] = this.part(curve), width = Math.ceil(this.area.w);
      const top = new Float64Array(width + 1).fill(Infinity), bottom = new Float64Array(width + 1).fill(-Infinity);
      for (let i = a; i < b; i++) {
        const y = this.py(curve.y[i]), column = Math.round(this.px(curve.x[i]) - this.area.x);
        if (!Number.isFinite(y) || column < 0 || column > width) continue;
        top[column] = Math.min(top[column], y);
        bottom[column] = Math.max(bottom[column], y);
      }
      const columns = [...top.keys()].filter(k => top[k] < Infinity);
      const trace = (edge, order) => order.forEach(k => context.lineTo(this.area.x + k, Math.max(-1e5, Math.min(1e5, edge[k]))));
      context.fillStyle = context.strokeStyle = colourOf(curve.run);
      context.lineWidth = 0.9;
      context.globalAlpha = 0.4;
      context.beginPath(); trace(top, columns); trace(bottom, [...columns].reverse()); context.fill();
      context.globalAlpha = 1;
      for (const edge of [top, bottom]) { context.beginPath(); trace(edge, columns); context.stroke(); }
    }

    // A dot every few pixels, which lets one see the line that it is compared with.
    dots(context, curve) {
      context.fillStyle = colours.ink;
      for (let at = 3; at < this.area.w; at += 7) {
        const x = this.unwarp(this.view.lo + at / this.area.w * (this.view.hi - this.view.lo));
        const i = this.nearest(curve, x), y = this.py(curve.y[i]);
        if (!Number.isFinite(y) || Math.abs(this.px(curve.x[i]) - this.area.x - at) > 7) continue;
        context.beginPath(); context.arc(this.px(curve.x[i]), y, 1.3, 0, 7); context.fill();
      }
    }

    // Place of the recorded value nearest to a time; of a stepped curve, of the step.
    nearest(curve, x) {
      let i = search(curve.x, x);
      if (i === curve.x.length || (i > 0 && (curve.stepped ? curve.x[i] > x : x - curve.x[i - 1] < curve.x[i] - x))) i--;
      return i;
    }

    stroke(context, curve, rough) {
      const [a, b] = this.part(curve);
      context.strokeStyle = colourOf(curve.run);
      context.globalAlpha = rough ? 0.7 : 1;
      context.lineWidth = rough ? 0.9 : 1.6;
      context.setLineDash(rough ? [] : dashOf(curve.run));
      context.lineJoin = "round";
      context.beginPath();
      let pen = false, last = 0;
      for (let i = a; i < b; i++) {
        const y = this.py(curve.y[i]);
        if (!Number.isFinite(y)) { pen = false; continue; }
        const x = this.px(curve.x[i]), clipped = Math.max(-1e5, Math.min(1e5, y));
        if (!pen) context.moveTo(x, clipped);
        else { if (curve.stepped) context.lineTo(x, last); context.lineTo(x, clipped); }
        pen = true;
        last = clipped;
      }
      context.stroke();
      context.setLineDash([]);
      context.globalAlpha = 1;
    }

    // ---- pointer ----

    point(x) {
      if (!this.area) return;
      if (x == null) { this.line.style.display = "none"; this.said.textContent = ""; return; }
      const at = this.px(x);
      Object.assign(this.line.style, { display: "block", left: at + "px", top: this.area.y + "px", height: this.area.h + "px" });
      this.tell(x);
    }

    tell(x) {
      this.said.textContent = "";
      make("span", this.said, {}, (this.options.nameX || "t") + " = " + short(x, 6) + " ");
      for (const curve of this.shown) {
        if (!curve.x.length) continue;
        const name = this.box.clientWidth > 560 ? ` ${curve.name} ` : " ";
        const value = make("b", this.said, {}, name + short(curve.y[this.nearest(curve, x)], 3));
        value.style.color = curve.dotted ? colours.ink : colourOf(curve.run);
        value.title = curve.name;
        if (curve.dotted) value.prepend("·");
      }
    }

    pointer() {
      const value = event => {
        const x = event.clientX - this.box.getBoundingClientRect().left;
        const share = Math.max(0, Math.min(1, (x - this.area.x) / this.area.w));
        return this.view.lo + share * (this.view.hi - this.view.lo);
      };
      let begin = null;
      this.box.addEventListener("pointerdown", event => {
        if (event.button !== 0 || !this.area) return;
        begin = value(event);
        this.view.point(this.unwarp(begin));
        this.box.setPointerCapture(event.pointerId);
      });
      this.box.addEventListener("pointermove", event => {
        if (!this.area) return;
        const x = value(event);
        this.view.point(this.unwarp(x));
        if (begin === null) return;
        const [a, b] = [this.px(this.unwarp(Math.min(begin, x))), this.px(this.unwarp(Math.max(begin, x)))];
        Object.assign(this.drag.style, { display: "block", left: a + "px", width: b - a + "px", top: this.area.y + "px", height: this.area.h + "px" });
      });
      const end = event => {
        this.drag.style.display = "none";
        if (begin === null) return;
        const [a, b] = [Math.min(begin, value(event)), Math.max(begin, value(event))];
        begin = null;
        if (event.type === "pointerup" && (b - a) / (this.view.hi - this.view.lo) * this.area.w > 6) this.view.set(a, b);
      };
      this.box.addEventListener("pointerup", end);
      this.box.addEventListener("pointercancel", end);
      this.box.addEventListener("pointerleave", event => {
        if (begin === null && event.pointerType !== "touch") this.view.point(null); // a finger leaves, what it showed stays
      });
      this.box.addEventListener("dblclick", () => this.view.set(...this.view.whole));
    }
  }

  // Rows of bars and marks over time: what broke, what was noticed, what was done.
  class Timeline extends Chart {
    constructor(parent, view, rows) {
      super(parent, view, "Faults, alarms, decisions over t, s", [], { left: 10, class: "timeline", label: "timeline" });
      this.rows = rows;
    }
    get inView() { return this.rows.filter(row => !row.runs.every(run => hidden.has(run))); }
    get height() { return MARGIN.top + MARGIN.bottom + 30 * Math.max(1, this.inView.length); }
    draw() {
      const context = this.prepare();
      if (!context) return;
      this.axisX(context);
      this.inside(context, () => this.inView.forEach((row, k) => {
        const top = this.area.y + 30 * k;
        const colour = row.fault ? colours.onset : colourOf(row.runs[0]);
        if (k) { context.strokeStyle = colours.line; context.beginPath(); context.moveTo(this.area.x, top); context.lineTo(this.area.x + this.area.w, top); context.stroke(); }
        context.fillStyle = colour;
        for (const [a, b] of row.bars) {
          const x = this.px(a);
          context.globalAlpha = row.fault ? 0.55 : 0.8;
          context.fillRect(x, top + 17, Math.max(1.5, this.px(b) - x), 9);
        }
        context.globalAlpha = 1;
        for (const [t] of row.marks) {
          const x = this.px(t);
          context.beginPath(); context.moveTo(x, top + 15); context.lineTo(x + 5, top + 21.5); context.lineTo(x, top + 28); context.lineTo(x - 5, top + 21.5); context.fill();
        }
        context.fillStyle = colours.ink;
        context.textAlign = "left"; context.textBaseline = "top";
        context.fillText(row.name, this.area.x + 5, top + 4);
      }));
    }
    tell(t) {
      const near = 4 / this.area.w * (this.view.hi - this.view.lo);
      const found = ["t = " + short(t, 6) + " s"];
      for (const row of this.inView) {
        const bars = row.bars.filter(([a, b]) => a - near <= t && t <= b + near).map(([a, b, text]) => `${text || ""} ${short(a, 6)}–${short(b, 6)} s`);
        const marks = row.marks.filter(([at]) => Math.abs(at - t) <= near).map(([at, text]) => `${text} at ${short(at, 6)} s`);
        const all = [...bars.slice(0, 3), ...marks.slice(0, 3)];
        if (all.length) found.push(`${row.name}: ${all.join(", ")}`);
      }
      this.said.textContent = found.join(" · ");
    }
  }

  // Quantiles of each law: least, 5 %, quarter, median, three quarters, 95 %, largest.
  class Boxes extends Chart {
    get height() { return MARGIN.top + MARGIN.bottom + 36 * Math.max(1, this.shown.length); }
    draw() {
      const context = this.prepare();
      if (!context) return;
      this.axisX(context);
      this.inside(context, () => this.shown.forEach((curve, k) => {
        const middle = this.area.y + 36 * k + 24;
        context.fillStyle = colours.ink;
        context.textAlign = "left"; context.textBaseline = "top";
        const missing = curve.of - curve.count;
        context.fillText(curve.name + (missing ? `: ${missing} of ${curve.of} not on the axis` : ""), this.area.x + 5, this.area.y + 36 * k + 2, this.area.w - 10);
        if (!curve.box) return;
        const [least, low, quarter, median, three, high, most] = curve.box.map(x => Math.max(-1e5, Math.min(1e5, this.px(x))));
        context.strokeStyle = context.fillStyle = colourOf(curve.run);
        context.lineWidth = 1.4;
        context.beginPath();
        context.moveTo(low, middle); context.lineTo(quarter, middle); context.moveTo(three, middle); context.lineTo(high, middle);
        for (const x of [low, high]) { context.moveTo(x, middle - 5); context.lineTo(x, middle + 5); }
        context.stroke();
        context.globalAlpha = 0.25; context.fillRect(quarter, middle - 8, three - quarter, 16); context.globalAlpha = 1;
        context.strokeRect(quarter, middle - 8, three - quarter, 16);
        context.lineWidth = 2.5;
        context.beginPath(); context.moveTo(median, middle - 8); context.lineTo(median, middle + 8); context.stroke();
        for (const x of [least, most]) { context.beginPath(); context.arc(x, middle, 2, 0, 7); context.fill(); }
      }));
    }
    tell() {
      this.said.textContent = "";
      for (const curve of this.shown) if (curve.box) {
        const value = make("b", this.said, {}, ` ${curve.name}: ${short(curve.box[3], 3)} [${short(curve.box[1], 3)}, ${short(curve.box[5], 3)}]`);
        value.style.color = colourOf(curve.run);
      }
    }
  }

  // One row per case, one dot per run.
  class Dots extends Chart {
    get height() { return MARGIN.top + MARGIN.bottom + 17 * this.options.cases.length; }
    draw() {
      this.options.left = this.box.clientWidth > 600 ? 250 : 120;
      const context = this.prepare();
      if (!context) return;
      this.axisX(context);
      const { x, y, w } = this.area;
      this.options.cases.forEach((name, k) => {
        const middle = y + 17 * k + 8.5;
        context.fillStyle = colours.ink; context.textAlign = "right"; context.textBaseline = "middle";
        context.fillText(name, x - 6, middle, x - 8);
        context.strokeStyle = colours.line;
        context.beginPath(); context.moveTo(x, middle); context.lineTo(x + w, middle); context.stroke();
      });
      this.inside(context, () => {
        for (const curve of this.shown) curve.x.forEach((value, i) => {
          context.fillStyle = colourOf(curve.run);
          shape(context, curve.run, this.px(value), y + 17 * curve.row[i] + 8.5);
        });
      });
    }
    tell(x) { this.said.textContent = short(x, 3); }
  }

  // Two values of each run: dots, medians with bars, and the Pareto front of the medians.
  class Scatter extends Chart {
    get height() { return 300; }
    limits() { return this.options.range; }
    draw() {
      const context = this.prepare();
      if (!context) return;
      this.axisX(context);
      this.axisY(context, ...this.limits());
      const { x, y, w, h } = this.area;
      const marked = this.shown.filter(c => c.middle.every(Number.isFinite));
      this.inside(context, () => {
        for (const curve of this.shown) {
          context.fillStyle = colourOf(curve.run);
          context.globalAlpha = 0.3;
          curve.x.forEach((value, i) => { context.beginPath(); context.arc(this.px(value), this.py(curve.y[i]), 1.6, 0, 7); context.fill(); });
          context.globalAlpha = 1;
        }
        const front = marked.filter(c => c.front).sort((p, q) => p.middle[0] - q.middle[0]);
        context.strokeStyle = colours.soft;
        context.lineWidth = 1.2;
        context.beginPath();
        front.forEach((c, k) => {
          const at = this.px(c.middle[0]);
          context[k ? "lineTo" : "moveTo"](at, k ? this.py(front[k - 1].middle[1]) : y);
          context.lineTo(at, this.py(c.middle[1]));
          if (k === front.length - 1) context.lineTo(x + w, this.py(c.middle[1]));
        });
        context.stroke();
        for (const curve of marked) {
          const [cx, cy] = [this.px(curve.middle[0]), this.py(curve.middle[1])];
          const [[left, , right], [low, , high]] = curve.spread;
          context.strokeStyle = context.fillStyle = colourOf(curve.run);
          context.lineWidth = 1.4;
          context.beginPath();
          context.moveTo(this.px(left), cy); context.lineTo(right == null ? cx : this.px(right), cy);
          context.moveTo(cx, this.py(low)); context.lineTo(cx, high == null ? cy : this.py(high));
          context.stroke();
          context.setLineDash([1.5, 3]); // beyond the edge
          context.beginPath();
          if (right == null) { context.moveTo(cx, cy); context.lineTo(x + w, cy); }
          if (high == null) { context.moveTo(cx, cy); context.lineTo(cx, y); }
          context.stroke();
          context.setLineDash([]);
          shape(context, curve.run, cx, cy, 5);
          if (!curve.front) continue;
          context.strokeStyle = colours.ink;
          context.beginPath(); context.arc(cx, cy, 9, 0, 7); context.stroke();
        }
        this.names(context, marked);
      });
      context.fillStyle = colours.soft;
      context.textAlign = "left"; context.textBaseline = "top";
      context.fillText("mean |e|, rad", x + 5, y + 4);
      context.textAlign = "right"; context.textBaseline = "bottom";
      context.fillText("torque variation, N·m/s", x + w - 5, y + h - 4);
    }

    // The names beside the marks, where there is place for them.
    names(context, marked) {
      const { x, y, w, h } = this.area;
      const taken = marked.map(c => { const [cx, cy] = [this.px(c.middle[0]), this.py(c.middle[1])]; return [cx - 7, cy - 7, cx + 7, cy + 7]; });
      taken.push([x, y, x + 80, y + 17], [x + w - 135, y + h - 17, x + w, y + h]);
      context.textAlign = "left"; context.textBaseline = "middle";
      for (const curve of marked) {
        const [cx, cy] = [this.px(curve.middle[0]), this.py(curve.middle[1])], width = context.measureText(curve.name).width;
        const places = [];
        for (const away of [0, -14, 14, -28, 28, -42, 42]) places.push([cx + 12, cy + away], [cx - 12 - width, cy + away]);
        const free = ([a, b]) => a >= x && a + width <= x + w && b - 6 >= y && b + 6 <= y + h
          && !taken.some(t => a < t[2] && a + width > t[0] && b - 6 < t[3] && b + 6 > t[1]);
        const [a, b] = places.find(free) || [Math.max(x + 2, Math.min(cx + 12, x + w - width - 2)), cy - 14];
        taken.push([a, b - 6, a + width, b + 6]);
        context.lineWidth = 3; context.strokeStyle = colours.paper; context.strokeText(curve.name, a, b);
        context.fillStyle = colours.ink;
        context.fillText(curve.name, a, b);
      }
    }
    tell() {
      this.said.textContent = "";
      for (const curve of this.shown) {
        const value = make("b", this.said, {}, ` ${curve.name}: ${short(curve.middle[1], 3)} at ${short(curve.middle[0], 3)}`);
        value.style.color = colourOf(curve.run);
      }
    }
  }

  // A value with its interval, from -1 to 1, of each law.
  class Intervals extends Chart {
    get height() { return MARGIN.top + MARGIN.bottom + 16 * Math.max(1, this.shown.length); }
    draw() {
      this.options.left = 8;
      const context = this.prepare();
      if (!context) return;
      this.axisX(context);
      const { x, y, w, h } = this.area, zero = this.px(0);
      this.inside(context, () => {
        context.strokeStyle = colours.onset;
        context.beginPath(); context.moveTo(zero, y); context.lineTo(zero, y + h); context.stroke();
        context.textBaseline = "middle";
        this.shown.forEach((curve, k) => {
          const cy = y + 16 * k + 8, [value, low, high] = curve.values || [0, 0, 0];
          const text = curve.values ? curve.name : curve.name + ": the same in every run";
          const [a, b] = [this.px(low), this.px(high)], width = context.measureText(text).width;
          if (curve.values) {
            context.strokeStyle = context.fillStyle = colourOf(curve.run);
            context.lineWidth = 2;
            context.beginPath(); context.moveTo(a, cy); context.lineTo(b, cy); context.stroke();
            shape(context, curve.run, this.px(value), cy);
          }
          const right = b + 9 + width < x + w;
          context.textAlign = right ? "left" : "right";
          context.fillStyle = colours.ink;
          context.fillText(text, right ? b + 9 : a - 9, cy);
        });
      });
    }
    tell() {
      this.said.textContent = "";
      for (const curve of this.shown) if (curve.values) {
        const [value, low, high] = curve.values.map(x => short(x, 2));
        make("b", this.said, {}, ` ${curve.name}: ${value} [${low}, ${high}]`).style.color = colourOf(curve.run);
      }
    }
  }

  // ---- controls ----

  function button(parent, text, pressed, act, kind = "") {
    const element = make("button", parent, { type: "button", class: kind, "aria-pressed": pressed }, text);
    element.addEventListener("click", () => act(element));
    return element;
  }

  function swatch(run) {
    if (data.suite) {
      const mark = make("span", null, { class: "mark" }, "●■▲"[kindOf(run)]);
      mark.style.color = `var(--run-${run % COLOURS})`;
      return mark;
    }
    const dash = dashOf(run).join(" "), space = "http://www.w3.org/2000/svg";
    const svg = document.createElementNS(space, "svg");
    svg.setAttribute("class", "swatch");
    const line = document.createElementNS(space, "line");
    for (const [name, value] of Object.entries({ x1: 0, x2: "100%", y1: "50%", y2: "50%", "stroke-width": 3, "stroke-dasharray": dash }))
      line.setAttribute(name, value);
    line.style.stroke = `var(--run-${run % COLOURS})`;
    svg.append(line);
    return svg;
  }

  function runButtons(bar, labels) {
    const group = make("div", bar, { class: "runs", role: "group", "aria-label": "runs" });
    labels.forEach((label, run) => {
      const element = button(group, "", true, () => {
        if (!hidden.delete(run)) hidden.add(run);
        element.setAttribute("aria-pressed", !hidden.has(run));
        charts.forEach(chart => chart.later());
      }, "run");
      element.append(swatch(run), label);
    });
  }

  function oneOf(bar, label, names, first, act) {
    const group = make("div", bar, { role: "group", "aria-label": label });
    const buttons = names.map((name, k) => button(group, name, k === first, () => {
      buttons.forEach((other, j) => other.setAttribute("aria-pressed", j === k));
      act(k);
    }));
  }

  function tick(bar, text, checked, act) {
    const label = make("label", make("div", bar));
    const box = make("input", label, { type: "checkbox" });
    box.checked = checked;
    label.append(text);
    box.addEventListener("change", () => act(box.checked));
  }

  // ---- the plots of runs ----

  function faultMarks(chart, context) {
    const { y, h } = chart.area;
    for (const fault of data.faults) {
      if (fault.runs.every(run => hidden.has(run))) continue;
      const begin = chart.px(fault.onset);
      const end = fault.end == null ? 1e5 : chart.px(fault.end);
      context.fillStyle = colours.shade;
      context.fillRect(begin, y, Math.min(end, 1e5) - begin, h);
      context.strokeStyle = colours.onset;
      context.setLineDash([3, 3]);
      context.lineWidth = 1;
      context.beginPath(); context.moveTo(begin, y); context.lineTo(begin, y + h); context.stroke();
    }
    context.strokeStyle = colours.decision;
    context.setLineDash([6, 2, 1, 2]);
    for (const row of data.rows) if (!row.end && !hidden.has(row.run)) for (const [t] of row.marks.slice(0, 50)) {
      context.beginPath(); context.moveTo(chart.px(t), y); context.lineTo(chart.px(t), y + h); context.stroke();
    }
    context.setLineDash([]);
  }

  function showRuns(place) {
    const view = new View(data.first, data.last);
    const bar = make("div", place, { class: "bar" });
    runButtons(bar, data.runs.map(run => run.label + (run.status === "completed" ? "" : ` (${run.status.replace("_", " ")})`)));
    const panels = [];
    const single = data.joints.length === 1;
    const showJoint = k => {
      panels.forEach(([joint, chart]) => { chart.panel.style.display = !k || joint === k - 1 ? "" : "none"; });
      charts.forEach(chart => chart.later());
    };
    const first = root.clientWidth < 640 ? 1 : 0; // on a phone one joint at a time
    if (!single) oneOf(bar, "joints", ["all joints", ...data.joints], first, showJoint);
    const spans = make("div", bar, { role: "group", "aria-label": "time" });
    for (const [name, lo, hi] of data.spans) {
      const element = make("button", spans, { type: "button" }, name);
      element.addEventListener("click", () => view.set(lo, hi));
    }
    const from = make("input", null, { type: "number", step: "any", "aria-label": "from, s" });
    const to = make("input", null, { type: "number", step: "any", "aria-label": "to, s" });
    spans.append(from, "–", to, "s");
    view.changed = () => { from.value = Number(view.lo.toPrecision(7)); to.value = Number(view.hi.toPrecision(7)); };
    for (const input of [from, to]) input.addEventListener("change", () => view.set(Number(from.value), Number(to.value)));
    view.changed();
    tick(bar, "|e|, |σ|, |ė| logarithmic", true, on => {
      panels.forEach(([, chart, key]) => { if (SIGNED.includes(key)) { chart.log = on; chart.later(); } });
    });
    make("p", place, { class: "note" }, "Grey: a fault acts, from the dashed line on. Green line: a decision or a change.");
    make("p", place, { class: "note hint" }, "Drag over a plot to zoom into that time, in all of them; double-click for the whole run.");
    const everyone = data.runs.map((_, run) => run);
    const rows = [
      ...data.faults.map(f => ({ name: "fault " + f.label + (f.runs.length < data.runs.length ? ` (${f.runs.map(r => data.runs[r].label).join(", ")})` : ""), fault: true, runs: f.runs, bars: [[f.onset, f.end ?? data.last, f.end == null ? "to the end," : ""]], marks: [] })),
      ...data.rows.map(row => ({ ...row, runs: [row.run] })),
    ];
    if (!rows.length) rows.push({ name: "no fault, no detector, no policy", fault: true, runs: everyone, bars: [], marks: [] });
    new Timeline(place, view, rows);
    for (const quantity of data.quantities) {
      const figure = make("figure", place);
      const heading = make("h3", figure, {}, quantity.title + " ");
      make("small", heading, {}, quantity.unit);
      const grid = make("div", figure, { class: "panels" });
      data.joints.forEach((joint, j) => {
        const curves = quantity.curves.filter(c => c.joint === j).map(c => {
          const run = data.runs[c.run];
          return {
            run: c.run, dotted: c.dotted, ended: run.ended, name: run.label + (c.dotted ? " (dots)" : ""),
            x: Float64Array.from(decode(c.ticks, Uint32Array), tick => run.first + tick * run.dt),
            y: decode(c.values, Float32Array),
          };
        });
        const chart = new Chart(grid, view, joint, curves, { log: SIGNED.includes(quantity.key), marks: faultMarks, label: quantity.title });
        panels.push([j, chart, quantity.key]);
      });
    }
    if (!single) showJoint(first);
  }

  // ---- distributions: x and y of each curve as they are ----

  function showCurves(place, plots) {
    const grid = make("div", place, { class: "panels" });
    for (const plot of plots) {
      const curves = plot.curves.map(c => ({ ...c, name: data.runs[c.run].label }));
      const xs = curves.flatMap(c => c.x);
      const [lo, hi] = [Math.min(...xs), Math.max(...xs)].map(x => plot.logX ? Math.log10(x) : x);
      const view = new View(lo, hi > lo ? hi : lo + 1);
      new Chart(grid, view, plot.title, curves, { logX: plot.logX, log: plot.logY, range: plot.range, nameX: plot.unit, height: 210 });
    }
  }

  // ---- campaigns: the distribution of a metric over the runs ----

  function showCampaign(place) {
    const campaign = data.campaign;
    const bar = make("div", place, { class: "bar" });
    runButtons(bar, data.runs.map(run => run.label));
    const groups = campaign.groups.filter(group => group.columns.length);
    let group = groups[0];
    if (groups.length > 1) oneOf(bar, "scenario", groups.map(one => one.name), 0, k => { group = groups[k]; offer(); });
    const choice = make("select", make("label", make("div", bar)), { "aria-label": "metric" });
    make("p", place, { class: "note" }, campaign.note);
    const grid = make("div", place, { class: "panels" });
    const own = [];
    const offer = () => {
      const before = choice.selectedIndex > 0 ? choice.selectedOptions[0].textContent : "";
      choice.textContent = "";
      group.columns.forEach((column, k) => { make("option", choice, { value: k }, column.name).selected = column.name === before; });
      build();
    };
    const build = () => {
      for (const chart of own.splice(0)) charts.splice(charts.indexOf(chart), 1);
      grid.textContent = "";
      const column = group.columns[choice.value];
      column.joints.forEach((laws, j) => {
        const curves = laws.map(law => {
          const x = decode(law.sample, Float32Array);
          const y = Float64Array.from(x, (_, i) => (x.length > 1 ? i * (law.count - 1) / (x.length - 1) + 1 : 1) / law.of);
          return { ...law, x, y, stepped: true, name: data.runs[law.run].label };
        });
        const cell = make("div", grid), boxes = curves.filter(c => c.box).map(c => c.box);
        if (!boxes.length) { make("p", cell, { class: "note" }, `joint ${j + 1}: no value`); return; }
        const least = Math.min(...boxes.map(box => box[0])), most = Math.max(...boxes.map(box => box[6]));
        const logX = least > 0 && most / least > 30;
        const ends = [least, most].map(x => logX ? Math.log10(x) : x), pad = 0.04 * (ends[1] - ends[0]) || Math.abs(ends[0]) * 0.05 || 1;
        const view = new View(ends[0] - pad, ends[1] + pad);
        const title = column.joints.length > 1 || column.perJoint ? "joint " + (j + 1) : "";
        const options = { logX, nameX: column.unit, label: column.name };
        own.push(new Boxes(cell, view, title, curves, options));
        own.push(new Chart(cell, view, "share of runs at or below", curves, { ...options, range: [0, 1.02], height: 190 }));
      });
      own.forEach(chart => chart.draw());
    };
    choice.addEventListener("change", build);
    offer();
  }

  // Panels of each scenario of a campaign, below its name.
  function perScenario(place, panels, show) {
    for (const group of data.campaign.groups) if (group[panels].length) {
      if (group.name) make("h3", place, {}, group.name);
      const grid = make("div", place, { class: "panels" });
      for (const panel of group[panels]) show(grid, panel);
    }
  }

  function showTradeoff(grid, panel) {
    const curves = panel.laws.map(law => ({
      ...law, name: data.runs[law.run].label, x: decode(law.x, Float32Array), y: decode(law.y, Float32Array),
      middle: law.spread.map(three => three[1] == null ? NaN : three[1]),
    }));
    const ends = [0, 1].map(axis => {
      const values = curves.flatMap(c => [...(axis ? c.y : c.x), ...c.spread[axis]]).filter(v => v != null);
      const log = values.length > 0 && Math.min(...values) > 0;
      const [lo, hi] = [Math.min(...values), Math.max(...values)].map(v => log ? Math.log10(v) : v);
      const pad = 0.06 * (hi - lo) || Math.abs(lo) * 0.05 || 1;
      return { log, range: [lo - pad, hi + pad] };
    });
    const view = new View(...ends[0].range);
    new Scatter(grid, view, panel.title, curves, { logX: ends[0].log, log: ends[1].log, range: ends[1].range, label: "error against torque variation," });
  }

  function showSensitivity(grid, panel) {
    const curves = panel.marks.map(mark => ({ ...mark, name: data.runs[mark.run].label }));
    new Intervals(grid, new View(-1.05, 1.05), panel.title, curves, { label: "rank correlation of the error with" });
  }

  function showSuite(place) {
    const bar = make("div", place, { class: "bar" });
    runButtons(bar, data.runs.map(run => run.label));
    for (const plot of data.suite) {
      const xs = plot.curves.flatMap(c => c.x);
      if (!xs.length) continue;
      const view = new View(Math.log10(Math.min(...xs)) - 0.1, Math.log10(Math.max(...xs)) + 0.1);
      new Dots(place, view, plot.title, plot.curves, { logX: true, cases: plot.cases, label: plot.title });
    }
  }

  // ---- begin ----

  function redraw() {
    readColours();
    charts.forEach(chart => chart.draw());
  }
  readColours();
  const at = id => document.getElementById(id);
  if (at("plots-here") && data.quantities) showRuns(at("plots-here"));
  if (at("timing-here") && data.timing) showCurves(at("timing-here"), data.timing);
  if (at("campaign-here") && data.campaign) showCampaign(at("campaign-here"));
  if (at("tradeoff-here")) perScenario(at("tradeoff-here"), "tradeoff", showTradeoff);
  if (at("sensitivity-here")) perScenario(at("sensitivity-here"), "sensitivity", showSensitivity);
  if (at("suite-here") && data.suite) showSuite(at("suite-here"));
  redraw();
  let width = root.clientWidth;
  window.addEventListener("resize", () => { if (root.clientWidth !== width) { width = root.clientWidth; charts.forEach(chart => chart.later()); } });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  const printing = on => { root.classList.toggle("printing", on); redraw(); };
  window.addEventListener("beforeprint", () => printing(true));
  window.addEventListener("afterprint", () => printing(false));
  root.dataset.drawn = "yes";
})();
