// Error by marker and frame, before and after, and the curves of two markers, of the sequence that is shown.
function mphygsMoments(Plotly, scene) {
  const heat = document.getElementById("chart-heat"), curves = document.getElementById("chart-curves");
  const options = { responsive: true, displaylogo: false, displayModeBar: "hover" };
  const M = () => scene.motion().markers, times = () => scene.motion().frames;

  function here(colours, refs) {
    const frame = times()[scene.at()];
    return refs.map((xref) => ({ type: "line", xref, yref: "paper", x0: frame, x1: frame, y0: 0, y1: 1,
      line: { color: colours.unseen, width: 1.5 } }));
  }

  function edges(colours, refs) {
    const [, b] = scene.motion().fit, frames = times();
    if (b <= frames[0] || b > frames.at(-1)) return [];
    return refs.map((xref) => ({ type: "line", xref, yref: "paper", x0: b - 0.5, x1: b - 0.5, y0: 0, y1: 1, line: { color: colours.ink, dash: "dot", width: 1.5 } }));
  }

  function drawHeat() {
    const motion = scene.motion(), colours = theme(), count = M(), order = motion.order;
    const names = order.map((m) => motion.labels[m] ?? `marker ${m}`), models = motion.models, refs = models.map((_, k) => (k ? `x${k + 1}` : "x"));
    const data = models.map((model, k) => ({ type: "heatmap", x: times(), y: order.map((_, i) => i), xaxis: refs[k],
      z: order.map((m) => times().map((_, t) => { const e = model.errors[t * count + m]; return Number.isFinite(e) ? 1000 * e : null; })),
      text: order.map((_, i) => times().map(() => names[i])), coloraxis: "coloraxis", hoverongaps: false,
      hovertemplate: `%{text}, frame %{x}<br>%{z:.3f} mm<extra>${models.length > 1 ? model.label : ""}</extra>` }));
    const width = 1 / models.length, layout = { height: 130 + Math.min(Math.max(5 * order.length, 130), 380), margin: { l: 60, r: 80, t: 34, b: 50 },
      coloraxis: { cmin: 0, cmax: motion.largest, colorscale: colours.errors, colorbar: { title: { text: "error mm" }, thickness: 14 } },
      yaxis: { title: { text: "marker" }, showgrid: false, autorange: "reversed", automargin: true, showticklabels: order.length <= 20, ticks: "", tickvals: order.map((_, i) => i), ticktext: names },
      shapes: [...edges(colours, refs), ...here(colours, refs)],
      annotations: models.map((model, k) => ({ xref: "paper", yref: "paper", x: width * (k + 0.5), y: 1, yanchor: "bottom", text: model.label, showarrow: false })) };
    models.forEach((_, k) => { layout[k ? `xaxis${k + 1}` : "xaxis"] = { title: { text: "frame" }, showgrid: false, domain: [width * k + (k ? 0.02 : 0), width * (k + 1) - (k + 1 < models.length ? 0.02 : 0)] }; });
    Plotly.react(heat, data, layoutOf(layout, colours), options);
  }

  // Marker and coordinate that move most, and those that are farthest off in the first model.
  function interesting() {
    const motion = scene.motion(), count = M(), moved = [-1, 0, 0], off = [-1, 0, 0];
    const first = motion.models[0], shapes = times().map((_, t) => scene.predicted(first, t));
    for (let m = 0; m < count; m++) for (let a = 0; a < 3; a++) {
      let low = Infinity, high = -Infinity, sum = 0, seen = 0;
      times().forEach((_, t) => {
        const x = motion.measured[3 * (t * count + m) + a];
        if (!Number.isFinite(x)) return;
        low = Math.min(low, x); high = Math.max(high, x); seen++; sum += (x - shapes[t][3 * m + a]) ** 2;
      });
      if (high - low > moved[0]) moved.splice(0, 3, high - low, m, a);
      if (seen && sum / seen > off[0]) off.splice(0, 3, sum / seen, m, a);
    }
    return [["moves most", ...moved.slice(1)], ["farthest off", ...off.slice(1)]];
  }

  function drawCurves() {
    const motion = scene.motion(), colours = theme(), count = M(), data = [], annotations = [];
    const tints = motion.models.length > 1 ? [colours.before, colours.fitted] : [colours.fitted];
    interesting().forEach(([what, m, a], row) => {
      const xaxis = row ? "x2" : "x", yaxis = row ? "y2" : "y", band = 2 * 1000 * motion.sigma;
      const seen = times().map((_, t) => { const v = motion.measured[3 * (t * count + m) + a]; return Number.isFinite(v) ? 1000 * v : null; });
      data.push({ type: "scatter", mode: "markers", name: "measured ± 2 sigma", legendgroup: "m", showlegend: !row, x: times(), y: seen, xaxis, yaxis,
        marker: { size: 5, color: colours.ink }, error_y: { type: "constant", value: band, thickness: 1, width: 0, color: colours.quiet }, hovertemplate: "measured %{y:.3f} mm, frame %{x}<extra></extra>" });
      motion.models.forEach((model, k) => data.push({ type: "scatter", mode: "lines", name: model.label, legendgroup: model.label, showlegend: !row, x: times(),
        y: times().map((_, t) => 1000 * scene.predicted(model, t)[3 * m + a]), xaxis, yaxis, line: { color: tints[k % tints.length], width: 2, dash: k + 1 < motion.models.length ? "dash" : "solid" },
        hovertemplate: `${model.label} %{y:.3f} mm, frame %{x}<extra></extra>` }));
      annotations.push({ xref: "paper", yref: "paper", x: row ? 0.55 : 0, y: 1, xanchor: "left", yanchor: "bottom", showarrow: false, text: `${what}: ${motion.labels[m] ?? "marker " + m}, ${"xyz"[a]}` });
    });
    const layout = { height: 340, margin: { l: 60, r: 24, t: 60, b: 50 }, annotations, legend: { orientation: "h", y: 1.12, yanchor: "bottom" },
      xaxis: { title: { text: "frame" }, domain: [0, 0.45] }, xaxis2: { title: { text: "frame" }, domain: [0.55, 1], anchor: "y2" },
      yaxis: { title: { text: "mm" } }, yaxis2: { anchor: "x2" }, shapes: edges(colours, ["x", "x2"]) };
    Plotly.react(curves, data, layoutOf(layout, colours), options);
  }

  const all = () => { drawHeat(); drawCurves(); };
  if (!heat || !M()) return;
  scene.listen((what) => {
    if (what === "sequence") return all();
    const refs = scene.motion().models.map((_, k) => (k ? `x${k + 1}` : "x")), colours = theme();
    Plotly.relayout(heat, { shapes: [...edges(colours, refs), ...here(colours, refs)] });
  });
  heat.on("plotly_click", (e) => scene.show(times().indexOf(e.points[0].x)));
  redraws.push(all);
}
