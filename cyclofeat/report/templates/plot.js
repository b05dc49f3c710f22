/* Plots that can be zoomed, in place of the still pictures, which stay on paper and without scripts. */
"use strict";
(() => {
  const page = getComputedStyle(document.documentElement);
  const colour = name => page.getPropertyValue(`--${name}`).trim();
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  const numbers = packed => {
    if (!packed.base64) {
      const step = (packed.last - packed.first) / (packed.n - 1);
      return Float64Array.from({length: packed.n}, (_, k) => packed.first + k * step);
    }
    const values = new Float32Array(Uint8Array.from(atob(packed.base64), c => c.charCodeAt(0)).buffer);
    return values.some(Number.isNaN) ? Array.from(values, v => (Number.isNaN(v) ? null : v)) : values;
  };

  // Round numbers, at most so many; on a logarithmic axis of more than a decade 1, 2, 5 times powers of ten.
  const ticks = (low, high, most, log) => {
    const found = [];
    if (log && high / low > 10) {
      const decades = Math.log10(high / low), stride = Math.ceil(decades / most);
      for (let k = Math.floor(Math.log10(low)); 10 ** k <= high; k += stride)
        for (const factor of 2 * decades <= most ? [1, 2, 5] : [1])
          found.push(Number(`${factor}e${k}`));
      return found.filter(value => value >= low && value <= high);
    }
    const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find(factor => factor * power >= raw * (1 - 1e-9));
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(Number((k * step).toPrecision(12)));
    return found;
  };

  // Seconds of round times, which begin at midnight of 1970, UTC.
  const TIMES = [1, 5, 15, 60, 300, 900, 3600, 10800, 21600, 43200, 86400, 172800, 604800, 1209600, 2592000, 7776000, 15552000, 31536000];
  const times = (low, high, most, start) => {
    const step = TIMES.find(size => size * most >= high - low) || 315360000, found = [];
    for (let k = Math.ceil((start + low) / step); k * step <= start + high; k++) found.push(k * step - start);
    return found;
  };
  const date = seconds => new Date(1000 * seconds).toISOString().slice(0, 16).replace("T", " ");

  const plain = value => {
    const size = Math.abs(value);
    return size && (size < 1e-3 || size >= 1e6) ? value.toExponential().replace("e+", "e") : String(value);
  };

  const element = (tag, properties = {}, ...children) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(properties))
      if (name in made) made[name] = value;
      else made.setAttribute(name, value);
    made.append(...children);
    return made;
  };

  const build = figure => {
    const plot = JSON.parse(figure.querySelector("script").textContent);
    const still = figure.querySelector("img");
    const [across, up] = plot.axes;
    const x = numbers(plot.x), n = x.length;
    const whole = [Math.min(x[0], plot.view[0]), Math.max(x[n - 1], plot.view[1])];
    const least = 4 * (whole[1] - whole[0]) / Math.max(n - 1, 1);
    let u, byKey = false;

    const columns = [x], series = [{}], bands = [], owner = [];
    for (const line of plot.lines) {
      const first = columns.length;
      owner.push(first);
      const stroke = () => colour(line.colour);
      const shape = {stroke, width: line.style === "wide" ? 2.4 : 1, dash: line.style === "dashed" ? [6, 4] : []};
      if (line.style === "dashed") shape.points = {show: false};
      if (line.style === "strokes") Object.assign(shape, {paths: stems, points: {show: false}, alpha: 0.4});
      if (line.style === "stems") Object.assign(shape, {paths: stems, points: {show: true, size: 5, fill: stroke}});
      if (line.style === "steps") Object.assign(shape, {paths: uPlot.paths.stepped({align: 1}), spanGaps: true, width: 1.5, points: {show: true, size: 6, fill: stroke}});
      if (line.style === "points") Object.assign(shape, {paths: () => null, points: {show: true, size: 6, fill: stroke}});
      columns.push(...line.columns.map(numbers));
      series.push(shape, ...line.columns.slice(1).map(() => ({stroke: null, width: 0, points: {show: false}})));
      if (line.columns.length === 3)
        bands.push({series: [first + 2, first + 1], fill: () => `${colour(line.colour)}38`});
    }

    function stems(self, i, from, to) {
      const path = new Path2D(), bottom = self.bbox.top + self.bbox.height;
      for (let k = from; k <= to; k++) {
        if (columns[i][k] == null) continue;
        const at = self.valToPos(x[k], "x", true);
        path.moveTo(at, bottom);
        path.lineTo(at, self.valToPos(columns[i][k], "y", true));
      }
      return {stroke: path, fill: null, clip: null, band: null, gaps: null, flags: 0};
    }

    const rangeX = (_, low, high) => {
      const width = clamp(high - low, least, whole[1] - whole[0]);
      const start = clamp((low + high - width) / 2, whole[0], whole[1] - width);
      return [start, start + width];
    };

    // All that is seen; single values can fall to any depth of a logarithmic axis by chance.
    const rangeY = (self, low, high) => {
      const [i0, i1] = self.series[0].idxs;
      if (up.ends && i1 - i0 > n - 4) return up.ends;
      if (low == null) return up.log ? [1, 10] : [0, 1];
      const roof = plot.spans.some(span => !span.band) ? 0.16 : 0.05;
      if (up.whole) return [low - 0.5, high + 0.5 + roof * (high - low + 1)];
      if (!up.log) {
        const size = high - low || Math.abs(high) || 1;
        return [low === 0 ? 0 : low - 0.05 * size, high + roof * size];
      }
      const seen = columns.slice(1).flatMap((column, k) =>
        (self.series[k + 1].show ? Array.from(column.slice(i0, i1 + 1)) : []).filter(v => v != null)).sort((a, b) => a - b);
      const bottom = seen.length ? seen[Math.floor(0.01 * seen.length)] : low;
      const size = Math.max(high / bottom, 2);
      return [bottom / size ** 0.03, bottom * size ** (1 + roof)];
    };

    const axis = (of, side) => ({
      side, label: of.unit ? `${of.quantity} (${of.unit})` : of.quantity,
      stroke: () => colour("faint"), font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
      labelSize: 20, gap: 4, grid: {stroke: () => colour("line"), width: 1}, ticks: {stroke: () => colour("line"), width: 1, size: 5},
      splits: (self, _, low, high) => (of.start == null
        ? ticks(low, high, side === 3 ? self.over.clientHeight / 40 : self.over.clientWidth / 70, of.log)
          .filter(value => !of.whole || Number.isInteger(value))
        : times(low, high, self.over.clientWidth / 110, of.start)),
      values: (_, values) => values.map(value => (of.start == null ? plain(value) : date(of.start + value).replace(" 00:00", ""))), filter: (_, values) => values,
      size: (_, values) => (side === 3 ? 14 + 7 * Math.max(3, ...(values || []).map(text => text.length)) : 32),
    });

    const behind = self => {
      const {ctx, bbox} = self;
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      for (const marks of plot.marks.filter(marks => !marks.hidden)) {
        ctx.globalAlpha = marks.short ? 1 : 0.25;
        ctx.strokeStyle = colour(marks.colour);
        ctx.lineWidth = devicePixelRatio;
        ctx.beginPath();
        for (const at of marks.at) {
          const px = self.valToPos(at, "x", true);
          ctx.moveTo(px, bbox.top + bbox.height * (marks.short ? 0.96 : 0));
          ctx.lineTo(px, bbox.top + bbox.height);
        }
        ctx.stroke();
      }
      ctx.restore();
    };

    const above = self => {
      const {ctx, bbox} = self, r = devicePixelRatio;
      ctx.save();
      ctx.font = `${11 * r}px system-ui, sans-serif`;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.setLineDash([]);
      for (const span of plot.spans) {
        const [from, to] = [span.start, span.stop].map(at =>
          clamp(self.valToPos(at, "x", true), bbox.left, bbox.left + bbox.width));
        if (span.band) {
          if (to > bbox.left && from < bbox.left + bbox.width) {
            ctx.fillStyle = colour(span.band);
            ctx.globalAlpha = 0.3;
            ctx.fillRect(from, bbox.top, Math.max(to - from, 2 * r), bbox.height);
            ctx.globalAlpha = 1;
          }
          continue;
        }
        if (to - from < 2) continue;
        ctx.fillStyle = ctx.strokeStyle = colour(span.amiss ? "wrong" : "accent");
        ctx.globalAlpha = 0.18;
        ctx.fillRect(from + r, bbox.top, to - from - 2 * r, 18 * r);
        ctx.globalAlpha = 1;
        ctx.strokeRect(from + r, bbox.top, to - from - 2 * r, 18 * r);
        ctx.fillStyle = colour("ink");
        const label = [span.label, span.label.split(" ")[0]].find(text => ctx.measureText(text).width < to - from - 8 * r);
        if (label) ctx.fillText(label, (from + to) / 2, bbox.top + 9.5 * r);
      }
      ctx.restore();
    };

    const how = "Drag to zoom; double-click, or Reset, shows all again. By keyboard: arrows read values, plus and minus zoom, " +
      "Page Up and Page Down move, Home and End go to the ends, 0 resets.";
    const box = element("div", {
      className: "zoom", tabIndex: 0, role: "application", "aria-roledescription": "zoomable plot", "aria-label": `${still.alt}. ${how}`,
    });
    const output = element("output");
    const say = text => {
      output.setAttribute("aria-live", byKey ? "polite" : "off");
      output.textContent = text;
    };
    const inView = value => {
      if (across.start != null) return date(across.start + value);
      const {min, max} = u.scales.x;
      return value.toFixed(clamp(Math.ceil(-Math.log10((max - min) / 1000)), 0, 9));
    };
    const quantity = (of, text) => `${of.quantity} ${text}${of.unit && ` ${of.unit}`}`;
    const read = () => {
      if (!u) return;
      const k = u.cursor.idx;
      if (k == null) {
        const {min, max} = u.scales.x, hint = min === plot.view[0] && max === plot.view[1] ? ": drag to zoom" : "";
        return say(quantity(across, `${inView(min)} to ${inView(max)}`) + hint);
      }
      const at = x[k], px = u.valToPos(at, "x");
      const parts = [quantity(across, inView(at))];
      plot.lines.forEach((line, i) => {
        const [value, low, high] = line.columns.map((_, j) => columns[owner[i] + j][k]);
        if (value == null || !u.series[owner[i]].show) return;
        const name = plot.lines.length > 1 ? line.name : up.quantity;
        const range = low == null ? "" : ` (${Number(low.toPrecision(3))} to ${Number(high.toPrecision(3))})`;
        parts.push(`${name} ${Number(value.toPrecision(4))}${up.unit && ` ${up.unit}`}${range}`);
      });
      for (const marks of plot.marks.filter(marks => !marks.hidden)) {
        const near = marks.at.findIndex(mark => Math.abs(u.valToPos(mark, "x") - px) < 4);
        if (near >= 0) parts.push(`${marks.name} ${near + 1}`);
      }
      for (const span of plot.spans) if (at >= span.start && at < span.stop) parts.push(span.text);
      say(parts.join(" · "));
    };

    const show = (low, high) => u.setScale("x", {min: low, max: high});
    const position = value => (across.log ? Math.log(value) : value);
    const value = at => (across.log ? Math.exp(at) : at);
    const zoom = (factor, left = u.cursor.left) => {
      const ends = [u.scales.x.min, u.scales.x.max].map(position);
      const about = left >= 0 ? position(u.posToVal(left, "x")) : (ends[0] + ends[1]) / 2;
      show(...ends.map(end => value(about + (end - about) * factor)));
    };
    const move = share => {
      const ends = [u.scales.x.min, u.scales.x.max].map(position), limits = whole.map(position);
      const by = clamp(share * (ends[1] - ends[0]), limits[0] - ends[0], limits[1] - ends[1]);
      show(...ends.map(end => value(end + by)));
    };
    const reset = () => show(...plot.view);
    const step = by => {
      const width = u.over.clientWidth;
      const from = u.cursor.left < 0 ? width / 2 : u.cursor.left;
      const k = u.posToIdx(from), beside = u.valToPos(x[clamp(k + Math.sign(by), 0, n - 1)], "x");
      // A pixel, or the next value where values lie farther apart.
      const to = Math.abs(beside - from) > Math.abs(by) ? beside : from + by;
      if (to < 0 || to > width) move(Math.sign(by) / 4);
      u.setCursor({left: clamp(to, 0, width), top: u.over.clientHeight / 2});
    };

    const keys = {
      ArrowLeft: e => step(e.shiftKey ? -20 : -1), ArrowRight: e => step(e.shiftKey ? 20 : 1),
      "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2),
      PageUp: () => move(-0.5), PageDown: () => move(0.5), Home: () => move(-Infinity), End: () => move(Infinity),
      0: reset, Escape: reset,
    };
    box.addEventListener("keydown", e => {
      if (e.ctrlKey || e.metaKey || e.altKey || !keys[e.key]) return;
      e.preventDefault();
      byKey = true;
      keys[e.key](e);
    });

    const button = (text, label, pressed) => element("button", {type: "button", textContent: text, "aria-label": label, onclick: () => {
      byKey = true;
      pressed();
    }});
    const tools = element("div", {className: "tools"},
      button("−", "Zoom out", () => zoom(2, -1)), button("+", "Zoom in", () => zoom(0.5, -1)),
      button("‹", "Back", () => move(-0.5)), button("›", "Ahead", () => move(0.5)), button("Reset", "Reset the view", reset), output);

    const legend = element("ul", {className: "legend"});
    const swatch = (name, style) => {
      const key = element("span", {className: "key", "aria-hidden": "true"});
      key.style.color = `var(--${name})`;
      key.classList.add(style);
      return key;
    };
    const addSwitch = (key, name, set) => {
      const toggle = element("button", {type: "button", "aria-pressed": "true"}, key, ` ${name}`);
      toggle.onclick = () => {
        const on = toggle.getAttribute("aria-pressed") !== "true";
        toggle.setAttribute("aria-pressed", String(on));
        set(on);
      };
      legend.append(element("li", {}, toggle));
    };
    if (plot.lines.length > 1)
      plot.lines.forEach((line, i) => addSwitch(swatch(line.colour, line.style), line.name,
        on => line.columns.forEach((_, j) => u.setSeries(owner[i] + j, {show: on}))));
    for (const [label, band] of new Map(plot.spans.filter(span => span.band).map(span => [span.label, span.band])))
      legend.append(element("li", {}, swatch(band, "band"), ` ${label}`));
    for (const marks of plot.marks)
      addSwitch(swatch(marks.colour, "mark"), marks.legend, on => {
        marks.hidden = !on;
        u.redraw(false);
      });

    const live = element("div", {className: "live"}, box, tools, legend);
    if (plot.note) live.append(element("p", {className: "faint", textContent: plot.note}));
    figure.append(live);

    const size = () => ({width: Math.max(box.clientWidth, 200), height: Math.round(clamp(box.clientWidth * still.height / still.width, 220, 380))});
    figure.classList.add("drawn");
    u = new uPlot({
      ...size(), legend: {show: false}, series, bands,
      scales: {
        x: {time: false, distr: across.log ? 3 : 1, min: plot.view[0], max: plot.view[1], range: rangeX},
        y: {distr: up.log ? 3 : 1, range: rangeY},
      },
      axes: [axis(across, 2), axis(up, 3)],
      cursor: {y: false, points: {show: true}, bind: {dblclick: () => () => reset()}},
      hooks: {drawAxes: [behind], draw: [above], setCursor: [read], setScale: [(_, key) => key === "x" && read()]},
    }, columns, box);
    reset();

    u.over.addEventListener("mousemove", () => { byKey = false; }, {capture: true});
    u.over.addEventListener("wheel", e => {
      // A page that scrolls must not stop at every plot: the wheel zooms where the plot was chosen.
      if (!e.ctrlKey && document.activeElement !== box) return;
      e.preventDefault();
      byKey = false;
      if (e.shiftKey || Math.abs(e.deltaX) > Math.abs(e.deltaY)) move((e.deltaX || e.deltaY) / 1000);
      else zoom(2 ** clamp(e.deltaY / 200, -1, 1));
    }, {passive: false});
    u.over.addEventListener("mousedown", () => box.focus({preventScroll: true}));
    new ResizeObserver(() => box.clientWidth && u.setSize(size())).observe(box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => u.redraw(false, true));
  };

  document.querySelectorAll("figure.zoomable").forEach(build);
})();
