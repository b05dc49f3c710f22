"use strict";
(() => {
  const machine = JSON.parse(document.getElementById("machine").textContent);
  const frames = machine.phi.length;
  const byId = (id) => document.getElementById(id);
  const longest = 22; // mm, of an arrow
  const make = (parent, name, attributes) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes || {})) element.setAttribute(key, value);
    parent.append(element);
    return element;
  };
  const degrees = (radians) => (radians * 180) / Math.PI;
  const mix = (values, place) => {
    const first = Math.min(Math.floor(place), frames - 2);
    return values[first] + (values[first + 1] - values[first]) * (place - first);
  };

  // The wheels. Points are in mm with y upwards: the drawing is turned over once, texts back again.

  const outline = (points) => {
    let path = "";
    for (let k = 0; k < points.length; k += 2) path += `${k ? "L" : "M"}${points[k]} ${points[k + 1]}`;
    return path + "Z";
  };

  const circlesAround = (parent, kind, n, radius, r) => {
    for (let k = 0; k < n; k++) {
      const at = (2 * Math.PI * k) / n;
      make(parent, "circle", { class: kind, r, cx: radius * Math.cos(at), cy: radius * Math.sin(at) });
    }
    return parent;
  };

  const buildWheel = (number) => {
    const wheel = machine.wheels[number];
    const svg = byId(`wheel-${number}`);
    const upright = make(svg, "g", { transform: "scale(1 -1)" });
    const turning = make(upright, "g");
    make(turning, "path", { class: "wheel", d: outline(wheel.outline) });
    const perLobe = wheel.outline.length / 2 / machine.n_lobes;
    for (const lobe of wheel.worn) {
      // From tip to pit: the worn half, down to the circle of the pits.
      const half = wheel.outline.slice(2 * lobe * perLobe, 2 * (lobe * perLobe + perLobe / 2 + 1));
      const inner = (0.88 * machine.pit) / Math.hypot(half[0], half[1]);
      const end = half.slice(-2).map((x) => 0.88 * x);
      make(turning, "path", {
        class: "mark",
        d: outline([...half, ...end, inner * half[0], inner * half[1]]),
      });
    }
    const holes = circlesAround(make(upright, "g"), "hole", machine.n_sleeves, machine.sleeve_circle, machine.hole_radius);
    const sleeves = circlesAround(make(upright, "g"), "sleeve", machine.n_sleeves, machine.sleeve_circle, machine.sleeve_radius);
    circlesAround(upright, "sleeve", machine.n_pins, machine.pin_circle, machine.pin_radius);
    // On top of the holes, and turning with the wheel.
    const labels = make(upright, "g");
    const numbers = Array.from({ length: machine.n_lobes }, (_, lobe) => {
      const at = (2 * Math.PI * (lobe + 0.25)) / machine.n_lobes;
      const worn = wheel.worn.includes(lobe);
      const radius = (wheel.removed.includes(lobe) ? 0.86 : 0.935) * machine.pit;
      const place = make(labels, "g", {
        transform: `translate(${radius * Math.cos(at)} ${radius * Math.sin(at)})`,
      });
      const text = make(place, "text", { class: worn ? "number is-worn" : "number" });
      text.textContent = lobe + 1;
      return text;
    });
    const hub = make(upright, "circle", { class: "cam", r: 0.3 * machine.sleeve_circle });
    const pointer = make(upright, "line", { class: "pointer", x1: 0, y1: 0 });
    make(upright, "circle", { class: "dot", r: 0.9 });
    const arrows = (n, group) => Array.from({ length: n }, () => make(group, "path"));
    const internal = make(upright, "g", { class: "internal" });
    const external = make(upright, "g", { class: "external" });
    return {
      ...wheel, svg, turning, numbers, labels, holes, sleeves, hub, pointer,
      internal: arrows(machine.n_sleeves, internal),
      external: arrows(machine.n_pins, external),
    };
  };

  // An arrow that ends at (x, y), along the force (fx, fy).
  const setArrow = (path, x, y, fx, fy) => {
    const force = Math.hypot(fx, fy);
    // The root, else a worn lobe's impacts would leave nothing to see of all other forces.
    const share = Math.sqrt(Math.min(force / machine.force_scale, 1));
    const length = longest * share;
    if (length < 0.8) {
      path.setAttribute("d", "");
      return;
    }
    const [ux, uy] = [fx / force, fy / force];
    const head = Math.min(4, 0.6 * length);
    const corner = (back, aside) => `${(x - ux * back - uy * aside).toFixed(2)} ${(y - uy * back + ux * aside).toFixed(2)}`;
    path.setAttribute(
      "d",
      `M${x.toFixed(2)} ${y.toFixed(2)}L${corner(head, 0.45 * head)}L${corner(head, 0.6)}L${corner(length, 0.6)}` +
        `L${corner(length, -0.6)}L${corner(head, -0.6)}L${corner(head, -0.45 * head)}Z`,
    );
    path.setAttribute("class", `f${Math.min(Math.floor(5 * share), 4)}`);
  };

  const force = (rows, place, wheel, count, k) => {
    const first = Math.min(Math.floor(place), frames - 2);
    const share = place - first;
    const at = 2 * (wheel * count + k);
    const [one, next] = [rows[first], rows[first + 1]];
    return [one[at] + (next[at] - one[at]) * share, one[at + 1] + (next[at + 1] - one[at + 1]) * share];
  };

  const lobeAt = (wheel, phi) => {
    const z = machine.n_lobes;
    const cam = ((z + 1) / z) * phi + (wheel.cam < 0 ? Math.PI : 0) - wheel.rest;
    const lobe = Math.floor((cam * z) / (2 * Math.PI) + 0.5) % z;
    return (lobe + z) % z;
  };

  const drawWheel = (wheel, number, place) => {
    const phi = mix(machine.phi, place);
    const psi = mix(machine.psi, place);
    const turned = wheel.rest - phi / machine.n_lobes;
    const [cx, cy] = [wheel.cam * Math.cos(phi), wheel.cam * Math.sin(phi)];
    for (const part of [wheel.turning, wheel.labels]) {
      part.setAttribute("transform", `translate(${cx} ${cy}) rotate(${degrees(turned)})`);
    }
    for (const text of wheel.numbers) text.setAttribute("transform", `rotate(${degrees(-turned)}) scale(1 -1)`);
    wheel.holes.setAttribute("transform", `translate(${cx} ${cy}) rotate(${degrees(-phi / machine.n_lobes)})`);
    wheel.sleeves.setAttribute("transform", `rotate(${degrees(psi)})`);
    wheel.hub.setAttribute("cx", cx);
    wheel.hub.setAttribute("cy", cy);
    const reach = (0.3 * machine.sleeve_circle) / Math.abs(wheel.cam);
    wheel.pointer.setAttribute("x2", cx * (1 + reach));
    wheel.pointer.setAttribute("y2", cy * (1 + reach));
    let largest = 0;
    const ring = (arrows, rows, count, circle, radius, offset) => {
      for (let k = 0; k < count; k++) {
        const [fx, fy] = force(rows, place, number, count, k);
        const size = Math.hypot(fx, fy) || 1;
        const at = (2 * Math.PI * k) / count + offset;
        const x = circle * Math.cos(at) + (radius * fx) / size;
        const y = circle * Math.sin(at) + (radius * fy) / size;
        setArrow(arrows[k], x, y, fx, fy);
        largest = Math.max(largest, Math.hypot(fx, fy));
      }
    };
    ring(wheel.external, machine.external, machine.n_pins, machine.pin_circle, machine.pin_radius, 0);
    ring(wheel.internal, machine.internal, machine.n_sleeves, machine.sleeve_circle, machine.sleeve_radius, psi);
    return { phi, largest, lobe: lobeAt(wheel, phi) };
  };

  // The torque beside it.

  const box = { left: 62, right: 990, top: 12, bottom: 205 };
  const low = Math.min(...machine.trace);
  const high = Math.max(...machine.trace);
  const margin = 0.06 * (high - low) || 1;
  const toX = (time) => box.left + ((box.right - box.left) * time) / machine.duration;
  const toY = (torque) =>
    box.bottom - ((box.bottom - box.top) * (torque - low + margin)) / (high - low + 2 * margin);

  const ticks = (from, to, about) => {
    const raw = (to - from) / about;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * power).find((m) => m >= raw);
    const found = [];
    for (let value = Math.ceil(from / step - 1e-9) * step; value <= to + 1e-9 * step; value += step) {
      found.push([value, value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))]);
    }
    return found;
  };

  const buildTrace = () => {
    const svg = byId("trace");
    svg.setAttribute("aria-label", `Output torque over ${machine.duration.toFixed(3)} s, from ${low.toFixed(2)} to ${high.toFixed(2)} Nm`);
    for (const [begin, end] of machine.bands) {
      make(svg, "rect", { class: "band", x: toX(begin), y: box.top, width: toX(end) - toX(begin), height: box.bottom - box.top });
    }
    for (const [value, text] of ticks(low - margin, high + margin, 5)) {
      make(svg, "line", { class: "grid", x1: box.left, x2: box.right, y1: toY(value), y2: toY(value) });
      make(svg, "text", { class: "axis", x: box.left - 8, y: toY(value) + 4, "text-anchor": "end" }).textContent = text;
    }
    for (const [value, text] of ticks(0, machine.duration, 9)) {
      make(svg, "line", { class: "grid", x1: toX(value), x2: toX(value), y1: box.bottom, y2: box.bottom + 5 });
      make(svg, "text", { class: "axis", x: toX(value), y: box.bottom + 20, "text-anchor": "middle" }).textContent = text;
    }
    make(svg, "text", { class: "axis", x: (box.left + box.right) / 2, y: 246, "text-anchor": "middle" }).textContent = "time (s)";
    const middle = (box.top + box.bottom) / 2;
    const label = make(svg, "text", { class: "axis upright", x: 14, y: middle, "text-anchor": "middle", transform: `rotate(-90 14 ${middle})` });
    label.textContent = "output torque (Nm)";
    const points = machine.trace_times.map((time, k) => `${toX(time).toFixed(2)} ${toY(machine.trace[k]).toFixed(2)}`);
    make(svg, "path", { class: "curve", d: `M${points.join("L")}` });
    const cursor = make(svg, "line", { class: "cursor", y1: box.top, y2: box.bottom });
    const now = make(svg, "circle", { class: "now", r: 4 });
    return { svg, cursor, now };
  };

  const torqueAt = (time) => {
    const times = machine.trace_times;
    let [below, above] = [0, times.length - 1];
    while (above - below > 1) {
      const middle = (below + above) >> 1;
      if (times[middle] <= time) below = middle;
      else above = middle;
    }
    const share = (time - times[below]) / (times[above] - times[below] || 1);
    return machine.trace[below] + (machine.trace[above] - machine.trace[below]) * Math.min(Math.max(share, 0), 1);
  };

  // Playing.

  const wheels = [buildWheel(0), buildWheel(1)];
  const trace = buildTrace();
  const [play, scrub, speed] = ["play", "scrub", "speed"].map(byId);
  scrub.max = frames - 1;
  let place = 0; // in frames
  let playing = false;
  let before = null;

  const words = (state, time) =>
    `${time.toFixed(4)} s: output torque ${torqueAt(time).toFixed(2)} Nm, cam at lobe ${state.lobe + 1}, largest force ${state.largest.toFixed(0)} N`;

  const draw = (tell) => {
    const time = (machine.duration * place) / (frames - 1);
    const states = wheels.map((wheel, number) => drawWheel(wheel, number, place));
    const state = { ...states[0], largest: Math.max(...states.map((one) => one.largest)) };
    trace.cursor.setAttribute("x1", toX(time));
    trace.cursor.setAttribute("x2", toX(time));
    trace.now.setAttribute("cx", toX(time));
    trace.now.setAttribute("cy", toY(torqueAt(time)));
    byId("now-time").textContent = `${time.toFixed(4)} s`;
    byId("now-torque").textContent = `${torqueAt(time).toFixed(2)} Nm`;
    byId("now-turns").textContent = ((state.phi - machine.phi[0]) / (2 * Math.PI)).toFixed(3);
    byId("now-lobe").textContent = state.lobe + 1;
    byId("now-force").textContent = `${state.largest.toFixed(0)} N`;
    scrub.value = Math.round(place);
    scrub.setAttribute("aria-valuetext", `${time.toFixed(3)} s`);
    wheels.forEach((wheel, number) => {
      const marked = wheel.worn.length ? `, worn: ${wheel.worn.map((lobe) => lobe + 1).join(", ")}` : "";
      if (tell || !wheel.svg.hasAttribute("aria-label")) {
        wheel.svg.setAttribute("aria-label", `Wheel ${number + 1} between its sleeves${marked}; cam at lobe ${states[number].lobe + 1}`);
      }
    });
    // While it plays a screen reader would never come to an end.
    if (tell) byId("said").textContent = words(state, time);
  };

  const go = (to) => {
    place = Math.min(Math.max(to, 0), frames - 1);
    draw(!playing);
  };
  const step = (now) => {
    if (!playing) return;
    if (before !== null) {
      const rate = (frames - 1) / machine.duration; // frames in a second of the machine
      place += ((now - before) / 1000) * Number(speed.value) * rate;
      if (place > frames - 1) place = 0;
    }
    before = now;
    draw(false);
    requestAnimationFrame(step);
  };
  const toggle = () => {
    playing = !playing;
    play.textContent = playing ? "Stop" : "Play";
    before = null;
    if (playing) requestAnimationFrame(step);
    else draw(true);
  };
  const stop = () => {
    if (playing) toggle();
  };

  play.addEventListener("click", toggle);
  scrub.addEventListener("input", () => {
    stop();
    go(Number(scrub.value));
  });
  for (const [id, by] of [["back", -1], ["ahead", 1]]) {
    byId(id).addEventListener("click", () => {
      stop();
      go(Math.round(place) + by);
    });
  }
  for (const kind of ["external", "internal"]) {
    const box = byId(`show-${kind}`);
    box.addEventListener("change", () => {
      for (const group of document.querySelectorAll(`g.${kind}`)) group.style.display = box.checked ? "" : "none";
    });
  }
  const seek = (event) => {
    const area = trace.svg.getBoundingClientRect();
    const x = ((event.clientX - area.left) / area.width) * 1000;
    stop();
    go(((x - box.left) / (box.right - box.left)) * (frames - 1));
  };
  trace.svg.addEventListener("pointerdown", (event) => {
    trace.svg.setPointerCapture(event.pointerId);
    seek(event);
  });
  trace.svg.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) seek(event);
  });
  document.addEventListener("keydown", (event) => {
    // Controls keep their own keys.
    if (event.target.closest("button, select, input, a, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
    const keys = { " ": toggle, ArrowLeft: () => byId("back").click(), ArrowRight: () => byId("ahead").click() };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  draw(false);
})();
