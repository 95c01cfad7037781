"use strict";
// A turning view of measured and predicted points over time, on a plain canvas: no library, no network.
function mphygsViewer(root, data) {
  const MISSING = -32768, LARGEST = 32767;
  const partColours = [[122, 150, 110], [176, 140, 98], [110, 138, 170], [160, 120, 160], [140, 140, 140]];
  const pick = (name) => root.querySelector(`[data-role="${name}"]`);
  const canvas = pick("canvas"), slider = pick("time"), label = pick("label"), select = pick("sequence");
  const play = pick("play"), turn = pick("turn");
  const shown = { surface: pick("surface"), measured: pick("measured"), predicted: pick("predicted"),
    force: pick("force") };
  const view = { yaw: -0.9, pitch: 0.35, zoom: 1.0 };
  let motion = null, playing = false, last = 0;

  function unpack(text, low, high) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const whole = new Int16Array(bytes.buffer), out = new Float64Array(whole.length);
    for (let i = 0; i < whole.length; i++) {
      const a = i % 3, span = high[a] > low[a] ? high[a] - low[a] : 1;
      out[i] = whole[i] === MISSING ? NaN : (whole[i] + LARGEST) / (2 * LARGEST) * span + low[a];
    }
    return out;
  }

  function load(name) {
    const given = data.sequences[name];
    motion = {
      ...given,
      measured: unpack(given.measured, given.low, given.high),
      predicted: unpack(given.predicted, given.low, given.high),
      surface: unpack(given.surface, given.low, given.high),
      arrows: given.arrows ? unpack(given.arrows, given.low, given.high) : null,
    };
    pick("force-label").hidden = !motion.arrows;
    const size = motion.high.map((h, a) => h - motion.low[a]);
    motion.centre = motion.low.map((l, a) => l + 0.5 * size[a]);
    motion.reach = Math.hypot(...size);
    slider.max = String(motion.frames.length - 1);
    slider.value = String(Math.min(Number(slider.value), motion.frames.length - 1));
    draw();
  }

  function draw() {
    const scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    const pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    const at = Number(slider.value), cy = Math.cos(view.yaw), sy = Math.sin(view.yaw);
    const cp = Math.cos(view.pitch), sp = Math.sin(view.pitch);
    const gain = view.zoom * 1.15 * Math.min(width, height) / motion.reach;
    // Seen from the side, z up; returns pixels and depth.
    const turned = (x, y, z) => {
      const u = cy * x - sy * y, v = sy * x + cy * y;
      return [u, cp * z - sp * v, cp * v + sp * z];
    };
    const project = (list, i) => {
      const [u, w, d] = turned(...[0, 1, 2].map((a) => list[3 * i + a] - motion.centre[a]));
      return [0.5 * width + gain * u, 0.5 * height - gain * w, d];
    };
    let drawn = 0, arrows = 0;
    if (shown.surface.checked) {
      const points = [];
      for (let k = 0; k < motion.points; k++) {
        points.push([...project(motion.surface, at * motion.points + k), k]);
      }
      points.sort((a, b) => b[2] - a[2]);
      const size = Math.max(1.5, 0.9 * gain * motion.reach / Math.sqrt(motion.points * 3));
      for (const [x, y, , k] of points) {
        const facing = -turned(...motion.normals[k])[2], light = 0.62 + 0.38 * facing;
        const colour = partColours[motion.part[k] % partColours.length].map((c) => Math.round(c * light));
        pen.fillStyle = `rgba(${colour}, 0.55)`;
        pen.fillRect(x - 0.5 * size, y - 0.5 * size, size, size);
        drawn++;
      }
    }
    for (let k = 0; k < motion.markers; k++) {
      const i = at * motion.markers + k;
      const [px, py] = project(motion.predicted, i), seen = !Number.isNaN(motion.measured[3 * i]);
      const [mx, my] = seen ? project(motion.measured, i) : [0, 0];
      if (seen && shown.measured.checked && shown.predicted.checked) {
        pen.strokeStyle = "#d1495b";
        pen.beginPath();
        pen.moveTo(px, py);
        pen.lineTo(mx, my);
        pen.stroke();
      }
      if (shown.predicted.checked) {
        pen.fillStyle = "#d1495b";
        pen.beginPath();
        pen.arc(px, py, 2.6, 0, 2 * Math.PI);
        pen.fill();
        drawn++;
      }
      if (seen && shown.measured.checked) {
        pen.strokeStyle = "#111111";
        pen.beginPath();
        pen.arc(mx, my, 3.4, 0, 2 * Math.PI);
        pen.stroke();
        drawn++;
      }
    }
    if (motion.arrows && shown.force.checked) {
      pen.strokeStyle = pen.fillStyle = "#1f4fd1";
      pen.lineWidth = 2;
      for (let k = 0; k < motion.arrow_count; k++) {
        const i = 2 * (at * motion.arrow_count + k);
        if (Number.isNaN(motion.arrows[3 * i])) continue;
        const [ax, ay] = project(motion.arrows, i), [bx, by] = project(motion.arrows, i + 1);
        const length = Math.hypot(bx - ax, by - ay);
        if (length < 1) continue;
        const ux = (bx - ax) / length, uy = (by - ay) / length, head = Math.min(6, 0.5 * length);
        pen.beginPath();
        pen.moveTo(ax, ay);
        pen.lineTo(bx, by);
        pen.lineTo(bx - head * (ux + 0.5 * uy), by - head * (uy - 0.5 * ux));
        pen.moveTo(bx, by);
        pen.lineTo(bx - head * (ux - 0.5 * uy), by - head * (uy + 0.5 * ux));
        pen.stroke();
        arrows++;
      }
      pen.lineWidth = 1;
    }
    const frame = motion.frames[at], fitted = frame >= motion.fit[0] && frame < motion.fit[1];
    label.textContent = `frame ${frame}, ${(frame / motion.fps).toFixed(3)} s, ${fitted ? "fitted" : "not fitted"}`;
    root.dataset.drawn = String(drawn);
    root.dataset.arrows = String(arrows);
    root.dataset.frame = String(frame);
  }

  function tick(now) {
    if (now - last > 40) {
      last = now;
      if (playing) slider.value = String((Number(slider.value) + 1) % motion.frames.length);
      if (turn.checked) view.yaw += 0.015;
      if (playing || turn.checked) draw();
    }
    window.requestAnimationFrame(tick);
  }

  let held = null;
  canvas.addEventListener("pointerdown", (e) => { held = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointermove", (e) => {
    if (!held) return;
    view.yaw += 0.01 * (e.clientX - held[0]);
    view.pitch = Math.max(-1.57, Math.min(1.57, view.pitch + 0.01 * (e.clientY - held[1])));
    held = [e.clientX, e.clientY];
    draw();
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    view.zoom *= Math.exp(-0.001 * e.deltaY);
    draw();
  }, { passive: false });
  slider.addEventListener("input", draw);
  for (const box of Object.values(shown)) box.addEventListener("change", draw);
  play.addEventListener("click", () => { playing = !playing; play.textContent = playing ? "pause" : "play"; });
  window.addEventListener("resize", draw);
  for (const name of Object.keys(data.sequences)) {
    const option = document.createElement("option");
    option.textContent = option.value = name;
    select.append(option);
  }
  select.addEventListener("change", () => load(select.value));
  load(Object.keys(data.sequences)[0]);
  window.requestAnimationFrame(tick);
  root.dataset.ready = "true";
  return {
    current: () => select.value,
    replace: (name, given) => { data.sequences[name] = given; if (select.value === name) load(name); },
  };
}
