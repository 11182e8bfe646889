"use strict";
// Charts on canvases: an image with axes, marks and lines; pan and zoom by pointer, wheel and keys.
(() => {
  const page = JSON.parse(document.getElementById("page-data").textContent);
  const style = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const SYMBOL = 6, SYMBOLS = ["ring", "plus", "cross", "diamond"];
  const heat = (level) => {
    const stops = page.heat, at = Math.max(0, Math.min(1, level)) * (stops.length - 1);
    const i = Math.min(stops.length - 2, Math.floor(at)), t = at - i;
    return stops[i].map((low, k) => Math.round(low + t * (stops[i + 1][k] - low)));
  };
  const rgb = (c) => `rgb(${c[0]},${c[1]},${c[2]})`;
  // Of marks and lines on the page's own ground: without the levels that are as dark, or as bright.
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const onGround = (level) => rgb(heat(dark.matches ? 0.3 + 0.7 * level : 0.88 * level));
  page.colourOf = (level) => rgb(heat(level));

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

  const painted = (image, alpha) => {
    const canvas = document.createElement("canvas");
    canvas.width = image.columns;
    canvas.height = image.rows;
    const context = canvas.getContext("2d");
    const pixels = context.createImageData(image.columns, image.rows);
    image.levels = bytes(image.data);
    image.levels.forEach((level, i) => {
      if (!level) return;
      const part = (level - 1) / 254;
      const colour = image.colours === "grey" ? [255 * part, 255 * part, 255 * part] : heat(part);
      pixels.data.set([...colour, alpha], 4 * i);
    });
    context.putImageData(pixels, 0, 0);
    return canvas;
  };

  const digits = (value) =>
    value === 0 ? "0" : Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3
      ? value.toExponential(1) : String(Number(value.toPrecision(4)));

  const ticks = (low, high, count) => {
    const raw = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw) || raw;
    const found = [];
    for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step && found.length < 50; v += step)
      found.push(Math.abs(v) < 1e-9 * step ? 0 : Number(v.toPrecision(12)));
    return found;
  };

  const NARROW = 560;
  // A plan on a narrow page: what is ahead of the rig is up.
  const upright = (spec) => {
    const { ahead, across, sign } = spec.upright;
    const times = (values, by) => values.map((v) => (v === null ? null : by * v));
    const span = (axis, by, name) => by > 0 ? { ...axis, name } : { low: -axis.high, high: -axis.low, name };
    return {
      ...spec,
      x: span(spec.y, -sign, across),
      y: span(spec.x, sign, ahead),
      layers: spec.layers.map((l) => ({
        ...l, x: times(l.y, -sign), y: times(l.x, sign), errors: l.errors && [l.errors[1], l.errors[0]],
      })),
    };
  };

  class Chart {
    constructor(figure, spec) {
      this.figure = figure;
      this.specs = { wide: spec, narrow: spec.upright ? upright(spec) : spec };
      this.spec = spec;
      this.canvas = figure.querySelector("canvas");
      this.tip = figure.querySelector(".tip");
      this.hidden = new Set(spec.layers.filter((l) => l.off).map((l) => l.name));
      this.pictures = [
        ...(spec.image ? [[spec.image, painted(spec.image, 255)]] : []),
        ...(spec.overlays || []).map((image) => [image, painted(image, 115)]),
      ];
      this.reset();
      this.legend();
      this.listen();
      new ResizeObserver(() => this.draw()).observe(this.canvas);
    }

    reset() {
      const { x, y } = this.spec;
      this.view = { x0: x.low, x1: x.high, y0: y.low, y1: y.high };
      this.zoomed = false;
      this.canvas.style.touchAction = "pan-y";
    }

    legend() {
      const box = this.figure.querySelector(".legend");
      if (!box) return;
      const entries = new Map();
      for (const image of this.spec.overlays || []) entries.set(image.name, { mark: "heat" });
      for (const layer of this.spec.layers) entries.set(layer.name, layer);
      for (const [name, layer] of entries) {
        const button = document.createElement("button");
        button.type = "button";
        button.setAttribute("aria-pressed", String(!this.hidden.has(name)));
        const sample = document.createElement("canvas");
        sample.width = sample.height = 36;
        sample.setAttribute("aria-hidden", "true");
        button.append(sample, name);
        button.addEventListener("click", () => {
          this.hidden.has(name) ? this.hidden.delete(name) : this.hidden.add(name);
          button.setAttribute("aria-pressed", String(!this.hidden.has(name)));
          this.draw();
        });
        box.append(button);
        (this.samples ||= []).push([sample, layer]);
      }
      const scaled = this.spec.image && this.spec.image.unit ? this.spec.image
        : (this.spec.overlays || [])[0] || null;
      const scale = scaled ? [scaled.low, scaled.high, scaled.unit, scaled.log]
        : this.spec.scale ? [...this.spec.scale, "dB SNR"] : null;
      if (scale) {
        const bar = document.createElement("div");
        bar.className = "scale";
        const said = (v) => digits(scale[3] ? 10 ** v : v);
        const strip = document.createElement("i");
        const paint = () => {
          const colour = scaled ? (level) => rgb(heat(level)) : onGround;
          const gradient = Array.from({ length: 9 }, (_, i) => colour(i / 8)).join(",");
          strip.style.background = `linear-gradient(90deg,${gradient})`;
        };
        paint();
        dark.addEventListener("change", paint);
        const first = document.createElement("span"), last = document.createElement("span");
        first.textContent = said(scale[0]);
        last.textContent = `${said(scale[1])} ${scale[2]}${scale[3] ? " (logarithmic)" : ""}`;
        bar.append(first, strip, last);
        box.append(bar);
      }
    }

    frame() {
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
      const axes = this.spec.axes;
      const box = axes ? { l: this.margin || 52, t: 8, r: width - 10, b: height - 40 }
        : { l: 0, t: 0, r: width, b: height };
      const v = { ...this.view };
      if (this.spec.equal) {
        const sx = (v.x1 - v.x0) / (box.r - box.l), sy = (v.y1 - v.y0) / (box.b - box.t);
        const s = Math.max(sx, sy), cx = (v.x0 + v.x1) / 2, cy = (v.y0 + v.y1) / 2;
        v.x0 = cx - (s * (box.r - box.l)) / 2; v.x1 = cx + (s * (box.r - box.l)) / 2;
        v.y0 = cy - (s * (box.b - box.t)) / 2; v.y1 = cy + (s * (box.b - box.t)) / 2;
      }
      const X = (x) => box.l + ((x - v.x0) / (v.x1 - v.x0)) * (box.r - box.l);
      const Y = (y) => box.b - ((y - v.y0) / (v.y1 - v.y0)) * (box.b - box.t);
      return { width, height, box, v, X, Y };
    }

    colour(layer, i) {
      // Over a picture the colours of the dark scheme stand out in both.
      if (this.spec.image && !layer.levels.length && layer.colour === "orange") return "#ff9a52";
      if (layer.levels.length && layer.levels[i] !== null) {
        return this.spec.image ? rgb(heat(layer.levels[i])) : onGround(layer.levels[i]);
      }
      if (layer.colour === "white") return "#fff";
      return style(layer.colour) || layer.colour;
    }

    draw() {
      const ratio = window.devicePixelRatio || 1;
      const f = this.frame();
      if (!f.width || !f.height) return;
      const fitting = this.specs[f.width < NARROW ? "narrow" : "wide"];
      if (this.spec !== fitting) { this.spec = fitting; this.reset(); return this.draw(); }
      this.canvas.width = Math.round(f.width * ratio);
      this.canvas.height = Math.round(f.height * ratio);
      const c = this.canvas.getContext("2d");
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.clearRect(0, 0, f.width, f.height);
      c.font = "12px system-ui, sans-serif";
      if (this.spec.axes) {
        // Room for the widest number, before anything is placed.
        const widths = ticks(f.v.y0, f.v.y1, (f.box.b - f.box.t) / 45).map((y) => c.measureText(digits(y)).width);
        const margin = 26 + Math.ceil(Math.max(12, ...widths));
        if (this.margin !== margin) { this.margin = margin; return this.draw(); }
        this.axes(c, f);
      }
      c.save();
      c.beginPath();
      c.rect(f.box.l, f.box.t, f.box.r - f.box.l, f.box.b - f.box.t);
      c.clip();
      c.imageSmoothingEnabled = false;
      for (const [image, picture] of this.pictures) {
        if (this.hidden.has(image.name)) continue;
        const x = f.X(image.x[0]), y = f.Y(image.y[0]);
        c.save();
        c.translate(x, y);
        c.scale((f.X(image.x[1]) - x) / image.columns, (f.Y(image.y[1]) - y) / image.rows);
        c.drawImage(picture, 0, 0);
        c.restore();
      }
      this.marks = [];
      const shown = this.spec.layers.filter((layer) => !this.hidden.has(layer.name));
      for (const layer of shown) this.layer(c, f, layer);
      this.labels(c, f, shown);
      c.restore();
      for (const [sample, layer] of this.samples || []) this.sample(sample, layer);
    }

    axes(c, f) {
      c.fillStyle = style("soft");
      c.strokeStyle = style("line");
      c.lineWidth = 1;
      c.textAlign = "center";
      c.textBaseline = "top";
      const mathOf = (v) => digits(v).replace("-", "−");
      for (const x of ticks(f.v.x0, f.v.x1, (f.box.r - f.box.l) / 70)) {
        c.beginPath(); c.moveTo(f.X(x), f.box.t); c.lineTo(f.X(x), f.box.b); c.stroke();
        c.fillText(mathOf(x), f.X(x), f.box.b + 4);
      }
      c.textAlign = "right";
      c.textBaseline = "middle";
      for (const y of ticks(f.v.y0, f.v.y1, (f.box.b - f.box.t) / 45)) {
        c.beginPath(); c.moveTo(f.box.l, f.Y(y)); c.lineTo(f.box.r, f.Y(y)); c.stroke();
        c.fillText(mathOf(y), f.box.l - 5, f.Y(y));
      }
      c.fillStyle = style("ink");
      c.textAlign = "center";
      c.textBaseline = "bottom";
      c.fillText(this.spec.x.name, (f.box.l + f.box.r) / 2, f.height - 2, f.box.r - f.box.l);
      c.save();
      c.translate(2, (f.box.t + f.box.b) / 2);
      c.rotate(-Math.PI / 2);
      c.textBaseline = "top";
      c.fillText(this.spec.y.name, 0, 0, f.box.b - f.box.t);
      c.restore();
    }

    layer(c, f, layer) {
      c.lineWidth = 1.4;
      c.setLineDash(layer.dashed ? [5, 4] : []);
      const n = layer.x.length;
      if (layer.mark === "line" || layer.mark === "area") {
        let open = false, last = 0;
        const end = () => {
          if (!open) return;
          c.strokeStyle = this.colour(layer, last);
          if (layer.mark === "area") {
            c.globalAlpha = 0.13; c.fillStyle = c.strokeStyle; c.fill(); c.globalAlpha = 0.9;
          }
          c.stroke();
          c.globalAlpha = 1;
          open = false;
        };
        for (let i = 0; i < n; i++) {
          const x = layer.x[i], y = layer.y[i];
          if (x === null || y === null) { end(); continue; }
          if (!open) { c.beginPath(); c.moveTo(f.X(x), f.Y(y)); open = true; }
          else c.lineTo(f.X(x), f.Y(y));
          last = i;
          if (layer.texts[i]) this.marks.push([f.X(x), f.Y(y), layer.texts[i]]);
        }
        end();
        c.setLineDash([]);
        return;
      }
      for (let i = 0; i < n; i++) {
        if (layer.x[i] === null || layer.y[i] === null) continue;
        const x = f.X(layer.x[i]), y = f.Y(layer.y[i]);
        if (layer.errors) {
          c.strokeStyle = this.colour(layer, i);
          const [ex, ey] = [layer.errors[0][i], layer.errors[1][i]];
          const bar = (a, b, p, q) => { c.beginPath(); c.moveTo(a, b); c.lineTo(p, q); c.stroke(); };
          if (ex) bar(f.X(layer.x[i] - ex), y, f.X(layer.x[i] + ex), y);
          if (ey) bar(x, f.Y(layer.y[i] - ey), x, f.Y(layer.y[i] + ey));
        }
        this.symbol(c, x, y, layer.mark, this.colour(layer, i));
        if (layer.texts[i]) this.marks.push([x, y, layer.texts[i]]);
      }
    }

    halo() {
      return this.spec.image ? "rgba(0,0,0,.7)" : style("ground");
    }

    symbol(c, x, y, mark, colour) {
      const path = () => {
        c.beginPath();
        if (mark === "ring") c.arc(x, y, SYMBOL, 0, 7);
        else if (mark === "plus") {
          c.moveTo(x - SYMBOL, y); c.lineTo(x + SYMBOL, y);
          c.moveTo(x, y - SYMBOL); c.lineTo(x, y + SYMBOL);
        } else if (mark === "cross") {
          c.moveTo(x - 5, y - 5); c.lineTo(x + 5, y + 5);
          c.moveTo(x - 5, y + 5); c.lineTo(x + 5, y - 5);
        } else if (mark === "diamond") {
          c.moveTo(x, y - 7); c.lineTo(x + 6, y); c.lineTo(x, y + 7); c.lineTo(x - 6, y); c.closePath();
        }
      };
      if (mark === "dot") { c.fillStyle = colour; c.fillRect(x - 0.8, y - 0.8, 1.6, 1.6); return; }
      path();
      c.strokeStyle = this.halo(); c.lineWidth = 4; c.stroke();
      path();
      if (mark === "diamond") { c.fillStyle = colour; c.fill(); }
      c.strokeStyle = colour; c.lineWidth = 2; c.stroke();
    }

    sample(canvas, layer) {
      const c = canvas.getContext("2d");
      c.setTransform(2, 0, 0, 2, 0, 0);
      c.clearRect(0, 0, 18, 18);
      if (layer.mark === "heat") { c.fillStyle = rgb(heat(0.7)); c.fillRect(2, 3, 14, 12); return; }
      const shown = this.spec.image ? rgb(heat(0.7)) : onGround(0.7);
      const level = layer.levels && layer.levels.length ? shown : null;
      const colour = level || this.colour({ ...layer, levels: [] }, 0);
      c.strokeStyle = c.fillStyle = colour;
      if (layer.mark === "area") {
        c.globalAlpha = 0.25; c.fillRect(1, 3, 16, 12); c.globalAlpha = 1; c.strokeRect(1.5, 3.5, 15, 11);
      } else if (layer.mark === "line") {
        c.lineWidth = 2; c.setLineDash(layer.dashed ? [4, 3] : []);
        c.beginPath(); c.moveTo(1, 9); c.lineTo(17, 9); c.stroke(); c.setLineDash([]);
      } else if (layer.mark === "dot") { c.fillRect(7, 7, 4, 4); }
      else this.symbol(c, 9, 9, layer.mark, colour);
    }

    labels(c, f, layers) {
      c.font = "600 12px system-ui, sans-serif";
      c.textBaseline = "middle";
      c.textAlign = "left";
      const marks = [], labels = [];
      for (const layer of layers) {
        if (!SYMBOLS.includes(layer.mark)) continue;
        layer.x.forEach((px, i) => {
          if (px === null || layer.y[i] === null) return;
          const x = f.X(px), y = f.Y(layer.y[i]), text = layer.labels[i];
          if (x < f.box.l || x > f.box.r || y < f.box.t || y > f.box.b) return;
          marks.push([x, y]);
          if (text) labels.push({ x, y, text, width: c.measureText(text).width });
        });
      }
      this.placed = window.placedLabels(labels, marks, f.box);
      for (const { x, y, text, width, left, middle } of this.placed) {
        if (Math.abs(middle - y) > 8) {
          c.strokeStyle = style("soft"); c.lineWidth = 1;
          c.beginPath(); c.moveTo(x, y); c.lineTo(left < x ? left + width + 2 : left - 2, middle); c.stroke();
        }
        c.lineWidth = 3.5; c.strokeStyle = this.halo(); c.lineJoin = "round";
        c.strokeText(text, left, middle);
        c.fillStyle = this.spec.image ? "#fff" : style("ink"); c.fillText(text, left, middle);
      }
    }

    zoom(factor, px, py) {
      const f = this.frame(), v = f.v;
      const at = px === undefined ? [(v.x0 + v.x1) / 2, (v.y0 + v.y1) / 2] : this.world(f, px, py);
      this.view = {
        x0: at[0] + (v.x0 - at[0]) * factor, x1: at[0] + (v.x1 - at[0]) * factor,
        y0: at[1] + (v.y0 - at[1]) * factor, y1: at[1] + (v.y1 - at[1]) * factor,
      };
      this.zoomed = true;
      this.canvas.style.touchAction = "none";
      this.draw();
    }

    pan(dx, dy) {
      const f = this.frame(), v = f.v;
      const sx = ((v.x1 - v.x0) / (f.box.r - f.box.l)) * dx;
      const sy = ((v.y1 - v.y0) / (f.box.b - f.box.t)) * dy;
      this.view = { x0: v.x0 - sx, x1: v.x1 - sx, y0: v.y0 + sy, y1: v.y1 + sy };
      this.draw();
    }

    world(f, px, py) {
      return [
        f.v.x0 + ((px - f.box.l) / (f.box.r - f.box.l)) * (f.v.x1 - f.v.x0),
        f.v.y0 + ((f.box.b - py) / (f.box.b - f.box.t)) * (f.v.y1 - f.v.y0),
      ];
    }

    point(event) {
      // The nearest mark, else the image's level under the pointer.
      const box = this.canvas.getBoundingClientRect();
      const px = event.clientX - box.left, py = event.clientY - box.top;
      let best = null, least = 14 ** 2;
      for (const [x, y, text] of this.marks || []) {
        const d = (x - px) ** 2 + (y - py) ** 2;
        if (d < least) { least = d; best = text; }
      }
      if (!best) best = this.level(px, py);
      this.tip.textContent = best || "";
      this.tip.hidden = !best;
      this.tip.style.left = `${Math.min(px + 12, Math.max(0, box.width - 190))}px`;
      this.tip.style.top = `${py + 16}px`;
    }

    level(px, py) {
      const image = this.spec.image;
      if (!image || !image.unit) return null;
      const f = this.frame(), [x, y] = this.world(f, px, py);
      const column = Math.floor(((x - image.x[0]) / (image.x[1] - image.x[0])) * image.columns);
      const row = Math.floor(((y - image.y[0]) / (image.y[1] - image.y[0])) * image.rows);
      if (column < 0 || row < 0 || column >= image.columns || row >= image.rows) return null;
      const level = image.levels[row * image.columns + column];
      if (!level) return null;
      const value = image.low + ((level - 1) / 254) * (image.high - image.low);
      const place = this.spec.axes ? ` at ${digits(x)}, ${digits(y)}` : "";
      return `${digits(image.log ? 10 ** value : value)} ${image.unit}${place}`;
    }

    listen() {
      const canvas = this.canvas;
      let held = null;
      canvas.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
        event.preventDefault();
        this.zoom(event.deltaY > 0 ? 1.2 : 1 / 1.2, event.offsetX, event.offsetY);
      }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        canvas.focus({ preventScroll: true });
        if (event.pointerType === "mouse" || this.zoomed) {
          held = [event.clientX, event.clientY];
          canvas.setPointerCapture(event.pointerId);
        }
      });
      canvas.addEventListener("pointermove", (event) => {
        if (held) {
          this.pan(event.clientX - held[0], event.clientY - held[1]);
          held = [event.clientX, event.clientY];
        } else this.point(event);
      });
      for (const name of ["pointerup", "pointercancel"])
        canvas.addEventListener(name, () => { held = null; });
      canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; });
      canvas.addEventListener("dblclick", () => { this.reset(); this.draw(); });
      canvas.addEventListener("keydown", (event) => {
        const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
        if (event.key === "+" || event.key === "=") this.zoom(1 / 1.3);
        else if (event.key === "-") this.zoom(1.3);
        else if (event.key === "0") { this.reset(); this.draw(); }
        else if (moves[event.key]) this.pan(...moves[event.key]);
        else return;
        event.preventDefault();
      });
      for (const button of this.figure.querySelectorAll("[data-act]"))
        button.addEventListener("click", () => {
          if (button.dataset.act === "in") this.zoom(1 / 1.4);
          else if (button.dataset.act === "out") this.zoom(1.4);
          else { this.reset(); this.draw(); }
        });
    }
  }

  page.charts_drawn = {};
  for (const figure of document.querySelectorAll("figure[data-chart]"))
    page.charts_drawn[figure.dataset.chart] = new Chart(figure, page.charts[figure.dataset.chart]);
  const redraw = () => Object.values(page.charts_drawn).forEach((chart) => chart.draw());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  matchMedia("print").addEventListener("change", redraw);

  // One of several pictures at a time.
  for (const group of document.querySelectorAll("[data-choice]")) {
    const buttons = [...group.querySelectorAll("[data-shows]")];
    const show = (name) => {
      for (const button of buttons) {
        const on = button.dataset.shows === name;
        button.setAttribute("aria-pressed", String(on));
        document.getElementById(button.dataset.shows).hidden = !on;
      }
    };
    buttons.forEach((button) => button.addEventListener("click", () => show(button.dataset.shows)));
    if (buttons.length) show(buttons[0].dataset.shows);
  }
  window.twinPage = page;
})();
