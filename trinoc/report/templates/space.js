// The figure to turn: lines in space on a canvas, seen in perspective, without any library.
(() => {
  const canvas = document.getElementById("space-figure");
  const context = canvas.getContext("2d");
  const store = JSON.parse(document.getElementById("space-numbers").textContent);
  const WIDTHS = { three: 2.6, two: 2.6, cameras: 1.6, sheet: 1, axes: 2, bars: 1.6, joined: 2 };
  const NEAR_PX = 9;
  const state = { azimuth: 0, elevation: 0, zoom: 1, shift: [0, 0], view: 0, lit: null, fit: 1, centre: [0, 0] };
  let shown = [];

  const parts = store.layers.flatMap((layer, number) =>
    layer.parts.map((flat, row) => ({
      layer: number,
      role: layer.role,
      points: Array.from({ length: flat.length / 3 }, (_, k) => flat.slice(3 * k, 3 * k + 3)),
      track: layer.tracks.length ? String(layer.tracks[row]) : null,
      words: layer.words[row] ?? "",
    }))
  );
  const on = store.layers.map((layer) => layer.shown);

  const box = () => store.views[state.view];
  const frame = () => {
    const [ca, sa] = [Math.cos(state.azimuth), Math.sin(state.azimuth)];
    const [ce, se] = [Math.cos(state.elevation), Math.sin(state.elevation)];
    const { low, high } = box();
    const middle = low.map((value, k) => (value + high[k]) / 2);
    const radius = Math.hypot(...low.map((value, k) => high[k] - value)) / 2;
    return {
      middle, distance: 4 * radius, right: [-sa, ca, 0],
      up: [-se * ca, -se * sa, ce], toEye: [ce * ca, ce * sa, se],
    };
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  // (x to the right, y up, depth toward the eye), or null behind it; in units of the box.
  const seen = (f, point) => {
    const d = point.map((value, k) => value - f.middle[k]);
    const z = dot(d, f.toEye);
    const nearness = 1 - z / f.distance;
    return nearness < 0.05 ? null : [dot(d, f.right) / nearness, dot(d, f.up) / nearness, z];
  };
  const size = () => [canvas.clientWidth, canvas.clientHeight];
  const onScreen = (f, point) => {
    const at = seen(f, point);
    if (!at) return null;
    const [width, height] = size();
    const scale = state.fit * state.zoom;
    return [
      width / 2 + state.shift[0] + (at[0] - state.centre[0]) * scale,
      height / 2 + state.shift[1] - (at[1] - state.centre[1]) * scale,
      at[2],
    ];
  };
  // What the view holds fills the canvas: its lines, as far as they lie in its box.
  const fit = () => {
    const f = frame(), { low, high } = box(), [width, height] = size();
    const inside = (point) => point.every((value, k) => low[k] <= value && value <= high[k]);
    const points = parts.filter((part) => on[part.layer]).flatMap((part) => part.points).filter(inside);
    const places = (points.length > 1 ? points : [low, high]).map((point) => seen(f, point)).filter(Boolean);
    const [left, right] = [Math.min(...places.map((p) => p[0])), Math.max(...places.map((p) => p[0]))];
    const [bottom, top] = [Math.min(...places.map((p) => p[1])), Math.max(...places.map((p) => p[1]))];
    state.fit = Math.min((width - 60) / (right - left || 1), (height - 60) / (top - bottom || 1));
    state.centre = [(left + right) / 2, (bottom + top) / 2];
  };
  const start = (view) => {
    Object.assign(state, { view, azimuth: store.views[view].azimuth, elevation: 0.5, zoom: 1, shift: [0, 0] });
    fit();
    draw();
  };

  const colour = (role) => getComputedStyle(canvas).getPropertyValue(`--${role}`).trim();
  const draw = () => {
    const [width, height] = size(), ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.lineCap = context.lineJoin = "round";
    const f = frame();
    shown = parts.filter((part) => on[part.layer]).map((part) => {
      const points = part.points.map((point) => onScreen(f, point)).filter(Boolean);
      return { part, points, depth: points.reduce((sum, p) => sum + p[2], 0) / (points.length || 1) };
    }).sort((a, b) => a.depth - b.depth);
    const inks = Object.fromEntries(store.layers.map(({ role }) => [role, colour(role)]));
    const stroke = ({ part, points }, lit) => {
      if (!points.length) return;
      context.strokeStyle = context.fillStyle = lit ? colour("lit") : inks[part.role];
      context.lineWidth = (WIDTHS[part.role] ?? 2) + (lit ? 3 : 0);
      context.beginPath();
      if (points.length === 1) {
        context.arc(points[0][0], points[0][1], 3.5, 0, 7);
        context.fill();
        return;
      }
      points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.stroke();
    };
    shown.forEach((line) => {
      const dim = state.lit !== null && line.part.track !== null;
      context.globalAlpha = dim ? 0.25 : 1;
      stroke(line, false);
    });
    context.globalAlpha = 1;
    shown.filter(({ part }) => part.track !== null && part.track === state.lit)
      .forEach((line) => stroke(line, true));
    context.font = "600 14px system-ui, sans-serif";
    context.textAlign = "center";
    store.labels.forEach(({ at, text, role }) => {
      const layer = store.layers.findIndex((other) => other.role === role);
      const place = on[layer] ? onScreen(f, at) : null;
      if (!place) return;
      const half = context.measureText(text).width / 2 + 4;
      const x = Math.min(Math.max(place[0], half), width - half);
      context.lineWidth = 4;
      context.strokeStyle = colour("ground");
      context.fillStyle = colour("ink");
      const y = place[1] - (role === "cameras" ? 10 : -5);
      context.strokeText(text, x, y);
      context.fillText(text, x, y);
    });
  };

  const distance = ([x, y], [ax, ay], [bx, by]) => {
    const length = (bx - ax) ** 2 + (by - ay) ** 2;
    const t = length ? Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length)) : 0;
    return Math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay));
  };
  const pointedAt = (event) => {
    const place = [event.offsetX, event.offsetY];
    let best = null, least = NEAR_PX;
    shown.forEach(({ part, points }) => {
      if (!part.words) return;
      points.forEach((point, k) => {
        const away = distance(place, point, points[Math.min(k + 1, points.length - 1)]);
        if (away < least) [best, least] = [part, away];
      });
    });
    return best && { track: best.track, words: best.words };
  };
  const say = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));

  const turn = (right, up) => {
    state.azimuth += right;
    state.elevation = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, state.elevation + up));
    draw();
  };
  const zoom = (factor) => { state.zoom = Math.min(40, Math.max(0.2, state.zoom * factor)); draw(); };
  const move = (x, y) => { state.shift[0] += x; state.shift[1] += y; draw(); };
  const keys = {
    ArrowLeft: (far) => (far ? move(-25, 0) : turn(-0.1, 0)),
    ArrowRight: (far) => (far ? move(25, 0) : turn(0.1, 0)),
    ArrowUp: (far) => (far ? move(0, -25) : turn(0, 0.1)),
    ArrowDown: (far) => (far ? move(0, 25) : turn(0, -0.1)),
    "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2), 0: () => start(state.view),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key](event.shiftKey);
  });

  const fingers = new Map();
  let dragged = 0;
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    canvas.setPointerCapture(event.pointerId);
    dragged = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId), now = [event.offsetX, event.offsetY];
    if (!before) return say("trinoc-point", pointedAt(event));
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    dragged += Math.hypot(dx, dy);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
      zoom(apart(now) / apart(before));
    } else if (event.shiftKey || event.buttons & 2) move(dx, dy);
    else turn(-dx * 0.008, dy * 0.008);
    fingers.set(event.pointerId, now);
  });
  const lift = (event) => fingers.delete(event.pointerId);
  canvas.addEventListener("pointerup", (event) => {
    lift(event);
    if (dragged < 4) say("trinoc-pin", pointedAt(event));
  });
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => say("trinoc-point", null));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015));
  }, { passive: false });

  const LOOKS = { top: [-Math.PI / 2, Math.PI / 2], front: [-Math.PI / 2, 0] };
  document.querySelectorAll(".space button").forEach((button) => {
    button.addEventListener("click", () => {
      const { view, look, key } = button.dataset;
      if (view !== undefined) return start(Number(view));
      if (key !== undefined) return keys[key](false);
      [state.azimuth, state.elevation] = LOOKS[look];
      Object.assign(state, { zoom: 1, shift: [0, 0] });
      fit();
      draw();
    });
  });
  document.querySelectorAll("[data-layer]").forEach((input) => {
    const apply = () => { on[Number(input.dataset.layer)] = input.checked; draw(); };
    input.addEventListener("change", apply);
  });
  document.addEventListener("trinoc-lit", (event) => {
    if (event.detail === state.lit) return;
    state.lit = event.detail;
    draw();
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  new ResizeObserver(() => { fit(); draw(); }).observe(canvas);
  start(0);
})();
