"""Warp on the CPU (one core): one kernel a transfer, its tape for the gradient."""

import numpy as np
import warp as wp
import workload as w

SPACING = wp.constant(w.SPACING)
STEP = wp.constant(w.STEP)
RELAXATION = wp.constant(w.RELAXATION)
GRAVITY = wp.constant(wp.vec3(*w.GRAVITY))
MU_PER_YOUNG, LAMBDA_PER_YOUNG = (wp.constant(x) for x in w.lame_per_young())


@wp.func
def weights(s: float) -> wp.vec3:
    return wp.vec3(0.5 * (1.5 - s) * (1.5 - s), 0.75 - (s - 1.0) * (s - 1.0), 0.5 * (s - 0.5) * (s - 0.5))


@wp.kernel
def scatter(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    c: wp.array(dtype=wp.mat33),
    f: wp.array(dtype=wp.mat33),
    young: wp.array(dtype=float),
    material: wp.array(dtype=int),
    held: wp.array(dtype=int),
    rest: wp.array(dtype=wp.vec3),
    particle_mass: float,
    volume: float,
    momentum: wp.array3d(dtype=wp.vec3),
    mass: wp.array3d(dtype=float),
):
    p = wp.tid()
    scaled = x[p] / SPACING
    bi = int(scaled[0] - 0.5)
    bj = int(scaled[1] - 0.5)
    bk = int(scaled[2] - 0.5)
    s = scaled - wp.vec3(float(bi), float(bj), float(bk))
    wi = weights(s[0])
    wj = weights(s[1])
    wk = weights(s[2])
    modulus = young[material[p]]
    one = wp.identity(n=3, dtype=float)
    tau = modulus * MU_PER_YOUNG * (f[p] * wp.transpose(f[p]) - one)
    tau += modulus * LAMBDA_PER_YOUNG * wp.log(wp.determinant(f[p])) * one
    affine = particle_mass * c[p] - (4.0 * STEP * volume / (SPACING * SPACING)) * tau
    velocity = v[p]
    if held[p] == 1:
        velocity = (rest[p] - x[p]) / (RELAXATION * STEP)
    given = particle_mass * (velocity + STEP * GRAVITY)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                offset = (wp.vec3(float(i), float(j), float(k)) - s) * SPACING
                share = wi[i] * wj[j] * wk[k]
                wp.atomic_add(momentum, bi + i, bj + j, bk + k, share * (given + affine * offset))
                wp.atomic_add(mass, bi + i, bj + j, bk + k, share * particle_mass)


@wp.kernel
def update(
    momentum: wp.array3d(dtype=wp.vec3),
    mass: wp.array3d(dtype=float),
    velocity: wp.array3d(dtype=wp.vec3),
):
    i, j, k = wp.tid()
    if mass[i, j, k] > 0.0:
        velocity[i, j, k] = momentum[i, j, k] / mass[i, j, k]


@wp.kernel
def gather(
    x: wp.array(dtype=wp.vec3),
    f: wp.array(dtype=wp.mat33),
    velocity: wp.array3d(dtype=wp.vec3),
    x_next: wp.array(dtype=wp.vec3),
    v_next: wp.array(dtype=wp.vec3),
    c_next: wp.array(dtype=wp.mat33),
    f_next: wp.array(dtype=wp.mat33),
):
    p = wp.tid()
    scaled = x[p] / SPACING
    bi = int(scaled[0] - 0.5)
    bj = int(scaled[1] - 0.5)
    bk = int(scaled[2] - 0.5)
    s = scaled - wp.vec3(float(bi), float(bj), float(bk))
    wi = weights(s[0])
    wj = weights(s[1])
    wk = weights(s[2])
    value = wp.vec3()
    affine = wp.mat33()
    for i in range(3):
        for j in range(3):
            for k in range(3):
                part = wi[i] * wj[j] * wk[k] * velocity[bi + i, bj + j, bk + k]
                value += part
                affine += (4.0 / SPACING) * wp.outer(part, wp.vec3(float(i), float(j), float(k)) - s)
    v_next[p] = value
    c_next[p] = affine
    x_next[p] = x[p] + STEP * value
    f_next[p] = f[p] + STEP * affine * f[p]


