"use strict";
// Unpacks the drawing library, draws the charts in the colours of the reader's theme, and gets ready for print.
const THEMES = {
  light: { ink: "#1c2024", quiet: "#5d6670", paper: "#ffffff", line: "#d9dde1", fitted: "#0072b2",
    unseen: "#d55e00", grid: "#8a6d00", before: "#aa4499" },
  dark: { ink: "#e8eaed", quiet: "#a3abb3", paper: "#15181b", line: "#353b41", fitted: "#56b4e9",
    unseen: "#f08a3c", grid: "#e0c340", before: "#d98cc8" },
};
const PARTS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999"];
const DIVERGING = { light: [[0, "#0072b2"], [0.5, "#f4f4f2"], [1, "#d55e00"]],
  dark: [[0, "#56b4e9"], [0.5, "#23282c"], [1, "#f08a3c"]] };
// From near the paper to the ink, lightness one way all along: what is off stands out, for the colour-blind too.
const ERRORS = { light: [[0, "#d5dce2"], [0.12, "#e9cf9c"], [0.4, "#e08214"], [0.75, "#a83a05"], [1, "#4a1203"]],
  dark: [[0, "#4a545d"], [0.12, "#7d5a33"], [0.4, "#d0701a"], [0.75, "#f5b04a"], [1, "#fff6c2"]] };
let printing = false;
const redraws = [];

function theme() {
  const dark = !printing && window.matchMedia("(prefers-color-scheme: dark)").matches;
  const name = dark ? "dark" : "light";
  return { name, ...THEMES[name], diverging: DIVERGING[name], errors: ERRORS[name] };
}

// "$name" stands for a colour of the theme.
function coloured(value, colours) {
  if (typeof value === "string") return value.startsWith("$") && value.slice(1) in colours ? colours[value.slice(1)] : value;
  if (Array.isArray(value)) return value.map((v) => coloured(v, colours));
  if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, coloured(v, colours)]));
  return value;
}

function layoutOf(own, colours) {
  const axis = { gridcolor: colours.line, linecolor: colours.line, zerolinecolor: colours.line };
  const layout = { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: colours.ink, family: "system-ui, sans-serif", size: 13 },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
    hoverlabel: { bgcolor: colours.paper, bordercolor: colours.quiet, font: { color: colours.ink } },
    ...coloured(own, colours) };
  for (const key of Object.keys(layout)) {
    if (/^[xy]axis/.test(key)) layout[key] = { ...axis, ...layout[key] };
  }
  for (const key of ["xaxis", "yaxis"]) layout[key] = layout[key] ?? axis;
  return layout;
}

function drawChart(Plotly, figure) {
  const place = document.getElementById(figure.id), colours = theme();
  const layout = layoutOf(figure.layout, colours);
  const options = { responsive: true, displaylogo: false, displayModeBar: "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
  return Plotly.react(place, coloured(figure.data, colours), layout, options);
}

function bytesOf(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
}

async function unpacked(id) {
  const stream = new Blob([bytesOf(document.getElementById(id).textContent)]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("gzip"))).text();
}

function redrawAll() {
  for (const redraw of redraws) redraw();
}

async function mphygsPage() {
  window.addEventListener("error", (e) => { document.body.dataset.error = e.message; });
  try {
    const script = document.createElement("script");
    script.textContent = await unpacked("library");
    document.head.append(script);
    const data = JSON.parse(document.getElementById("data").textContent);
    for (const figure of data.charts) {
      redraws.push(() => drawChart(window.Plotly, figure));
      await drawChart(window.Plotly, figure);
    }
    if (data.scene) {
      const place = document.getElementById("scene");
      window.scene = mphygsScene(place, window.Plotly, data.scene);
      mphygsMoments(window.Plotly, window.scene);
      await window.scene.drawn();
    }
    for (const film of data.films ?? []) mphygsWipe(document.getElementById(film.id), film);
  } catch (error) {
    document.body.dataset.error = String(error.stack ?? error);
    document.getElementById("failed").hidden = false;
  }
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redrawAll);
  window.addEventListener("beforeprint", () => {
    printing = true;
    for (const part of document.querySelectorAll("details:not([open])")) { part.open = true; part.dataset.folded = "1"; }
    redrawAll();
  });
  window.addEventListener("afterprint", () => {
    printing = false;
    for (const part of document.querySelectorAll("details[data-folded]")) { part.open = false; delete part.dataset.folded; }
    redrawAll();
  });
  document.body.dataset.ready = "true";
}
