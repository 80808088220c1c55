"use strict";
// Draws the figures of a page as SVG from the numbers it carries: at the width there is, in the page's colours, again when either
// changes. Pointing tells values, dragging zooms (time axes together), a double click shows all again, a key hides its curve.
const SVG = "http://www.w3.org/2000/svg";
const LEFT = 50, RIGHT = 10, TOP = 6, BOTTOM = 22, FONT = 11;  // px
const TALLEST = 1.15;  // of a picture to scale, over its width
const MARKS = {
  o: (r) => `M${-r},0a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0z`,
  s: (r) => `M${-r},${-r}h${2 * r}v${2 * r}h${-2 * r}z`,
  D: (r) => `M0,${-1.3 * r}L${1.3 * r},0L0,${1.3 * r}L${-1.3 * r},0z`,
  X: (r) => `M${-r},${-r}L${r},${r}M${-r},${r}L${r},${-r}`,
  "^": (r) => `M0,${-1.2 * r}L${1.2 * r},${r}L${-1.2 * r},${r}z`,
};
const drawings = [];

const make = (name, attributes, parent) => {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  parent?.append(node);
  return node;
};
const element = (name, kind, parent) => {
  const node = document.createElement(name);
  node.className = kind;
  parent.append(node);
  return node;
};
const numbers = (text) => new Float32Array(Uint8Array.from(atob(text), (one) => one.charCodeAt(0)).buffer);
const stroke = (line) => `stroke:var(--${line.color});stroke-width:${line.width}px;stroke-dasharray:${line.dash.join(" ") || "none"}`;
const nearest = (values, value) => {  // row in rising numbers
  let low = 0, high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] < value) low = middle; else high = middle;
  }
  return Math.abs(values[low] - value) <= Math.abs(values[high] - value) ? low : high;
};
const digits = (value) => Number.isFinite(value) ? String(Number(value.toPrecision(4))) : "–";

class Axis {
  constructor(range, pixels, log, room, given) {
    [this.low, this.high] = log ? range.map(Math.log10) : range;
    [this.first, this.last] = pixels;
    this.log = log;
    const span = this.high - this.low, most = Math.max(2, Math.abs(this.last - this.first) / room);
    if (given) this.ticks = given;
    else if (log) {
      const steps = span <= 1 ? [1, 1.5, 2, 3, 4, 5, 7] : span <= 3 ? [1, 2, 5] : [1];
      this.ticks = [];
      for (let power = Math.floor(this.low); power <= Math.ceil(this.high); power += 1)
        for (const step of most < steps.length * span ? [1] : steps) this.ticks.push([step * 10 ** power, null]);
      const each = Math.ceil(this.ticks.length / most / 2);
      this.ticks = this.ticks.filter((_, row) => row % each === 0).map(([at]) => [at, Number(at.toPrecision(3)).toLocaleString("en").replaceAll(",", "\u2009")]);
    } else {
      const rough = span / most, power = 10 ** Math.floor(Math.log10(rough));
      const step = power * [1, 2, 5, 10].find((one) => one * power >= rough * 0.999);
      const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      this.ticks = [];
      for (let count = Math.ceil(this.low / step - 1e-6); count * step <= this.high + 1e-6 * step; count += 1)
        this.ticks.push([count * step, (count * step).toFixed(places).replace(/^-(0\.?0*)$/, "$1").replace("-", "−")]);
    }
    this.ticks = this.ticks.filter(([at]) => this.holds(at));
  }
  to(value) {
    const known = this.log ? Math.log10(value) : value;
    return this.first + (known - this.low) / (this.high - this.low) * (this.last - this.first);
  }
  from(pixel) {
    const value = this.low + (pixel - this.first) / (this.last - this.first) * (this.high - this.low);
    return this.log ? 10 ** value : value;
  }
  holds(value) {
    const known = this.log ? Math.log10(value) : value, rest = 1e-6 * (this.high - this.low);
    return known >= this.low - rest && known <= this.high + rest;
  }
}

class Drawing {
  constructor(root, figure) {
    Object.assign(this, {root, figure, zoomed: {}, series: figure.series.map((one) => ({...one}))});
    for (const one of this.series) for (const key of ["x", "y", "x2", "y2"]) if (typeof one[key] === "string") one[key] = numbers(one[key]);
    const head = element("figcaption", "", root);
    if (figure.label) element("span", "label", head).innerHTML = figure.label;
    const seen = new Set();
    for (const one of this.series) {
      if (!one.name || !one.legend || seen.has(one.tag)) continue;
      seen.add(one.tag);
      const key = element("button", "key", head);
      key.type = "button";
      key.dataset.tag = one.tag;
      key.setAttribute("aria-pressed", "true");
      key.append(sample(one));
      element("span", "", key).innerHTML = one.name;
    }
    this.all = element("button", "all", head);
    this.all.type = "button";
    this.all.textContent = "show all again";
    this.all.hidden = true;
    this.all.addEventListener("click", () => this.zoom(null));
    this.frame = element("div", "frame", root);
    this.said = element("div", "readout", this.frame);
    this.said.hidden = true;
    if (figure.xlabel) element("div", "xlabel", root).innerHTML = figure.xlabel;
    new ResizeObserver(() => { if (this.frame.clientWidth !== this.width) this.draw(); }).observe(this.frame);
    this.draw();
  }

