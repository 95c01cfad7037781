"""A gradient through the simulation: stiffness and viscosity found by torch's own optimiser."""

import bar
import torch

import mphygs


def main(steps: int = 30) -> dict[str, float]:
    """Adam on logarithms; each step is one run and one adjoint run."""
    capture = bar.make()
    model = mphygs.Model.of(capture, spacing=0.006).with_effect("viscosity", {"eta": 20.0})
    measured = torch.as_tensor(capture.sequences[0].markers.position)
    start = {"bar.youngs_modulus": 1.5e5, "viscosity.eta": 30.0}
    logs = {
        key: torch.tensor(value, dtype=torch.float64).log().requires_grad_() for key, value in start.items()
    }
    optimiser = torch.optim.Adam(logs.values(), lr=0.08)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        optimiser.zero_grad()
        position = mphygs.rollout(model, {key: log.exp() for key, log in logs.items()}, "swing")
        loss = ((position - measured) ** 2).mean() / bar.SIGMA**2
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 10 == 0:
            print(f"step {step}: chi^2 per number {float(loss.detach()):.4g}")
    found = {key: float(log.detach().exp()) for key, log in logs.items()}
    print(found)
    return found


if __name__ == "__main__":
    main()
