// The object in 3D: its skin, painted with the error, over time; predicted and measured take turns.
function mphygsScene(root, Plotly, data) {
  const MISSING = -32768, LARGEST = 32767, MM = 1000, HEIGHT = 520, NEARER = 0.03;
  const pick = (name) => root.querySelector(`[data-role="${name}"]`);
  const canvas = pick("canvas"), slider = pick("time"), select = pick("sequence"), play = pick("play");
  const chosen = (name) => pick(name).querySelector("input:checked")?.value;
  const array = (Kind, text) => new Kind(bytesOf(text).buffer);
  const skin = { ...data.skin, faces: array(data.skin.wide ? Uint32Array : Uint16Array, data.skin.faces) };
  const vertices = skin.part.length;
  const corners = [0, 1, 2].map((c) => Array.from({ length: skin.faces.length / 3 }, (_, f) => skin.faces[3 * f + c]));
  const listeners = [];
  let motion = null, playing = false, last = 0, flipped = false, latest = Promise.resolve(), revision = 0, camera = null, turned = null;

  function unpack(text, low, high) {
    const whole = array(Int16Array, text), out = new Float64Array(whole.length);
    for (let i = 0; i < whole.length; i++) {
      const a = i % 3, span = high[a] > low[a] ? high[a] - low[a] : 1;
      out[i] = whole[i] === MISSING ? NaN : (whole[i] + LARGEST) / (2 * LARGEST) * span + low[a];
    }
    return out;
  }

  function load(name) {
    const given = data.sequences[name], before = chosen("model");
    motion = { ...given, near: array(Uint16Array, given.near), weight: array(Uint8Array, given.weight), measured: unpack(given.measured, given.low, given.high),
      arrows: given.arrows ? unpack(given.arrows, given.low, given.high) : null,
      models: given.models.map((m) => ({ ...m, errors: array(Float32Array, m.errors), mean: unpack(m.mean, given.low, given.high),
        modes: array(Int16Array, m.modes), amplitudes: array(Float32Array, m.amplitudes) })) };
    pick("force-label").hidden = !motion.arrows;
    pick("model").hidden = motion.models.length < 2;
    pick("model").replaceChildren(...motion.models.map((m, k) => {
      const label = document.createElement("label"), input = document.createElement("input");
      Object.assign(input, { type: "radio", name: "model", value: String(k) });
      input.checked = String(k) === (before ?? String(motion.models.length - 1));
      input.addEventListener("change", draw);
      label.append(input, " " + m.label);
      return label;
    }));
    const finite = motion.models[0].errors.filter(Number.isFinite).sort();
    motion.largest = MM * (finite.length ? finite[Math.floor(0.99 * (finite.length - 1))] : 0) || 1;
    slider.max = String(motion.frames.length - 1);
    slider.value = String(Math.min(Number(slider.value), motion.frames.length - 1));
    if (camera) turned = null;
    camera = null;
    draw();
    for (const tell of listeners) tell("sequence");
  }

  // Markers and, behind them, the skin, predicted in a frame [m].
  function predicted(model, at) {
    const out = Float64Array.from(model.mean);
    for (let k = 0; k < model.count; k++) {
      const a = model.amplitudes[at * model.count + k], offset = k * out.length;
      for (let i = 0; i < out.length; i++) out[i] += a * model.modes[offset + i];
    }
    return out;
  }

  // Of every vertex: its error [mm] and how far measured is from predicted [m], from the markers near it.
  function carried(points, model, at) {
    const M = motion.markers, K = motion.neighbours, error = new Float64Array(vertices), off = new Float64Array(3 * vertices);
    for (let v = 0; v < vertices; v++) {
      let total = 0;
      for (let n = 0; n < K; n++) {
        const m = motion.near[v * K + n], w = motion.weight[v * K + n], i = 3 * (at * M + m);
        if (!Number.isFinite(model.errors[at * M + m])) continue;
        total += w;
        error[v] += w * MM * model.errors[at * M + m];
        for (let a = 0; a < 3; a++) off[3 * v + a] += w * (motion.measured[i + a] - points[3 * m + a]);
      }
      error[v] = total ? error[v] / total : NaN;
      for (let a = 0; a < 3; a++) off[3 * v + a] = total ? off[3 * v + a] / total : 0;
    }
    return { error, off };
  }

  // The box of the motion in units of the scene, and where it is looked at from: from the side, and from as near as
  // shows all its corners and the numbers beside them (plotly's camera opens by 45 degrees from top to bottom).
  function viewOf(span) {
    const longest = Math.max(...span), ratio = span.map((s) => 1.7 * Math.max(s / longest, 0.08)), up = data.up;
    const flat = [0, 1, 2].filter((a) => Math.abs(up[a]) < 0.7).sort((a, b) => span[a] - span[b]);
    const to = up.map((u) => 0.42 * u);
    to[flat[0]] -= 1.0;
    to[flat[1] ?? flat[0]] += 0.38;
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], unit = (a) => a.map((x) => x / Math.hypot(...a));
    const cross = (a, b) => [0, 1, 2].map((k) => a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
    const back = unit(to), right = unit(cross(up, back)), top = cross(back, right);
    const high = 0.85 * Math.tan(Math.PI / 8), wide = high * 0.9 * (canvas.clientWidth || 2 * HEIGHT) / HEIGHT;
    let distance = 0;
    for (let k = 0; k < 8; k++) {
      const c = ratio.map((r, a) => (k >> a & 1 ? 0.5 : -0.5) * r);
      distance = Math.max(distance, dot(c, back) + Math.max(Math.abs(dot(c, top)) / high, Math.abs(dot(c, right)) / wide));
    }
    const at = (v) => ({ x: v[0], y: v[1], z: v[2] });
    return { ratio, home: { eye: at(back.map((x) => distance * x)), up: at(up), center: at([0, 0, 0]) } };
  }

  // Points [mm] brought a little nearer to the eye, so that the skin that they lie in does not cut them.
  function nearer(points, eye, ratio, span) {
    const middle = motion.high.map((h, a) => MM * (h + motion.low[a]) / 2), from = [eye.x, eye.y, eye.z];
    const moved = points[0].map((_, k) => {
      const own = points.map((p, a) => (p[k] - middle[a]) / span[a] * ratio[a]), way = own.map((x, a) => from[a] - x);
      return own.map((x, a) => middle[a] + (x + NEARER * way[a] / Math.hypot(...way)) / ratio[a] * span[a]);
    });
    return [0, 1, 2].map((a) => moved.map((p) => p[a]));
  }

  function columns(list, first, count) {
    return [0, 1, 2].map((a) => Array.from({ length: count }, (_, k) => MM * list[3 * (first + k) + a]));
  }

  function draw() {
    const colours = theme(), at = Number(slider.value), M = motion.markers;
    const number = Number(chosen("model") ?? motion.models.length - 1), model = motion.models[number];
    const shape = chosen("shape") === "both" ? (flipped ? "measured" : "predicted") : chosen("shape");
    const points = predicted(model, at), { error, off } = carried(points, model, at);
    if (shape === "measured") {
      for (let i = 0; i < 3 * vertices; i++) points[3 * M + i] += off[i];
      for (let i = 0; i < 3 * M; i++) points[i] = motion.measured[3 * at * M + i];
    }
    const byPart = pick("paint").value === "part", parts = skin.parts.length;
    const [x, y, z] = columns(points, M, vertices), near = (e) => (Number.isFinite(e) ? `${e.toFixed(3)} mm off` : "not measured here");
    const bar = { title: { text: "error mm", side: "right" }, thickness: 14, len: 0.8, x: 1.0, xanchor: "right" };  // within the drawing, whatever its width
    const mesh = { type: "mesh3d", x, y, z, i: corners[0], j: corners[1], k: corners[2], name: "skin",
      text: skin.part.map((p, v) => `${skin.parts[p]}<br>${near(error[v])}`), hovertemplate: "%{text}<extra></extra>",
      lighting: { ambient: 0.65, diffuse: 0.55, specular: 0.08, roughness: 0.7, fresnel: 0.05 },
      lightposition: { x: 2000, y: -4000, z: 6000 }, cmin: 0, cmax: motion.largest, colorscale: colours.errors,
      intensity: Array.from(error, (e) => (Number.isFinite(e) ? e : 0)), showscale: !byPart, colorbar: bar };
    if (byPart) {
      Object.assign(mesh, { intensity: skin.part, cmin: 0, cmax: Math.max(parts - 1, 1),
        colorscale: Array.from({ length: Math.max(parts, 2) }, (_, p) => [p / Math.max(parts - 1, 1), PARTS[p % PARTS.length]]) });
    }
    const span = motion.high.map((h, a) => MM * (h - motion.low[a])), { ratio, home } = viewOf(span);
    const [mx, my, mz] = pick("points").checked ? nearer(columns(points, 0, M), (turned ?? home).eye, ratio, span) : [[], [], []];
    const errors = Array.from({ length: M }, (_, m) => MM * model.errors[at * M + m]);
    const dots = { type: "scatter3d", mode: "markers", x: mx, y: my, z: mz, name: "markers",
      text: errors.map((e, m) => `${motion.labels[m] ?? "marker " + m}<br>${near(e)}`), hovertemplate: "%{text}<extra></extra>",
      marker: { size: 3, color: shape === "measured" ? colours.unseen : colours.fitted, line: { color: colours.paper, width: 0.5 } } };
    const arrows = arrowTraces(at, colours);
    const axis = (a) => ({ range: [MM * motion.low[a], MM * motion.high[a]], title: { text: `${"xyz"[a]} mm` },
      gridcolor: colours.line, zerolinecolor: colours.line, color: colours.quiet, showbackground: false, nticks: 5 });
    const layout = layoutOf({ height: HEIGHT, margin: { l: 0, r: 24, t: 0, b: 0 }, showlegend: false,
      uirevision: camera ?? "home", scene: { domain: { x: [0, 0.9] }, xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: "manual",
        aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] },
        uirevision: camera ?? "home", camera: home } }, colours);
    layout.datarevision = revision++;
    latest = Plotly.react(canvas, [mesh, dots, ...arrows], layout, { responsive: true, displaylogo: false, displayModeBar: "hover" });
    const frame = motion.frames[at], fitted = frame >= motion.fit[0] && frame < motion.fit[1];
    const seen = errors.filter(Number.isFinite), rms = Math.sqrt(seen.reduce((s, e) => s + e * e, 0) / Math.max(seen.length, 1));
    pick("label").textContent = `${shape}, ${model.label}: frame ${frame}, ${(frame / motion.fps).toFixed(3)} s, ` +
      `${fitted ? "fitted" : "unseen"}; ` + (seen.length ? `error ${rms.toFixed(3)} mm rms, ${(rms / MM / motion.sigma / Math.sqrt(3)).toFixed(2)} times the noise` : "nothing measured");
    Object.assign(root.dataset, { frame, shape, model: number, rms: rms.toFixed(6), arrows: arrows.length ? arrows[1].x.length : 0 });
    for (const tell of listeners) tell("frame");
  }

  function arrowTraces(at, colours) {
    if (!motion.arrows || !pick("force").checked) return [];
    const line = [[], [], []], tip = [[], [], []], way = [[], [], []], value = [];
    let longest = 0;
    const lengths = [];
    for (let i = 0; i < motion.arrows.length / 6; i++) {
      const d = [0, 1, 2].map((a) => motion.arrows[6 * i + 3 + a] - motion.arrows[6 * i + a]);
      lengths.push(Math.hypot(...d));
      if (Number.isFinite(lengths[i])) longest = Math.max(longest, lengths[i]);
    }
    for (let k = 0; k < motion.arrow_count; k++) {
      const i = at * motion.arrow_count + k;
      if (!(lengths[i] > 0.02 * longest)) continue;
      for (let a = 0; a < 3; a++) {
        const foot = MM * motion.arrows[6 * i + a], end = MM * motion.arrows[6 * i + 3 + a];
        line[a].push(foot, end, null);
        tip[a].push(end);
        way[a].push((end - foot) / (MM * lengths[i]));
      }
      value.push(`missing force ${(motion.largest_force * lengths[i] / longest).toPrecision(3)} N/kg`);
    }
    const head = 0.12 * MM * longest;
    return [{ type: "scatter3d", mode: "lines", x: line[0], y: line[1], z: line[2], hoverinfo: "skip", line: { color: colours.before, width: 5 } },
      { type: "cone", x: tip[0], y: tip[1], z: tip[2], u: way[0], v: way[1], w: way[2], anchor: "tip", sizemode: "raw", sizeref: 2 * head,
        showscale: false, colorscale: [[0, colours.before], [1, colours.before]], text: value, hovertemplate: "%{text}<extra></extra>" }];
  }

  function tick(now) {
    if (playing && now - last > 60) {
      last = now;
      slider.value = String((Number(slider.value) + 1) % motion.frames.length);
      draw();
    }
    window.requestAnimationFrame(tick);
  }

  window.setInterval(() => { if (chosen("shape") === "both") { flipped = !flipped; draw(); } }, 700);
  slider.addEventListener("input", draw);
  for (const input of root.querySelectorAll("[name=shape], [data-role=paint], [data-role=points], [data-role=force]")) input.addEventListener("change", draw);
  play.addEventListener("click", () => { playing = !playing; play.textContent = playing ? "pause" : "play"; });
  pick("home").addEventListener("click", () => { camera = `home-${revision}`; turned = null; draw(); });
  for (const name of Object.keys(data.sequences)) select.append(new Option(name, name));
  select.addEventListener("change", () => load(select.value));
  redraws.push(() => draw());
  load(Object.keys(data.sequences)[0]);
  canvas.on("plotly_relayout", (e) => {
    turned = e["scene.camera"] ?? turned;
    window.requestAnimationFrame(draw);
  });
  window.requestAnimationFrame(tick);
  return {
    current: () => select.value,
    motion: () => motion,
    predicted,
    at: () => Number(slider.value),
    show: (at) => { slider.value = String(at); draw(); },
    drawn: () => latest,
    listen: (tell) => { listeners.push(tell); tell("sequence"); },
    replace: (name, given) => { data.sequences[name] = given; if (select.value === name) load(name); },
  };
}
