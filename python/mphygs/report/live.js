"use strict";
// Every slider moved asks for the motion that follows from it.
const status = document.getElementById("status"), inputs = [...document.querySelectorAll("[data-key]")];
let waiting = null;
async function ask() {
  const parameters = Object.fromEntries(inputs.map((i) => [i.dataset.key, Number(i.value)]));
  for (const i of inputs) i.nextElementSibling.textContent = i.dataset.log ?
    Math.exp(i.value).toPrecision(4) : Number(i.value).toPrecision(4);
  status.textContent = "simulating ...";
  const name = window.viewer.current();
  const reply = await fetch("/motion", { method: "POST", body: JSON.stringify({ sequence: name, parameters }) });
  const found = await reply.json();
  status.textContent = found.error ?? `rms ${(1e3 * found.rms).toFixed(3)} mm over the measured points`;
  if (!found.error) window.viewer.replace(name, found.motion);
}
for (const i of inputs) i.addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(ask, 150); });
document.querySelector("[data-role=sequence]").addEventListener("change", ask);
document.body.dataset.live = "true";
