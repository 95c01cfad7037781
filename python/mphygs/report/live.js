// Every slider moved and every effect switched asks for the motion that follows from it.
const status = document.getElementById("status"), inputs = [...document.querySelectorAll("[data-key]")];
const switches = [...document.querySelectorAll("[data-effect]")];
let waiting = null, asked = 0;
async function ask() {
  const parameters = {}, number = ++asked, without = switches.filter((s) => !s.checked).map((s) => s.dataset.effect);
  for (const i of inputs) {
    i.nextElementSibling.textContent = (i.dataset.log ? Math.exp(i.value) : Number(i.value)).toPrecision(4);
    i.disabled = without.some((effect) => i.dataset.key.startsWith(`${effect}.`));
    if (!i.disabled) parameters[i.dataset.key] = Number(i.value);
  }
  status.textContent = "simulating ...";
  const name = window.scene.current();
  try {
    const reply = await fetch("/motion", { method: "POST", body: JSON.stringify({ sequence: name, parameters, without }) });
    const found = await reply.json();
    if (number !== asked) return;
    status.textContent = found.error ?? `error ${(1e3 * found.rms).toFixed(3)} mm rms over the measured points, ${found.over_noise.toFixed(2)} times the noise`;
    if (!found.error) window.scene.replace(name, found.motion);
    status.dataset.rms = String(found.rms ?? "");
  } catch {
    status.textContent = "mphygs view has ended";
  }
}
for (const i of inputs) i.addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(ask, 150); });
for (const s of switches) s.addEventListener("change", ask);
document.querySelector("[data-role=sequence]").addEventListener("change", ask);
document.body.dataset.live = "true";
