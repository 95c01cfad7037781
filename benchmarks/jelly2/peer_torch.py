"""Plain PyTorch: index_add_ for the scatter, advanced indexing for the gather, autograd for the gradient."""

import numpy as np
import torch
import workload as w


class Peer:
    """forward() -> final positions (N, 3) [m]; gradient() -> d(sum of final z)/dE of both materials."""

    def __init__(self, work: w.Workload, threads: int) -> None:
        torch.set_num_threads(threads)
        self.work = work
        self.rest = torch.tensor(work.shifted, dtype=torch.float32)
        self.material = torch.tensor(work.material, dtype=torch.int64)
        self.held = torch.tensor(work.held)[:, None]
        self.young = torch.tensor(w.YOUNG, dtype=torch.float32)
        self.gravity = torch.tensor(w.GRAVITY)
        axis = torch.arange(3)
        self.offsets = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1).reshape(27, 3)
        self.strides = torch.tensor([work.grid[1] * work.grid[2], work.grid[2], 1])

    def forward(self) -> np.ndarray:
        """Final positions after the forward steps."""
        with torch.no_grad():
            return self._run(self.work.forward_steps, self.young).numpy() - w.MARGIN * w.SPACING

    def gradient(self) -> np.ndarray:
        """Derivative of the sum of all final heights by both E."""
        young = self.young.clone().requires_grad_()
        self._run(self.work.gradient_steps, young)[:, 2].sum().backward()
        return young.grad.numpy().astype(np.float64)

    def _run(self, steps: int, young: torch.Tensor) -> torch.Tensor:
        count, nodes = self.work.count, int(np.prod(self.work.grid))
        x, v = self.rest, torch.zeros(count, 3)
        c, f = torch.zeros(count, 3, 3), torch.eye(3).expand(count, 3, 3)
        one = torch.eye(3)
        mu, lame = ((young * ratio)[self.material][:, None, None] for ratio in w.lame_per_young())
        for _ in range(steps):
            scaled = x / w.SPACING
            base = (scaled.detach() - 0.5).to(torch.int64)
            s = scaled - base
            each = torch.stack([0.5 * (1.5 - s) ** 2, 0.75 - (s - 1) ** 2, 0.5 * (s - 0.5) ** 2], dim=1)
            weight = torch.einsum("ni,nj,nk->nijk", *each.unbind(dim=2)).reshape(count, 27, 1)
            node = ((base[:, None] + self.offsets) * self.strides).sum(-1).reshape(-1)
            offset = self.offsets - s[:, None]
            logarithm = torch.log(torch.linalg.det(f))[:, None, None]
            tau = mu * (f @ f.transpose(1, 2) - one) + lame * logarithm * one
            affine = self.work.mass * c - (4 * w.STEP * self.work.volume / w.SPACING**2) * tau
            velocity = torch.where(self.held, (self.rest - x) / (w.RELAXATION * w.STEP), v)
            momentum = self.work.mass * (velocity + w.STEP * self.gravity)
            given = weight * (momentum[:, None] + w.SPACING * offset @ affine.transpose(1, 2))
            grid = torch.zeros(nodes, 3).index_add(0, node, given.reshape(-1, 3))
            mass = torch.zeros(nodes, 1).index_add(0, node, (weight * self.work.mass).reshape(-1, 1))
            taken = weight * (grid / mass.clamp_min(1e-20))[node].reshape(count, 27, 3)
            v = taken.sum(1)
            c = 4 / w.SPACING * taken.transpose(1, 2) @ offset
            x = x + w.STEP * v
            f = f + w.STEP * c @ f
        return x