  ranges() {
    const {figure} = this, found = {};
    for (const axis of ["x", "y"]) {
      let [low, high] = this.zoomed[axis] ?? figure[axis] ?? [null, null];
      if (low === null || high === null) {
        let least = Infinity, most = -Infinity;
        for (const one of this.series)
          for (const values of [one[axis], one[`${axis}2`]]) for (const value of values ?? [])
            if (Number.isFinite(value)) { least = Math.min(least, value); most = Math.max(most, value); }
        if (least > most) [least, most] = [0, 1];
        const rest = least === most ? Math.abs(least) * 0.1 || 1 : 0.06 * (most - least);
        [low, high] = [low ?? least - rest, high ?? most + rest];
      }
      found[axis] = [low, high];
    }
    return found;
  }

  draw() {
    const {figure, frame} = this, width = this.width = frame.clientWidth;
    if (width === 0) return;
    const left = figure.left ?? LEFT, bottom = figure.bare ? 6 : BOTTOM, {x, y} = this.ranges();
    const inner = width - left - RIGHT;
    let high = figure.height;
    if (figure.to_scale) {
      high = Math.min(inner * (y[1] - y[0]) / (x[1] - x[0]), TALLEST * inner, figure.height);
      const scale = Math.max((x[1] - x[0]) / inner, (y[1] - y[0]) / high);
      for (const [range, pixels] of [[x, inner], [y, high]]) {
        const rest = 0.5 * (scale * pixels - range[1] + range[0]);
        range[0] -= rest; range[1] += rest;
      }
    }
    const log = figure.log ?? "";
    this.x = new Axis(x, [left, left + inner], log.includes("x"), 68);
    this.y = new Axis(y, [TOP + high, TOP], log.includes("y"), figure.to_scale ? 52 : 26, figure.names?.map((name, row) => [row, name]));
    const height = TOP + high + bottom;
    this.svg?.remove();
    const svg = this.svg = make("svg", {viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": this.words()}, frame);
    const clip = `clip${drawings.indexOf(this) < 0 ? drawings.length : drawings.indexOf(this)}`;
    make("rect", {x: left, y: TOP, width: inner, height: high}, make("clipPath", {id: clip}, make("defs", {}, svg)));
    const grid = make("g", {class: "grid"}, svg);
    for (const [at, words] of this.x.ticks) {
      const place = this.x.to(at);
      make("line", {x1: place, x2: place, y1: TOP, y2: TOP + high}, grid);
      const anchor = place + 3.5 * words.length > width ? "end" : "middle";  // the last one stays within the picture
      if (!figure.bare) make("text", {x: place, y: TOP + high + 15, "text-anchor": anchor}, grid).textContent = words;
    }
    for (const [at, words] of this.y.ticks) {
      const place = this.y.to(at);
      make("line", {x1: left, x2: left + inner, y1: place, y2: place}, grid);
      make("text", {x: left - 6, y: place + 4, "text-anchor": "end"}, grid).textContent = words;
    }
    make("path", {d: `M${left},${TOP}V${TOP + high}H${left + inner}`, class: "edge"}, grid);
    const content = make("g", {"clip-path": `url(#${clip})`}, svg);
    for (const rule of figure.rules ?? [])
      for (const at of rule.at) {
        const place = this[rule.axis].to(at), ends = rule.axis === "x"
          ? {x1: place, x2: place, y1: TOP, y2: TOP + high} : {x1: left, x2: left + inner, y1: place, y2: place};
        make("line", {...ends, style: stroke(rule.line)}, content);
      }
    this.boxes = [];
    for (const {mark, size, x: xs, y: ys} of this.series)
      for (let row = 0; mark && row < xs.length; row += 1) {
        const [px, py] = [this.x.to(xs[row]), this.y.to(ys[row])];
        this.boxes.push([px - size, py - size, px + size, py + size]);
      }
    for (const one of this.series) this.curve(one, content, svg);
    this.hair = make("line", {class: "hair", y1: TOP, y2: TOP + high, visibility: "hidden"}, svg);
    this.dragged = make("rect", {class: "dragged", visibility: "hidden"}, svg);
    this.listen(svg);
    this.all.hidden = Object.keys(this.zoomed).length === 0;
  }

  curve(one, content, svg) {
    const shape = make("g", {"data-tag": one.tag ?? ""}, one.mark ? svg : content);
    if (hidden.has(one.tag)) shape.setAttribute("display", "none");
    if (one.y2) {  // boxes from (x, y) to (x2, y2)
      let path = "";
      for (let row = 0; row < one.x.length; row += 1) {
        const [a, b, c, d] = [this.x.to(one.x[row]), this.x.to(one.x2[row]), this.y.to(one.y[row]), this.y.to(one.y2[row])];
        path += `M${a.toFixed(1)},${c.toFixed(1)}H${Math.max(b, a + 1).toFixed(1)}V${d.toFixed(1)}H${a.toFixed(1)}z`;
      }
      make("path", {d: path, style: one.fill ? `fill:var(--${one.line.color})` : `fill:none;${stroke(one.line)}`}, shape);
    } else if (one.mark) {
      for (let row = 0; row < one.x.length; row += 1) {
        if (!this.x.holds(one.x[row]) || !this.y.holds(one.y[row])) continue;
        const [px, py] = [this.x.to(one.x[row]), this.y.to(one.y[row])];
        make("path", {d: MARKS[one.mark](one.size), transform: `translate(${px.toFixed(1)},${py.toFixed(1)})`,
                      style: `fill:var(--${one.fill ?? "paper"});${stroke(one.line)}`}, shape);
        if (one.text?.[row]) this.write(one.text[row], px, py, one.size, shape);
      }
    } else {
      let path = "", drawn = false;
      const first = this.figure.to_scale ? 0 : Math.max(0, nearest(one.x, this.x.from(this.x.first)) - 1);
      for (let row = first; row < one.x.length; row += 1) {
        const px = this.x.to(one.x[row]), py = this.y.to(one.y[row]);
        if (!Number.isFinite(px) || !Number.isFinite(py)) { drawn = false; continue; }
        path += `${drawn ? "L" : "M"}${px.toFixed(1)},${Math.min(Math.max(py, -1e4), 1e4).toFixed(1)}`;
        drawn = true;
        if (!this.figure.to_scale && px > this.x.last) break;
      }
      make("path", {d: path, class: "curve", style: stroke(one.line)}, shape);
    }
  }

  write(words, px, py, size, parent) {  // beside a mark, where no other word lies
    const wide = 6.8 * words.length, tall = FONT + 2, away = size + 4;
    for (const [dx, dy] of [[away, -4], [away, 14], [-away - wide, -4], [-away - wide, 14], [-wide / 2, -away - 2], [-wide / 2, away + 10]]) {
      const box = [px + dx, py + dy - tall + 2, px + dx + wide, py + dy + 2];
      if (box[0] < this.x.first || box[2] > this.x.last + RIGHT || box[1] < 0 || box[3] > this.y.first) continue;
      if (this.boxes.some((b) => box[0] < b[2] && box[2] > b[0] && box[1] < b[3] && box[3] > b[1])) continue;
      this.boxes.push(box);
      make("text", {x: px + dx, y: py + dy, class: "word"}, parent).textContent = words;
      return;
    }
  }

  words() {
    const plain = (text) => text.replace(/<[^>]*>/g, "");
    return [this.figure.label, ...new Set(this.series.map((one) => one.name ?? ""))].filter(Boolean).map(plain).join("; ");
  }

  listen(svg) {
    let from = null;
    const place = (event) => {
      const box = svg.getBoundingClientRect(), scale = this.width / box.width;
      return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    };
    const rectangle = ([px, py]) => {
      const whole = Math.abs(py - from[1]) < 12 && !this.figure.to_scale;
      const clamp = (value, axis) => Math.min(Math.max(value, Math.min(axis.first, axis.last)), Math.max(axis.first, axis.last));
      return {x: [from[0], px].map((one) => clamp(one, this.x)).sort((a, b) => a - b),
              y: whole ? [this.y.last, this.y.first] : [from[1], py].map((one) => clamp(one, this.y)).sort((a, b) => a - b), whole};
    };
    svg.addEventListener("pointerdown", (event) => { if (event.button === 0) from = place(event); });
    svg.addEventListener("pointermove", (event) => {
      const [px, py] = place(event);
      if (from && Math.abs(px - from[0]) > 6) {
        svg.setPointerCapture(event.pointerId);
        const {x, y} = rectangle([px, py]);
        for (const [key, value] of [["x", x[0]], ["y", y[0]], ["width", x[1] - x[0]], ["height", y[1] - y[0]], ["visibility", "visible"]])
          this.dragged.setAttribute(key, value);
      } else if (!from) this.tell(px, py);
    });
    svg.addEventListener("pointerup", (event) => {
      const to = place(event);
      if (from && Math.abs(to[0] - from[0]) > 6) {
        const {x, y, whole} = rectangle(to);
        this.zoom({x: x.map((one) => this.x.from(one)), ...(whole ? {} : {y: y.map((one) => this.y.from(one)).sort((a, b) => a - b)})});
      }
      from = null;
    });
    for (const name of ["pointercancel", "pointerleave"]) svg.addEventListener(name, () => {
      if (name === "pointercancel") from = null;
      this.dragged.setAttribute("visibility", "hidden");
      this.tell(NaN, NaN);
    });
    svg.addEventListener("dblclick", () => this.zoom(null));
  }

  together() {
    return drawings.filter((one) => one === this || (this.figure.group && one.figure.group === this.figure.group));
  }

  zoom(ranges) {
    for (const one of this.together()) {
      if (ranges === null) one.zoomed = {};
      else Object.assign(one.zoomed, one === this ? ranges : {x: ranges.x});
      one.draw();
    }
  }

  tell(px, py) {
    const inside = px >= this.x.first && px <= this.x.last, at = this.x.from(px);
    for (const one of this.together()) {
      one.hair.setAttribute("visibility", inside && !this.figure.to_scale ? "visible" : "hidden");
      if (inside) for (const key of ["x1", "x2"]) one.hair.setAttribute(key, one.x.to(at));
    }
    const lines = [], seen = this.series.filter((one) => one.name && !hidden.has(one.tag) && one.x.length);
    if (inside && this.figure.to_scale) {
      let best = [18, null];
      for (const one of seen) for (let row = 0; row < one.x.length; row += 1) {
        const gap = Math.hypot(this.x.to(one.x[row]) - px, this.y.to(one.y[row]) - py);
        if (gap < best[0]) best = [gap, `${one.name}${one.text?.[row] ? ` ${one.text[row]}` : ""}: x ${digits(one.x[row])}, y ${digits(one.y[row])}`];
      }
      if (best[1]) lines.push(best[1]);
    } else if (inside && !this.figure.names) {
      lines.push(`${digits(at)}`);
      for (const one of seen) {
        if (!one.y2) lines.push(`${one.name}: ${digits(one.y[nearest(one.x, at)])}`);
        else { const row = one.x.findIndex((low, index) => low <= at && at < one.x2[index]); if (row >= 0) lines.push(`${one.name}: ${digits(one.y2[row])}`); }
      }
    } else if (inside) {
      for (const one of seen) for (let row = 0; row < one.x.length; row += 1)
        if (at >= one.x[row] && at <= one.x2[row] && this.y.from(py) >= one.y[row] && this.y.from(py) <= one.y2[row])
          lines.push(`${one.name}: ${digits(one.x[row])} to ${digits(one.x2[row])} s`);
    }
    this.said.hidden = lines.length === 0;
    this.said.innerHTML = lines.join("<br>");
    if (lines.length) this.said.style.left = `${Math.min(Math.max(px + 12, 0), Math.max(this.width - this.said.offsetWidth - 4, 0))}px`;
  }
}

const hidden = new Set();
const sample = (one) => {
  const svg = make("svg", {width: 30, height: 10, "aria-hidden": "true"});
  if (one.mark) make("path", {d: MARKS[one.mark](Math.min(one.size, 4)), transform: "translate(15,5)", style: `fill:var(--${one.fill ?? "paper"});${stroke(one.line)}`}, svg);
  else make("line", {x1: 0, x2: 30, y1: 5, y2: 5, style: stroke(one.line)}, svg);
  return svg;
};

const figures = JSON.parse(document.getElementById("figures").textContent);
for (const root of document.querySelectorAll("figure[data-figure]")) drawings.push(new Drawing(root, figures[root.dataset.figure]));
document.addEventListener("click", (event) => {
  const key = event.target.closest?.("button.key");
  if (!key) return;
  const {tag} = key.dataset, shown = hidden.has(tag);
  if (shown) hidden.delete(tag); else hidden.add(tag);
  for (const other of document.querySelectorAll("button.key")) if (other.dataset.tag === tag) other.setAttribute("aria-pressed", shown);
  for (const shape of document.querySelectorAll("svg g[data-tag]")) if (shape.dataset.tag === tag) shape.setAttribute("display", shown ? "inline" : "none");
});
addEventListener("beforeprint", () => { for (const one of document.querySelectorAll("details")) one.open = true; });