@wp.kernel
def add_heights(x: wp.array(dtype=wp.vec3), loss: wp.array(dtype=float)):
    wp.atomic_add(loss, 0, x[wp.tid()][2])


class _State:
    def __init__(self, work: w.Workload, differentiable: bool) -> None:
        def make(dtype: type, shape: int | tuple) -> wp.array:
            return wp.zeros(shape, dtype=dtype, requires_grad=differentiable)

        self.x, self.v = make(wp.vec3, work.count), make(wp.vec3, work.count)
        self.c, self.f = make(wp.mat33, work.count), make(wp.mat33, work.count)
        self.momentum, self.velocity = make(wp.vec3, work.grid), make(wp.vec3, work.grid)
        self.mass = make(float, work.grid)


class Peer:
    """forward() -> final positions (N, 3) [m]; gradient() -> d(sum of final z)/dE of both materials."""

    def __init__(self, work: w.Workload, threads: int) -> None:
        if threads != 1:
            raise ValueError("Warp uses one core of the CPU")
        wp.config.quiet = True
        wp.init()
        wp.set_device("cpu")
        self.work = work
        self.rest = wp.array(work.shifted.astype(np.float32), dtype=wp.vec3)
        self.one = wp.array(np.tile(np.eye(3, dtype=np.float32), (work.count, 1, 1)), dtype=wp.mat33)
        self.material = wp.array(work.material, dtype=int)
        self.held = wp.array(work.held.astype(np.int32), dtype=int)
        self.young = wp.array(np.array(w.YOUNG, np.float32), dtype=float, requires_grad=True)
        self.loss = wp.zeros(1, dtype=float, requires_grad=True)
        self.short = [_State(work, False) for _ in range(2)]
        self.long = [_State(work, True) for _ in range(work.gradient_steps + 1)]

    def forward(self) -> np.ndarray:
        """Final positions after the forward steps, on two alternating states."""
        steps = self.work.forward_steps
        self._start(self.short[0])
        for n in range(steps):
            self._substep(self.short[n % 2], self.short[(n + 1) % 2])
        return self.short[steps % 2].x.numpy() - w.MARGIN * w.SPACING

    def gradient(self) -> np.ndarray:
        """Derivative of the sum of all final heights by both E."""
        self._start(self.long[0])
        self.loss.zero_()
        tape = wp.Tape()
        for state in self.long:
            state.momentum.zero_()
            state.mass.zero_()
        with tape:
            for now, then in zip(self.long[:-1], self.long[1:], strict=True):
                self._substep(now, then, clear=False)
            wp.launch(add_heights, dim=self.work.count, inputs=[self.long[-1].x, self.loss])
        tape.backward(self.loss)
        result = self.young.grad.numpy().astype(np.float64)
        tape.zero()
        return result

    def _start(self, state: _State) -> None:
        wp.copy(state.x, self.rest)
        wp.copy(state.f, self.one)
        state.v.zero_()
        state.c.zero_()

    def _substep(self, now: _State, then: _State, clear: bool = True) -> None:
        if clear:
            now.momentum.zero_()
            now.mass.zero_()
        fixed = [self.young, self.material, self.held, self.rest, self.work.mass, self.work.volume]
        given = [now.x, now.v, now.c, now.f, *fixed, now.momentum, now.mass]
        taken = [now.x, now.f, now.velocity, then.x, then.v, then.c, then.f]
        wp.launch(scatter, dim=self.work.count, inputs=given)
        wp.launch(update, dim=self.work.grid, inputs=[now.momentum, now.mass, now.velocity])
        wp.launch(gather, dim=self.work.count, inputs=taken)
