"""The same training steps in other libraries, where they are installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

Step = Callable[[], object]


def installed(package: str) -> bool:
    """Whether there is such a package; says so where there is not."""
    found = importlib.util.find_spec(package) is not None
    if not found:
        print(f"{package} is not installed: left out")
    return found


def jax_gru(y: Tensor, warmup: int, hidden: int) -> Step:
    """A GRU's training step as two `scan`s, compiled whole: rollout, gradient and Adam.

    XLA takes as many threads as there are cores, whatever torch is set to.
    """
    import jax  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415

    batch, length, ny = y.shape
    shapes = (
        (3 * hidden, ny),
        (3 * hidden, hidden),
        (3 * hidden,),
        (3 * hidden,),
        (ny, hidden),
        (ny,),
    )
    keys = jax.random.split(jax.random.PRNGKey(0), len(shapes))
    bound = hidden**-0.5
    weights = [
        jax.random.uniform(key, shape, minval=-bound, maxval=bound)
        for key, shape in zip(keys, shapes, strict=True)
    ]
    samples = jnp.asarray(y.numpy()).swapaxes(0, 1)

    def transition(w: Any, h: Any, x: Any) -> Any:
        from_x = jnp.split(x @ w[0].T + w[2], 3, axis=-1)
        from_h = jnp.split(h @ w[1].T + w[3], 3, axis=-1)
        r, z = (jax.nn.sigmoid(a + b) for a, b in zip(from_x[:2], from_h[:2], strict=True))
        n = jnp.tanh(from_x[2] + r * from_h[2])
        return n + z * (h - n)

    def loss(w: Any) -> Any:
        start = jnp.zeros((batch, hidden))
        h, _ = jax.lax.scan(lambda h, x: (transition(w, h, x), None), start, samples[:warmup])

        def free(h: Any, _: Any) -> Any:
            predicted = h @ w[4].T + w[5]
            return transition(w, h, predicted), predicted

        _, predicted = jax.lax.scan(free, h, None, length - warmup)
        return jnp.sqrt(jnp.mean((predicted - samples[warmup:]) ** 2))

    @jax.jit  # type: ignore[untyped-decorator]
    def step(w: Any, m: Any, v: Any, t: Any) -> Any:
        grads = jax.grad(loss)(w)
        m = [0.9 * a + 0.1 * g for a, g in zip(m, grads, strict=True)]
        v = [0.999 * a + 0.001 * g * g for a, g in zip(v, grads, strict=True)]
        scales = 1e-3 / (1 - 0.9**t), 1 / (1 - 0.999**t)
        moved = [
            p - scales[0] * a / (jnp.sqrt(b * scales[1]) + 1e-8)
            for p, a, b in zip(w, m, v, strict=True)
        ]
        return moved, m, v, t + 1

    zeros = [jnp.zeros_like(w) for w in weights]
    state = [weights, zeros, zeros, 1.0]

    def call() -> None:
        state[:] = jax.block_until_ready(step(*state))

    return call


def tsfast_gru(ny: int, hidden: int) -> tuple[torch.nn.Module, Callable[[Tensor, int], Tensor]]:
    """Its autoregressive GRU: teacher-forced over the warm-up, then on its own output."""
    from tsfast.models import AR_Model, SimpleRNN  # noqa: PLC0415

    inner = SimpleRNN(ny, ny, hidden_size=hidden, return_state=True)
    model = AR_Model(inner, model_has_state=True, return_state=True, out_sz=ny)

    def predict(warmup: Tensor, steps: int) -> Tensor:
        _, state = model(warmup, ar=False)
        y: Tensor = model(warmup.new_empty(len(warmup), steps, 0), state)[0]
        return y

    return model, predict


def tsfast_state_space(
    size: int, hidden: int, backend: str
) -> tuple[torch.nn.Module, Callable[[Tensor, int], Tensor]]:
    """Its neural state space with two hidden layers, from a given state."""
    from tsfast.models import NeuralStateSpace  # noqa: PLC0415

    model = NeuralStateSpace(1, size, size, hidden, backend=backend)
    return model, lambda h0, steps: model(h0.new_zeros(len(h0), steps, 1), h0)


def jax_state_space(y: Tensor, u: Tensor, warmup: int, weights: dict[str, Tensor]) -> Step:
    """The loss of a `StateSpace` and its gradient as two `scan`s, compiled whole.

    The outputs of the free run, on which no state depends, are computed for all samples at once.

    Parameters
    ----------
    y, u : `(batch, time, n)`.
    weights : The cell's, by name.
    """
    import jax  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415

    size = weights["gain"].shape[0]
    samples, rows = (jnp.asarray(x.numpy()).swapaxes(0, 1) for x in (y, u))
    before = jnp.concatenate([rows[:1], rows[:-1]])

    def equation(w: Any, units: str, out: str, x: Any, row: Any) -> Any:
        seen = jnp.concatenate([x, row], -1)
        active = jnp.tanh(seen @ w[f"{units}.0.weight"].T + w[f"{units}.0.bias"])
        seen = jnp.concatenate([seen, active], -1)
        return seen @ w[f"{out}.weight"].T + w[f"{out}.bias"]

    def loss(w: Any) -> Any:
        def observe(x: Any, now: Any) -> Any:
            measured, row, row_before = now
            e = measured - equation(w, "g", "observation", x, row_before)
            return equation(w, "f", "transition", x, row) + e @ w["gain"].T, None

        def free(x: Any, row: Any) -> Any:
            return equation(w, "f", "transition", x, row), x

        seen = samples[:warmup], rows[:warmup], before[:warmup]
        x, _ = jax.lax.scan(observe, jnp.zeros((y.shape[0], size)), seen)
        _, xs = jax.lax.scan(free, x, rows[warmup:])
        predicted = equation(w, "g", "observation", xs, before[warmup:])
        return jnp.sqrt(jnp.mean((predicted - samples[warmup:]) ** 2))

    gradient = jax.jit(jax.value_and_grad(loss))
    of_jax = {name: jnp.asarray(w.detach().numpy()) for name, w in weights.items()}
    return lambda: jax.block_until_ready(gradient(of_jax))
