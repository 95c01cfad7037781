"""Taichi: one kernel a transfer, its own reverse mode, the grid recomputed on the way back."""

import numpy as np
import taichi as ti
import workload as w


class Peer:
    """forward() -> final positions (N, 3) [m]; gradient() -> d(sum of final z)/dE of both materials."""

    def __init__(self, work: w.Workload, threads: int) -> None:
        ti.init(arch=ti.cpu, cpu_max_num_threads=threads, default_fp=ti.f32, log_level=ti.WARN)
        self.work = work
        self.short = _Program(work, slots=2, differentiable=False)
        self.long = _Program(work, slots=work.gradient_steps + 1, differentiable=True)

    def forward(self) -> np.ndarray:
        """Final positions after the forward steps, on two alternating states."""
        program, steps = self.short, self.work.forward_steps
        program.reset()
        for n in range(steps):
            program.substep(n % 2, (n + 1) % 2)
        ti.sync()
        return program.x.to_numpy()[steps % 2] - w.MARGIN * w.SPACING

    def gradient(self) -> np.ndarray:
        """Derivative of the sum of all final heights by both E."""
        program, steps = self.long, self.work.gradient_steps
        program.reset()
        program.clear_gradients()
        for n in range(steps):
            program.substep(n, n + 1)
        program.seed(steps)
        for n in reversed(range(steps)):
            program.clear_grid()
            program.scatter(n)
            program.update()
            program.gather.grad(n, n + 1)
            program.update.grad()
            program.scatter.grad(n)
        return program.young.grad.to_numpy().astype(np.float64)


@ti.data_oriented
class _Program:
    def __init__(self, work: w.Workload, slots: int, differentiable: bool) -> None:
        n = work.count
        kind = {"dtype": ti.f32, "needs_grad": differentiable}
        self.count = n
        self.start = work.shifted.astype(np.float32)
        self.x = ti.Vector.field(3, shape=(slots, n), **kind)
        self.v = ti.Vector.field(3, shape=(slots, n), **kind)
        self.c = ti.Matrix.field(3, 3, shape=(slots, n), **kind)
        self.f = ti.Matrix.field(3, 3, shape=(slots, n), **kind)
        self.young = ti.field(shape=2, **kind)
        self.momentum = ti.Vector.field(3, shape=work.grid, **kind)
        self.velocity = ti.Vector.field(3, shape=work.grid, **kind)
        self.mass = ti.field(shape=work.grid, **kind)
        self.rest = ti.Vector.field(3, dtype=ti.f32, shape=n)
        self.material = ti.field(dtype=ti.i32, shape=n)
        self.held = ti.field(dtype=ti.i32, shape=n)
        self.differentiable = differentiable
        self.rest.from_numpy(self.start)
        self.material.from_numpy(work.material)
        self.held.from_numpy(work.held.astype(np.int32))
        self.young.from_numpy(np.array(w.YOUNG, np.float32))
        self.particle_mass, self.volume = work.mass, work.volume
        self.mu_per_young, self.lambda_per_young = w.lame_per_young()

    def substep(self, now: int, then: int) -> None:
        self.clear_grid()
        self.scatter(now)
        self.update()
        self.gather(now, then)

    @ti.kernel
    def reset(self):
        for p in range(self.count):
            self.x[0, p] = self.rest[p]
            self.v[0, p] = ti.Vector.zero(ti.f32, 3)
            self.c[0, p] = ti.Matrix.zero(ti.f32, 3, 3)
            self.f[0, p] = ti.Matrix.identity(ti.f32, 3)

    @ti.kernel
    def clear_grid(self):
        for node in ti.grouped(self.mass):
            self.momentum[node] = ti.Vector.zero(ti.f32, 3)
            self.mass[node] = 0.0
            if ti.static(self.differentiable):
                self.momentum.grad[node] = ti.Vector.zero(ti.f32, 3)
                self.velocity.grad[node] = ti.Vector.zero(ti.f32, 3)
                self.mass.grad[node] = 0.0

    @ti.kernel
    def clear_gradients(self):
        for slot, p in self.x:
            self.x.grad[slot, p] = ti.Vector.zero(ti.f32, 3)
            self.v.grad[slot, p] = ti.Vector.zero(ti.f32, 3)
            self.c.grad[slot, p] = ti.Matrix.zero(ti.f32, 3, 3)
            self.f.grad[slot, p] = ti.Matrix.zero(ti.f32, 3, 3)
        for i in range(2):
            self.young.grad[i] = 0.0

    @ti.kernel
    def seed(self, slot: ti.i32):
        for p in range(self.count):
            self.x.grad[slot, p] = ti.Vector([0.0, 0.0, 1.0])

    @ti.kernel
    def scatter(self, now: ti.i32):
        for p in range(self.count):
            scaled = self.x[now, p] / w.SPACING
            base = ti.cast(scaled - 0.5, ti.i32)
            s = scaled - ti.cast(base, ti.f32)
            weight = [0.5 * (1.5 - s) ** 2, 0.75 - (s - 1.0) ** 2, 0.5 * (s - 0.5) ** 2]
            modulus = self.young[self.material[p]]
            mu, lame = modulus * self.mu_per_young, modulus * self.lambda_per_young
            f = self.f[now, p]
            one = ti.Matrix.identity(ti.f32, 3)
            tau = mu * (f @ f.transpose() - one) + lame * ti.log(f.determinant()) * one
            affine = self.particle_mass * self.c[now, p] - (4.0 * w.STEP * self.volume / w.SPACING**2) * tau
            velocity = self.v[now, p]
            if self.held[p] == 1:
                velocity = (self.rest[p] - self.x[now, p]) / (w.RELAXATION * w.STEP)
            momentum = self.particle_mass * (velocity + w.STEP * ti.Vector(w.GRAVITY))
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = (ti.Vector([i, j, k]) - s) * w.SPACING
                share = weight[i][0] * weight[j][1] * weight[k][2]
                node = base + ti.Vector([i, j, k])
                self.momentum[node] += share * (momentum + affine @ offset)
                self.mass[node] += share * self.particle_mass

    @ti.kernel
    def update(self):
        for node in ti.grouped(self.mass):
            if self.mass[node] > 0.0:
                self.velocity[node] = self.momentum[node] / self.mass[node]

    @ti.kernel
    def gather(self, now: ti.i32, then: ti.i32):
        for p in range(self.count):
            scaled = self.x[now, p] / w.SPACING
            base = ti.cast(scaled - 0.5, ti.i32)
            s = scaled - ti.cast(base, ti.f32)
            weight = [0.5 * (1.5 - s) ** 2, 0.75 - (s - 1.0) ** 2, 0.5 * (s - 0.5) ** 2]
            velocity = ti.Vector.zero(ti.f32, 3)
            affine = ti.Matrix.zero(ti.f32, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                share = weight[i][0] * weight[j][1] * weight[k][2]
                part = share * self.velocity[base + ti.Vector([i, j, k])]
                velocity += part
                affine += (4.0 / w.SPACING) * part.outer_product(ti.Vector([i, j, k]) - s)
            self.v[then, p] = velocity
            self.c[then, p] = affine
            self.x[then, p] = self.x[now, p] + w.STEP * velocity
            self.f[then, p] = self.f[now, p] + w.STEP * affine @ self.f[now, p]
